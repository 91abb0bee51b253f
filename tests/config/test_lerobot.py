"""Calibration files of LeRobot."""

import json

import pytest

import pliant
from pliant.config import read_calibration
from pliant.config.schema import zeros

MOTOR = {"id": 1, "drive_mode": 0, "homing_offset": -12, "range_min": 900, "range_max": 3100}


def test_a_file_is_read_as_it_is(tmp_path):
    file = tmp_path / "my_arm.json"
    file.write_text(json.dumps({"shoulder_pan": MOTOR}))
    motor = read_calibration(file)["shoulder_pan"]
    assert (motor.id, motor.middle, motor.homing_offset) == (1, 2000.0, -12)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({k: v for k, v in MOTOR.items() if k != "range_max"}, "lacks range_max"),
        ({**MOTOR, "range_mni": 3}, "did you mean 'range_min'"),
        ({**MOTOR, "id": "one"}, r"shoulder_pan\.id is a whole number, got 'one'"),
        ({**MOTOR, "id": True}, r"shoulder_pan\.id is a whole number"),
        ({**MOTOR, "range_min": 3100}, "empty range"),
        ({**MOTOR, "range_min": 3099}, "empty range, 3099 to 3100 counts"),
        ({**MOTOR, "drive_mode": 7}, "drive_mode is 0 or 1, got 7"),
        ([], "is not a table"),
    ],
)
def test_invalid_entries_of_a_motor_are_named(tmp_path, entry, message):
    file = tmp_path / "arm.json"
    file.write_text(json.dumps({"shoulder_pan": entry}))
    with pytest.raises(pliant.ConfigError, match=message):
        read_calibration(file)


def test_files_that_are_not_calibrations(tmp_path):
    with pytest.raises(pliant.ConfigError, match="lerobot-calibrate"):
        read_calibration(tmp_path / "none.json")
    for text in ("{", "[]", "{}", '"x"'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(pliant.ConfigError, match="not a calibration file"):
            read_calibration(tmp_path / "bad.json")
    for text in ("[" * 100_000, '{"shoulder_pan": ' + "1" * 5000 + "}"):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(pliant.ConfigError, match="not a calibration file"):
            read_calibration(tmp_path / "bad.json")


@pytest.mark.parametrize("key", ["id", "homing_offset", "range_max"])
def test_a_number_that_no_register_holds_is_refused(tmp_path, key):
    file = tmp_path / "arm.json"
    file.write_text(json.dumps({"shoulder_pan": {**MOTOR, key: 10**400}}))
    with pytest.raises(pliant.ConfigError, match=rf"{key} is larger than any register.*401 digits"):
        read_calibration(file)


@pytest.mark.parametrize(("key", "count"), [("range_min", -1), ("range_max", 4096)])
def test_a_range_outside_the_encoder_is_refused(tmp_path, key, count):
    (tmp_path / "cal.json").write_text(json.dumps({"shoulder_pan": {**MOTOR, key: count}}))
    text = (
        'robot.builtin = "so101"\ncalibration = "cal.json"\n[[port]]\npath = "/dev/x"\n[servo]\n'
        'shoulder_pan = { model = "STS3215-7.4V", id = 1 }\n'
    )
    arm_config = pliant.config.parse(text, folder=tmp_path)
    message = rf"shoulder_pan\.{key} is {count}, and positions of STS3215-7\.4V run from 0 to 4095"
    with pytest.raises(pliant.ConfigError, match=message) as error:
        zeros(arm_config)
    assert "degrees" not in str(error.value)


def test_a_calibrated_range_in_degrees_is_recognised(tmp_path):
    motor = {**MOTOR, "range_min": -90, "range_max": 90}
    (tmp_path / "cal.json").write_text(json.dumps({"shoulder_pan": motor}))
    text = (
        'robot.builtin = "so101"\ncalibration = "cal.json"\n[[port]]\npath = "/dev/x"\n[servo]\n'
        'shoulder_pan = { model = "STS3215-7.4V", id = 1 }\n'
    )
    with pytest.raises(pliant.ConfigError, match="or its range is in degrees instead of counts"):
        zeros(pliant.config.parse(text, folder=tmp_path))
