"""Torque-limited position servos on real physics, with hands, doors and walls (extra `sim`).

>>> import pliant, pliant.sim
>>> arm = pliant.robots.arm7()
>>> plant = pliant.sim.Plant(arm, scene=[pliant.sim.STRONG])
>>> state = plant.reset(q_start)

`Plant.read()` and `Plant.write(goal, limit)` are the interface that hardware also has. `Plant.q`,
`Plant.tool` and `Plant.hands` are the true state, for figures and tests. World axes are the model's
base axes; all units SI.
axes; all units SI.
"""

from pliant.drive import State
from pliant.sim.doors import Door, Drive, door, fridge, oven
from pliant.sim.drawer import Drawer, drawer
from pliant.sim.drive import SimDrive
from pliant.sim.friction import MX64, MX106, STS3215, Friction
from pliant.sim.grip import Gripped
from pliant.sim.hand import (
    LIGHT,
    ROBUST,
    STRONG,
    YAW,
    Course,
    Drag,
    Guide,
    Hand,
    Push,
    Twist,
    tap,
)
from pliant.sim.handed import Handed
from pliant.sim.imperfections import Overload
from pliant.sim.plant import Plant
from pliant.sim.record import Recorder
from pliant.sim.scene import Fixture, Table, Wall, table
from pliant.sim.socket import Socket
from pliant.sim.state import Felt
from pliant.sim.surface import Surface
from pliant.sim.tabletop import Tabletop
from pliant.sim.truth import Frame, Truth

__all__ = [
    "LIGHT",
    "MX64",
    "MX106",
    "ROBUST",
    "STRONG",
    "STS3215",
    "YAW",
    "Course",
    "Door",
    "Drag",
    "Drawer",
    "Drive",
    "Felt",
    "Fixture",
    "Frame",
    "Friction",
    "Gripped",
    "Guide",
    "Hand",
    "Handed",
    "Overload",
    "Plant",
    "Push",
    "Recorder",
    "SimDrive",
    "Socket",
    "State",
    "Surface",
    "Table",
    "Tabletop",
    "Truth",
    "Twist",
    "Wall",
    "door",
    "drawer",
    "fridge",
    "oven",
    "table",
    "tap",
]
