"""Recording of hand-guided motions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import PliantError
from pliant.identify import HandGuiding
from pliant.loop import Loop
from pliant.teach.motion import Motion

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant._core import Command
    from pliant._typing import Array
    from pliant.arm import Arm, State


#: Message of `teach` when the recording begins.
RECORDING = "recording"
#: Message of `teach` if the caller asks the user.
STARTS_AND_STOPS = "Enter starts and stops"
#: Share of a gripper's range from its closed end within which it counts as pressed.
PRESSED = 0.15
#: Share of its torque limit for a gripper that follows the hand.
FOLLOW_SHARE = 0.3
#: Motion of every joint below which the arm counts as at rest [rad].
MIN_MOTION = 0.02


class Teacher:
    """Floats an arm and records its motion; call `step` once per tick.

    Off-chain joints (a gripper) follow the hand and are recorded as well.

    Args:
        arm: The arm, enabled.
        rate: Ticks per second [Hz].
        floating: Hand guiding of the arm; None: a new `pliant.HandGuiding`.

    Attributes:
        recording: True while ticks are recorded.
        still: Time for which the arm has been at rest [s], since the recording began.
        moved: True if the arm has moved since then.
    """

    def __init__(
        self, arm: Arm, *, rate: float = 100.0, floating: HandGuiding | None = None
    ) -> None:
        self._arm, self._dt = arm, 1.0 / rate
        self._float = floating or HandGuiding(arm.model, arm.servos, rate=rate)
        self._rows: list[tuple[float, Array, dict[str, float]]] = []
        self.recording = False
        self.still, self.moved = 0.0, False
        self._rest_q: Array | None = None
        self._closed = False

    @property
    def ready(self) -> bool:
        """True once the first swing is over and the arm may be touched."""
        return self._float.ready

    def step(self, state: State, *, dt: float | None = None) -> Command:
        """Return goals and limits that let a hand lead the arm.

        Args:
            state: State reported by the arm.
            dt: Time since the last step [s]; None: 1/rate.
        """
        command = self._float.step(state.q, dt=dt)
        if self.recording:
            self._append(state, self._dt if dt is None else dt)
        return command

    def start(self) -> None:
        """Start recording; an earlier recording is cleared.

        Raises:
            PliantError: The first swing is not over.
        """
        if not self.ready:
            raise PliantError("the arm still swings to find its weight: wait until it is ready")
        self._rows.clear()
        self.recording, self.still, self.moved, self._rest_q = True, 0.0, False, None

    def stop(self) -> Motion:
        """Stop recording and return the motion, neither trimmed nor smoothed.

        Raises:
            PliantError: Fewer than two ticks were recorded.
        """
        self.recording = False
        if len(self._rows) < 2:
            raise PliantError("nothing was recorded")
        times, positions, others = zip(*self._rows, strict=True)
        extra = {name: np.array([row[name] for row in others]) for name in others[0]}
        names = tuple(self._arm.model.joint_names)
        return Motion(names, np.array(times), np.array(positions), extra)

    def extra(self, state: State) -> dict[str, tuple[float, float]]:
        """Return goals and torque limits of the grippers, which follow the hand."""
        return {
            name: (state.extra[name], FOLLOW_SHARE * gripper.limit)
            for name, gripper in self._arm.grippers.items()
        }

    def gripper_pressed(self, state: State) -> bool:
        """Return True if a gripper has just been pressed shut, a signal to start or stop."""
        closed = False
        for name, gripper in self._arm.grippers.items():
            share = (state.extra[name] - gripper.closed) / (gripper.opened - gripper.closed)
            closed |= bool(share < PRESSED)
        is_new, self._closed = closed and not self._closed, closed
        return is_new

    def _append(self, state: State, dt: float) -> None:
        if not self._rows or state.time > self._rows[-1][0]:
            self._rows.append((state.time, state.q.copy(), dict(state.extra)))
        if self._rest_q is None or (np.abs(state.q - self._rest_q) > MIN_MOTION).any():
            self.moved |= self._rest_q is not None
            self._rest_q, self.still = state.q.copy(), 0.0
        self.still += dt


def record(
    arm: Arm,
    *,
    seconds: float | None = None,
    idle_timeout: float = 3.0,
    start_timeout: float = 60.0,
    rate: float | None = None,
    should_toggle: Callable[[Teacher, State], bool] | None = None,
    on_status: Callable[[str], None] = lambda _: None,
    on_interrupt: Callable[[Motion], None] = lambda _: None,
) -> Motion:
    """Float an enabled arm, record how a hand leads it, trim and smooth the motion.

    The recording begins when the arm is ready, or when `should_toggle` returns True. It ends after
    `seconds`, after a rest that follows a motion, or when `should_toggle` returns True.

    Args:
        arm: The arm, enabled.
        seconds: Longest recording [s]; None: no bound.
        idle_timeout: Rest that ends a recording with motion [s].
        start_timeout: Longest time to wait for a first motion [s].
        rate: Ticks per second [Hz]; None: the arm's.
        should_toggle: Called at every tick; True if the user has just asked to start or stop.
        on_status: Gets a line at every change, for a screen.
        on_interrupt: Gets the motion so far if an exception (also Ctrl-C) ends the recording; the
            exception propagates. It should return immediately: the arm is lowered after it.

    Returns:
        The motion, trimmed and smoothed.

    Raises:
        PliantError: Nothing was recorded.
        ServoError: As in a `Loop`.
    """
    rate = arm.rate if rate is None else rate
    teacher = Teacher(arm, rate=rate)
    on_status("do not touch: the arm swings a little to find its weight")
    try:
        _record(
            arm,
            teacher,
            rate=rate,
            seconds=seconds,
            idle_timeout=idle_timeout,
            start_timeout=start_timeout,
            should_toggle=should_toggle,
            on_status=on_status,
        )
    except BaseException:
        if teacher.recording and teacher.moved:
            on_interrupt(teacher.stop())
        raise
    motion = teacher.stop().trimmed().smoothed().for_model(arm.model)
    on_status(f"kept {motion.duration:.1f} s")
    return motion


def _record(
    arm: Arm,
    teacher: Teacher,
    *,
    rate: float,
    seconds: float | None,
    idle_timeout: float,
    start_timeout: float,
    should_toggle: Callable[[Teacher, State], bool] | None,
    on_status: Callable[[str], None],
) -> None:
    """Run the ticks from the first swing to the end of the recording."""
    begun = 0.0
    for tick in Loop(arm, rate=rate):
        before = teacher.ready
        tick.write(teacher.step(tick.state, dt=tick.dt), teacher.extra(tick.state))
        if not teacher.ready:
            continue
        if not before:
            ends = (
                f"a rest of {idle_timeout:g} s ends the recording"
                if should_toggle is None
                else STARTS_AND_STOPS
            )
            on_status(f"ready: lead the arm; {ends}")
            begun = tick.time
        now = should_toggle is not None and should_toggle(teacher, tick.state)
        if not teacher.recording and (should_toggle is None or now):
            teacher.start()
            begun = tick.time
            on_status(RECORDING)
            continue
        late = tick.time - begun
        if teacher.recording and (
            now
            or (teacher.moved and should_toggle is None and teacher.still > idle_timeout)
            or (seconds is not None and late > seconds)
        ):
            break
        if late > start_timeout and not teacher.moved:
            raise PliantError(f"the arm was not moved by hand within {start_timeout:g} s")
