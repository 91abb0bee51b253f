"""Compliant replay of a recorded motion; the motion pauses while the arm is blocked."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pliant import functional
from pliant._core import ContactEstimator, OutOfRangeError
from pliant._validation import AXES, number, positive, rounded_up, vector

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._core import Command, Controller
    from pliant._typing import Array
    from pliant.arm import Arm
    from pliant.teach.motion import Motion


#: Largest joint speed on the way to the start of the motion, and back to it after a stop [rad/s].
APPROACH_SPEED = 0.4
#: Duration of the speed-up of the motion's clock from standstill to full rate [s].
RISE_TIME = 0.5
#: The clock of the motion slows down if the deviation exceeds this share of its bound [1].
SLOWING_SHARE = 0.5
#: The replay counts as blocked below `BLOCKED_PACE`, and as free again above `FREE_PACE`; both are
#: rates of the motion's clock, of which 1 is the full rate.
BLOCKED_PACE, FREE_PACE = 0.05, 0.3
#: Minimum duration of a contact that stops the replay [s].
MIN_CONTACT = 0.05
#: Time after `resume` during which contacts are ignored [s].
IGNORE_TIME = 1.0

State = Literal["approaching", "playing", "blocked", "stopped", "done"]


class Replay:
    """Steps a controller along a motion; call `Replay.step` once per tick, not `Controller.step`.

    The motion has its own clock, which runs at `speed` times a factor p. This factor follows
    ``clip(2 (1 − m), 0, 1)``, where m is the largest ratio of the tool's deviation to its bound
    `wait`; p falls immediately and rises gradually. The clock thus runs at full rate up to half the
    bound and stops at the bound, so that the deviation, and with it the force, does not grow while
    the tool is blocked.

    Args:
        controller: The controller; its settings define the compliance of each axis.
        motion: The motion.
        speed: Factor on the speed of the motion.
        wait: Deviations of the tool, (linear [m], angular [rad]), at which the clock stops.
        stop: Force [N] along a translation axis of the task at which the arm stops until
            `resume()`; None: the arm does not stop. Values below the uncertainty of the force
            estimate are rejected.

    Attributes:
        time: Time of the motion's clock [s].
        pace: The factor p of the clock's rate in this tick, 0 to 1.
        blocked_time: Total time for which the clock has been blocked [s].
        stops: Number of stops because of a contact force above `stop`.

    Raises:
        ConfigError: The motion was recorded on a different arm.
        OutOfRangeError: A number is out of range, or `stop` is below the uncertainty of forces.
    """

    def __init__(
        self,
        controller: Controller | Any,
        motion: Motion,
        *,
        speed: float = 1.0,
        wait: tuple[float, float] = (0.03, 0.25),
        stop: float | None = None,
    ) -> None:
        speed, bounds = number(speed, "speed", 0.05, 3.0), vector(wait, 2, "wait", "m, rad")
        positive(bounds.min(), "wait", "m, rad")
        motion.validate_for(controller.model)
        self.motion, self.speed = motion, speed
        self._controller, self._model = controller, controller.model
        names = controller.settings.task.names
        self._rows = [AXES.index(name) for name in names]
        self._bound = bounds[[int(row >= 3) for row in self._rows]]
        self._contact: ContactEstimator | None = None
        if stop is not None:
            axes = "".join(name for name in names if name in "xyz")
            inner = getattr(controller, "inner", controller)
            contact = ContactEstimator(inner)
            estimate = contact.typical_uncertainty()[[AXES.index(name) for name in axes]]
            minimum = rounded_up(contact.guard * estimate.max(initial=1e-3))
            if not float(minimum) <= stop < math.inf:
                raise OutOfRangeError(
                    f"stop [N] = {stop:g} is outside [{minimum}, ∞): this arm, at rest in the "
                    "median pose, cannot tell a smaller force from friction, k_p and gravity"
                )
            self._contact = ContactEstimator(inner, touch={axes: stop}, min_time=MIN_CONTACT)
        self.time, self.pace, self.blocked_time, self.stops = 0.0, 1.0, 0.0, 0
        self._offset: Array | None = None
        self._remaining = self._transition_time = 0.0
        self._stopped_q: Array | None = None
        self._blocked = False
        self._ignore_time = 0.0

    @property
    def state(self) -> State:
        """Present state: `approaching`, `playing`, `blocked`, `stopped` or `done`."""
        if self._stopped_q is not None:
            return "stopped"
        if self.time >= self.motion.duration:
            return "done"
        if self._blocked:
            return "blocked"
        return "approaching" if self._remaining > 0.0 else "playing"

    @property
    def done(self) -> bool:
        """True once the motion has been played to its end."""
        return self.state == "done"

    def step(
        self, q: ArrayLike, *, dt: float | None = None, load: ArrayLike | None = None
    ) -> Command:
        """Step the controller along the motion, and return its command for this tick.

        Args:
            q: Measured joint positions (n,) [rad].
            dt: Time since the last tick [s]; None: 1 / rate of the settings.
            load: Torques reported by the servos (n,) [N·m], which improve the estimate for `stop`.

        Raises:
            ShapeError, OutOfRangeError: An input is invalid; see `Controller.step`.
        """
        q = np.asarray(q, dtype=np.float64)
        time_step = 1.0 / self._controller.settings.rate if dt is None else dt
        if self._offset is None:
            self._start_transition(q)
        self._check_contact(q, dt, load, time_step)
        if self._stopped_q is not None:
            goal = self._stopped_q
        else:
            self._advance(q, time_step)
            goal = self._target()
        return self._controller.step_joints(q, goal, dt=dt)

    def extra(self, arm: Arm) -> dict[str, tuple[float, float]]:
        """Return goal [rad] and torque limit [N·m] of each gripper in the motion, by name."""
        return {
            name: (position, arm.grippers[name].limit)
            for name, position in self.motion.extra_at(self.time).items()
            if name in arm.grippers
        }

    def resume(self) -> None:
        """Continue after a stop by a contact: move back to the motion, then continue it."""
        if self._stopped_q is not None:
            q, self._stopped_q, self._ignore_time = self._stopped_q, None, IGNORE_TIME
            self._start_transition(q)

    def _start_transition(self, q: Array) -> None:
        """Start a smooth transition from the positions q (n,) [rad] to the motion."""
        self._offset = q - self.motion.at(self.time)
        # Factor 15/8: peak over mean speed of the fifth-order polynomial of the transition.
        self._transition_time = 1.875 * float(np.abs(self._offset).max()) / APPROACH_SPEED
        self._remaining, self.pace = self._transition_time, 0.0

    def _target(self) -> Array:
        """Return the joint target (n,) [rad]: the motion plus the present transition offset."""
        goal = self.motion.at(self.time)
        if self._remaining <= 0.0 or self._offset is None:
            return goal
        s = self._remaining / self._transition_time
        return goal + s**3 * (10.0 - 15.0 * s + 6.0 * s * s) * self._offset

    def _advance(self, q: Array, dt: float) -> None:
        """Advance the transition or the clock of the motion, slower if the tool deviates more."""
        tool, target_pose = (
            self._model.forward_kinematics(positions) for positions in (q, self._target())
        )
        error = functional.pose_error(tool, target_pose)[self._rows]
        share = float(np.abs(error / self._bound).max())
        scale = min(max((1.0 - share) / (1.0 - SLOWING_SHARE), 0.0), 1.0)
        self.pace = min(scale, self.pace + dt / RISE_TIME)
        self._blocked = scale < (FREE_PACE if self._blocked else BLOCKED_PACE)
        self.blocked_time += dt * self._blocked
        if self._remaining > 0.0:
            self._remaining = max(self._remaining - self.pace * dt, 0.0)
        else:
            self.time = min(self.time + self.pace * self.speed * dt, self.motion.duration)

    def _check_contact(
        self, q: Array, dt: float | None, load: ArrayLike | None, time_step: float
    ) -> None:
        """Update the contact estimate; stop the arm on a contact (`time_step` in [s])."""
        if self._contact is None:
            return
        estimate = self._contact.update(q, dt=dt, load=load)
        self._ignore_time = max(self._ignore_time - time_step, 0.0)
        if estimate.touch.any() and self._stopped_q is None and self._ignore_time == 0.0:
            self._stopped_q = q.copy()
            self.stops += 1
