"""Recording of the motion of an arm while a hand guides it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import PliantError
from pliant.identify import HandGuiding
from pliant.loop import Loop, capture_leads
from pliant.teach.motion import Motion

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant._core import Command
    from pliant._typing import Array
    from pliant.arm import Arm, State


#: Text that `record` passes to `on_status` when the recording begins.
RECORDING = "recording"
#: Instruction in a text that `record` passes to `on_status` if `should_toggle` is given.
STARTS_AND_STOPS = "Enter starts and stops"
#: A gripper counts as pressed shut within this share of its range from the closed end [1].
PRESSED_SHARE = 0.15
#: Torque limit of a gripper that follows the hand, as a share of its configured limit [1].
FOLLOW_SHARE = 0.3
#: The arm counts as moved if a joint has moved by more than this angle [rad].
MIN_MOTION = 0.02


class Teacher:
    """Makes an arm weightless and records its motion; call `step` once per tick.

    Joints outside the chain (a gripper) follow the hand and are recorded too.

    Args:
        arm: The arm, enabled.
        rate: Control rate [Hz].

    Attributes:
        recording: True while positions are recorded.
        still: Time since the arm last moved, or since the recording began [s].
        moved: True if the arm has moved since the recording began.
    """

    def __init__(self, arm: Arm, *, rate: float = 100.0) -> None:
        self._arm, self._dt = arm, 1.0 / rate
        self._guiding = HandGuiding(arm.model, arm.servos, rate=rate)
        capture_leads(arm, self._guiding)
        self._samples: list[tuple[float, Array, dict[str, float]]] = []
        self.recording = False
        self.still, self.moved = 0.0, False
        self._rest_q: Array | None = None
        self._was_closed = False

    @property
    def ready(self) -> bool:
        """True once the initial oscillation of `HandGuiding` is over: the arm may be touched."""
        return self._guiding.ready

    def step(self, state: State, *, dt: float | None = None) -> Command:
        """Return the command that lets a hand guide the arm; record the state while `recording`.

        Args:
            state: State of the arm in this tick.
            dt: Time since the last step [s]; None: 1/rate.

        Raises the exceptions of `HandGuiding.step`.
        """
        command = self._guiding.step(state.q, dt=dt)
        if self.recording:
            self._append(state, self._dt if dt is None else dt)
        return command

    def start(self) -> None:
        """Start a recording; an earlier recording is deleted.

        Raises:
            PliantError: The initial oscillation of the hand guiding is not over.
        """
        if not self.ready:
            raise PliantError("the arm still swings to find its weight: wait until it is ready")
        self._samples.clear()
        self.recording, self.still, self.moved, self._rest_q = True, 0.0, False, None

    def stop(self) -> Motion:
        """Stop the recording and return the motion, neither trimmed nor smoothed.

        Raises:
            PliantError: The positions of fewer than two ticks were recorded.
        """
        self.recording = False
        if len(self._samples) < 2:
            raise PliantError("nothing was recorded")
        times, positions, others = zip(*self._samples, strict=True)
        extra = {name: np.array([row[name] for row in others]) for name in others[0]}
        names = tuple(self._arm.model.joint_names)
        return Motion(names, np.array(times), np.array(positions), extra)

    def extra(self, state: State) -> dict[str, tuple[float, float]]:
        """Return goal [rad] and torque limit [N·m] with which each gripper follows the hand."""
        return {
            name: (state.extra[name], FOLLOW_SHARE * gripper.limit)
            for name, gripper in self._arm.grippers.items()
        }

    def gripper_pressed(self, state: State) -> bool:
        """Return True if a gripper that was open at the last call is now pressed shut."""
        closed = False
        for name, gripper in self._arm.grippers.items():
            share = (state.extra[name] - gripper.closed) / (gripper.opened - gripper.closed)
            closed |= bool(share < PRESSED_SHARE)
        is_new, self._was_closed = closed and not self._was_closed, closed
        return is_new

    def _append(self, state: State, dt: float) -> None:
        if not self._samples or state.time > self._samples[-1][0]:
            self._samples.append((state.time, state.q.copy(), dict(state.extra)))
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
    should_toggle: Callable[[Teacher, State], bool] | None = None,
    on_status: Callable[[str], None] = lambda _: None,
    on_interrupt: Callable[[Motion], None] = lambda _: None,
) -> Motion:
    """Record a motion while a hand guides the arm; return the motion, trimmed and smoothed.

    Without `should_toggle`, the recording begins when the arm is ready and ends when the arm has
    rested after a motion. With `should_toggle`, it begins and ends when that function returns True.

    Args:
        arm: The arm, enabled.
        seconds: Maximum duration of the recording [s]; None: no maximum.
        idle_timeout: Duration of the rest that ends a recording [s].
        start_timeout: Maximum time to wait for a first motion [s].
        should_toggle: Function called in every tick with the `Teacher` and the arm's state; returns
            True if the user asks to start or to stop.
        on_status: Function that is called with a line of text at every change of the status.
        on_interrupt: Function that is called with the motion so far, neither trimmed nor smoothed,
            if an exception (also Ctrl-C, or one of `on_status`) ends this function once the arm
            has moved. It should return quickly, because the arm is lowered only afterwards.

    Raises:
        PliantError: Nothing was recorded, or the arm was not moved within `start_timeout`.
        ServoError: The control loop failed; see `pliant.Loop`.
    """
    teacher = Teacher(arm, rate=arm.rate)
    on_status("do not touch: the arm swings a little to find its weight")
    recorded: Motion | None = None
    try:
        start_time = 0.0
        for tick in Loop(arm):
            was_ready = teacher.ready
            tick.write(teacher.step(tick.state, dt=tick.dt), teacher.extra(tick.state))
            if not teacher.ready:
                continue
            if not was_ready:
                ends = (
                    f"a rest of {idle_timeout:g} s ends the recording"
                    if should_toggle is None
                    else STARTS_AND_STOPS
                )
                on_status(f"ready: lead the arm; {ends}")
                start_time = tick.time
            is_toggled = should_toggle is not None and should_toggle(teacher, tick.state)
            if not teacher.recording and (should_toggle is None or is_toggled):
                teacher.start()
                start_time = tick.time
                on_status(RECORDING)
                continue
            elapsed = tick.time - start_time
            if teacher.recording and (
                is_toggled
                or (teacher.moved and should_toggle is None and teacher.still > idle_timeout)
                or (seconds is not None and elapsed > seconds)
            ):
                break
            if elapsed > start_timeout and not teacher.moved:
                raise PliantError(f"the arm was not moved by hand within {start_timeout:g} s")
        recorded = teacher.stop()
        motion = recorded.trimmed().smoothed().for_model(arm.model)
        on_status(f"kept {motion.duration:.1f} s")
    except BaseException:
        if teacher.moved and recorded is None and teacher.recording:
            recorded = teacher.stop()
        if teacher.moved and recorded is not None:
            on_interrupt(recorded)
        raise
    return motion
