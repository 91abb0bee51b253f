"""An arm with torque always has an owner that will lower it, in every order of its threads.

A schedule is one order in which the lines of program, watchdog thread and guardian process run,
with signals, bus faults, stalls and SIGKILL in between; a plan determines it. In each schedule, the
tests check these invariants: while torque is on, the program or a guardian owns the arm, unless the
user left it enabled; only the owner uses the bus; no command of the program follows the beginning
of a descent; torque goes off only when the arm rests.

The tested code of the arm is the real one. Threads, locks, clocks and the pipe to the guardian are
those of `schedules`; servos, the law of the descent and the transfer of weight are stand-ins with
few steps.
"""

from __future__ import annotations

import itertools
import os
import random
import signal
import sys
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from schedules import Clock, Pipe, Plan, Scheduler

if os.name != "posix":
    pytest.skip("there is no SIGHUP and no guardian", allow_module_level=True)

import pliant
from pliant.arm import _guardian, _guardian_process, _shutdown, _signals, _supervisor
from pliant.arm import arm as arm_module
from pliant.arm._messages import Message
from pliant.drive import JointReadings

# Python drops the exception that a signal handler raises while a generator, for example that of a
# loop, is being deleted; the signal then has no effect.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

#: Files in which every line is a step.
FILES = (
    "pliant/arm/arm.py",
    "pliant/arm/_supervisor.py",
    "pliant/arm/_signals.py",
    "pliant/arm/_guardian.py",
    "pliant/arm/_guardian_process.py",
    "pliant/arm/_shutdown.py",
    "pliant/loop.py",
)
MODEL = pliant.robots.load("koch")
SERVOS = pliant.Servos(kp=np.full(MODEL.n, 20.0), max_torque=np.full(MODEL.n, 1.0))
#: Torque limit that only the program commands [N·m], and one that only the descent commands.
PROGRAM_LIMIT, DESCENT_LIMIT = 0.123, 0.05
#: Duration of a descent [periods].
DESCENT_PERIODS = 3
INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


@pytest.fixture(autouse=True)
def switch_interval():
    """Restore the interpreter's switch interval: threads of killed programs do not restore it."""
    interval = sys.getswitchinterval()
    yield
    sys.setswitchinterval(interval)


class Servos:
    """Servos that keep goals, limits and torque after the end of the program.

    Attributes:
        on: True if torque is on.
        is_descending: True from the beginning of a descent until torque on.
        periods_left: Periods of a descent until the arm rests.
        port: Drive that has the port open; None if it is closed.
        faults: Number of accesses that will fail.
    """

    def __init__(self, world):
        self.world, self.periods_left = world, DESCENT_PERIODS
        self.on, self.is_descending = False, False
        self.port, self.faults = None, 0

    def check(self, drive, description):
        """Count a step, and check that the current task may use the bus; fail for a bus fault."""
        world = self.world
        world.scheduler.retrace()
        world.scheduler.step()
        lock = drive.arm()._supervisor.lock if drive.arm is not None else None
        if self.port != drive:
            raise pliant.ServoError("the port is closed")
        if lock is not None and lock.owner is not world.scheduler.current:
            world.fail(f"{description} without the lock of the arm")
        if self.faults:
            self.faults -= 1
            raise pliant.ServoError("no answer")


#: Pickled drives by id, for the process that opens the same servos.
COPIES: dict[int, ServoDrive] = {}


def take_copy(number):
    return COPIES.pop(number)


