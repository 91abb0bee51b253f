"""Control loop that yields one tick per period, and stops if positions or commands are missing."""

from __future__ import annotations

import logging
import math
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pliant._core import Command, ConfigError, ServoError, ServoFaultError, ServoTimeoutError
from pliant._validation import format_value, real
from pliant.arm._checks import vector

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pliant._typing import Array
    from pliant.arm.arm import Arm
    from pliant.drive import State


LOG = logging.getLogger("pliant")
#: Gap between two steps after which a controller is reset to the present pose [s].
RESTART = 0.25
#: A command is rejected if its tick began longer ago than `STALE_PERIODS` periods and `STALE` [s].
STALE_PERIODS, STALE = 5.0, 0.1
#: Time step of the controller step after a reset [s]: long enough for a goal that holds the arm
#: against gravity, because goals move at a limited speed.
PRIME = 0.1
#: Extra time before the arm's watchdog acts on a stall, so that the loop detects it first [s].
GRACE = 0.1
#: Lowest rate [Hz]: the time step of a controller is at most 1 s.
LOWEST = 1.0
#: The delay is the median of `AVERAGE` commands. The controller is told if it changes by more than
#: `CHANGE` [s] and by more than the share `CHANGE_SHARE` of the value reported last.
AVERAGE, CHANGE, CHANGE_SHARE = 50, 5e-4, 0.1


#: Histogram bins: lower end of the first [s] (`FIRST`), bins per decade (`PER_DECADE`), and number
#: of bins (`BINS`); they end at 10 s.
FIRST, PER_DECADE, BINS = 1e-6, 20, 140


