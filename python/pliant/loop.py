"""Real-time control loop `Loop`: one tick per period, with timeouts for positions and commands."""

from __future__ import annotations

import logging
import math
import warnings
from array import array
from bisect import bisect_right
from contextlib import contextmanager, suppress
from threading import Thread
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pliant._core import (
    Command,
    ConfigError,
    Controller,
    Model,
    OutOfRangeError,
    ServoError,
    ServoFaultError,
    ServoTimeoutError,
)
from pliant._processes import check_real_time_priority, real_time_priority
from pliant._validation import format_value, real
from pliant.arm._checks import check_same_robot, join_faults, longest_command_age, vector
from pliant.arm._startup import unit_load

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from pliant._typing import Array
    from pliant.arm.arm import Arm
    from pliant.drive import State


LOG = logging.getLogger("pliant")
#: Time without new positions after which the controller is reset to the present pose [s], unless
#: each joint is within `HELD` [rad] of its position before, with the controller's goals within
#: `SAME_GOAL` [rad] in the servos.
RESTART, HELD, SAME_GOAL = 0.25, 0.02, 0.02
#: Time step of the controller's steps after a reset, before its first command [s], and their
#: largest number. Goals move at a limited speed; in these steps they reach the lead (goal minus
#: position) that holds the arm against gravity.
PRIME, MAX_PRIMES = 0.1, 1000
#: Time by which the arm's supervisor thread acts later than the loop when the program stalls [s].
GRACE = 0.1
#: Time for which the end of a loop waits for its recorder while the arm has torque [s].
CLOSE_PATIENCE = 0.1
#: Lowest rate of the loop [Hz], because the time step of a controller is at most 1 s.
LOWEST = 1.0
#: The delay is the median over `AVERAGE` commands. The controller gets a new median if it differs
#: from the last one by more than `CHANGE` [s] and `CHANGE_SHARE` [1].
AVERAGE, CHANGE, CHANGE_SHARE = 50, 5e-4, 0.1
#: Largest delay that the settings of a controller accept [s].
MAX_DELAY = 0.5
#: Time before an error of the loop at which the arm counts as held [s]: a servo that restarts has
#: no torque until the error is raised.
HELD_TIME = 0.1
#: Every `WATCHED`-th command is examined; after `FIRST_STEPS` in a row from the first steps of
#: controllers, the loop warns.
WATCHED, FIRST_STEPS = 4, 3
#: Longest time step of the goals' speed limit [s], as in the core.
LONGEST_SLEW = 0.1


#: Logarithmic bins of the lateness histogram: lower end of the first bin [s], number of bins per
#: decade, number of bins.
FIRST, PER_DECADE, BINS = 1e-6, 20, 140
#: Lower ends of these bins, and upper end of the last [s].
EDGES = array("d", [FIRST * 10.0 ** (i / PER_DECADE) for i in range(BINS + 1)])
#: Number of ticks that are sorted into the bins at a time.
SORTED = 64