class ServoDrive:
    """Drive of `Servos`; the guardian reopens them with a copy."""

    names = tuple(MODEL.joint_names)
    servos, stiffness_known = SERVOS, np.ones(MODEL.n, dtype=bool)
    outlives_program = True

    def __init__(self, servos):
        self.hardware, self.arm, self.counters = servos, None, {}
        self.clock = Clock(servos.world.scheduler)

    @property
    def enabled(self):
        return np.full(MODEL.n, self.hardware.on)

    def open(self):
        if self.hardware.port not in (None, self):
            raise pliant.ServoError("another program has the port")
        self.hardware.port = self

    def close(self):
        self.hardware.world.scheduler.step()
        if self.hardware.port is self:
            self.hardware.port = None

    def closed_copy(self):
        return ServoDrive(self.hardware)

    def __reduce__(self):
        COPIES[id(self)] = self
        return take_copy, (id(self),)

    def reopen(self):
        if self.hardware.world.has_ended:
            self.hardware.port = None
        self.open()
        value = 0.0 if self.hardware.on else np.nan
        return np.full(MODEL.n, value), np.full(MODEL.n, abs(value) + DESCENT_LIMIT)

    def drop_ports(self):
        raise AssertionError

    def read(self):
        self.hardware.check(self, "read")
        return JointReadings(np.zeros(MODEL.n), np.ones(MODEL.n, dtype=bool), self.clock.now())

    def poll_status(self):
        return None

    def watchdog(self, seconds):
        self.hardware.check(self, "watchdog")

    def enable(self, goal, limit):
        self.hardware.check(self, "enable")
        self.hardware.on, self.hardware.periods_left = True, DESCENT_PERIODS
        self.hardware.is_descending = False

    def write(self, goal, limit, velocity=None):
        hardware = self.hardware
        hardware.check(self, "write")
        if limit[0] == PROGRAM_LIMIT and hardware.is_descending:
            hardware.world.fail("a command of the program after the descent began")
        if limit[0] == DESCENT_LIMIT:
            hardware.periods_left = max(hardware.periods_left - 1, 0)

    def disable(self, names):
        hardware = self.hardware
        hardware.check(self, "disable")
        if hardware.on and hardware.periods_left > 0:
            hardware.world.fail(f"torque off {hardware.periods_left} periods before the arm rests")
        hardware.on = False


class Descent:
    """Stand-in for `Lowering`: the arm rests after `DESCENT_PERIODS`."""

    blind, phase = False, "down"
    world: World

    def __init__(self, *_, **__):
        self._hardware = self.world.hardware
        self._hardware.is_descending = True

    def step(self, q, ok, dt, age):
        if self._hardware.periods_left == 0:
            return None
        limit = np.full(MODEL.n, DESCENT_LIMIT)
        free = np.full(MODEL.n, np.inf)
        return SimpleNamespace(goal=np.zeros(MODEL.n), torque_limit=limit, speed_limit=free)


class Messages:
    """Stand-in for the message queue that writes each message at once."""

    def __init__(self):
        self.texts = []

    def start(self):
        pass

    def post(self, text, level=0, *, progress=False):
        self.texts.append(text)
        message = Message(text, level, progress=progress)
        message.is_written = True
        return message

    def flush(self, timeout=0.0):
        pass


class Exits:
    """Stand-in for the module `atexit`."""

    def __init__(self):
        self.functions = []

    def register(self, function):
        self.functions.append(function)

    def unregister(self, function):
        self.functions = [f for f in self.functions if f != function]


