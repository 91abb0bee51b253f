"""An emulated arm that records its tool speed, to be made in a process of its own."""

from __future__ import annotations

from experiments.faults import Watcher
from pliant import config
from pliant.config.factory import make_emulator


def so101():
    """Make the ready arm in real time, on servos that record the tool speed on request."""
    bus = make_emulator(config.load("so101"))
    bus.watcher = Watcher(bus)
    bus.on = lambda: any(servo.get("torque_enable") for servo in bus.servos)
    return bus
