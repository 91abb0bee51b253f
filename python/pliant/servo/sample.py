"""Conversion of servo readings to joint readings."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pliant.drive import JointReadings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.servo.device import Device

#: Difference between two servos of a joint from which on they work against each other [rad].
TWINS_APART = 0.1


def align_secondaries(joints: Sequence[Sequence[Device]]) -> None:
    """Set the zero of each second servo from the first one, because the joint couples them.

    Raises:
        ServoError: The joint's range then crosses the second servo's encoder seam.
    """
    for first, *secondaries in joints:
        for secondary in secondaries:
            if first.position is not None and secondary.position is not None:
                q = first.angle(first.position)
                zero = secondary.position - secondary.units.sign * q / secondary.units.count
                secondary.units = replace(secondary.units, zero=zero)
                secondary.set_range()


def gather(joints: Sequence[Sequence[Device]], answered: set[tuple[str, int]]) -> JointReadings:
    """Return one reading of all joints.

    Args:
        joints: Servos of each joint, the first one first.
        answered: Port and id of the servos that answered in this reading.
    """
    rows = []
    for joint in joints:
        first = joint[0]
        angles = [d.angle(d.position) for d in joint if d.position is not None]
        apart = max(angles) - min(angles) if angles else 0.0
        first.fault(
            "secondaries",
            apart > TWINS_APART,
            f"its two servos disagree by {apart:.2f} rad and work against each other",
        )
        amps = np.nan
        if first.current is not None and first.row.current_unit:
            amps = first.row.current_unit * sum(abs(d.current or 0) for d in joint)
        rows.append(
            (
                angles[0] if angles else np.nan,
                all((d.spec.port, d.id) in answered for d in joint),
                min(d.time for d in joint),
                first.units.velocity(first.speed),
                sum(d.torque for d in joint) / len(joint),
                amps,
            )
        )
    position, ok, times, velocity, load, current = (np.array(c) for c in zip(*rows, strict=True))
    return JointReadings(position, ok, times, velocity, load, current)
