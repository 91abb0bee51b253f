"""Force of a user of the browser page on a simulated arm: a push of the tool or a mouse pull."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant.sim.ground_truth import TOOL

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._typing import Array
    from pliant.sim import Plant
    from pliant.sim.ground_truth import GroundTruth
    from pliant.sim.hand import Wrench


#: Duration of the rise of a push's force at its start, and of the fall at its end [s].
RAMP_TIME = 0.1
#: Length of the spring between mouse and gripped point at which its force is the maximum [m].
FULL_FORCE_DISTANCE = 0.15
#: Ratio of damping to stiffness of that spring [s].
DAMPING_TIME = 0.05


class MouseForce:
    """A `pliant.sim.Hand` whose force the user of the page changes while the simulation runs.

    Attributes:
        at: Name of the frame on which the force acts.
        max_push: Maximum force of a pull by the mouse [N].
        applied: Point of application (3,) [m] and force (3,) [N] in the last physics step; None: no
            force.
    """

    def __init__(self, max_push: float) -> None:
        """Create a hand without a force; `max_push` is the maximum force of a pull [N]."""
        self.at, self.max_push = TOOL, max_push
        self._zero = np.zeros(3)
        self.let_go()

    def let_go(self) -> None:
        """Remove the force abruptly; the next force acts on the tool again."""
        self.at, self._grip_offset = TOOL, self._zero
        self._pull_toward: Array | None = None
        self._wrench, self._applied_wrench, self._until = np.zeros(6), np.zeros(6), -np.inf
        self._last_time = 0.0
        self.applied: tuple[Array, Array] | None = None

    def push(self, force: ArrayLike, torque: ArrayLike, until: float) -> None:
        """Push the tool with a force (3,) [N] and a torque (3,) [N·m].

        The push ends at the simulated time `until` [s].
        """
        if self._pull_toward is not None:
            self.let_go()
        self._wrench = np.concatenate((np.asarray(force), np.asarray(torque))).astype(np.float64)
        self._until = until

    def grab(self, plant: Plant, body: int, point: ArrayLike | None, toward: ArrayLike) -> None:
        """Grip a point of a body of the arm, and pull it toward another point.

        Args:
            plant: The simulation.
            body: Index of the MuJoCo body. A body that is not a link of the arm is ignored.
            point: Point to grip (3,) [m], base axes; None: keep the gripped point.
            toward: Point toward which the spring pulls (3,) [m], base axes.
        """
        if point is not None:
            frame = frame_of(plant, body)
            if frame is None:
                return
            self.let_go()
            self.at = frame
            link = plant.ground_truth.frame(frame)
            self._grip_offset = link.rotation.T @ (np.asarray(point) - link.position)
        elif self._pull_toward is None:
            return
        self._pull_toward = np.asarray(toward, dtype=np.float64)

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return the force on the arm at simulated time t [s].

        Returns:
            Force (3,) [N], torque (3,) [N·m] and point of application (3,) [m], base axes.
        """
        frame = ground_truth.frame(self.at)
        if self._pull_toward is None:
            if t < self._until or self.applied is not None:
                self._ramp(t, frame.position)
            self._last_time = t
            return self._applied_wrench[:3], self._applied_wrench[3:], frame.position
        lever = frame.rotation @ self._grip_offset
        point = frame.position + lever
        twist = frame.twist()
        stiffness = self.max_push / FULL_FORCE_DISTANCE
        speed = twist[:3] + np.cross(twist[3:], lever)
        pull = stiffness * (self._pull_toward - point) - DAMPING_TIME * stiffness * speed
        norm = float(np.linalg.norm(pull))
        pull *= min(1.0, self.max_push / max(norm, 1e-9))
        self.applied = point, pull
        return pull, self._zero, point

    def _ramp(self, t: float, point: Array) -> None:
        """Change the applied force gradually to the desired push, or to zero after its end.

        `t` is the simulated time [s], and `point` the point of application (3,) [m].
        """
        desired = self._wrench if t < self._until else np.zeros(6)
        largest_change = np.abs(self._wrench).max() * min(
            max(t - self._last_time, 0.0) / RAMP_TIME, 1.0
        )
        self._applied_wrench = self._applied_wrench + np.clip(
            desired - self._applied_wrench, -largest_change, largest_change
        )
        self.applied = (
            (point.copy(), self._applied_wrench[:3]) if self._applied_wrench.any() else None
        )


def frame_of(plant: Plant, body: int) -> str | None:
    """Return the name of a link that is fixed to a MuJoCo body; None if no link is fixed to it."""
    model = plant.mj_model
    links = {link.name for link in plant.model.links}
    for site in np.flatnonzero(model.site_bodyid == body).tolist():
        name = model.site(site).name
        if name in links:
            return str(name)
    return None
