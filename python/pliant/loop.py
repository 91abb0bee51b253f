"""The control loop: absolute deadlines, honest times, and no lunge after a silence."""

from __future__ import annotations

import logging
import math
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pliant import Command, ConfigError, ServoError, ServoFaultError, ServoTimeoutError
from pliant.arguments import given, real
from pliant.arm.checks import vector
from pliant.arm.lateness import Lateness

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from pliant.arm import Arm, State
    from pliant.log import Recorder

    Array = NDArray[np.float64]

LOG = logging.getLogger("pliant")
#: After a gap this long between two steps a controller starts anew from where the arm is [s].
RESTART = 0.25
#: A command made from positions older than this many periods, and this long [s], is not sent.
STALE_PERIODS, STALE = 5.0, 0.1
#: Slew of a step that lets a controller's first goal carry the weight [s].
PRIME = 0.1
#: How much later than the loop itself would the arm sees that the program does not come back [s].
GRACE = 0.1
#: Lowest rate [Hz]: a controller is told no longer time than 1 s between two steps.
LOWEST = 1.0
#: Ticks over which the delay is averaged, and the change that is passed on [s], [1].
AVERAGE, CHANGE, CHANGE_SHARE = 50, 5e-4, 0.1


class Commanded(Protocol):
    """What a controller hands to the servos."""

    @property
    def goal(self) -> Array:
        """Joint goals (n,) [rad]."""

    @property
    def torque_limit(self) -> Array:
        """Torque limits (n,) [N·m]."""


class Tick:
    """One turn of the loop.

    Attributes:
        q: Joint positions (n,) [rad], new in this tick.
        dt: Time since the positions of the last tick were sampled [s].
        state: All that was read.
        time: When the tick began [s]; 0 at the first tick of the loop, on every backend.
        index: Count of ticks before it.
        began: `time` on the arm's clock, which `state.time` and `arm.time` are read from [s].
        command: The last command given to `write`; None before.
    """

    __slots__ = ("_loop", "answered", "began", "command", "dt", "index", "q", "state", "time")

    def __init__(
        self, loop: Loop, state: State, dt: float, times: tuple[float, float], index: int
    ) -> None:
        """Made by `Loop`; times: of this tick and of the first, on the arm's clock."""
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
        """Send a command; goal and limits stay as they are where it cannot be sent.

        A command that is not finite, or made from positions of more than five periods ago, is
        counted and not sent.

        Args:
            command: Goals and limits; a `pliant.Command`. Limits of another making are sent however
                low they are, and an arm that they do not carry sinks or falls: see `Arm.write`.
            extra: Goal [rad] and limit [N·m] of joints off the chain by name.

        Returns:
            Whether it was sent.

        Raises:
            ShapeError, ConfigError, OutOfRangeError: A command of another arm, or a negative limit.
            TypeError: No command.
            ServoError: Torque is off, or the connection is gone.
        """
        self.command = command
        self.answered = self._loop._write(self, command, extra)
        return self.answered

    def skip(self) -> None:
        """Keep goal and limits on purpose, for as long as it is said at every tick."""
        self.answered = True


