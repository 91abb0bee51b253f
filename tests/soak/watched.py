"""An emulated arm that records its tool speed, to be made in a process of its own."""

from __future__ import annotations

from experiments.faults import PeakRecorder
from pliant import config
from pliant.config.factory import make_emulator


def so101(q=None):
    """Make the ready arm in real time, in q (5,) [rad], whose tool speed is recorded on request."""
    bus = make_emulator(config.load("so101"), q=q)
    bus.recorder = PeakRecorder(bus)
    bus.on = lambda: any(servo.get("torque_enable") for servo in bus.servos)
    return bus
