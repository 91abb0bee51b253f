"""Simulated table on which the arm stands: a plane in contact with the moving links."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError
from pliant.sim._mujoco import mujoco
from pliant.sim.plant import Fixture

if TYPE_CHECKING:
    from pliant._core import Model
    from pliant._typing import Array
    from pliant.sim._model_builder import Build, Group
    from pliant.sim.plant import Plant

#: Bit of MuJoCo's contact filter for the plane and the arm's links; plug and socket of the class
#: `Socket` have another bit.
CONTACT_BIT = 4
#: MuJoCo's contact parameter `solref`: time constant [s] and damping ratio [1]. For a mass of 1 kg
#: the contact stiffness is then 20 kN/m.
CONTACT = (0.007, 1.0)
#: Component |z| of the unit vector of a joint axis above which the axis counts as vertical [1]; a
#: joint with a vertical axis cannot raise a link.
VERTICAL = 0.999


@dataclass(kw_only=True, eq=False)
class Tabletop(Fixture):
    """Horizontal plane in contact with every link that can move up or down.

    The contact geometry of a link is its visible geometry, the capsules. Links that only turn about
    a vertical axis do not change their height and are excluded.

    Attributes:
        height: Height of the plane in base axes [m].
        friction: Friction coefficient between links and plane [1].
        force: Sum of the normal forces of all contacts in the last physics step [N].
        peak_force: Largest normal force since reset [N].
        touching: Names of the links in contact in the last physics step.
    """

    height: float = 0.0
    friction: float = 0.5
    name: str = "tabletop"
    force: float = field(default=0.0, init=False)
    peak_force: float = field(default=0.0, init=False)
    touching: tuple[str, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        if not (np.isfinite(self.height) and self.friction >= 0.0):
            raise ConfigError(f"Tabletop needs a finite height and friction >= 0, got {self!r}")

    def add(self, build_spec: Build) -> None:
        """Add the plane, and enable contact for the links that can move up or down."""
        spec = build_spec.spec
        spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        spec.worldbody.add_geom(
            name=self.name,
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            pos=(0.0, 0.0, self.height),
            size=(0.6, 0.6, 0.05),
            rgba=(0.55, 0.50, 0.44, 1.0),
            contype=CONTACT_BIT,
            conaffinity=0,
            friction=(self.friction, 0.005, 0.0001),
            solref=CONTACT,
        )
        self._links: dict[str, str] = {}
        for index, group in enumerate(build_spec.rigid_groups):
            if not can_rise(build_spec.model, build_spec.rigid_groups, index):
                continue
            link = build_spec.model.links[group.link].name
            for number, geom in enumerate(build_spec.bodies[index].geoms):
                geom.name = f"{self.name}:{link}:{number}"
                geom.conaffinity = CONTACT_BIT
                geom.friction = (self.friction, 0.005, 0.0001)
                geom.solref = CONTACT
                self._links[geom.name] = link

    def place(self, plant: Plant) -> None:
        """Look up the compiled contact geometry, and clear recorded forces."""
        model = plant.mj_model
        self._plane = int(model.geom(self.name).id)
        self._link_of = {int(model.geom(name).id): link for name, link in self._links.items()}
        self._data, self._model = plant.mj_data, model
        self.force = self.peak_force = 0.0
        self.touching = ()

    def after(self, plant: Plant) -> None:
        """Record the normal force and the links in contact after a physics step."""
        data = plant.mj_data
        if not data.ncon:
            self.force, self.touching = 0.0, ()
            return
        total, links, wrench = 0.0, [], np.zeros(6)
        for i in range(data.ncon):
            pair = data.contact[i].geom
            if self._plane not in pair:
                continue
            mujoco.mj_contactForce(plant.mj_model, data, i, wrench)
            total += float(wrench[0])
            links.append(self._link_of[int(pair[0] if pair[1] == self._plane else pair[1])])
        self.force, self.touching = total, tuple(dict.fromkeys(links))
        self.peak_force = max(self.peak_force, total)

    def clearance(self) -> float:
        """Return the smallest height of the links above the plane [m]; negative below the plane."""
        lowest = np.inf
        for geom in self._link_of:
            radius, half = self._model.geom_size[geom, :2]
            drop = abs(float(self._data.geom_xmat[geom, 8])) * half + radius
            lowest = min(lowest, float(self._data.geom_xpos[geom, 2]) - drop - self.height)
        return lowest


def can_rise(model: Model, groups: list[Group], index: int) -> bool:
    """Return True if a joint between the base and the group `index` can raise or lower it."""
    chain: list[int] = []
    current: int | None = index
    while current is not None and groups[current].joint is not None:
        chain.append(current)
        current = groups[current].parent
    pose: Array = groups[0].pose.copy()
    for number in reversed(chain):
        pose = pose @ groups[number].pose
        index_of_joint = groups[number].joint
        assert index_of_joint is not None
        joint = model.joints[index_of_joint]
        axis = pose[:3, :3] @ joint.axis
        if joint.kind == "prismatic" or abs(float(axis[2])) < VERTICAL:
            return True
    return False