class Loop:
    """Turns of a control loop over an enabled arm.

    A tick is given out only with new positions of all joints. Goals and limits stay as they are
    while positions do not arrive, while commands are missing or not finite, and while the program
    does not come back; after `arm.comm_timeout` of that the loop raises, and the arm's `with`
    lowers it. A controller that had to wait more than 0.25 s is reset to where the arm is, and
    limits rise again within 0.5 s. Where a program does not come back for the longer of
    `comm_timeout` and `max_step_time`, and a period and 0.1 s more, a thread lowers an arm in real
    time in its place.

    Args:
        arm: The arm, enabled.
        controller: What makes the commands; its delay is set from measurements, and it is reset
            when it must start anew. None: nothing to set or reset.
        rate: Ticks per second [Hz], at least 1; None: the controller's, or the arm's.
        duration: Ends the loop [s]; None: never.
        max_step_time: Longest time that one turn of the program may take [s]; None:
            `arm.comm_timeout`.
        recorder: A `pliant.log.Recorder`, or anything with its `start`, `add` and `close`: it gets
            every tick with its command, and is closed when the loop ends.

    Attributes:
        controller: The controller to step: with a recorder one that records its calls. Give this
            one to whatever steps it for you (`pliant.teach.Replay`).
        period: Time between two ticks [s].
        duration: As given.
        lateness: Histogram of how late ticks began.
        missed: Deadlines that were skipped because a turn took too long.
        missing: Ticks without new positions of all joints.
        rejected: Commands that were not sent.
        restarts: How often the controller started anew.
        delay: Measured, from positions to the arrival of the goal [s].

    Raises:
        TypeError: `arm` is no arm, or `controller` nothing that can be reset.
        ConfigError: The rate does not fit, or a time is negative or no number.
        ServoTimeoutError: While looping: positions, commands or the program did not come.
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
        recorder: Recorder | None = None,
    ) -> None:
        """Check that it can run."""
        if not hasattr(arm, "clock"):
            raise TypeError(
                f"arm must be an Arm, as pliant.connect(...) makes one, got {given(arm)}"
            )
        if controller is not None and not callable(getattr(controller, "reset", None)):
            raise TypeError(
                f"controller must be a Controller, or have reset(q), or be None, got "
                f"{given(controller)}"
            )
        wanted = getattr(getattr(controller, "settings", None), "rate", arm.rate)
        rate = real(wanted if rate is None else rate, "rate")
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
        self.lateness = Lateness()
        self.missed = self.missing = self.rejected = self.restarts = 0
        self.delay: float | None = None
        self._told: float | None = None
        self._check: Callable[[], None] = _never
        self._delays: list[float] = []
        self._recorder = recorder
        self.controller: Any = controller
        if recorder is not None:
            self.controller = recorder.start(arm, controller, rate)

    def __iter__(self) -> Iterator[Tick]:
        """Wait, read, give out a tick; again."""
        if not self._arm.enabled:
            raise ServoError("torque is off: use `with connect(...) as arm`, or arm.enable()")
        patience = max(self._max_step_time, self._arm.comm_timeout) + self.period + GRACE
        ended = False
        try:
            with self._arm.watched(patience) as self._check:
                yield from self._turns()
            ended = True
        finally:
            if self._recorder is not None:
                self._close(self._recorder, raises=ended)

    def _close(self, recorder: Recorder, *, raises: bool) -> None:
        """Close the recorder; an error is logged where raising it would hide another."""
        try:
            recorder.close()
        except OSError as error:
            if raises:
                raise
            LOG.error("%s", error)

    def _turns(self) -> Iterator[Tick]:
        """The loop itself."""
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
                # A turn without positions is none in which a command could have been sent.
                commanded += now - before
            before = now
            deadline += self.period
            late = clock.now() - deadline
            if late > 0.0:
                skipped = math.ceil(late / self.period - 1e-9)
                self.missed += skipped
                deadline += skipped * self.period

    def _wait_no_longer_than(self, state: State, most: float) -> None:
        """Raise where positions have not come for too long."""
        if state.age.max() > most:
            names = [
                name
                for name, age in zip(self._arm.model.joint_names, state.age, strict=True)
                if age > most
            ]
            joints = "any joint" if len(names) == state.q.size else ", ".join(names)
            raise ServoTimeoutError(
                f"no position of {joints} for {state.age.max():.2f} s: look at the cable to it, at "
                "those before it, and at its power"
            )

    def _restart(self, q: Array, *, first: bool) -> None:
        """Let the controller begin at q (n,) [rad], and its first goal carry the weight."""
        controller = self.controller
        if not first:
            self.restarts += 1
            self._arm.ease()
        if controller is None:
            return
        if first:
            self._capture(q)
        # Capturing is bumpless: only the reset lets the goals carry the weight by what it found.
        controller.reset(q)
        if hasattr(controller, "model"):
            # Goals slew from q: one long step in place takes up the weight before anything is sent.
            controller.step(q, controller.model.forward_kinematics(q), dt=PRIME)

    def _capture(self, q: Array) -> None:
        """Tell the controller by which leads joints of unknown stiffness are carried at q (n,)."""
        arm, capture = self._arm, getattr(self.controller, "capture_gravity", None)
        leads = getattr(arm, "leads", None)
        if capture is None or leads is None or arm.servos.stiffness_known:
            return
        believed = np.asarray(arm.model.gravity(q)) / np.asarray(arm.servos.kp)
        capture(q, q + np.where(np.isfinite(leads), leads, believed))

    def _write(
        self, tick: Tick, command: Commanded, extra: Mapping[str, tuple[float, float]] | None
    ) -> bool:
        """Send a command, or count it."""
        self._check()
        clock = self._arm.clock
        if not (hasattr(command, "goal") and hasattr(command, "torque_limit")):
            raise TypeError(
                "command must be a Command, as Controller.step makes one, or have goal and "
                f"torque_limit, got {given(command)}; arm.write(goal, limit) takes bare numbers"
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
        """Average the delay; tell the controller when it has changed."""
        self._delays.append(delay + getattr(self._arm.drive, "latency", 0.0))
        if len(self._delays) < AVERAGE:
            return
        self.delay = float(np.median(self._delays))
        self._delays.clear()
        told = self._told
        if told is None or abs(self.delay - told) > max(CHANGE, CHANGE_SHARE * told):
            self._told = self.delay
            tell = getattr(self.controller, "set_delay", None)
            if tell is not None:
                tell(self.delay)


def _never() -> None:
    """Outside the loop nobody takes the arm over."""


def _divides(grain: float, period: float) -> bool:
    """Whether a period is a whole number of grains."""
    ratio = period / grain
    return ratio > 0.5 and abs(ratio - round(ratio)) < 1e-6
