"""Life cycle of an arm over any drive: torque on, read and write, lower, torque off."""

from pliant.arm.arm import Arm
from pliant.arm.budget import Budget
from pliant.arm.drive import Clock, Drive, Health, MonotonicClock, Sample
from pliant.arm.gripper import Gripper, GripperConfig
from pliant.arm.lowering import Lowering
from pliant.arm.state import State

__all__ = [
    "Arm",
    "Budget",
    "Clock",
    "Drive",
    "Gripper",
    "GripperConfig",
    "Health",
    "Lowering",
    "MonotonicClock",
    "Sample",
    "State",
]
