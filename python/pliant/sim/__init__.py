"""MuJoCo simulation of arms with torque-limited servos, hands, doors and walls (extra `sim`).

>>> import pliant, pliant.sim
>>> arm = pliant.robots.arm7()
>>> plant = pliant.sim.Plant(arm, scene=[pliant.sim.DRAG_80N])
>>> state = plant.reset(q_start)

`Plant.read()` and `Plant.write(goal, limit)` act like a servo bus, with its delays and losses.
`Plant.q`, `Plant.tool` and `Plant.hands` are the true state, for figures and tests. The world frame
is the base frame of the robot model; all units are SI.
"""

from pliant.drive import State
from pliant.sim._servos import Overload
from pliant.sim.doors import Door, Drive, door, fridge, oven
from pliant.sim.drawer import Drawer, drawer
from pliant.sim.drive import SimDrive
from pliant.sim.friction import MX64, MX106, STS3215, Friction
from pliant.sim.grasp import GraspedObject, HandoverObject
from pliant.sim.ground_truth import Frame, GroundTruth
from pliant.sim.hand import (
    DRAG_15N,
    DRAG_30N,
    DRAG_80N,
    TWIST_3NM,
    AppliedForce,
    Drag,
    ForceProfile,
    Hand,
    Push,
    SpringConstraint,
    Twist,
    tap,
)
from pliant.sim.plant import Fixture, Plant
from pliant.sim.record import Recorder
from pliant.sim.scene import Table, Wall, table
from pliant.sim.socket import Socket
from pliant.sim.surface import Surface
from pliant.sim.tabletop import Tabletop

__all__ = [
    "DRAG_15N",
    "DRAG_30N",
    "DRAG_80N",
    "MX64",
    "MX106",
    "STS3215",
    "TWIST_3NM",
    "AppliedForce",
    "Door",
    "Drag",
    "Drawer",
    "Drive",
    "Fixture",
    "ForceProfile",
    "Frame",
    "Friction",
    "GraspedObject",
    "GroundTruth",
    "Hand",
    "HandoverObject",
    "Overload",
    "Plant",
    "Push",
    "Recorder",
    "SimDrive",
    "Socket",
    "SpringConstraint",
    "State",
    "Surface",
    "Table",
    "Tabletop",
    "Twist",
    "Wall",
    "door",
    "drawer",
    "fridge",
    "oven",
    "table",
    "tap",
]
