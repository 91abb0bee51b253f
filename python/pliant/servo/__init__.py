"""Servo drivers: the bus of an arm's servos, servo models, unit conversion and serial ports.

Only opening a serial port needs the extra ``servo``.
"""

from __future__ import annotations

from pliant.servo._transactions import wire_bytes, wire_time
from pliant.servo.bus import ServoBus
from pliant.servo.models import ServoModel, get_model, list_models
from pliant.servo.spec import ServoSpec, Units, servos_of
from pliant.servo.transport import BusError, RustypotTransport, Transport, serial_ports

__all__ = [
    "BusError",
    "RustypotTransport",
    "ServoBus",
    "ServoModel",
    "ServoSpec",
    "Transport",
    "Units",
    "get_model",
    "list_models",
    "serial_ports",
    "servos_of",
    "wire_bytes",
    "wire_time",
]
