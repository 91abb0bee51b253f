"""Emulated servos behind pseudo-terminals: three protocols over real bytes, for tests and trials.

>>> from pliant.emulator import Device, Emulator
>>> with Emulator([Device("STS3215", id=1), Device("STS3215", id=2)]) as bus:
...     print(bus.port)

Register tables, checksums and conversions are independent of the drivers, so that the emulator can
test them.
"""

from pliant.emulator.arm import ArmEmulator, ArmPhysics, Mount, emulate
from pliant.emulator.device import Device
from pliant.emulator.emulator import Emulator
from pliant.emulator.faults import Faults
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
]
