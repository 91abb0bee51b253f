"""Emulated servos behind pseudo-terminals: three protocols over real bytes, for tests and trials.

>>> from pliant.servo.emulator import Device, Emulator
>>> with Emulator([Device("STS3215", id=1), Device("STS3215", id=2)]) as bus:
...     print(bus.port)

Register tables, checksums and conversions are this package's own, shared with no driver: it judges
them.
"""

from pliant.servo.emulator.arm import ArmEmulator, ArmPhysics, Mount, emulate
from pliant.servo.emulator.device import Device
from pliant.servo.emulator.emulator import Emulator
from pliant.servo.emulator.faults import Faults
from pliant.servo.emulator.line import Delivery, Line
from pliant.servo.emulator.log import Log, Transaction, Write
from pliant.servo.emulator.models import MODELS
from pliant.servo.emulator.motion import Joints, Physics
from pliant.servo.emulator.process import Remote
from pliant.servo.emulator.servo import Drive, Load, Servo, Shaft
from pliant.servo.emulator.steps import StepClock
from pliant.servo.emulator.timing import Timing

__all__ = [
    "MODELS",
    "ArmEmulator",
    "ArmPhysics",
    "Delivery",
    "Device",
    "Drive",
    "Emulator",
    "Faults",
    "Joints",
    "Line",
    "Load",
    "Log",
    "Mount",
    "Physics",
    "Remote",
    "Servo",
    "Shaft",
    "StepClock",
    "Timing",
    "Transaction",
    "Write",
    "emulate",
]
