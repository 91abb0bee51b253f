"""`pliant servos doctor` finds errors in a configuration before they affect the arm."""

import os
import re

import numpy as np
import pytest

import pliant
from pliant import config
from pliant.arm._checks import posture
from pliant.cli import main
from pliant.cli.servos import doctor
from pliant.config import doctor as doctor_checks
from pliant.config import factory
from pliant.config.doctor import Diagnosis, examine
from pliant.config.factory import make_emulator


def findings(text, folder, level="bad"):
    arm_config = config.parse(text, source="arm.toml", folder=folder)
    return {f.about: f.text for f in examine(arm_config) if f.level == level}


def so101_of(urdf):
    servos = "\n".join(
        f'{joint} = {{ model = "STS3215-7.4V", id = {i} }}'
        for i, joint in enumerate(config.load("so101").servo, 1)
    )
    robot = f'urdf = "{urdf}"\nbase = "base"\ntip = "tool"'
    return f'backend = "sim"\n[robot]\n{robot}\n[servo]\n{servos}\n'


@pytest.mark.parametrize(("factor", "is_bad"), [(1.0, False), (1000.0, True)])
def test_a_urdf_with_masses_in_grams_is_not_ready(factor, is_bad, tmp_path):
    from importlib.resources import files

    text = files("pliant.robots").joinpath("so101_like.urdf").read_text("utf-8")
    heavy = re.sub(r'mass value="([\d.]+)"', lambda m: f'mass value="{factor * float(m[1])}"', text)
    (tmp_path / "arm.urdf").write_text(heavy, "utf-8")
    messages = findings(so101_of("arm.urdf"), tmp_path)
    assert ("model" in messages) == is_bad
    if is_bad:
        assert "gravity takes all the torque" in messages["model"]
    notes = findings(so101_of("arm.urdf"), tmp_path, "note")
    assert "6 axes on an arm of 5 joints" in notes["settings"]
    assert "settings" not in findings(
        config.loader.builtin_text("so101").replace("auto", "/x"), tmp_path
    )


