"""Robot arm on any `Drive` (servo bus or simulator): enable, read, write, lower, torque off."""

from pliant._core import Lowering
from pliant.arm.arm import Arm
from pliant.arm.gripper import Gripper, GripperConfig
from pliant.arm.thermal import Budget
from pliant.drive import Clock, Drive, JointReadings, MonotonicClock, ServoStatus, State

__all__ = [
    "Arm",
    "Budget",
    "Clock",
    "Drive",
    "Gripper",
    "GripperConfig",
    "JointReadings",
    "Lowering",
    "MonotonicClock",
    "ServoStatus",
    "State",
]
