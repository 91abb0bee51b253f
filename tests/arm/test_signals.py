"""Signals and interpreter exit on the simulator, in separate processes; signal handlers alone."""

import os
import signal
import textwrap
import threading
from types import SimpleNamespace

import programs
import pytest

pytest.importorskip("mujoco", reason="these programs drive a simulated arm: extra sim")

import pliant
from pliant.arm import _signals
from pliant.arm._signals import Signals

# A test run in the background ignores Ctrl-C, and its children would inherit that.
BEGIN = """
import os, signal, sys, pliant
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
def report():
    plant = arm.drive.plant
    print(f"{arm.enabled} {arm.drive.enabled.any()} {plant.tool[2, 3] < start - 0.02}", flush=True)
arm = pliant.connect("koch", backend="sim", table=False, rest_q=None, q=[0.0, 1.2, 0.0, 0.0, 0.0])
start = arm.drive.plant.tool[2, 3]
"""


def run(program):
    return programs.run("-c", BEGIN + textwrap.dedent(program))


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_lowers_the_arm_and_the_handlers_come_back(name):
    result = run(f"""
        before = signal.getsignal(signal.{name})
        try:
            with arm:
                for tick in pliant.Loop(arm):
                    tick.skip()
                    if tick.index == 5:
                        os.kill(os.getpid(), signal.{name})
        finally:
            report()
            print(signal.getsignal(signal.{name}) is before, flush=True)
    """)
    assert result.stdout.split() == ["False", "False", "True", "True"], result.stderr
    expected = -signal.SIGINT if name == "SIGINT" else 128 + getattr(signal, name)
    assert result.returncode in {expected, 130}


def test_a_default_handler_that_the_program_puts_back_does_not_end_a_descent():
    result = run("""
        def once():
            arm.drive.clock.on_tick = None
            os.kill(os.getpid(), signal.SIGINT)
        arm.enable()
        # As Jupyter does in each cell.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        arm.drive.clock.wait_until(1.0)
        arm.drive.clock.on_tick = once
        try:
            arm.lower()
        except KeyboardInterrupt:
            report()
        print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)
    """)
    assert result.stdout.split() == ["False", "False", "True", "True"], result.stderr


def test_a_signal_during_the_descent_waits_for_the_ground():
    result = run("""
        def once():
            arm.drive.clock.on_tick = None
            os.kill(os.getpid(), signal.SIGTERM)
        try:
            with arm:
                arm.drive.clock.on_tick = None
                arm.drive.clock.wait_until(1.0)
                arm.drive.clock.on_tick = once
        finally:
            report()
    """)
    assert result.stdout.split() == ["False", "False", "True"], result.stderr
    assert "once it is down" in result.stderr
    assert "torque OFF" in result.stderr
    assert result.returncode == 128 + signal.SIGTERM


def test_the_end_of_the_program_lowers():
    result = run("""
        import atexit
        atexit.register(report)
        arm.enable()
    """)
    assert result.stdout.split() == ["False", "False", "True"], result.stderr
    assert "is being lowered (the program ends)" in result.stderr
    assert result.returncode == 0


def test_other_threads_are_warned_that_signals_do_nothing():
    arm = pliant.connect("koch", backend="sim", table=False, rest_q=None)
    messages = []

    def work():
        with pytest.warns(RuntimeWarning, match="outside the main thread"):
            arm.enable()
        arm.leave_enabled()
        messages.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert messages == [True]


class Presses:
    """A registry of signals with two arms, the first of which is being lowered."""

    def __init__(self, monkeypatch, *, leaving=True, is_written=True):
        self.now, self.posted, self.aborted = 0.0, [], []
        self.registry = _signals.Registry()
        self.registry._process = os.getpid()
        self.arms = [Signals(lambda k=k: self.aborted.append(k)) for k in range(2)]
        self.arms[0].leaving = leaving
        self.registry.arms += self.arms
        monkeypatch.setattr(_signals, "time", SimpleNamespace(monotonic=lambda: self.now))
        self.message = SimpleNamespace(is_written=is_written)
        monkeypatch.setattr(_signals, "MESSAGES", self)

    def post(self, text, level):
        self.posted.append(text)
        return self.message

    def press(self, *times, number=signal.SIGINT):
        """Send a signal at these times [s]; return the exceptions."""
        raised = []
        for self.now in times:
            try:
                self.registry._catch(number, None)
            except BaseException as error:
                raised.append(error)
        return raised


@pytest.mark.parametrize(
    ("times", "is_written", "is_aborted", "is_ended"),
    [
        ((10.0,), True, False, False),
        ((10.0, 10.5, 11.0), True, False, False),  # a key that is held down
        ((10.0, 10.8), True, True, False),
        ((10.0, 10.8), False, False, False),  # the message with the way to abort is not yet written
        ((10.0, 10.8, 11.7), True, True, False),  # too early: the bus may still answer
        ((10.0, 10.8, 11.9), True, True, True),
        ((10.0, 10.8, 11.3, 11.9), True, True, False),
        ((10.0, 10.8, 11.3, 12.1), True, True, True),
    ],
)
def test_ctrl_c_during_a_descent(monkeypatch, times, is_written, is_aborted, is_ended):
    presses = Presses(monkeypatch, is_written=is_written)
    raised = presses.press(*times)
    assert [error.code for error in raised] == [128 + signal.SIGINT] * is_ended
    assert presses.aborted == [0] * is_aborted
    assert [arm.stopped for arm in presses.arms] == [is_aborted, False]
    assert len(presses.posted) == 1
    assert presses.registry.pending == signal.SIGINT


