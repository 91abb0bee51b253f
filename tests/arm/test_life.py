"""Random sequences of life-cycle calls and signals, with one arm or two: effects of a signal."""

import signal
import threading
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="these arms are simulated: extra sim")

from bare_arm import bare_arm
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

import pliant
import pliant.arm._signals
import pliant.arm.arm
from pliant.sim import Plant, SimDrive

HANDLED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
NUMBERS = [getattr(signal, name) for name in HANDLED if hasattr(signal, name)]
#: Times between two signals [s] that count as one request, and as two.
REPEAT_GAP, DELIBERATE_GAP = 0.1, 2.0
LOW = np.array([0.0, 1.5, 0.0, 0.0, 0.0])
#: Number of loop iterations of the stand-in for a descent in these tests.
ITERATIONS = 12


def expected(number):
    return KeyboardInterrupt if number == signal.SIGINT else SystemExit


class Life(RuleBasedStateMachine):
    """State machine that predicts which arms have torque after random calls and signals."""

    def __init__(self):
        super().__init__()
        self.patch = pytest.MonkeyPatch()
        self.time, self.during, self.heard = 100.0, [], []
        clock = SimpleNamespace(monotonic=lambda: self.time)
        self.patch.setattr(pliant.arm._signals, "time", clock, raising=False)
        self.patch.setattr(pliant.arm.arm, "descend", self.descend)
        self.patch.setattr(
            pliant.arm.arm, "transfer_weight", lambda _, start_q, *__: np.full(5, np.nan)
        )
        self.former = lambda number, _: self.heard.append(number)
        self.before = {number: signal.signal(number, self.former) for number in NUMBERS}
        self.last = (0, -10.0)

    def teardown(self):
        self.during.clear()
        for arm in getattr(self, "arms", []):
            arm.close()
        for number, handler in self.before.items():
            signal.signal(number, handler)
        self.patch.undo()

    @initialize(has_second=st.booleans())
    def make(self, has_second):
        self.arms = []
        for _ in range(1 + has_second):
            plant = Plant(pliant.robots.koch(), dt=0.005)
            plant.reset(LOW)
            self.arms.append(pliant.arm.Arm(plant.model, SimDrive(plant)))
        self.on = [False] * len(self.arms)
        self.left_on = [False] * len(self.arms)

    def descend(self, io, rest_q, rate, is_aborted, **_):
        """Replace a descent by a wait of `ITERATIONS` iterations, in which signals arrive."""
        for _ in range(ITERATIONS):
            if self.during:
                number, gap = self.during.pop(0)
                self.wait(gap)
                signal.raise_signal(number)
            if is_aborted():
                return False
            io.clock.wait_until(io.clock.now() + 1.0 / rate)
        return True

    def wait(self, seconds):
        self.time += seconds
        if messages := getattr(pliant.arm._signals, "MESSAGES", None):
            messages.flush(5.0)

    def which(self, data):
        return data.draw(st.integers(0, len(self.arms) - 1), label="arm")

    @rule(data=st.data())
    def enable(self, data):
        index = self.which(data)
        if not self.on[index]:
            self.last = (0, -10.0)
        self.arms[index].enable()
        self.on[index], self.left_on[index] = True, False

    @rule(data=st.data(), verb=st.sampled_from(["leave_enabled", "disable_torque", "close"]))
    def leave(self, data, verb):
        index = self.which(data)
        getattr(self.arms[index], verb)()
        if verb == "leave_enabled":
            self.left_on[index] |= self.on[index]
        elif verb == "disable_torque":
            self.left_on[index] = False
        self.on[index] = False

    @rule(
        data=st.data(),
        park=st.booleans(),
        arrivals=st.lists(
            st.tuples(st.sampled_from(NUMBERS), st.sampled_from([REPEAT_GAP, DELIBERATE_GAP])),
            max_size=4,
        ),
    )
    def lower(self, data, park, arrivals):
        index = self.which(data)
        arm = self.arms[index]
        self.during = list(arrivals)
        if self.on[index]:
            kind, is_stopped = self.foresee(arrivals)
        else:
            kind, is_stopped, self.during = None, False, []
        drive_on = arm.drive.enabled.any()
        if self.left_on[index]:
            kind = pliant.ServoError

        def run():
            arm.park(LOW) if park else arm.lower()

        if kind is None:
            run()
        else:
            with pytest.raises(kind):
                run()
        if self.on[index]:
            assert arm.drive.enabled.any() == is_stopped
            self.left_on[index] = is_stopped
        else:
            assert arm.drive.enabled.any() == drive_on
        self.on[index] = False
        self.during = []

    def foresee(self, arrivals):
        """Return the exception class of a descent with signals, and True if torque stays on.

        The class is None if the descent raises nothing.
        """
        time, last, interrupts, kind = self.time, self.last, 0, None
        for number, gap in arrivals:
            time += gap
            is_repeat = last[0] == number and time - last[1] < 0.5
            last = (number, time)
            if number != signal.SIGINT:
                kind = SystemExit
            elif interrupts == 0:
                interrupts, kind = 1, kind or KeyboardInterrupt
            elif not is_repeat:
                self.last = last
                return SystemExit, True
        self.last = last
        return kind, False

    @rule(number=st.sampled_from(NUMBERS), gap=st.sampled_from([REPEAT_GAP, DELIBERATE_GAP]))
    def signal(self, number, gap):
        self.wait(gap)
        is_repeat = self.last[0] == number and self.time - self.last[1] < 0.5
        if not any(self.on):
            count = len(self.heard)
            signal.raise_signal(number)
            assert len(self.heard) == count + 1
        else:
            self.last = (number, self.time)
            if is_repeat:
                signal.raise_signal(number)
            else:
                with pytest.raises(expected(number)):
                    signal.raise_signal(number)

    @precondition(lambda self: len(getattr(self, "arms", [])) == 2)
    @rule(number=st.sampled_from(NUMBERS), swap=st.booleans())
    def with_both(self, number, swap):
        """Check that a signal inside nested `with` blocks of two arms lowers both of them."""
        first, second = self.arms[::-1] if swap else self.arms
        self.last = (0, -10.0)

        def run():
            with first, second:
                self.time += DELIBERATE_GAP
                signal.raise_signal(number)

        with pytest.raises(expected(number)):
            run()
        assert not any(arm.drive.enabled.any() for arm in self.arms)
        self.last = (number, self.time)
        self.on, self.left_on = [False, False], [False, False]

    @rule(data=st.data())
    def lower_elsewhere(self, data):
        """Lower one arm in another thread; signals in the main thread affect the other arms."""
        index = self.which(data)
        arm, errors = self.arms[index], []

        def lower():
            try:
                arm.lower()
            except pliant.ServoError as error:
                errors.append(error)

        thread = threading.Thread(target=lower)
        thread.start()
        thread.join()
        assert bool(errors) is self.left_on[index]
        self.on[index] = False

    @invariant()
    def belief_holds(self):
        if not hasattr(self, "arms"):
            return
        assert [arm.enabled for arm in self.arms] == self.on
        for number in NUMBERS:
            if any(self.on):
                assert signal.getsignal(number) != self.former


@pytest.mark.parametrize("examples", [60, pytest.param(1500, marks=pytest.mark.full)])
def test_a_signal_does_the_same_in_every_life(examples):
    run_state_machine_as_test(
        Life,
        settings=settings(
            max_examples=examples,
            stateful_step_count=20,
            deadline=None,
            derandomize=examples < 100,
            suppress_health_check=list(HealthCheck),
        ),
    )


def test_a_handler_that_a_program_puts_back_later_acts_as_the_former_one():
    calls = []
    before = signal.signal(signal.SIGTERM, lambda *_: calls.append("former"))
    try:
        arm = bare_arm("koch", q=LOW)
        arm.enable()
        previous = signal.signal(signal.SIGTERM, lambda *_: calls.append("program"))
        arm.leave_enabled()
        signal.raise_signal(signal.SIGTERM)
        signal.signal(signal.SIGTERM, previous)
        signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert calls == ["program", "former"]