class World:
    """Program with an arm, run in the order of a plan, with or without a guardian.

    Args:
        patch: The fixture `monkeypatch`, which puts the stand-ins into modules.
        program: Function ``(world, arm)`` that uses the arm.
        guardian: True: a guardian watches the program.
        on_exit: The argument of `Arm`.
    """

    def __init__(self, patch, program, *, guardian=False, on_exit="lower"):
        self._patch, self._program = patch, program
        self.states, self.watch = [], lambda state: None
        self._has_guardian, self._on_exit = guardian, on_exit

    def fail(self, text):
        raise AssertionError(f"{self.scheduler.now:.3f} s: {text}")

    @property
    def has_ended(self):
        return "program" in self.scheduler.ended

    def may_stay_on(self):
        """Return True if the user asked for torque to stay on."""
        return (
            self.scheduler.delivered.count(INT) >= 2
            or self.is_left_enabled
            or self._on_exit == "leave_enabled"
        )

    def state(self):
        """Return the state of the arm and its owner, as in docs/lifecycle.md."""
        arm, hardware = self.arm, self.hardware
        if not hardware.on:
            return "off", "none"
        if arm.enabled and not self.has_ended:
            if "did not come back" in (arm._supervisor.reason or ""):
                return "taken over", "watchdog thread"
            if arm._signals.leaving:
                return "lowering", "program"
            if arm._supervisor.heartbeat[1] == arm_module.ENABLE_TIME:
                return "enabling", "program"
            return ("lowering" if hardware.is_descending else "on"), "program"
        if not any(g.is_watching and not g.has_rested for g in self.guardians):
            return "left on", "user"
        if self.has_ended or arm._is_unfinished or hardware.port is None:
            return "not lowered", "guardian"
        # The program is between two statements that hand the arm to its next owner.
        return self.states[-1]

    def check(self):
        """Record the state of the arm; check that an arm with torque has an owner."""
        arm = self.arm
        state = self.state()
        if self.states[-1:] != [state]:
            self.states.append(state)
        self.watch(state[0])
        if not self.hardware.on or self.may_stay_on():
            return
        if not self.has_ended and arm.enabled:
            return
        if any(guard.is_watching for guard in self.guardians):
            return
        if self.guardians or not self.needs_guardian():
            self.fail("torque is on, and neither program nor guardian owns the arm")

    @property
    def is_lowered(self):
        return self.hardware.periods_left == 0 and not self.hardware.on

    def needs_guardian(self):
        """Return True if only a guardian could lower the arm: after SIGKILL or a long bus fault."""
        kinds = {kind for kind, _ in self.scheduler.plan.actions.values()}
        reports = ("was not lowered", "torque off failed")
        is_reported = any(report in text for text in self.messages.texts for report in reports)
        return "kill" in kinds or ("call" in kinds and is_reported)

    def run(self, plan):
        """Run the program by a plan; return the number of steps.

        Raises:
            AssertionError: An invariant does not hold.
        """
        self.scheduler = scheduler = Scheduler(plan, FILES, self.check)
        self.hardware, self.messages, self.exits = Servos(self), Messages(), Exits()
        self.guardians, self.is_left_enabled = [], False
        self._put_stand_ins()
        before = {number: signal.getsignal(number) for number in _signals.HANDLED}
        signal.signal(INT, signal.default_int_handler)
        for number in _signals.HANDLED:
            if number != INT:
                signal.signal(number, self._default)
        try:
            drive = ServoDrive(self.hardware)
            self.arm = arm_module.Arm(
                MODEL,
                drive,
                rate=20.0,
                comm_timeout=0.2,
                on_exit=self._on_exit,
                guardian=self._has_guardian,
            )
            drive.arm = lambda: self.arm
            # `sys.exception()` may stay set after a trace function has raised. Run in a generator,
            # which has an exception state of its own.
            next(self._generator(scheduler))
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            _signals._REGISTRY.__init__()
            _guardian._running.clear()
        may_be_on = self.may_stay_on() or (not self.guardians and self.needs_guardian())
        assert not self.hardware.on or may_be_on, f"torque is on: {self.messages.texts}"
        return scheduler.steps

    def _generator(self, scheduler):
        scheduler.run(self._live)
        yield

    def _live(self):
        """Run the program, then the exit handlers of the interpreter."""
        with suppress(KeyboardInterrupt, SystemExit, pliant.ServoError):
            self._program(self, self.arm)
        while self.exits.functions:
            with suppress(KeyboardInterrupt, SystemExit, pliant.ServoError):
                self.exits.functions.pop()()

    def _default(self, number, frame):
        """End the program, as the default action of a signal does."""
        self.scheduler.end("program")
        self.scheduler.step()

    def _put_stand_ins(self):
        set_attribute, scheduler = self._patch.setattr, self.scheduler
        Descent.world = self
        set_attribute(_supervisor, "threading", scheduler.threading)
        set_attribute(_supervisor, "time", scheduler.time)
        # A killed program would hold the lock of the module's own object forever.
        set_attribute(_supervisor, "_SHORT_SWITCH_INTERVAL", _supervisor.ShortSwitchInterval())
        set_attribute(_signals, "time", scheduler.time)
        set_attribute(_shutdown, "time", scheduler.time)
        set_attribute(_shutdown, "Lowering", Descent)
        set_attribute(_guardian_process, "time", scheduler.time)
        set_attribute(_guardian_process, "wait", self._wait)
        set_attribute(_guardian_process, "_is_stopped", lambda _: False)
        set_attribute(arm_module, "atexit", self.exits)
        set_attribute(arm_module, "transfer_weight", self._transfer)
        set_attribute(arm_module, "Guardian", self._make_guardian)
        for module in (arm_module, _signals, _shutdown, _guardian, _guardian_process):
            set_attribute(module, "MESSAGES", self.messages)

    def _transfer(self, io, *_):
        for _ in range(2):
            io.clock.wait_until(io.clock.now() + 0.01)
            io.sample()
            io.send(io.goal, io.limit)
        return np.full(MODEL.n, np.nan)

    def _wait(self, objects, timeout):
        scheduler = self.scheduler

        def ready():
            return [t for t in objects if (self.has_ended if t == "end" else t.is_ready())]

        scheduler.wait(lambda: bool(ready()), scheduler.now + timeout)
        return ready()

    def _make_guardian(self, supervisor):
        world, scheduler = self, self.scheduler

        class Program(_guardian_process.Program):
            @property
            def sentinels(self):
                return [] if world.has_ended else ["end"]

            @property
            def has_ended(self):
                return world.has_ended

            def kill(self):
                scheduler.end("program")

        class ScheduledGuardian(_guardian.Guardian):
            def __init__(self):
                self._line, guardian_end = Pipe.pair(scheduler, "program", "guardian")
                heartbeat = memoryview(bytearray(16)).cast("d")
                program = Program(0, heartbeat)

                def work():
                    status = _guardian_process.watch(program, guardian_end)
                    if status is not None:
                        _guardian_process.take_over(*status, program)

                self._task = task = scheduler.spawn("guardian", work, "guardian")
                self._process = SimpleNamespace(
                    poll=lambda: 0 if task.is_done else None,
                    kill=lambda: setattr(task, "is_killed", True),
                    wait=lambda: None,
                    pid=0,
                )
                self._supervisor, supervisor.heartbeat = supervisor, heartbeat
                self._drive = None
                _guardian._running.add(self)
                world.guardians.append(self)

            @property
            def has_rested(self):
                return self._drive is None

            @property
            def is_watching(self):
                is_alive = not (self._task.is_done or self._task.is_killed)
                return is_alive and (self._drive is not None or world.has_ended)

        return ScheduledGuardian()


