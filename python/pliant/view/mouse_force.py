"""The visitor's hand: it pushes the tool, or holds a point and pulls."""

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


#: Rise and fall time of a push [s].
RISE = 0.1
#: Distance of the hand from its grip at full force [m], and the damping, as the time constant of
#: the grip's motion [s].
REACH, BRAKE = 0.15, 0.05


class MouseForce:
    """A `pliant.sim.Hand` that is controlled from outside while the physics runs.

    Attributes:
        at: Frame on which it acts.
        max_push: Largest force [N].
        felt: Point of application (3,) [m] and force (3,) [N] of the last physics step; None: none.
    """

    def __init__(self, max_push: float) -> None:
        """Start without a force."""
        self.at, self.max_push = TOOL, max_push
        self._zero = np.zeros(3)
        self.let_go()

    def let_go(self) -> None:
        """Release: no force, at the tool."""
        self.at, self._local = TOOL, self._zero
        self._toward: Array | None = None
        self._wrench, self._now, self._until = np.zeros(6), np.zeros(6), -np.inf
        self._before = 0.0
        self.felt: tuple[Array, Array] | None = None

    def push(self, force: ArrayLike, torque: ArrayLike, until: float) -> None:
        """Push the tool with a force (3,) [N] and a torque (3,) [N·m] until a time [s]."""
        if self._toward is not None:
            self.let_go()
        self._wrench = np.concatenate((np.asarray(force), np.asarray(torque))).astype(np.float64)
        self._until = until

    def grab(self, plant: Plant, body: int, point: ArrayLike | None, toward: ArrayLike) -> None:
        """Hold a point (3,) [m] of a body of the arm, None for the present one, and pull.

        A body without a frame (a door) cannot be held.
        """
        if point is not None:
            frame = frame_of(plant, body)
            if frame is None:
                return
            self.let_go()
            self.at = frame
            held = plant.ground_truth.frame(frame)
            self._local = held.rotation.T @ (np.asarray(point) - held.position)
        elif self._toward is None:
            return
        self._toward = np.asarray(toward, dtype=np.float64)

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return force (3,), torque (3,) and point of application (3,)."""
        frame = ground_truth.frame(self.at)
        if self._toward is None:
            if t < self._until or self.felt is not None:
                self._ease(t, frame.position)
            self._before = t
            return self._now[:3], self._now[3:], frame.position
        lever = frame.rotation @ self._local
        place = frame.position + lever
        twist = frame.twist()
        stiffness = self.max_push / REACH
        speed = twist[:3] + np.cross(twist[3:], lever)
        pull = stiffness * (self._toward - place) - BRAKE * stiffness * speed
        size = float(np.linalg.norm(pull))
        pull *= min(1.0, self.max_push / max(size, 1e-9))
        self.felt = place, pull
        return pull, self._zero, place

    def _ease(self, t: float, place: Array) -> None:
        """Ramp the push at a point (3,) up or down."""
        wish = self._wrench if t < self._until else np.zeros(6)
        most = np.abs(self._wrench).max() * min(max(t - self._before, 0.0) / RISE, 1.0)
        self._now = self._now + np.clip(wish - self._now, -most, most)
        self.felt = (place.copy(), self._now[:3]) if self._now.any() else None


def frame_of(plant: Plant, body: int) -> str | None:
    """Return the name of a robot frame fixed to a simulated body, None without one."""
    model = plant.mj_model
    links = {link.name for link in plant.model.links}
    for site in np.flatnonzero(model.site_bodyid == body).tolist():
        name = model.site(site).name
        if name in links:
            return str(name)
    return None