class LatenessHistogram:
    """Histogram of ticks by lateness, 20 bins per decade from 1 µs to 10 s.

    Attributes:
        counts: Ticks per bin (142,): below 1 µs, the 140 bins, above 10 s.
        largest: Largest lateness of a tick [s]; 0 without ticks.
    """

    def __init__(self) -> None:
        """Start with empty bins."""
        self.counts = np.zeros(BINS + 2, dtype=np.int64)
        self.largest = 0.0

    def add(self, late: float) -> None:
        """Count a tick that began `late` [s] after its deadline."""
        late = max(late, 0.0)
        self.largest = max(self.largest, late)
        bin_ = 0
        if late >= FIRST:
            bin_ = min(1 + int(PER_DECADE * math.log10(late / FIRST)), BINS + 1)
        self.counts[bin_] += 1

    def __len__(self) -> int:
        """Return the number of ticks."""
        return int(self.counts.sum())

    def percentile(self, share: float) -> float:
        """Return the lateness [s] at percentile `share` (0 to 100); 0 without ticks.

        It is the upper end of a bin, so up to 12 % too large, but never above `largest`.
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
    """Protocol of a command: joint goals and torque limits."""

    @property
    def goal(self) -> Array:
        """Joint goals (n,) [rad]."""

    @property
    def torque_limit(self) -> Array:
        """Torque limits (n,) [N·m]."""


class TickRecorder(Protocol):
    """Protocol of a recorder of ticks; `pliant.log.Recorder` is one."""

    def start(self, arm: Arm, controller: Any | None, rate: float) -> Any:
        """Begin a run at `rate` [Hz]; return the controller that the loop steps."""

    def add(self, tick: Tick, command: Commanded | None) -> None:
        """Record a tick with its command."""

    def close(self) -> None:
        """Finish the record."""


class Tick:
    """One cycle of the loop.

    Attributes:
        q: Joint positions (n,) [rad], new in this tick.
        dt: Time from the position sample of the last tick to that of this tick [s], at least 0.1
            of a period; one period in the first tick and after a reset of the controller.
        state: State of the arm in this tick.
        time: Start of the tick [s]; 0 at the first tick of the loop, on every backend.
        index: Number of ticks that the loop yielded before this one.
        began: Start of the tick on the arm's clock, which `state.time` and `arm.time` also use [s].
        command: Last command given to `write` in this tick, sent or not; None before.
    """

    __slots__ = ("_loop", "answered", "began", "command", "dt", "index", "q", "state", "time")

    def __init__(
        self, loop: Loop, state: State, dt: float, times: tuple[float, float], index: int
    ) -> None:
        """Store the state; `Loop` creates ticks. `times`: start of this and the first tick [s]."""
        began, first = times
        self._loop, self.state, self.q, self.dt = loop, state, state.q, dt
        self.began, self.time, self.index, self.answered = began, began - first, index, False
        self.command: Commanded | None = None

    def step(self, *args: Any, **inputs: Any) -> Any:
        """Step the loop's controller with `q` and `dt`, write its command and return it.

        Short for ``command = loop.controller.step(tick.q, *args, dt=tick.dt, **inputs)`` and
        ``tick.write(command)``.

        Args:
            *args: Arguments of the controller's `step` after q: the target pose of a
                `pliant.Controller`, nothing for `pliant.HandGuiding`.
            **inputs: Keywords of the controller's `step`, such as `twist`.

        Raises:
            ConfigError: The loop has no controller with `step`. All that the controller's `step`
                and `write` raise.
        """
        step = getattr(self._loop.controller, "step", None)
        if step is None:
            raise ConfigError(
                "tick.step(...) needs a controller: pliant.Loop(arm, controller), or send commands "
                "with tick.write(command)"
            )
        command = step(self.q, *args, dt=self.dt, **inputs)
        self.write(command)
        return command

    def write(
        self, command: Commanded, extra: Mapping[str, tuple[float, float]] | None = None
    ) -> bool:
        """Send a command; if it is rejected, goals and limits in the servos stay unchanged.

        A command is rejected, and counted in `Loop.rejected`, if a goal or limit is not finite, or
        if the tick began longer ago than five periods and 0.1 s.

        Args:
            command: Goals and limits: a `pliant.Command`, or an object with `goal` and
                `torque_limit`. The limits are not raised to the weight: an arm whose limits are
                too low sinks or falls, see `Arm.write`.
            extra: Goal [rad] and limit [N·m] of joints off the chain by name.

        Returns:
            True if the command was sent.

        Raises:
            ShapeError, ConfigError, OutOfRangeError: Wrong number of joints, or a negative limit.
            TypeError: Not a command.
            ServoError: Torque is off, or the connection is gone.
        """
        self.answered = self._loop._write(self, command, extra)
        self.command = command
        return self.answered

    def skip(self) -> None:
        """Leave goals and limits unchanged in this tick.

        Call it in each tick without a command: the loop raises after `arm.comm_timeout` without
        commands and without calls of `skip`.
        """
        self.answered = True


class Loop:
    """Control loop over an enabled arm; an iterator of ticks.

    A tick is yielded only with new positions of all joints. Goals and limits stay unchanged while
    positions are missing, while commands are missing or not finite, and while the program stalls.
    If positions or commands are missing for more than `arm.comm_timeout`, or a tick takes longer
    than `max_step_time`, the loop raises, and the arm's `with` lowers the arm. After a gap of more
    than 0.25 s between positions the controller is reset to the present pose, and limits rise again
    within 0.5 s. If the program makes no call for the longer of `comm_timeout` and `max_step_time`,
    plus a period and 0.1 s, a thread lowers the arm (not in simulated time).

    Args:
        arm: The arm, enabled.
        controller: Controller that `Tick.step` steps. The loop sets its delay from measurements,
            and resets it at the start and after gaps. None: no controller.
        rate: Ticks per second [Hz], at least 1; None: the rate in the controller's settings, or
            `arm.rate` if it has none.
        duration: Duration of the loop [s]; None: unlimited.
        max_step_time: Longest time that the program may take in one tick [s]; None:
            `arm.comm_timeout`.
        recorder: A `pliant.log.Recorder`, or an object with its `start`, `add` and `close`. It
            receives every tick with its command. It is started here and closed when the loop ends.

    Attributes:
        controller: Controller to step. With a recorder, a wrapper that records its calls. Pass this
            object to helpers that step the controller (`pliant.teach.Replay`).
        period: Time between two ticks [s].
        duration: As given.
        lateness: Histogram of the lateness of ticks.
        missed: Number of deadlines skipped because a tick took too long.
        missing: Number of ticks without new positions of all joints.
        rejected: Number of commands that were not sent.
        restarts: Number of resets after a gap; the reset at the start is not counted.
        delay: Median time from the sample of positions to the effect of the goals computed from
            them [s], over 50 commands; None before.

    Raises:
        TypeError: `arm` is not an arm, or `controller` has no `reset`.
        ConfigError: The rate is below 1 Hz, or its period is not a multiple of a simulated arm's
            period; or a time is negative or not a number.
        ServoTimeoutError: While looping: positions, commands or the program stalled.
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
    ) -> None:
        """Check the arguments."""
        if not hasattr(arm, "clock"):
            raise TypeError(
                f"arm must be an Arm, as pliant.connect(...) makes one, got {format_value(arm)}"
            )
        if controller is not None and not callable(getattr(controller, "reset", None)):
            raise TypeError(
                f"controller must be a Controller, or have reset(q), or be None, got "
                f"{format_value(controller)}"
            )
        default_rate = getattr(getattr(controller, "settings", None), "rate", arm.rate)
        rate = real(default_rate if rate is None else rate, "rate")
        if not LOWEST <= rate < math.inf:
            raise ConfigError(f"rate must be {LOWEST:g} Hz or more, got {rate!r}")
        for name, time in (("duration", duration), ("max_step_time", max_step_time)):
            if time is not None and not real(time, name) >= 0.0:
                raise ConfigError(f"{name} must be 0 s or more, or None, got {time!r}")
        self.period = 1.0 / rate
        grain = getattr(arm.clock, "period", None)
        if grain is not None and not _divides(grain, self.period):
            raise ConfigError(
                f"the simulated arm runs at {1.0 / grain:g} Hz and cannot run {rate:g} "
                f"ticks per second: connect(..., rate={rate:g})"
            )
        self._arm, self.duration = arm, duration
        self._max_step_time = arm.comm_timeout if max_step_time is None else float(max_step_time)
        self.lateness = LatenessHistogram()
        self.missed = self.missing = self.rejected = self.restarts = 0
        self.delay: float | None = None
        self._reported_delay: float | None = None
        self._check: Callable[[], None] = _never
        self._delays: list[float] = []
        self._recorder = recorder
        self.controller: Any = controller
        if recorder is not None:
            self.controller = recorder.start(arm, controller, rate)

    def __iter__(self) -> Iterator[Tick]:
        """Enable supervision by the arm and yield ticks; close the recorder at the end."""
        if not self._arm.enabled:
            raise ServoError("torque is off: use `with connect(...) as arm`, or arm.enable()")
        patience = max(self._max_step_time, self._arm.comm_timeout) + self.period + GRACE
        ended = False
        try:
            with self._arm.supervised(patience) as self._check:
                yield from self._turns()
            ended = True
        finally:
            if self._recorder is not None:
                self._close(self._recorder, raises=ended)

    def _close(self, recorder: TickRecorder, *, raises: bool) -> None:
        """Close the recorder; its `OSError` is raised if `raises`, else logged.

        It is logged if the loop has ended with an exception, which it would replace.
        """
        try:
            recorder.close()
        except OSError as error:
            if raises:
                raise
            LOG.error("%s", error)

    def _turns(self) -> Iterator[Tick]:
        """Wait for each deadline, read the arm, and yield a tick if all positions are new."""
        arm, clock = self._arm, self._arm.clock
        begin = deadline = clock.now()
        last: float | None = None
        first: float | None = None
        commanded, before, index = begin, begin, 0
        while self.duration is None or deadline - begin < self.duration - 1e-9:
            clock.wait_until(deadline)
            now = clock.now()
            self.lateness.add(now - deadline)
            state = arm.read()
            if state.faults:
                raise ServoFaultError("; ".join(state.faults))
            if state.fresh:
                if last is None or state.time - last > RESTART:
                    self._restart(state.q, first=last is None)
                    last = None
                dt = self.period if last is None else max(state.time - last, 0.1 * self.period)
                last = state.time
                first = now if first is None else first
                tick = Tick(self, state, dt, (now, first), index)
                try:
                    yield tick
                finally:
                    if self._recorder is not None:
                        self._recorder.add(tick, tick.command)
                self._check()
                index += 1
                done = clock.now()
                if done - now > self._max_step_time:
                    raise ServoTimeoutError(
                        f"the program did not come back for {done - now:.2f} s (max_step_time "
                        f"allows {self._max_step_time:g} s); the servos held meanwhile"
                    )
                commanded = now if tick.answered else commanded
                if now - commanded > arm.comm_timeout:
                    raise ServoTimeoutError(
                        f"no command could be sent for {now - commanded:.2f} s: every tick needs "
                        "tick.write(command) with finite numbers, or tick.skip()"
                    )
            else:
                self.missing += 1
                self._wait_no_longer_than(state, arm.comm_timeout)
                # The program gets no tick without positions, so this time must not count as time
                # without a command.
                commanded += now - before
            before = now
            deadline += self.period
            late = clock.now() - deadline
            if late > 0.0:
                skipped = math.ceil(late / self.period - 1e-9)
                self.missed += skipped
                deadline += skipped * self.period

    def _wait_no_longer_than(self, state: State, longest: float) -> None:
        """Raise if positions of a joint have been missing for more than `longest` [s]."""
        if state.age.max() > longest:
            names = [
                name
                for name, age in zip(self._arm.model.joint_names, state.age, strict=True)
                if age > longest
            ]
            joints = "any joint" if len(names) == state.q.size else ", ".join(names)
            raise ServoTimeoutError(
                f"no position of {joints} for {state.age.max():.2f} s: look at the cable to it, at "
                "those before it, and at its power"
            )

    def _restart(self, q: Array, *, first: bool) -> None:
        """Reset the controller to q (n,) [rad], so that its next goal holds the arm at q.

        Unless this is the `first` reset, count it and ramp the torque limits up again.
        """
        controller = self.controller
        if not first:
            self.restarts += 1
            self._arm.ramp_limits()
        if controller is None:
            return
        if first:
            self._capture(q)
        # `capture_gravity` does not change the goals; `reset` applies the captured leads.
        controller.reset(q)
        if hasattr(controller, "model"):
            # Goals move from q at a limited speed: one long step, which is not sent, lets them
            # reach the leads that hold the arm against gravity.
            controller.step(q, controller.model.forward_kinematics(q), dt=PRIME)

    def _capture(self, q: Array) -> None:
        """Pass the leads measured at torque on to the controller, if the stiffness is unknown.

        The leads are those at q (n,) [rad]. Joints without a measured lead get the gravity torque
        divided by the assumed stiffness.
        """
        arm, capture = self._arm, getattr(self.controller, "capture_gravity", None)
        leads = getattr(arm, "leads", None)
        if capture is None or leads is None or arm.servos.stiffness_known:
            return
        modelled = np.asarray(arm.model.gravity(q)) / np.asarray(arm.servos.kp)
        capture(q, q + np.where(np.isfinite(leads), leads, modelled))

    def _write(
        self, tick: Tick, command: Commanded, extra: Mapping[str, tuple[float, float]] | None
    ) -> bool:
        """Check and send a command; return False and count it if it is rejected."""
        self._check()
        clock = self._arm.clock
        if not (hasattr(command, "goal") and hasattr(command, "torque_limit")):
            raise TypeError(
                "command must be a Command, as Controller.step makes one, or have goal and "
                f"torque_limit, got {format_value(command)}; arm.write(goal, limit) "
                "takes bare numbers"
            )
        model = self._arm.model
        goal = vector(model, command.goal, "goal", finite=False)
        limit = vector(model, command.torque_limit, "limit", finite=False)
        old = clock.now() - tick.began > max(STALE_PERIODS * self.period, STALE)
        if old or not (np.isfinite(goal).all() and np.isfinite(limit).all()):
            self.rejected += 1
            return False
        speed = command.speed_limit if isinstance(command, Command) else None
        self._arm.write(goal, limit, extra, lead=speed is not None, velocity=speed)
        self._measure(clock.now() - tick.state.time)
        return True

    def _measure(self, delay: float) -> None:
        """Add a delay [s]; after each 50, store their median and tell the controller of a change.

        The drive's latency is added to each delay.
        """
        self._delays.append(delay + getattr(self._arm.drive, "latency", 0.0))
        if len(self._delays) < AVERAGE:
            return
        self.delay = float(np.median(self._delays))
        self._delays.clear()
        reported = self._reported_delay
        if reported is None or abs(self.delay - reported) > max(CHANGE, CHANGE_SHARE * reported):
            self._reported_delay = self.delay
            tell = getattr(self.controller, "set_delay", None)
            if tell is not None:
                tell(self.delay)


def _never() -> None:
    """Stand in for the supervisor's check before the loop runs; never raises."""


def _divides(grain: float, period: float) -> bool:
    """Return True if `period` is a multiple of `grain`, both in [s]."""
    ratio = period / grain
    return ratio > 0.5 and abs(ratio - round(ratio)) < 1e-6
