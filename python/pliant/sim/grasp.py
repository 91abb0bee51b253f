"""Objects in the grip of the arm: the grip itself, and a handover to a person."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ConfigError
from pliant.sim._mujoco import mujoco
from pliant.sim.hand import ForceProfile
from pliant.sim.plant import Fixture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from pliant.sim._model_builder import Build
    from pliant.sim.plant import Plant


Grip = Literal["rigid", "turning"]

#: Time constant of the grip [s].
GRIP_TIME = 0.01
#: Impedance of the grip constraint (MuJoCo's solimp), close to and far from its target: stiffer
#: than MuJoCo's default.
GRIP_IMPEDANCE = (0.95, 0.99)
#: Start of the records [s]: at a start from rest the arm shakes the handle while the servos take
#: up its weight.
SETTLE = 0.5


@dataclass(kw_only=True)
class GraspedObject(Fixture):
    """An object that the arm holds at its site `handle`, which is where the tool is at reset.

    Attributes:
        grip: `rigid` (a weld) or `turning` (the handle rotates in the grip).
        name: Unique in a scene; prefix of all bodies and joints.
        force: Norm of the force in the grip in the last physics step [N].
        torque: Norm of the torque in the grip in the last physics step [N·m]; 0 if `turning`.
        peak_force, peak_torque: Largest of any physics step since 0.5 s after the reset.
    """

    grip: Grip = "rigid"
    name: str = "thing"
    force: float = field(default=0.0, init=False)
    torque: float = field(default=0.0, init=False)
    peak_force: float = field(default=0.0, init=False)
    peak_torque: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        """Check the grip."""
        if self.grip not in {"rigid", "turning"}:
            kind = type(self).__name__
            raise ConfigError(f"{kind}.grip must be 'rigid' or 'turning', got {self.grip!r}")

    def add_grip(self, build_spec: Build, body: mujoco.MjsBody, at: ArrayLike) -> None:
        """Tie the tool to a handle at `at` (3,) [m] on a body of the object."""
        spec = build_spec.spec
        place = np.asarray(at, dtype=np.float64)
        body.add_site(name=f"{self.name}:handle", pos=place, size=(0.01, 0.0, 0.0))
        grip = spec.add_equality(
            name=f"{self.name}:grip", name1=build_spec.model.tip, name2=f"{self.name}:handle"
        )
        grip.type = mujoco.mjtEq.mjEQ_WELD if self.grip == "rigid" else mujoco.mjtEq.mjEQ_CONNECT
        grip.objtype = mujoco.mjtObj.mjOBJ_SITE
        if self.grip == "rigid":
            grip.data[10] = 1.0
        grip.solref = (GRIP_TIME, 1.0)
        grip.solimp[:2] = GRIP_IMPEDANCE

    def place_grip(self, plant: Plant) -> None:
        """Align the handle with the tool, close the grip, and clear the records."""
        model = plant.mj_model
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(plant.tool[:3, :3]).reshape(9))
        handle = model.site(f"{self.name}:handle")
        handle.quat[:] = quat
        # Without this, a site compiled with the body's axes would keep copying them.
        model.site_sameframe[handle.id] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        self._grip = model.equality(f"{self.name}:grip").id
        self._rows = 6 if self.grip == "rigid" else 3
        self._row: int | None = None
        self.force = self.torque = self.peak_force = self.peak_torque = 0.0
        self.pull = np.zeros(3)
        plant.mj_data.eq_active[self._grip] = 1

    def release(self, plant: Plant) -> None:
        """Open the grip; the object stays where it is."""
        plant.mj_data.eq_active[self._grip] = 0
        self._row = None

    def after(self, plant: Plant) -> None:
        """Record force and torque in the grip; `pull` (3,) is the force in base axes [N]."""
        data = plant.mj_data
        if not data.eq_active[self._grip]:
            self.force = self.torque = 0.0
            self.pull = np.zeros(3)
            return
        if self._row is None:
            mine = (data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (
                data.efc_id == self._grip
            )
            self._row = int(np.flatnonzero(mine)[0])
        rows = data.efc_force[self._row : self._row + self._rows]
        self.pull = rows[:3].copy()
        self.force = float(np.sqrt(rows[:3] @ rows[:3]))
        counts = data.time > SETTLE
        if counts:
            self.peak_force = max(self.peak_force, self.force)
        if self._rows > 3:
            # The rotational rows of a weld use half the rotation vector, so they carry twice the
            # torque.
            self.torque = 0.5 * float(np.sqrt(rows[3:] @ rows[3:]))
            if counts:
                self.peak_torque = max(self.peak_torque, self.torque)


#: Distance of the tool from its start at which the gripper opens [m].
RELEASE_DISTANCE = 0.05


@dataclass(kw_only=True)
class HandoverObject(GraspedObject):
    """A ball in the grip that a person takes: a spring from the ball to a receding hand.

    The person's force is ``stiffness (goal - place) - damping v``, with its norm limited to
    `limit`. Once the grip is open, the hand also carries the ball's weight. Before the course
    starts there is no force.

    Attributes:
        mass: Mass of the ball [kg].
        displacement: Displacement of the hand (3,) in base axes [m].
        stiffness: Stiffness of the person's arm [N/m].
        damping: Damping of the person's arm [N·s/m].
        limit: Largest force of the person [N].
        course: When the hand takes hold, and the duration of its motion.
        effort: Present force of the person [N].
        peak_effort: Largest force so far [N].
        released: Time at which the grip opened [s], None before.
    """

    mass: float = 0.3
    displacement: Sequence[float] = (0.25, 0.0, 0.05)
    stiffness: float = 600.0
    damping: float = 20.0
    limit: float = 60.0
    course: ForceProfile = field(
        default_factory=lambda: ForceProfile(start=2.0, rise=1.5, end=60.0)
    )
    name: str = "handed"
    effort: float = field(default=0.0, init=False)
    peak_effort: float = field(default=0.0, init=False)
    released: float | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        """Check the numbers once."""
        super().__post_init__()
        if np.shape(self.displacement) != (3,):
            raise ConfigError(
                f"HandoverObject.displacement has three entries, got {self.displacement!r}"
            )
        if not (self.mass > 0.0 and min(self.stiffness, self.damping, self.limit) >= 0.0):
            raise ConfigError(
                "HandoverObject needs mass > 0; stiffness, damping and limit at least 0; got "
                f"{self!r}"
            )

    def add(self, build_spec: Build) -> None:
        """Add the ball and the grip on it."""
        ball = build_spec.spec.worldbody.add_body(name=f"{self.name}:ball")
        ball.add_freejoint(name=f"{self.name}:free")
        ball.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(0.03, 0.0, 0.0),
            mass=self.mass,
            rgba=(0.85, 0.35, 0.2, 1.0),
            contype=0,
            conaffinity=0,
        )
        self.add_grip(build_spec, ball, (0.0, 0.0, 0.0))

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

    def during(self, plant: Plant) -> None:
        """Apply the person's force, and the ball's weight once the grip is open."""
        data = plant.mj_data
        if not self.course.active(data.time):
            return
        place, speed = data.xpos[self._body], data.qvel[self._dof : self._dof + 3]
        goal = self._home + self.course.share(data.time) * np.asarray(self.displacement)
        force = self.stiffness * (goal - place) - self.damping * speed
        size = float(np.sqrt(force @ force))
        if size > self.limit:
            force, size = force * (self.limit / size), self.limit
        self.effort = size
        self.peak_effort = max(self.peak_effort, size)
        lift = self._weight if self.released is not None else np.zeros(3)
        plant.pull(self._body, force + lift, np.zeros(3), place.copy())

    def place_of(self, plant: Plant) -> np.ndarray:
        """Return the position of the ball (3,) [m]."""
        return np.array(plant.mj_data.xpos[self._body])