def command():
    return SimpleNamespace(goal=np.zeros(MODEL.n), torque_limit=np.full(MODEL.n, PROGRAM_LIMIT))


def ticks(world, arm, count, stall):
    """Run a loop of `count` ticks that stalls for `stall` [s] in its second tick."""
    for tick in pliant.Loop(arm, rate=20.0, duration=0.05 * count):
        tick.write(command())
        world.ending = world.scheduler.steps
        if tick.index == 1 and stall:
            arm.clock.wait_until(arm.clock.now() + stall)


def with_block(world, arm, stall):
    with arm:
        ticks(world, arm, 3, stall)


def calls(world, arm, stall):
    arm.enable()
    try:
        ticks(world, arm, 2, stall)
        arm.lower()
    finally:
        arm.close()


def again(world, arm, stall):
    """Use the arm twice; Ctrl-C ends the first use only."""
    for _ in range(2):
        with suppress(KeyboardInterrupt), arm:
            ticks(world, arm, 2, stall)


def hand_back(world, arm, stall):
    """Leave the arm enabled, take it over again, and lower it."""
    with arm:
        ticks(world, arm, 2, stall)
        world.is_left_enabled = True
        arm.leave_enabled()
        arm.enable()
        world.is_left_enabled = False
    arm.close()


def end_at_once(world, arm, stall):
    """End the program without closing the arm."""
    arm.enable()
    ticks(world, arm, 2, stall)


PROGRAMS = (with_block, calls, again, hand_back, end_at_once)
#: Durations of a stall [s]: none; until the watchdog thread may lower the arm; into the descent;
#: beyond its end.
STALLS = (0.0, 0.35, 0.4, 1.0)


class Case:
    """A program with its options.

    Attributes:
        steps: Number of steps of an undisturbed run.
        ending: Step of that run at the program's last command, before its ending.
    """

    def __init__(self, patch, program, stall, guardian, on_exit="lower"):
        self.name = f"{program.__name__}, stall {stall}, guardian {guardian}, {on_exit}"
        self.guardian = guardian
        self._make = lambda: World(
            patch,
            lambda world, arm: program(world, arm, stall),
            guardian=guardian,
            on_exit=on_exit,
        )
        world = self._make()
        self.steps = world.run(Plan())
        self.ending = world.ending
        assert world.is_lowered or on_exit == "leave_enabled", self.name

    def run(self, actions):
        """Run the program with actions (kind, value) by step, and check the invariants."""
        world = self._make()
        plan = Plan({step: self._action(world, *action) for step, action in actions.items()})
        try:
            world.run(plan)
        except AssertionError as error:
            error.add_note(f"{self.name}: {actions}")
            raise

    def _action(self, world, kind, value):
        if kind == "fault":
            return "call", lambda: setattr(world.hardware, "faults", value)
        return kind, value


