"""Helpers for tests of the LeRobot plugin: fast simulated time, and waits in that time."""

import os
import time
from pathlib import Path

import numpy as np

from pliant.drive import MonotonicClock

#: Simulated seconds per real second; in real time, a descent would take a quarter of a minute.
SPEED = 4.0
MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


class FastClock(MonotonicClock):
    """A clock that runs `SPEED` times faster."""

    def now(self):
        return SPEED * super().now()

    def wait_until(self, deadline):
        super().wait_until(deadline / SPEED)


def wait(seconds):
    """Wait for `seconds` of simulated time."""
    time.sleep(seconds / SPEED)


def wait_for(condition, seconds=40.0):
    """Wait until a condition holds; return False if it does not within `seconds` (simulated)."""
    end = time.monotonic() + seconds / SPEED
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def arm_of(robot):
    return robot._session.arm


def plant_of(robot):
    return arm_of(robot).drive.plant


def powered(arm):
    return bool(np.any(arm.drive.enabled))


def positions(robot):
    return {k: v for k, v in robot.get_observation().items() if k.endswith(".pos")}


def calibrations():
    return Path(os.environ["HF_LEROBOT_CALIBRATION"])