@pytest.mark.parametrize("payload", ["mass = 150", "mass = 0.15, com = [0, 0, 30]"])
def test_a_payload_in_grams_or_millimetres_is_named(payload, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("pliant.config.doctor.CLOCK_TEST_TIME", 0.01)
    text = config.loader.builtin_text("so101")
    text = text.replace("[robot]", f"[robot]\npayload = {{ {payload} }}")
    file = tmp_path / "arm.toml"
    file.write_text(text)
    message = findings(f'backend = "sim"\n{text}', tmp_path)["model"]
    assert re.search(r"shoulder_lift needs up to \d+\.\d+ N·m, its servo has 1\.91\d N·m", message)
    mass = "150" if "150" in payload else "0.15"
    assert f"check masses [kg] and centres of mass [m] of the payload ({mass} kg)" in message
    assert main(["run", str(file), "--backend", "sim", "--quiet", "--duration", "0.1"]) == 2
    assert capsys.readouterr().err == f"error: {message}\n"


def test_joints_without_position_limits_are_noted(tmp_path, monkeypatch):
    """Each of the two remedies in the note ends the note for the joint that gets it."""
    from importlib.resources import files

    monkeypatch.setattr("pliant.config.doctor.CLOCK_TEST_TIME", 0.01)
    text = files("pliant.robots").joinpath("so101_like.urdf").read_text("utf-8")
    endless = text.replace('type="revolute"', 'type="continuous"')
    (tmp_path / "arm.urdf").write_text(endless.replace("elbow_flex", "elbow flex"), "utf-8")
    arm = so101_of("arm.urdf").replace("elbow_flex", '"elbow flex"')
    note = findings(arm, tmp_path, "note")["limits"]
    assert note.startswith("shoulder_pan, shoulder_lift, elbow flex, wrist_flex, wrist_roll: no ")
    assert "`limits = { shoulder_pan = [LOWER, UPPER] }` [rad] in [robot]" in note
    one = "limits = { shoulder_pan = [-1.5, 1.5] }"
    arm = arm.replace("[servo]", f"{one}\n[servo]").replace(
        "id = 2", "id = 2, lower = -1, upper = 1"
    )
    note = findings(arm, tmp_path, "note")["limits"]
    assert note.startswith("elbow flex, wrist_flex, wrist_roll: no position limits")
    assert '`limits = { "elbow flex" = [LOWER, UPPER] }`' in note
    every = '"elbow flex" = [-1, 1], wrist_flex = [-1, 1], wrist_roll = [-2, 2]'
    arm = arm.replace("1.5] }", f"1.5], {every} }}")
    assert "limits" not in findings(arm, tmp_path, "note")


def test_a_rest_pose_inside_the_table_is_bad(tmp_path):
    text = so101_of("arm.urdf").replace(
        'urdf = "arm.urdf"\nbase = "base"\ntip = "tool"', 'builtin = "so101"\ntable = 0.0'
    )
    assert findings(text + "[life]\nrest_q = [0, 0, 0, 0, 0]\n", tmp_path) == {}
    messages = findings(text + "[life]\nrest_q = [0, 1.5, 1.2, 0, 0]\n", tmp_path)
    assert "inside the table" in messages["rest pose"]


def test_a_gain_that_differs_from_the_servo_is_reported():
    with make_emulator(config.load("so101", backend="emulator"), clock="steps") as bus:
        arm_config = config.load("so101", port=bus.port)
        servo_bus = factory.make_bus(arm_config, {"main": bus.port})
        servo_bus.open()
        try:
            assert servo_bus.gains == dict.fromkeys(servo_bus.names, 16)
        finally:
            servo_bus.close()
    text = config.loader.builtin_text("so101").replace("id = 2, gain = 16", "id = 2, gain = 32")
    with make_emulator(config.parse(f'backend = "emulator"\n{text}')) as bus:
        arm_config = config.load("so101", port=bus.port)
        notes = {f.about: f.text for f in examine(arm_config) if f.level == "note"}
    assert notes["shoulder_lift"].startswith("its P gain is 32, the file says 16")
    assert factory.servo_specs(arm_config, {"main": "port"})[1].gain == 16
    assert "shoulder_pan" not in notes


def test_a_servo_that_torque_on_would_refuse_is_not_ready():
    """The servo is the gripper's, which is no joint of the model and is outside its goal range."""
    with make_emulator(config.load("so101", backend="emulator")) as bus:
        servo = bus.servo(6)
        servo.put("min_position_limit", servo.get("present_position") + 100)
        arm_config = config.load("so101", port=bus.port)
        bad = {f.about: f.text for f in examine(arm_config) if f.level == "bad"}
        with (
            pytest.raises(pliant.ServoError) as refused,
            pliant.connect(arm_config, handle_signals=False, guardian=False),
        ):
            pass
    assert bad["gripper"] in str(refused.value)
    assert "outside of" in bad["gripper"]


def test_servos_without_a_joint_are_noted(monkeypatch):
    monkeypatch.setattr("pliant.config.doctor.CLOCK_TEST_TIME", 0.01)
    text = config.loader.builtin_text("so101")
    with make_emulator(config.parse(text), q=[0.0] * 5) as bus:
        # A swap: the file gives the elbow the id of the gripper, and has no gripper.
        text = text.replace("id = 3", "id = 6").replace('"auto"', f'"{bus.port}"')
        text = text.partition("[gripper]")[0]
        notes = {f.about: f.text for f in examine(config.parse(text)) if f.level == "note"}
        assert notes["ids"].startswith(f"3 on {bus.port}: servos that the file does not name")


@pytest.mark.parametrize("broken", [2, 3])
def test_a_servo_that_has_shut_down_is_not_ready(broken):
    """The shoulder has two servos; the one without a fault must not hide the fault of the other."""
    text = config.loader.builtin_text("koch").replace(
        "id = 2 }", "id = 2, secondary = { id = 3, sign = 1 } }"
    )
    text = text.replace("id = 6", "id = 7").replace('M288", id = 3', 'M288", id = 6')
    with make_emulator(config.parse(f'backend = "emulator"\n{text}')) as bus:
        bus.trip(broken, "heat")
        arm_config = config.parse(text.replace('"auto"', f'"{bus.port}"'))
        bad = {f.about: f.text for f in examine(arm_config) if f.level == "bad"}
        with (
            pytest.raises(pliant.ServoError) as refused,
            pliant.connect(arm_config, handle_signals=False, guardian=False),
        ):
            pass
    assert bad["shoulder_lift"] in str(refused.value)
    assert f"shoulder_lift (id {broken}): too hot" in bad["shoulder_lift"]
    assert "ServoBus.reboot('shoulder_lift')" in bad["shoulder_lift"]


def test_the_watch_ends_with_a_rest_pose_to_paste(capsys):
    with make_emulator(config.load("so101", backend="emulator")) as bus:
        assert (
            main(["servos", "doctor", "so101", "--port", bus.port, "--watch", "--duration", "0.3"])
            == 0
        )
    line = capsys.readouterr().out.splitlines()[-1]
    pasted = config.parse(
        config.loader.builtin_text("so101").partition("[life]")[0] + f"[life]\n{line}\n"
    )
    model = pasted.model()
    assert posture(model, pasted.life.rest_q, "rest_q") == pytest.approx([0.0] * 5, abs=0.02)


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_a_calibration_that_may_not_be_read_is_not_called_something_else(tmp_path):
    file = tmp_path / "cal.json"
    file.write_text("{}")
    file.chmod(0)
    with pytest.raises(pliant.ConfigError, match=r"cal\.json cannot be read: Permission denied"):
        config.read_calibration(file)


def test_a_calibration_that_is_a_folder_cannot_be_read(tmp_path):
    with pytest.raises(pliant.ConfigError, match="is a folder: name a file"):
        config.read_calibration(tmp_path)


def test_every_mistake_has_its_own_line(tmp_path, capsys):
    file = tmp_path / "arm.toml"
    file.write_text(
        'bakend = 1\n[robot]\nbuiltin = "so101"\n[loop]\nrate = -1\ncomm_timeout = 99\n'
    )
    assert main(["servos", "doctor", str(file)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].endswith("arm.toml has 3 mistakes:")
    assert len(lines) == 4
    assert all(len(line) < 200 for line in lines)


@pytest.mark.parametrize(("count", "message"), [(1, "1 problem to fix"), (2, "2 problems to fix")])
def test_it_ends_with_the_number_of_problems(count, message, monkeypatch, capsys):
    problems = [Diagnosis("bad", "servo", "it is not there")] * count
    monkeypatch.setattr(doctor, "examine", lambda _: [Diagnosis("good", "file", "read"), *problems])
    assert main(["servos", "doctor", "so101", "--backend", "sim"]) == 2
    assert capsys.readouterr().err == f"error: not ready: {message}\n"


@pytest.mark.parametrize(
    ("supply", "message"),
    [
        (
            "voltage = 11.1",
            "supply.voltage: XL330-M288 of elbow_flex takes 3.7 to 6 V, got 11.1 V; leave it out",
        ),
        (
            "current = 4.0",
            "supply.current: .*STS3215-7.4V.* cannot limit their current.*; leave it out",
        ),
    ],
)
def test_a_supply_that_does_not_fit_the_servos_is_named(supply, message, tmp_path, capsys):
    name = "koch" if "voltage" in supply else "so100"
    text = re.sub(r"(?s)\[supply\]\n.*?\n\n", "", config.loader.builtin_text(name))
    file = tmp_path / "arm.toml"
    file.write_text(f"{text}\n[supply]\n{supply}\n")
    assert main(["servos", "doctor", str(file)]) == 2
    assert re.search(message, " ".join(capsys.readouterr().err.split()))
    if "current" in supply:
        assert config.load(file, backend="sim").supply.current == 4.0


@pytest.mark.parametrize(
    ("typical", "late", "cause"),
    [
        (0.0005, 0.008, "other programs delay some readings"),
        (0.008, 0.008, "latency timer of the adapter"),
    ],
)
def test_late_readings_are_not_blamed_on_the_baud_rate(monkeypatch, typical, late, cause):
    times = np.full(doctor_checks.CYCLES, typical)
    times[-5:] = late
    monkeypatch.setattr(doctor_checks, "time_readings", lambda _: (times, 0))
    monkeypatch.setattr(doctor_checks, "wire_read_time", lambda *_: 0.0013)
    found = doctor_checks._cycle(None, config.load("so101"))
    assert found.level == "bad"
    assert cause in found.text
