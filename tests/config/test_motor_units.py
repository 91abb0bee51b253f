"""Joint positions in the units of LeRobot, compared with its formulas."""

import json
import math

import numpy as np
import pytest
from calibrations import JOINTS, lerobot_calibration

import pliant
from pliant import config


def calibrated(folder, name="so101", **changes):
    table = lerobot_calibration(7, **changes)
    (folder / "arm.json").write_text(json.dumps(table), "utf-8")
    return config.load(name, calibration=folder / "arm.json"), table


def lerobot_value(count, entry, norm, *, is_feetech):
    """Convert an encoder count to LeRobot's units by the documented rules of its `MotorsBus`."""
    low, high = entry["range_min"], entry["range_max"]
    if norm == "degrees":
        return (count - (low + high) / 2) * 360 / 4095
    bounded = min(high, max(low, count))
    inverted = is_feetech and entry["drive_mode"]
    if norm == "range_m100_100":
        value = (bounded - low) / (high - low) * 200 - 100
        return -value if inverted else value
    value = (bounded - low) / (high - low) * 100
    return 100 - value if inverted else value


@pytest.mark.parametrize("use_degrees", [True, False])
@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_values_are_those_of_lerobot(name, mode, use_degrees, tmp_path):
    changes = {joint: {"drive_mode": mode} for joint in ("elbow_flex", "gripper")}
    arm_config, table = calibrated(tmp_path, name, **changes)
    units = config.motor_units(arm_config, arm_config.model(), use_degrees=use_degrees)
    assert tuple(units) == JOINTS
    for joint, unit in units.items():
        norm = "range_0_100" if joint == "gripper" else unit.norm
        assert unit.norm == norm
        assert (norm == "degrees") == (use_degrees and joint != "gripper")
        entry = table[joint]
        for count in (0, entry["range_min"], 1000, 2047, 3000, entry["range_max"], 4095):
            position = (count - unit.zero) * unit.step
            value = lerobot_value(count, entry, norm, is_feetech=name == "so101")
            assert unit.value(position) == pytest.approx(value, abs=1e-9)
            if entry["range_min"] <= count <= entry["range_max"]:
                assert unit.position(value) == pytest.approx(position, abs=1e-9)


def test_zero_of_a_joint_is_the_middle_and_of_a_gripper_closed(tmp_path):
    arm_config, _ = calibrated(tmp_path)
    units = config.motor_units(arm_config, arm_config.model())
    for joint in JOINTS[:-1]:
        assert units[joint].value(0.0) == pytest.approx(0.0, abs=1e-9)
    assert units["gripper"].value(0.0) == pytest.approx(0.0)
    assert units["shoulder_lift"].value(math.radians(30.0)) == pytest.approx(30.0 * 4096 / 4095)
    assert units["shoulder_pan"].value(math.radians(30.0)) == pytest.approx(-30.0 * 4096 / 4095)


def test_without_a_calibration_the_ranges_are_the_position_limits():
    arm_config = config.load("so101")
    model = arm_config.model()
    units = config.motor_units(arm_config, model, use_degrees=False)
    lower = [units[joint].value(low) for joint, low in zip(JOINTS, model.lower, strict=False)]
    np.testing.assert_allclose(np.abs(lower), 100.0)
    assert units["gripper"].value(0.0) == pytest.approx(0.0)
    assert units["gripper"].value(1.7) == pytest.approx(100.0)


def test_a_file_without_servos_is_refused():
    arm_config = config.parse('backend = "sim"\nrobot.builtin = "arm7"\n')
    with pytest.raises(pliant.ConfigError, match=r"its servo in \[servo\]"):
        config.motor_units(arm_config, arm_config.model())


def test_calibrations_are_found_where_each_version_left_them(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    for subfolder in ("robots/so101_follower", "robots/koch_follower", "teleoperators/so_leader"):
        (tmp_path / subfolder).mkdir(parents=True)
    (tmp_path / "robots/so101_follower/mine.json").write_text("{}")
    (tmp_path / "teleoperators/so_leader/lead.json").write_text("{}")
    path = config.find_calibration("mine", "so101")
    assert path == tmp_path / "robots/so101_follower/mine.json"
    leader = config.find_calibration("lead", "so100", "teleoperators")
    assert leader.parent.name == "so_leader"
    (tmp_path / "robots/so_follower").mkdir()
    (tmp_path / "robots/so_follower/mine.json").write_text("{}")
    assert config.find_calibration("mine", "so101").parent.name == "so_follower"
    assert config.find_calibration("mine", "my_arm.toml").parent.name == "so_follower"
    # The plugin's own types write no calibration.
    run = "lerobot-calibrate --robot.type=koch_follower --robot.id=mine --robot.port=PORT"
    with pytest.raises(pliant.ConfigError, match=rf"'mine' .*koch_follower: run {run}"):
        config.find_calibration("mine", "koch")
    # Leaders and followers with the same id are different arms.
    with pytest.raises(pliant.ConfigError, match=r"'lead' .*so_follower; there are mine"):
        config.find_calibration("lead", "so101")
    with pytest.raises(pliant.ConfigError, match=r"--teleop\.type=so101_leader --teleop\.id=mine"):
        config.find_calibration("mine", "my_arm.toml", "teleoperators")