class LatenessHistogram:
    """Histogram of the lateness of ticks: 20 bins per decade from 1 µs to 10 s."""

    def __init__(self) -> None:
        """Start with empty bins."""
        self._counts = np.zeros(BINS + 2, dtype=np.int64)
        self._largest = 0.0
        # Collect values first: when a tick begins, the bins are no longer in the caches.
        self._unsorted: list[float] = []

    def add(self, late: float) -> None:
        """Count a tick that began `late` [s] after its deadline."""
        self._unsorted.append(late)
        if len(self._unsorted) == SORTED:
            self._sort()

    def add_all(self, other: LatenessHistogram) -> None:
        """Count the ticks of another histogram."""
        self._counts = self.counts + other.counts
        self._largest = max(self.largest, other.largest)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of ticks per bin (142,): below 1 µs, in the 140 bins, above 10 s."""
        self._sort()
        return self._counts

    @property
    def largest(self) -> float:
        """Largest lateness of a tick [s]; 0 without ticks."""
        self._sort()
        return self._largest

    def _sort(self) -> None:
        unsorted, self._unsorted = self._unsorted, []
        for late in unsorted:
            self._largest = max(self._largest, late)
            self._counts[bisect_right(EDGES, late)] += 1

    def __len__(self) -> int:
        """Return the number of counted ticks."""
        return int(self.counts.sum())

    def percentile(self, share: float) -> float:
        """Return the lateness [s] at percentile `share` (0 to 100); 0 without ticks.

        The result is the upper end of a bin: up to 12 % too large, but not above `largest`.
        """
        total = len(self)
        if total == 0:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self.counts), max(share / 100.0 * total, 1e-9)))
        if place > BINS:
            return self.largest
        return min(FIRST * float(10.0 ** (place / PER_DECADE)), self.largest)

    def __str__(self) -> str:
        parts = [f"{1e6 * self.percentile(p):.0f}" for p in (50.0, 99.0, 99.9)]
        return f"{' / '.join(parts)} µs (50, 99, 99.9 %), at most {1e6 * self.largest:.0f} µs"


class Commanded(Protocol):
    """Interface of a command: joint goals and torque limits."""

    @property
    def goal(self) -> Array:
        """Joint goals (n,) [rad]."""

    @property
    def torque_limit(self) -> Array:
        """Torque limits (n,) [N·m]."""


def _close_quietly(recorder: TickRecorder, errors: list[OSError]) -> None:
    """Close the recorder; write its `OSError` to the log and append it to `errors`."""
    try:
        recorder.close()
    except OSError as error:
        LOG.error("%s", error)
        errors.append(error)


class TickRecorder(Protocol):
    """Interface of a recorder of ticks; `pliant.log.Recorder` implements it."""

    def start(self, arm: Arm, controller: Any | None, rate: float) -> Any:
        """Begin a run at `rate` [Hz]; return the controller, or a wrapper, that the loop steps."""

    def add(self, tick: Tick, command: Commanded | None) -> None:
        """Record a tick with its command; None: the tick had no command."""

    def close(self) -> None:
        """End the recording."""


class Tick:
    """One cycle of the loop.

    Attributes:
        q: Joint positions (n,) [rad], new in this tick.
        dt: Time between the position samples of the last tick and of this tick [s], at least 0.1 of
            a period. In the first tick, and after a gap of more than 0.25 s, it is one period.
        state: State of the arm in this tick.
        time: Start of the tick [s]; 0 at the first tick of the loop, on every backend.
        index: Number of ticks that the loop yielded before this one.
        began: Start of the tick on the arm's clock, which `state.time` and `arm.time` also use [s].
        command: Last command passed to `write` in this tick, also a rejected one; None: no command.
    """

    __slots__ = ("_loop", "answered", "began", "command", "dt", "index", "q", "state", "time")

    def __init__(
        self, loop: Loop, state: State, dt: float, times: tuple[float, float], index: int
    ) -> None:
        """Create a tick for `Loop`; `times` are the start of this tick and of the first one [s]."""
        began, first = times
        self._loop, self.state, self.q, self.dt = loop, state, state.q, dt
        self.began, self.time, self.index, self.answered = began, began - first, index, False
        self.command: Commanded | None = None

    def step(self, *args: Any, **inputs: Any) -> Any:
        """Step the loop's controller with `q` and `dt`, write its command and return it.

        Equivalent to ``command = loop.controller.step(tick.q, *args, dt=tick.dt, **inputs)`` and
        ``tick.write(command)``.

        Args:
            *args: Arguments of the controller's `step` after q: the target pose of a
                `pliant.Controller`, nothing for `pliant.HandGuiding`.
            **inputs: Keywords of the controller's `step`, such as `twist`.

        Raises:
            ConfigError: The loop has no controller with `step`. The controller's `step` and `write`
                may raise further errors.
        """
        step = getattr(self._loop._controller, "step", None)
        if step is None:
            raise ConfigError(
                "tick.step(...) needs a controller: pliant.Loop(arm, controller), or send commands "
                "with tick.write(command)"
            )
        command = step(self.q, *args, dt=self.dt, **inputs)
        self.answered = self._loop._write(self, command, None)
        self.command = command
        return command

    def write(
        self, command: Commanded, extra: Mapping[str, tuple[float, float]] | None = None
    ) -> bool:
        """Send a command to the servos, unless it is invalid or late.

        A command is rejected, and counted in `Loop.rejected`, if a goal or limit is not finite, or
        if the tick began longer ago than both five periods and 0.1 s. Goals and limits in the
        servos then stay unchanged.

        Args:
            command: Goals and torque limits: a `pliant.Command`, or an object with `goal` and
                `torque_limit`. Limits below the torque that gravity requires are sent as they are:
                the arm then sinks or falls, see `Arm.write`.
            extra: Goal [rad] and torque limit [N·m], by name, of joints outside the chain.

        Returns:
            True if the command was sent.

        Raises:
            ShapeError, ConfigError, OutOfRangeError: The command has the wrong number of joints, a
                negative limit, or a goal far outside the position limits; or `extra` is invalid.
            TypeError: The object is not a command.
            ServoError: Torque is off, or the connection is gone.
        """
        self.answered = self._loop._write(self, command, extra)
        self.command = command
        return self.answered

    def skip(self) -> None:
        """Leave goals and torque limits in the servos unchanged in this tick.

        Call `skip` in each tick without a command: after `arm.comm_timeout` without commands and
        calls of `skip`, the loop raises an error.
        """
        self.answered = True


class Loop:
    """Control loop over an enabled arm; an iterator of ticks (control cycles).

    A tick is yielded only with new positions of all joints. Goals and limits in the servos stay
    unchanged while positions are missing, while commands are missing or not finite, and while the
    program stalls. If positions or commands are missing for more than `arm.comm_timeout`, or a tick
    takes longer than `max_step_time`, the loop raises an error, and the arm is lowered at the end
    of its `with` block. After a gap of more than 0.25 s between positions, torque limits rise again
    within 0.5 s. If a joint has moved by more than 0.02 rad in the gap, the controller is reset to
    the present pose. If the program makes no call for the longer of `comm_timeout` and
    `max_step_time`, plus a period and 0.1 s, a thread lowers the arm (not in simulated time).

    Args:
        arm: An enabled arm.
        controller: Controller for `Tick.step`. The loop sets its delay from measurements, and
            resets it at the start and after gaps in which the arm moved. None: no controller.
        rate: Ticks per second [Hz], at least 1; None: the rate in the controller's settings, or
            `arm.rate` if it has none.
        duration: Duration of the loop [s]; None: unlimited.
        max_step_time: Longest time that the program may take in one tick [s]; inf: any time,
            without the thread; None: `arm.comm_timeout`.
        recorder: A `pliant.log.Recorder`, or an object with its `start`, `add` and `close`, which
            receives every tick with its command. The loop starts it, and closes it at the end. In
            real time, while the arm has torque, the loop waits for this for at most 0.1 s. Closing
            then continues while the arm is lowered, and `Arm.close` waits for it after torque off.
        realtime_priority: Priority (1 to 99) with the scheduling policy SCHED_FIFO of the thread
            that iterates, and of threads started in the loop, until the loop ends (Linux). Other
            programs then do not delay ticks, but your program delays them if it does not wait
            between ticks. None: no real-time scheduling.

    Attributes:
        period: Time between two ticks [s].
        duration: Duration of the loop [s]; None: unlimited.
        lateness: Histogram of the lateness of ticks.
        missed: Number of deadlines that were skipped because a tick took too long.
        missing: Number of periods without a tick, because a joint had no new position.
        rejected: Number of commands that were not sent.
        restarts: Number of gaps of more than 0.25 s between positions.
        delay: Median over 50 commands of the time from sampling positions until the servos use the
            goals computed from them [s]; None before the first 50 commands.

    Raises:
        TypeError: `arm` is not an arm, `controller` has no `reset`, or `recorder` is not one.
        ConfigError: The controller's model is of another robot than the arm's (masses, limits,
            payload, gravity, base and tip may differ). The rate is below 1 Hz, or its period is
            not a multiple of a simulated arm's period; or a time is negative or not a number; or
            the priority is out of range. While iterating: the system does not permit the priority,
            another loop over the arm has begun, or the controller steps another arm in a loop that
            has not ended.
        ServoTimeoutError: While looping: positions or commands are missing, or the program stalled.
        ServoFaultError: While looping: a servo reports a fault, or is too hot.

    Example:
        >>> with pliant.connect("arm7", backend="sim") as arm:
        ...     ctl = pliant.Controller(arm.model, settings, arm.servos)
        ...     for tick in pliant.Loop(arm, ctl, rate=100.0):
        ...         tick.step(target)
    """

    def __init__(
        self,
        arm: Arm,
        controller: Any | None = None,
        *,
        rate: float | None = None,
        duration: float | None = None,
        max_step_time: float | None = None,
        recorder: TickRecorder | None = None,
        realtime_priority: int | None = None,
    ) -> None:
        """Validate the arguments, and start the recorder if there is one."""
        if not hasattr(arm, "clock"):
            raise TypeError(
                f"arm must be an Arm, as pliant.connect(...) makes one, got {format_value(arm)}"
            )
        _check_controller(controller, arm)
        for name in ("start", "add", "close") if recorder is not None else ():
            if not callable(getattr(recorder, name, None)):
                raise TypeError(
                    "recorder must be a pliant.log.Recorder, or have start, add and close, or be "
                    f"None, got {format_value(recorder)}"
                )
        default_rate = getattr(getattr(controller, "settings", None), "rate", arm.rate)
        rate = real(default_rate if rate is None else rate, "rate")
        if not LOWEST <= rate < math.inf:
            raise ConfigError(f"rate must be {LOWEST:g} Hz or more, got {rate!r}")
        for name, time in (("duration", duration), ("max_step_time", max_step_time)):
            if time is not None and not real(time, name) >= 0.0:
                raise ConfigError(f"{name} must be 0 s or more, or None, got {time!r}")
        self._realtime_priority = check_real_time_priority(realtime_priority)
        self.period = 1.0 / rate
        grain = getattr(arm.clock, "period", None)
        if grain is not None and not _divides(grain, self.period):
            raise ConfigError(
                f"the simulated arm runs at {1.0 / grain:g} Hz and cannot run {rate:g} "
                f"ticks per second: connect(..., rate={rate:g})"
            )
        self._arm, self._clock, self.duration = arm, arm.clock, duration
        self._stale = longest_command_age(rate)
        # Age of the last rejected command [s]; 0: a goal or limit was not finite.
        self._rejected_age = 0.0
        self._max_step_time = arm.comm_timeout if max_step_time is None else float(max_step_time)
        self.lateness = LatenessHistogram()
        self.missed = self.missing = self.rejected = self.restarts = 0
        self.delay: float | None = None
        self._delays: list[float] = []
        self._recorder = recorder
        # The present tick; None: the loop has not begun, or has ended.
        self._tick: Tick | None = None
        # Positions (n,) [rad] at least `HELD_TIME` before the last ones, and those noted last; None
        # before them.
        self._held: Array | None = None
        self._marked: Array | None = None
        # Examined commands in a row that a first step made; None: the loop has warned.
        self._first_steps: int | None = 0
        self._set_controller(controller)
        if recorder is not None:
            self._controller = recorder.start(arm, controller, rate)

    @property
    def controller(self) -> Any:
        """Controller that `Tick.step` steps; with a recorder, a wrapper that records its calls.

        Pass this object to helpers that step the controller (`pliant.teach.Replay`). Assign another
        controller to let it take over: in a tick, the loop resets it to the present positions, with
        goals that hold the arm there. A controller that your program steps itself starts with goals
        at the positions, so that the arm sinks before it is carried.

        Assigning raises `TypeError` if the object has no `reset`, and `ConfigError` if its model is
        of another robot, if it steps another arm in a loop that has not ended, or if the loop has a
        recorder, which records one controller.
        """
        return self._controller

    @controller.setter
    def controller(self, controller: Any) -> None:
        if controller is self._controller:
            return
        if self._recorder is not None:
            raise ConfigError(
                "a recorder records one controller: end this loop, and give the next controller a "
                "loop and a recorder of its own"
            )
        _check_controller(controller, self._arm)
        if self._tick is None:
            self._set_controller(controller)
            return
        self._claim(controller)
        self._release()
        self._set_controller(controller)
        if self.delay is not None:
            self._report_delay(self.delay)
        self._restart(self._tick.q, first=True)

    def _set_controller(self, controller: Any) -> None:
        """Make `controller` the one that the loop steps."""
        self._controller = controller
        # `_controller` may become a wrapper of it, with the recorder.
        self._stepped = controller
        # Largest speed of the controller's goals [rad/s]; without a controller, the default.
        tracking = getattr(getattr(controller, "settings", None), "tracking", None)
        self._goal_slew = float(getattr(tracking, "goal_slew", 1.0))
        self._reported_delay: float | None = None

    def _claim(self, controller: Any) -> None:
        """Let no loop over another arm step `controller` until `_release`.

        It has the state of one arm: with another arm's positions, it would command large jumps.
        """
        other = None if controller is None else _LOOPS.get(id(controller))
        if other is not None and other._arm is not self._arm and other._arm.enabled:
            raise ConfigError(
                "this controller steps another arm in a loop that has not ended, and has the state "
                "of that arm: make a Controller for each arm"
            )
        _LOOPS[id(controller)] = self

    def _release(self) -> None:
        """End the claim on the loop's controller."""
        if _LOOPS.get(id(self._stepped)) is self:
            del _LOOPS[id(self._stepped)]

    @contextmanager
    def _exclusive_controller(self) -> Iterator[None]:
        """Return a context in which no loop over another arm may step the loop's controller."""
        self._claim(self._stepped)
        try:
            yield
        finally:
            self._tick = None
            self._release()

    @contextmanager
    def _supervised(self) -> Iterator[Callable[[], None]]:
        """Return `Arm.supervised` as a context that closes the recorder at its end."""
        if not self._arm.enabled:
            self._arm._check_usable()
        patience = max(self._max_step_time, self._arm.comm_timeout) + self.period + GRACE
        ended = False
        try:
            # The supervisor's thread inherits the priority: it must be able to interrupt a stall.
            with (
                real_time_priority(self._realtime_priority),
                self._arm.supervised(patience) as check,
            ):
                yield check
            ended = True
        except ServoError:
            # Servos may have lost their torque: the arm then falls before its descent.
            held = self._marked if self._held is None else self._held
            if held is not None:
                self._arm._io.held = (self._clock.now(), held)
            raise
        finally:
            if self._recorder is not None:
                self._close(self._recorder, raises=ended)

    def _close(self, recorder: TickRecorder, *, raises: bool) -> None:
        """Close the recorder; raise its `OSError` if `raises` is True, else write it to the log.

        After an exception in the loop, an `OSError` must not be raised, because it would replace
        that exception. In real time, an arm with torque does not wait for a slow disk or a busy
        computer: nothing supervises it any more, and after an exception it must come down.
        """
        if getattr(self._clock, "real_time", False) and self._arm.enabled:
            errors: list[OSError] = []
            thread = Thread(
                target=_close_quietly, args=(recorder, errors), name="pliant-log", daemon=True
            )
            thread.start()
            self._arm._finish_later(thread)
            if raises:
                thread.join(CLOSE_PATIENCE)
                if errors and not thread.is_alive():
                    raise errors[0]
            return
        try:
            recorder.close()
        except OSError as error:
            if raises:
                raise
            LOG.error("%s", error)

    def __iter__(self) -> Iterator[Tick]:
        """Wait for each deadline, read the arm, and yield a tick if all positions are new.

        The arm's supervisor thread runs meanwhile; the recorder is closed at the end.
        """
        arm, clock, shortest = self._arm, self._arm.clock, 0.1 * self.period
        last: float | None = None
        first: float | None = None
        tick: Tick | None = None
        mark = -math.inf
        self._held = self._marked = None
        with self._exclusive_controller(), self._supervised() as check:
            begin = deadline = clock.now()
            commanded, before, index = begin, begin, 0
            while self.duration is None or deadline - begin < self.duration - 1e-9:
                clock.wait_until(deadline)
                now = clock.now()
                self.lateness.add(now - deadline)
                state = arm.read()
                if state.faults:
                    raise ServoFaultError(join_faults(state.faults))
                if state.fresh:
                    time = state.time
                    if now >= mark:
                        self._held, self._marked = self._marked, state.q
                        mark = now + HELD_TIME
                    if last is None or time - last > RESTART:
                        self._restart(state.q, first=last is None, before=tick)
                        last = None
                    if last is None:
                        dt = self.period
                    elif time - last < shortest:
                        dt = shortest
                    else:
                        dt = time - last
                    last = time
                    first = now if first is None else first
                    tick = self._tick = Tick(self, state, dt, (now, first), index)
                    try:
                        yield tick
                    finally:
                        if self._recorder is not None:
                            self._recorder.add(tick, tick.command)
                    check()
                    index += 1
                    done = clock.now()
                    if done - now > self._max_step_time:
                        if not arm.enabled:  # the program itself lowered the arm in this tick
                            arm._check_usable()
                        raise ServoTimeoutError(
                            f"the program did not come back for {done - now:.2f} s (max_step_time "
                            f"allows {self._max_step_time:g} s); the servos held meanwhile"
                        )
                    commanded = now if tick.answered else commanded
                    if now - commanded > arm.comm_timeout:
                        raise ServoTimeoutError(
                            f"no command could be sent for {now - commanded:.2f} s: {self._cause()}"
                        )
                else:
                    self.missing += 1
                    # Do not count a pause before the loop as silence of the joints.
                    ages = np.minimum(state.age, now - begin)
                    self._wait_no_longer_than(ages, arm.comm_timeout)
                    # Extend the command timeout: without a tick there is no command.
                    commanded += now - before
                before = now
                deadline += self.period
                late = clock.now() - deadline
                if late > 0.0:
                    skipped = math.ceil(late / self.period - 1e-9)
                    self.missed += skipped
                    deadline += skipped * self.period

    def _cause(self) -> str:
        """Return the cause and the remedy for ticks without a command."""
        if self.rejected and self._rejected_age:
            return (
                f"the last one came {self._rejected_age:.2f} s after the start of its tick, where "
                f"{self._stale:.2f} s are allowed: reading the arm or the program takes too long; "
                "`pliant servos doctor ARM` measures the reading; a lower rate allows more"
            )
        return "every tick needs tick.write(command) with finite numbers, or tick.skip()"

    def _wait_no_longer_than(self, ages: Array, longest: float) -> None:
        """Raise `ServoTimeoutError` if a position is older than `longest` [s].

        `ages` are the ages of the positions (n,) [s].
        """
        if ages.max() > longest:
            joints = self._arm.model.joint_names
            names = [name for name, age in zip(joints, ages, strict=True) if age > longest]
            silent, where = ", ".join(names), "its power, the cable to it, and those before it"
            if len(names) == len(joints):
                silent, where = "any joint", "the power supply, and the cable from the adapter"
            raise ServoTimeoutError(
                f"no position of {silent} for {ages.max():.2f} s: look at {where}"
            )

    def _restart(self, q: Array, *, first: bool, before: Tick | None = None) -> None:
        """Reset the controller to q (n,) [rad], so that its next goal holds the arm at q.

        Unless this is the `first` reset, count it and ramp the torque limits up again. Do not reset
        the controller if its goals have held the arm since the tick `before`.
        """
        controller = self._controller
        if not first:
            self.restarts += 1
            self._arm.ramp_limits()
        if controller is None or (before is not None and self._is_held(q, before)):
            return
        if first:
            capture_leads(self._arm, controller)
        # Reset afterwards: the goals of `reset` depend on the gravity offset.
        controller.reset(q)
        if isinstance(self._stepped, Controller):
            self._prime(controller, q)
        elif hasattr(controller, "model"):
            controller.step(q, controller.model.forward_kinematics(q), dt=PRIME)

    def _prime(self, controller: Any, q: Array) -> None:
        """Move the goals of a controller, just reset to q (n,) [rad], to where they hold the arm.

        They start at q and move at a limited speed. Long steps, whose commands are not sent, move
        them until the lead of no joint is at this limit. The null space has no part in these steps.
        """
        largest = float(controller.settings.tracking.goal_slew) * PRIME * (1.0 - 1e-6)
        pose, still = controller.model.forward_kinematics(q), np.zeros_like(q)
        for number in range(1, MAX_PRIMES + 1):
            command = controller.step(q, pose, dt=PRIME, gradient=still)
            if float(np.abs(command.goal - q).max()) < number * largest:
                return

    def _is_held(self, q: Array, before: Tick) -> bool:
        """Return True if the controller's goals have held the arm since the tick `before`.

        The controller then continues: the reference of a reset starts at the tool and accelerates
        toward the target. With a further gap, the goals of this acceleration stay in the servos and
        move the arm.
        """
        command = before.command
        return (
            isinstance(self._stepped, Controller)
            and isinstance(command, Command)
            and float(np.abs(q - before.q).max()) <= HELD
            and float(np.abs(self._arm._io.goal - command.goal).max()) <= SAME_GOAL
        )

    def _watch_first_steps(self, tick: Tick, command: Command) -> None:
        """Warn if commands keep coming from the first steps of controllers.

        The goals of a first step are at most `dt` times `goal_slew` away from the positions, and a
        joint that carries weight is at this bound. The goals of later steps are not, because they
        move from the last goals.

        Warns:
            RuntimeWarning: The goals do not carry the arm.
        """
        lead = float(np.abs(command.goal - tick.q).max())
        bounds = [self._goal_slew * min(dt, LONGEST_SLEW) for dt in (tick.dt, self.period)]
        if not any(abs(lead - bound) < 1e-6 * bound for bound in bounds):
            self._first_steps = 0
            return
        self._first_steps = (self._first_steps or 0) + 1
        if self._first_steps < FIRST_STEPS:
            return
        self._first_steps = None
        warnings.warn(
            "every command comes from the first step of a controller, whose goals start at the "
            "present positions: they do not carry the arm, which sinks or falls. Make the "
            "Controller once, before the loop, and do not reset it in every tick; "
            "controller.update(settings) changes its settings, tick.step(target) its target",
            RuntimeWarning,
            stacklevel=4,
        )

    def _write(
        self, tick: Tick, command: Commanded, extra: Mapping[str, tuple[float, float]] | None
    ) -> bool:
        """Check a command; send it and return True, or count it as rejected and return False."""
        arm, clock = self._arm, self._clock
        if isinstance(command, Command):
            if self._first_steps is not None and tick.index % WATCHED == 0:
                self._watch_first_steps(tick, command)
            goal, limit, speed = command.goal, command.torque_limit, command.speed_limit
        elif hasattr(command, "goal") and hasattr(command, "torque_limit"):
            goal = vector(arm.model, command.goal, "goal", finite=False)
            limit = vector(arm.model, command.torque_limit, "limit", finite=False)
            speed = None
        else:
            raise TypeError(
                "command must be a Command, as Controller.step makes one, or have goal and "
                f"torque_limit, got {format_value(command)}; arm.write(goal, limit) "
                "takes bare numbers"
            )
        if (age := clock.now() - tick.began) > self._stale:
            if not arm.enabled:  # a tick of an arm that has ended, which accepts no command at all
                arm._check_usable()
            self._rejected_age = age
            self.rejected += 1
            return False
        try:
            arm.write(goal, limit, extra, lead=speed is not None, velocity=speed)
        except OutOfRangeError:
            if np.isfinite(goal).all() and np.isfinite(limit).all():
                raise
            self._rejected_age = 0.0
            self.rejected += 1
            return False
        self._delays.append(clock.now() - tick.state.time)
        if len(self._delays) == AVERAGE:
            self._measure()
        return True

    def _measure(self) -> None:
        """Store the median delay of the last 50 commands, plus the drive's latency.

        The controller gets it if it differs enough from the value set before.

        Raises:
            ServoError: A controller cannot account for this delay.
        """
        self.delay = float(np.median(self._delays)) + getattr(self._arm.drive, "latency", 0.0)
        self._delays.clear()
        reported = self._reported_delay
        if reported is None or abs(self.delay - reported) > max(CHANGE, CHANGE_SHARE * reported):
            self._report_delay(self.delay)

    def _report_delay(self, delay: float) -> None:
        """Pass the delay [s] to the controller; `ServoError` if it cannot account for it."""
        self._reported_delay = delay
        tell = getattr(self._controller, "set_delay", None)
        if tell is None:
            return
        if not 0.0 <= delay <= MAX_DELAY:
            raise ServoError(
                f"positions are {delay:.3g} s old when the goals made from them are used, where 0 "
                f"to {MAX_DELAY:g} s are possible: reading the arm takes too long, or its drive "
                "returns old readings or readings with a wrong time"
            )
        tell(delay)


