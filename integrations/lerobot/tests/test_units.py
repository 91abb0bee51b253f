"""`pliant.config.motor_units` against the conversions of LeRobot's own buses."""

import json

import numpy as np
import pytest
from lerobot.motors import Motor, MotorCalibration, MotorNormMode
from lerobot.motors.dynamixel import DynamixelMotorsBus
from lerobot.motors.feetech import FeetechMotorsBus

import pliant

MODELS = {
    "so101": (FeetechMotorsBus, ["sts3215"] * 6),
    "koch": (DynamixelMotorsBus, ["xl430-w250"] * 2 + ["xl330-m288"] * 4),
}
BODY = {True: MotorNormMode.DEGREES, False: MotorNormMode.RANGE_M100_100}


@pytest.mark.parametrize("use_degrees", [True, False])
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_units_are_those_of_lerobots_bus(name, use_degrees, tmp_path):
    """Compare both directions, inside and outside the ranges, with and without inverted motors."""
    rng = np.random.default_rng(3)
    bus_class, models = MODELS[name]
    file = pliant.config.load(name, backend="sim")
    joints = [*file.model().joint_names, "gripper"]
    table = {
        joint: {
            "id": i,
            "drive_mode": i % 2,
            "homing_offset": int(rng.integers(-900, 900)),
            "range_min": int(rng.integers(500, 1500)),
            "range_max": int(rng.integers(2500, 3600)),
        }
        for i, joint in enumerate(joints, 1)
    }
    path = tmp_path / "arm.json"
    path.write_text(json.dumps(table), "utf-8")
    file = pliant.config.load(name, backend="sim", calibration=path)
    units = pliant.config.motor_units(file, file.model(), use_degrees=use_degrees)
    motors = {
        joint: Motor(
            i, model, MotorNormMode.RANGE_0_100 if joint == "gripper" else BODY[use_degrees]
        )
        for i, (joint, model) in enumerate(zip(joints, models, strict=True), 1)
    }
    bus = bus_class("unused", motors, {j: MotorCalibration(**e) for j, e in table.items()})
    for joint, unit in units.items():
        number = table[joint]["id"]
        for count in rng.integers(0, 4096, 200).tolist():
            position = (count - unit.zero) * unit.step
            theirs = bus._normalize({number: count})[number]
            assert unit.value(position) == pytest.approx(theirs, abs=1e-9)
        span = 180.0 if unit.norm == "degrees" else 120.0
        for value in rng.uniform(-span, span, 200).tolist():
            count = unit.zero + unit.position(value) / unit.step
            # LeRobot cuts the fraction off.
            assert abs(count - bus._unnormalize({number: value})[number]) <= 1.0
