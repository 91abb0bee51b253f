"""Servo emulator: three serial protocols on pseudo-terminals, for tests and trials.

>>> from pliant.emulator import Device, Emulator
>>> with Emulator([Device("STS3215", id=1), Device("STS3215", id=2)]) as bus:
...     print(bus.port)

The emulator shares no register tables, checksums or conversions with the drivers, so that it can
test them.
"""

from pliant.emulator.arm import ArmEmulator, ArmPhysics, Mount, emulate
from pliant.emulator.device import Device
from pliant.emulator.emulator import Emulator
from pliant.emulator.faults import Faults
from pliant.emulator.hand import JointHand, ranges, wave
from pliant.emulator.log import Log, Transaction, Write
from pliant.emulator.manual_clock import ManualClock
from pliant.emulator.models import MODELS
from pliant.emulator.motion import Joints, Physics
from pliant.emulator.process import EmulatorProcess
from pliant.emulator.serial_line import Delivery, SerialLine
from pliant.emulator.servo import Drive, Load, Servo, Shaft
from pliant.emulator.timing import Timing

__all__ = [
    "MODELS",
    "ArmEmulator",
    "ArmPhysics",
    "Delivery",
    "Device",
    "Drive",
    "Emulator",
    "EmulatorProcess",
    "Faults",
    "JointHand",
    "Joints",
    "Load",
    "Log",
    "ManualClock",
    "Mount",
    "Physics",
    "SerialLine",
    "Servo",
    "Shaft",
    "Timing",
    "Transaction",
    "Write",
    "emulate",
    "ranges",
    "wave",
]
