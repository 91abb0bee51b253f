"""The grip between the tool and an object, and the force and torque in it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ConfigError
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant.sim.plant import Plant
    from pliant.sim.spec import Build

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
class Gripped:
    """An object that the arm holds at its site `handle`, which is where the tool is at reset.

    Attributes:
        grip: `rigid` (a weld) or `turning` (the handle rotates in the grip).
        name: Unique in a scene; prefix of all bodies and joints.
        force, torque: Present force and torque in the grip [N], [N·m]; 0 torque if `turning`.
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

    def add_grip(self, build: Build, body: mujoco.MjsBody, at: ArrayLike) -> None:
        """Tie the tool to a handle at `at` (3,) [m] on a body of the object."""
        spec = build.spec
        place = np.asarray(at, dtype=np.float64)
        body.add_site(name=f"{self.name}:handle", pos=place, size=(0.01, 0.0, 0.0))
        grip = spec.add_equality(
            name=f"{self.name}:grip", name1=build.model.tip, name2=f"{self.name}:handle"
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

    def feel_grip(self, plant: Plant) -> None:
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
