"""Simulated objects that the arm holds, and a handover to a person."""

from __future__ import annotations

import math
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

#: Time constant of the grip constraint (MuJoCo's `solref`) [s].
GRIP_TIME = 0.01
#: Impedances d_0 and d_width of the grip constraint (first entries of MuJoCo's `solimp`) [1]; they
#: make it stiffer than the default.
GRIP_IMPEDANCE = (0.95, 0.99)
#: Peak forces are recorded once this time has passed since reset [s]; until then, the servos take
#: up the weight of the arm.
SETTLE = 0.5


@dataclass(kw_only=True)
class GraspedObject(Fixture):
    """Base class of objects that the arm holds at a handle; at reset the handle is at the tool.

    Attributes:
        grip: `rigid` (the handle is welded to the tool) or `turning` (it can rotate in the grip).
        name: Name in the scene, unique; prefix of all bodies and joints.
        force: Norm of the force in the grip in the last physics step [N].
        torque: Norm of the torque in the grip in the last physics step [N·m]; 0 if `turning`.
        peak_force, peak_torque: Largest force [N] and torque [N·m] since 0.5 s after reset.
    """

    grip: Grip = "rigid"
    name: str = "thing"
    force: float = field(default=0.0, init=False)
    torque: float = field(default=0.0, init=False)
    peak_force: float = field(default=0.0, init=False)
    peak_torque: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless `grip` is `rigid` or `turning`."""
        if self.grip not in {"rigid", "turning"}:
            kind = type(self).__name__
            raise ConfigError(f"{kind}.grip must be 'rigid' or 'turning', got {self.grip!r}")

    def add_grip(self, build_spec: Build, body: mujoco.MjsBody, at: ArrayLike) -> None:
        """Add a handle to `body` and the constraint that holds it at the tool.

        `at` (3,) [m] is the position of the handle in the frame of the body.
        """
        spec = build_spec.spec
        position = np.asarray(at, dtype=np.float64)
        body.add_site(name=f"{self.name}:handle", pos=position, size=(0.01, 0.0, 0.0))
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
        """Align the handle with the tool, close the grip, and clear recorded forces."""
        model = plant.mj_model
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(plant.tool[:3, :3]).reshape(9))
        handle = model.site(f"{self.name}:handle")
        handle.quat[:] = quat
        # Mark the site as not aligned with its body: else MuJoCo ignores its new orientation.
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

    def _first_row(self, data: mujoco.MjData) -> int:
        """Return the index of the grip's first entry in MuJoCo's constraint forces."""
        if self._row is None:
            is_equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
            is_grip = is_equality & (data.efc_id == self._grip)
            self._row = int(np.flatnonzero(is_grip)[0])
        return self._row

    def after(self, plant: Plant) -> None:
        """Record force and torque in the grip after a physics step.

        The attribute `pull` (3,) is then the force in base axes [N].
        """
        data = plant.mj_data
        if not data.eq_active[self._grip]:
            self.force = self.torque = 0.0
            self.pull = np.zeros(3)
            return
        first = self._first_row(data)
        rows = data.efc_force[first : first + self._rows]
        self.pull = pull = rows[:3].copy()
        self.force = math.sqrt(pull @ pull)
        is_settled = data.time > SETTLE
        if is_settled:
            self.peak_force = max(self.peak_force, self.force)
        if self._rows > 3:
            # Halve the constraint force: it is twice the torque, because the error of a MuJoCo weld
            # is half the rotation vector.
            turn = rows[3:]
            self.torque = 0.5 * math.sqrt(turn @ turn)
            if is_settled:
                self.peak_torque = max(self.peak_torque, self.torque)


#: Distance of the tool from its start at which a program should open the gripper [m], because a
#: person pulls at the object.
RELEASE_DISTANCE = 0.05


@dataclass(kw_only=True)
class HandoverObject(GraspedObject):
    """Ball in the arm's grip that a person takes: a spring between the ball and a moving hand.

    The person's force on the ball is ``stiffness (goal - position) - damping v``, with the position
    `goal` of the hand, and position and velocity v of the ball. Its norm is limited to `limit`, and
    it is zero before `course.start`. After the grip has opened, the hand also carries the weight of
    the ball.

    Attributes:
        mass: Mass of the ball [kg].
        displacement: Displacement of the hand from the start to the end of its motion (3,) in base
            axes [m].
        stiffness: Stiffness of the person's arm [N/m].
        damping: Damping of the person's arm [N·s/m].
        limit: Largest force of the person [N].
        course: Time course of the hand's motion.
        effort: Norm of the present force of the person [N].
        peak_effort: Largest force of the person since reset [N].
        released: Time at which the grip opened [s]; None if it is closed.
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
        """Raise `ConfigError` unless all attributes are valid."""
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
        """Add the ball and the grip constraint."""
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
        """Place the ball at the tool, close the grip, and clear recorded forces."""
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
        """Open the grip, and record the time in `released`."""
        super().release(plant)
        self.released = plant.time

    def during(self, plant: Plant) -> None:
        """Apply the person's force to the ball; once the grip is open, carry its weight too."""
        data = plant.mj_data
        if not self.course.active(data.time):
            return
        position, velocity = data.xpos[self._body], data.qvel[self._dof : self._dof + 3]
        goal = self._home + self.course.share(data.time) * np.asarray(self.displacement)
        force = self.stiffness * (goal - position) - self.damping * velocity
        norm = float(np.sqrt(force @ force))
        if norm > self.limit:
            force, norm = force * (self.limit / norm), self.limit
        self.effort = norm
        self.peak_effort = max(self.peak_effort, norm)
        lift = self._weight if self.released is not None else np.zeros(3)
        plant.pull(self._body, force + lift, np.zeros(3), position.copy())
