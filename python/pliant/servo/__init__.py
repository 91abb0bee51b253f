"""Servo buses: tables, units, transport, guard, and all servos of an arm as one chain.

Needs the extra ``servo`` only where a serial port is opened.
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