def test_a_signal_other_than_ctrl_c_stays_pending(monkeypatch):
    presses = Presses(monkeypatch)
    for number, pending, messages in (
        (signal.SIGINT, signal.SIGINT, 1),
        (signal.SIGTERM, signal.SIGTERM, 2),
        (signal.SIGHUP, signal.SIGTERM, 2),
    ):
        assert presses.press(presses.now + 2.0, number=number) == []
        assert presses.registry.pending == pending
        assert len(presses.posted) == messages
    assert not presses.aborted


@pytest.mark.parametrize("cause", [KeyboardInterrupt, SystemExit])
def test_a_descent_that_ctrl_c_caused_has_announced_the_next_one(monkeypatch, cause):
    presses, announcement = Presses(monkeypatch, leaving=False), SimpleNamespace(is_written=True)
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # keeps the handler of pytest
    try:
        raise cause
    except cause:
        presses.registry.begin(presses.arms[0], announcement)
    assert presses.arms[0].leaving
    assert presses.press(10.0) == []
    assert presses.aborted == [0] * (cause is KeyboardInterrupt)
    assert len(presses.posted) == (cause is SystemExit)


@pytest.mark.parametrize(
    ("pending", "active", "stopped", "expected"),
    [
        (None, None, False, None),
        (None, KeyboardInterrupt(), False, None),
        (signal.SIGINT, None, False, "interrupt"),
        (signal.SIGTERM, None, False, 128 + signal.SIGTERM),
        # SIGTERM prevails over SIGINT, in both orders.
        (signal.SIGINT, SystemExit(128 + signal.SIGTERM), False, None),
        (signal.SIGTERM, KeyboardInterrupt(), False, 128 + signal.SIGTERM),
        (None, None, True, 128 + signal.SIGINT),
        (signal.SIGTERM, KeyboardInterrupt(), True, 128 + signal.SIGTERM),
    ],
)
def test_a_pending_signal_is_raised_after_the_last_descent(
    monkeypatch, pending, active, stopped, expected
):
    presses = Presses(monkeypatch, leaving=False)
    registry, (arm, other) = presses.registry, presses.arms

    def deliver():
        registry.pending, arm.stopped = pending, stopped
        try:
            if active is not None:
                raise active
            registry.deliver(arm)
        except BaseException:
            if active is None:
                raise
            registry.deliver(arm)

    if expected is None:
        deliver()
    else:
        with pytest.raises((KeyboardInterrupt, SystemExit)) as caught:
            deliver()
        code = getattr(caught.value, "code", "interrupt")
        assert code == expected
    assert (registry.pending, arm.stopped) == (None, False)
    # In another thread, `deliver` sends the signal to the process instead of raising.
    number = expected - 128 if isinstance(expected, int) else expected and signal.SIGINT
    sent = []
    monkeypatch.setattr(_signals.os, "kill", lambda *arguments: sent.append(arguments))
    thread = threading.Thread(target=deliver)
    thread.start()
    thread.join()
    assert sent == ([] if number is None else [(os.getpid(), number)])
    other.leaving = True
    deliver()
    assert (registry.pending, arm.stopped) == (pending, stopped)


def test_signals_without_a_descent_are_raised_once(monkeypatch):
    presses = Presses(monkeypatch, leaving=False)
    (error,) = presses.press(10.0, 10.5, 11.0)
    assert isinstance(error, KeyboardInterrupt)
    (error,) = presses.press(11.2, number=signal.SIGTERM)
    assert error.code == 128 + signal.SIGTERM
    assert len(presses.press(13.0, 14.0, number=signal.SIGTERM)) == 2
    assert not presses.posted


@pytest.mark.parametrize(
    ("former", "is_called", "is_default"),
    [
        ("handler", True, False),
        (signal.SIG_IGN, False, False),
        (signal.SIG_DFL, False, True),
        (None, False, True),  # a handler that C code has set
    ],
)
def test_a_signal_without_an_arm_goes_to_its_former_handler(
    monkeypatch, former, is_called, is_default
):
    presses, called, default = Presses(monkeypatch), [], []
    monkeypatch.setattr(os, "kill", lambda *arguments: default.append(arguments))
    monkeypatch.setattr(signal, "signal", lambda *arguments: default.append(arguments))
    handler = (lambda *arguments: called.append(arguments)) if former == "handler" else former
    presses.registry._before[signal.SIGTERM] = handler
    presses.registry.arms.clear()
    assert not presses.press(10.0, number=signal.SIGTERM)
    assert called == [(signal.SIGTERM, None)] * is_called
    assert default == (
        [(signal.SIGTERM, signal.SIG_DFL), (os.getpid(), signal.SIGTERM)] if is_default else []
    )


def test_arms_and_signals_of_the_parent_are_not_those_of_a_forked_child(monkeypatch):
    presses = Presses(monkeypatch)
    registry = presses.registry
    registry.pending, registry._process = signal.SIGTERM, os.getpid() + 1
    child = Signals(lambda: None)
    handlers = {}
    monkeypatch.setattr(signal, "signal", handlers.__setitem__)
    registry.add(child)
    assert registry.arms == [child]
    assert registry.pending is None
    assert set(handlers.values()) == {registry._catch}
    registry.remove(presses.arms[0])  # an arm of the parent process
    assert registry.arms == [child]
