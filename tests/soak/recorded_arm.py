"""An emulated SO-101 that records the speed of its tool, to be created in a child process."""

from __future__ import annotations

from experiments.faults import PeakRecorder
from pliant import config
from pliant.config.factory import make_emulator


def so101(q=None):
    """Return an emulated SO-101 in real time at q (5,) [rad].

    Further attributes, for `EmulatorProcess.call`: `recorder`, which records the speed of the tool
    after its `begin`, and `has_torque()`.
    """
    emulator = make_emulator(config.load("so101"), q=q)
    emulator.recorder = PeakRecorder(emulator)
    emulator.has_torque = lambda: any(servo.get("torque_enable") for servo in emulator.servos)
    return emulator
