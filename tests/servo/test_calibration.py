"""Comparison of a calibration file with the servos' registers, before torque is switched on."""

import json
from pathlib import Path

import numpy as np
import pytest
from calibrations import JOINTS, lerobot_calibration

import pliant
from pliant import config
from pliant.config import factory
from pliant.config.doctor import examine
from pliant.config.factory import make_emulator, make_mounts
from pliant.emulator import ManualClock, emulate
from pliant.servo import ServoBus


def lerobot_file(folder, **changes):
    """Return a calibration file as lerobot-calibrate writes it; `changes`: entries by joint."""
    table = lerobot_calibration(10, **changes)
    file = folder / f"{len(list(folder.iterdir()))}.json"
    file.write_text(json.dumps(table), "utf-8")
    return file


def open_bus(name, folder, **changes):
    """Open a calibrated built-in arm with a calibration file changed by `changes`.

    Return the notes on its servos, and the closed bus.
    """
    matching = config.load(name, backend="emulator", calibration=lerobot_file(folder))
    changed = config.load(name, backend="emulator", calibration=lerobot_file(folder, **changes))
    with make_emulator(matching, clock="steps") as bus:
        before = bus.log.order(1)
        servo_bus = ServoBus(
            factory.servo_specs(changed, bus.ports), reply_timeout_min=0.5, clock=ManualClock(bus)
        )
        try:
            servo_bus.open()
            return [note for servo in servo_bus.found for note in servo.notes], servo_bus
        finally:
            servo_bus.close()
            assert bus.log.order(1) == before, "nothing was written"
            assert not bus.log.eeprom_writes()


@pytest.mark.parametrize("name", ["so101", "koch"])
def test_a_file_that_lerobot_wrote_passes(name, tmp_path):
    notes, servo_bus = open_bus(name, tmp_path)
    assert servo_bus.found
    assert not [note for note in notes if "calibration" in note]


@pytest.mark.parametrize("name", ["so101", "koch"])
@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"homing_offset": -1200}, r"elbow_flex .*homing_offset -1200, the servo 0: .*off by 105°"),
        ({"homing_offset": 1}, r"homing_offset 1, the servo 0: its zero would be off by 0.0879°"),
        ({"range_min": 1000}, r"range_min 1000, the servo 730: its zero would be off by 11.9°"),
        ({"range_max": 3000}, r"range_max 3000, the servo 3330: its zero would be off by 14.5°"),
    ],
)
def test_a_file_of_another_arm_is_refused_with_the_angle(name, entry, message, tmp_path):
    with pytest.raises(pliant.ServoError, match=message) as error:
        open_bus(name, tmp_path, elbow_flex=entry)
    assert "lerobot-calibrate" in str(error.value)
    assert "shoulder_pan" not in str(error.value)


def test_every_joint_that_differs_is_named(tmp_path):
    changes = {joint: {"homing_offset": 900} for joint in JOINTS}
    with pytest.raises(pliant.ServoError) as error:
        open_bus("so101", tmp_path, **changes)
    for joint in JOINTS:
        assert f"{joint} (id" in str(error.value)


def test_an_impossible_direction_is_refused_and_one_of_lerobot_is_noted(tmp_path):
    changes = {"wrist_flex": {"drive_mode": 1}}
    with pytest.raises(pliant.ServoError, match=r"drive_mode 1, the servo 0: it counts in"):
        open_bus("koch", tmp_path, **changes)
    notes, _ = open_bus("so101", tmp_path, **changes)
    assert len([note for note in notes if "drive_mode 1" in note and "`sign`" in note]) == 1


def test_a_joint_with_a_zero_of_its_own_needs_no_file(tmp_path):
    text = 'backend = "emulator"\nrobot.builtin = "so101"\n[servo]\n' + "\n".join(
        f'{joint} = {{ model = "STS3215-7.4V", id = {i}, zero = 2000 }}'
        for i, joint in enumerate(JOINTS[:5], 1)
    )
    file = lerobot_file(tmp_path)
    arm_config = config.parse(f'calibration = "{file.name}"\n{text}', folder=tmp_path)
    assert {
        spec.calibration for spec in factory.servo_specs(arm_config, {"main": "/dev/none"})
    } == {None}


def test_doctor_reports_each_joint(tmp_path, monkeypatch):
    uncalibrated = config.load("so101", backend="emulator")
    arm_config = config.load("so101", calibration=lerobot_file(tmp_path))
    with emulate(uncalibrated.model(), make_mounts(uncalibrated), [0.0] * 5, held=True) as bus:
        wired = config.load("so101", calibration=arm_config.calibration, port=bus.ports["main"])
        problems = [finding.text for finding in examine(wired) if finding.level == "bad"]
    offsets = [text for text in problems if "homing_offset" in text]
    # One error per joint, except the third, whose offset in the file is 0 as in a new servo.
    assert len(offsets) == 5
    assert any("shoulder_pan" in text and "off by 17.6°" in text for text in offsets)


@pytest.mark.parametrize(("sign", "closed"), [(1, 2000), (-1, 3100)])
def test_a_calibrated_gripper_closes_at_the_end_of_its_range(sign, closed, tmp_path):
    text = (Path(config.__file__).parent / "arms" / "so101.toml").read_text("utf-8")
    changed_text = text.replace("id = 6, gain = 16 }", f"id = 6, gain = 16, sign = {sign} }}")
    file = tmp_path / "arm.toml"
    file.write_text(changed_text, "utf-8")
    calibration = lerobot_file(tmp_path, gripper={"range_min": 2000, "range_max": 3100})
    arm_config = config.load(file, backend="emulator", calibration=calibration)
    (jaw,) = factory.gripper_configs(arm_config).values()
    assert jaw.closed == 0.0
    assert jaw.opened == pytest.approx(1100 * 2.0 * np.pi / 4096)
    with make_emulator(arm_config, clock="steps") as bus:
        drive = ServoBus(
            factory.servo_specs(arm_config, bus.ports),
            reply_timeout_min=0.5,
            clock=ManualClock(bus),
        )
        grippers = factory.gripper_configs(arm_config)
        with pliant.Arm(
            arm_config.model(),
            drive,
            grippers=grippers,
            handle_signals=False,
            on_exit="leave_enabled",
        ) as arm:
            for move, count in ((arm.gripper.close, closed), (arm.gripper.open, 5100 - closed)):
                move()
                for tick in pliant.Loop(arm, rate=100.0, duration=2.0):
                    tick.skip()
                assert bus.servo(6).get("present_position") == pytest.approx(count, abs=30)
