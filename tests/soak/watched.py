"""An emulated arm that records its tool speed, for use in a child process."""

from __future__ import annotations

from experiments.faults import PeakRecorder
from pliant import config
from pliant.config.factory import make_emulator


def so101(q=None):
    """Return an emulated SO-101 in real time at q (5,) [rad]; it records its tool speed.

    The recording starts with `recorder.begin`.
    """
    bus = make_emulator(config.load("so101"), q=q)
    bus.recorder = PeakRecorder(bus)
    bus.on = lambda: any(servo.get("torque_enable") for servo in bus.servos)
    return bus