def capture_leads(arm: Arm, controller: Any) -> None:
    """Pass the leads and the load of torque on to a controller, if servo stiffness is not known.

    The load adds once to the payload of the model; a payload of the controller's own stays. A later
    change of the payload changes the leads. The controller's `capture_gravity`, if it has one,
    derives the gravity offset from the lead (goal minus position) that held each joint when torque
    was switched on, and from the weight at the positions of that time: the arm may have moved
    since. For joints without a measured lead, the lead is the gravity torque divided by the assumed
    stiffness.
    """
    capture, leads = getattr(controller, "capture_gravity", None), getattr(arm, "_free_leads", None)
    if capture is None or leads is None or arm.servos.stiffness_known:
        return
    q, own = arm._leads_q, arm.model.payload
    mass, moment = (own.mass, own.mass * own.com) if own else (0.0, np.zeros(3))
    is_new = all(known is not controller for known in arm._loaded)
    if arm.load > 0.0 and is_new and getattr(controller, "payload", arm) == own:
        total = mass + arm.load
        # Refused where the servos cannot hold the load in any posture.
        with suppress(OutOfRangeError):
            controller.set_payload(total, moment / total)
        arm._loaded.append(controller)
    payload = getattr(controller, "payload", own)
    carried, kp = payload.mass if payload else 0.0, np.asarray(arm.servos.kp)
    if arm._leads_mass is None:
        arm._leads_mass = carried
    unit = unit_load(arm.model, q) / kp
    modelled = np.asarray(arm.model.gravity(q)) / kp + (carried - mass) * unit
    changed = leads + (carried - arm._leads_mass) * unit
    capture(q, q + np.where(np.isfinite(leads), changed, modelled))


def _check_controller(controller: Any, arm: Arm) -> None:
    """Raise `TypeError` or `ConfigError` if `controller` cannot step `arm`."""
    if controller is not None and not callable(getattr(controller, "reset", None)):
        raise TypeError(
            f"controller must be a Controller, or have reset(q), or be None, got "
            f"{format_value(controller)}"
        )
    # `HandGuiding` has a model too, but no public one.
    model = getattr(controller, "model", getattr(controller, "_model", None))
    if isinstance(model, Model):
        check_same_robot(model, arm.model)


#: Loops that iterate, by the id of their controller.
_LOOPS: dict[int, Loop] = {}


def _divides(grain: float, period: float) -> bool:
    """Return True if `period` is a multiple of `grain`, both in [s]."""
    ratio = period / grain
    return ratio > 0.5 and abs(ratio - round(ratio)) < 1e-6
