"""The table that an arm stands on: a plane that every moving link can touch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pliant import ConfigError
from pliant.sim._mujoco import mujoco
from pliant.sim.tree import as_matrix, unit

if TYPE_CHECKING:
    from pliant.sim.plant import Plant
    from pliant.sim.spec import Build
    from pliant.sim.tree import Group, Matrix, Robot

#: Bit by which the plane and the arm's links find each other; a plug and its socket have another.
CONTACT_BIT = 4
#: MuJoCo's time constant [s] and damping ratio of the contact: with 1 kg behind it, as stiff as
#: 20 kN/m.
CONTACT = (0.007, 1.0)
#: A joint axis this parallel to the vertical cannot raise or lower what it carries.
VERTICAL = 0.999


@dataclass(kw_only=True, eq=False)
class Tabletop:
    """A horizontal plane that stops every link that can move up or down.

    Links touch it with the capsules that draw the arm. Those that only turn about a vertical axis
    above the base never leave their height and never touch.

    Attributes:
        height: Of the plane in base axes [m].
        friction: Coefficient μ between links and plane.
        force: Normal force of all contacts in the last physics step [N].
        peak_force: The largest since reset [N].
        touching: Links that touched it in the last physics step.
    """

    height: float = 0.0
    friction: float = 0.5
    name: str = "tabletop"
    force: float = field(default=0.0, init=False)
    peak_force: float = field(default=0.0, init=False)
    touching: tuple[str, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        """Check the numbers once."""
        if not (np.isfinite(self.height) and self.friction >= 0.0):
            raise ConfigError(f"Tabletop needs a finite height and friction >= 0, got {self!r}")

    def add(self, build: Build) -> None:
        """Add the plane, and capsules to the links that can reach it."""
        spec = build.spec
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
        for index, group in enumerate(build.groups):
            if not can_rise(build.model, build.groups, index):
                continue
            link = build.model.links[group.link].name
            for number, geom in enumerate(build.bodies[index].geoms):
                geom.name = f"{self.name}:{link}:{number}"
                geom.conaffinity = CONTACT_BIT
                geom.friction = (self.friction, 0.005, 0.0001)
                geom.solref = CONTACT
                self._links[geom.name] = link

    def place(self, plant: Plant) -> None:
        """Forget the records."""
        model = plant.mj_model
        self._plane = int(model.geom(self.name).id)
        self._link_of = {int(model.geom(name).id): link for name, link in self._links.items()}
        self._data, self._model = plant.mj_data, model
        self.force = self.peak_force = 0.0
        self.touching = ()

    def before(self, plant: Plant) -> None:
        """Nothing moves by itself."""

    def during(self, plant: Plant) -> None:
        """The contact is MuJoCo's own."""

    def after(self, plant: Plant) -> None:
        """Record what presses on the table."""
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
        """Least height of any link that can touch over the table now [m]; below 0: inside it."""
        lowest = np.inf
        for geom in self._link_of:
            radius, half = self._model.geom_size[geom, :2]
            drop = abs(float(self._data.geom_xmat[geom, 8])) * half + radius
            lowest = min(lowest, float(self._data.geom_xpos[geom, 2]) - drop - self.height)
        return lowest


def can_rise(model: Robot, groups: list[Group], index: int) -> bool:
    """Return whether some joint between the base and a group can raise or lower it."""
    chain: list[int] = []
    at: int | None = index
    while at is not None and groups[at].joint is not None:
        chain.append(at)
        at = groups[at].parent
    pose: Matrix = groups[0].pose.copy()
    for number in reversed(chain):
        pose = pose @ as_matrix(groups[number].pose)
        joint = groups[number].joint
        assert joint is not None
        axis = pose[:3, :3] @ unit(model.joints[joint].axis)
        slides = str(model.joints[joint].kind).lower().endswith("prismatic")
        if slides or abs(float(axis[2])) < VERTICAL:
            return True
    return False
