"""An object in the arm's grip, and a person who pulls it away."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError
from pliant.sim._mujoco import mujoco
from pliant.sim.grip import Gripped
from pliant.sim.hand import Course

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.sim.plant import Plant
    from pliant.sim.spec import Build

#: Distance of the tool from its start at which the gripper opens [m].
OPENS = 0.05


@dataclass(kw_only=True)
class Handed(Gripped):
    """A ball in the grip that a person takes: a spring from the ball to a receding hand.

    The person's force is ``stiffness (goal - place) - damping v``, with its norm limited to
    `limit`. Once the grip is open, the hand also carries the ball's weight. Before the course
    starts there is no force.

    Attributes:
        mass: Mass of the ball [kg].
        way: Displacement of the hand (3,) in base axes [m].
        stiffness, damping, limit: Parameters of the person's arm [N/m], [N·s/m], [N].
        course: When the hand takes hold, and the duration of its motion.
        effort: Present force of the person [N].
        peak_effort: Largest force so far [N].
        released: Time at which the grip opened [s], None before.
    """

    mass: float = 0.3
    way: Sequence[float] = (0.25, 0.0, 0.05)
    stiffness: float = 600.0
    damping: float = 20.0
    limit: float = 60.0
    course: Course = field(default_factory=lambda: Course(start=2.0, rise=1.5, end=60.0))
    name: str = "handed"
    effort: float = field(default=0.0, init=False)
    peak_effort: float = field(default=0.0, init=False)
    released: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        """Check the numbers once."""
        super().__post_init__()
        if np.shape(self.way) != (3,):
            raise ConfigError(f"Handed.way has three entries, got {self.way!r}")
        if not (self.mass > 0.0 and min(self.stiffness, self.damping, self.limit) >= 0.0):
            raise ConfigError(
                f"Handed needs mass > 0; stiffness, damping and limit at least 0; got {self!r}"
            )

    def add(self, build: Build) -> None:
        """Add the ball and the grip on it."""
        ball = build.spec.worldbody.add_body(name=f"{self.name}:ball")
        ball.add_freejoint(name=f"{self.name}:free")
        ball.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(0.03, 0.0, 0.0),
            mass=self.mass,
            rgba=(0.85, 0.35, 0.2, 1.0),
            contype=0,
            conaffinity=0,
        )
        self.add_grip(build, ball, (0.0, 0.0, 0.0))

    def place(self, plant: Plant) -> None:
        """Put the ball into the tool, and clear the records."""
        model, data = plant.mj_model, plant.mj_data
        self._body = int(model.body(f"{self.name}:ball").id)
        joint = model.joint(f"{self.name}:free")
        start, self._dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._home = plant.tool[:3, 3].copy()
        data.qpos[start : start + 7] = (*self._home, 1.0, 0.0, 0.0, 0.0)
        self._weight = -self.mass * np.asarray(model.opt.gravity)
        self.place_grip(plant)
        self.effort = self.peak_effort = 0.0
        self.released = None

    def release(self, plant: Plant) -> None:
        """Open the grip."""
        super().release(plant)
        self.released = plant.time

    def before(self, plant: Plant) -> None:
        """Do nothing: no motion is prescribed."""

    def during(self, plant: Plant) -> None:
        """Apply the person's force, and the ball's weight once the grip is open."""
        data = plant.mj_data
        if not self.course.active(data.time):
            return
        place, speed = data.xpos[self._body], data.qvel[self._dof : self._dof + 3]
        goal = self._home + self.course.share(data.time) * np.asarray(self.way)
        force = self.stiffness * (goal - place) - self.damping * speed
        size = float(np.sqrt(force @ force))
        if size > self.limit:
            force, size = force * (self.limit / size), self.limit
        self.effort = size
        self.peak_effort = max(self.peak_effort, size)
        lift = self._weight if self.released is not None else np.zeros(3)
        plant.pull(self._body, force + lift, np.zeros(3), place.copy())

    def after(self, plant: Plant) -> None:
        """Record the force and torque in the grip."""
        self.feel_grip(plant)

    def place_of(self, plant: Plant) -> np.ndarray:
        """Return the position of the ball (3,) [m]."""
        return np.array(plant.mj_data.xpos[self._body])