def cases(patch):
    for program in PROGRAMS:
        for stall in STALLS:
            for guardian in (False, True):
                yield Case(patch, program, stall, guardian)
    yield Case(patch, with_block, 0.0, True, "leave_enabled")


def random_actions(rng, case):
    """Return one to four actions, most of them shortly after each other."""
    kinds = [("signal", INT), ("signal", TERM), ("signal", HUP), ("fault", 1), ("fault", 120)]
    kinds += [("switch", 0), ("switch", 1)] * 2
    kinds += [("kill", None)] * case.guardian
    first = step = rng.randrange(1, case.steps + 50)
    actions = {}
    for _ in range(rng.randint(1, 4)):
        actions[step] = rng.choice(kinds)
        is_near = rng.random() < 0.6
        step = max(1, first + rng.randint(-5, 40)) if is_near else rng.randrange(1, case.steps + 50)
    return actions


def run_at_random(all_cases, runs, first=0):
    for seed in range(first, first + runs):
        rng = random.Random(seed)
        case = rng.choice(all_cases)
        case.run(random_actions(rng, case))


@pytest.mark.parametrize(
    ("first", "runs"),
    [(0, 300), *(pytest.param(5000 * k, 5000, marks=pytest.mark.full) for k in range(8))],
)
def test_no_random_schedule_leaves_the_arm_without_an_owner(monkeypatch, first, runs):
    run_at_random(list(cases(monkeypatch)), runs, first)


@pytest.mark.parametrize("stride", [61, pytest.param(1, marks=pytest.mark.full)])
@pytest.mark.parametrize("guardian", [False, True])
def test_no_single_disturbance_at_any_line_breaks_an_invariant(monkeypatch, stride, guardian):
    """Try every action at every step, or at every `stride`-th step."""
    disturbances = [("signal", INT), ("signal", TERM), ("switch", 0), ("fault", 1), ("fault", 120)]
    disturbances += [("kill", None)] * guardian
    for stall in (0.0, 0.35):
        case = Case(monkeypatch, with_block, stall, guardian)
        for step in range(1, case.steps + 1, stride):
            for disturbance in disturbances:
                case.run({step: disturbance})


@pytest.mark.parametrize("program", [with_block, calls, end_at_once])
def test_two_signals_at_any_line_of_an_ending_change_nothing(monkeypatch, program):
    interrupt_ending(Case(monkeypatch, program, 0.0, guardian=False))


def interrupt_ending(case):
    for step in range(case.ending, case.ending + 110):
        case.run({step: ("signal", TERM)})
        case.run({step: ("signal", INT), step + 1 + step % 7: ("signal", TERM)})


@contextmanager
def unlocked(self, *, at_once=False):
    yield


