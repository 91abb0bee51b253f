"""An emulated arm that remembers how fast its tool was, to be made in a process of its own."""

from __future__ import annotations

from experiments.faults import Watcher
from pliant import config
from pliant.config.factory import make_emulator


def so101():
    """The ready arm in real time, on servos whose tool is watched once that is asked for."""
    bus = make_emulator(config.load("so101"))
    bus.watcher = Watcher(bus)
    bus.on = lambda: any(servo.get("torque_enable") for servo in bus.servos)
    return bus