#: Faults that replace an attribute of the code, and the program whose ending detects them; None:
#: random schedules detect them.
MUTANTS = {
    "signals raise at the beginning of `close`": (_signals.Signals, "hold", lambda _: None, None),
    "the lock is not taken for a descent": (
        _supervisor.Supervisor,
        "exclusive",
        unlocked,
        None,
    ),
    "the guardian always rests": (
        arm_module.Arm,
        "_rest_guardian",
        lambda self: self._guardian and self._guardian.rest(),
        None,
    ),
    "only the last exit handler is kept": (
        Exits,
        "register",
        lambda self, function: self.functions.__setitem__(slice(None), [function]),
        end_at_once,
    ),
    "the signal handlers do not know of a descent": (
        _signals.Signals,
        "begin",
        lambda *_: None,
        calls,
    ),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_schedules_find_a_seeded_fault(monkeypatch, name):
    owner, attribute, replacement, program = MUTANTS[name]
    all_cases = list(cases(monkeypatch)) if program is None else []
    case = None if program is None else Case(monkeypatch, program, 0.0, guardian=False)
    monkeypatch.setattr(owner, attribute, replacement)
    with pytest.raises(AssertionError):
        run_at_random(all_cases, 4000) if case is None else interrupt_ending(case)


PAGE = (Path(__file__).resolve().parents[2] / "docs" / "lifecycle.md").read_text(encoding="utf-8")


def table(heading):
    """Return the rows of the table with this heading in the section `States`."""
    section = PAGE.split("\n## States\n")[1].split("\n## ")[0]
    lines = section.split(f"\n| {heading} |\n")[1].splitlines()[1:]
    rows = itertools.takewhile(lambda line: line.startswith("|"), lines)
    return [tuple(cell.strip().strip("`") for cell in row.strip("|").split("|")) for row in rows]


OWNERS = {state: (torque, owner) for state, torque, owner in table("state | torque | owner")}
TRANSITIONS = table("state | event | then")


class Story:
    """Brings an arm into a state of docs/lifecycle.md, causes an event, and records the states."""

    def __init__(self, patch, state, event):
        self._state, self._event, self._at = state, event, None
        self.world = World(patch, self._live, guardian=True)

    def run(self):
        """Return the states and owners after the event."""
        self.world.run(Plan())
        assert self._at is not None, f"never {self._state}"
        return self.world.states[self._at :]

    def _happen(self, arm):
        """Cause the event in the awaited state."""
        world, event = self.world, self._event
        world.watch = lambda state: None
        if not world.states:
            world.scheduler.check()
        assert world.states[-1][0] == self._state
        self._at = len(world.states) - 1
        if event == "the bus is silent":
            world.hardware.faults = 120
            if self._state == "on":
                ticks(world, arm, 2, 0.0)
        elif event == "torque off fails":
            world.hardware.faults = 1
            with pytest.raises(pliant.ServoError, match="no answer"):
                arm.disable_torque()
            with pytest.raises(pliant.ServoError, match=r"torque off failed; .*its guardian"):
                arm.lower()
        elif event == "the program stalls":
            ticks(world, arm, 3, 0.4)
        elif event == "SIGKILL":
            world.scheduler.end("program")
            world.scheduler.check()
            self._at = len(world.states) - 1
        elif event.endswith("()"):
            world.is_left_enabled |= event == "leave_enabled()"
            if event == "disable_torque()":
                world.hardware.periods_left = 0
            # `lower` of an arm that was left on is an error.
            with suppress(pliant.ServoError) if self._state == "left on" else nullcontext():
                getattr(arm, event.removesuffix("()"))()
        else:
            number = INT if event.startswith("Ctrl-C") else TERM
            world.scheduler.pending.append(number)
            if event == "Ctrl-C twice":
                world.scheduler.spawn("hand", self._again)
        if event.endswith("()") or self._state not in {"enabling", "lowering"}:
            world.scheduler.step()

    def _again(self):
        """Press Ctrl-C again, after the time in which repeated signals count as one."""
        self.world.hardware.periods_left = 100
        self.world.scheduler.wait(deadline=self.world.scheduler.now + 1.0)
        self.world.scheduler.pending.append(INT)

    def _live(self, world, arm):
        def watch(state):
            is_late = state != "lowering" or world.hardware.periods_left < DESCENT_PERIODS
            if state == self._state and is_late:
                self._happen(arm)

        if self._state in {"enabling", "lowering"}:
            world.watch = watch
            arm.enable()
            arm.lower()
            return
        if self._state != "off":
            arm.enable()
        if self._state == "left on":
            world.is_left_enabled = True
            arm.leave_enabled()
        if self._state == "not lowered":
            world.hardware.faults = 85
            with suppress(pliant.ServoError):
                arm.lower()
            world.hardware.faults = 0
        if self._state == "taken over":
            with arm.supervised(0.1):
                arm.clock.wait_until(arm.clock.now() + 0.15)
                self._happen(arm)
            return
        self._happen(arm)


@pytest.mark.parametrize(("state", "event", "expected"), TRANSITIONS)
def test_states_of_the_page_are_those_of_the_code(monkeypatch, state, event, expected):
    states = Story(monkeypatch, state, event).run()
    assert ", ".join(name for name, _ in states) == expected
    for name, owner in states:
        assert OWNERS[name] == ("off" if name == "off" else "on", owner)


def test_every_state_of_the_page_is_reached_and_left():
    assert {state for state, _, _ in TRANSITIONS} == set(OWNERS)
    assert {name for *_, then in TRANSITIONS for name in then.split(", ")} == set(OWNERS)
