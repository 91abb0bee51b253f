"""A command's output never replaces its input, nor a file of another kind."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="runs need the extra sim")
pytest.importorskip("mcap_ros2", reason="logs need the extra log")

from bare_arm import bare_arm

import pliant
from pliant._files import KINDS, check_output, replacing
from pliant.cli import main
from pliant.log import Recorder
from pliant.teach import Motion

TOML = """
backend = "sim"
[robot]
urdf = "arm.urdf"
tip = "tool"
"""
TARGET_LINE = '{"position": [0.2, 0.0, 0.2]}\n'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Make a folder with one file of each kind that a command reads."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(pliant.robots.koch().source[0])
    (tmp_path / "mine.toml").write_text(TOML)
    (tmp_path / "targets.jsonl").write_text(TARGET_LINE)
    calibration = {
        name: {"id": i, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
        for i, name in enumerate((*pliant.robots.so101().joint_names, "gripper"), 1)
    }
    (tmp_path / "my_arm.json").write_text(json.dumps(calibration))
    time = np.linspace(0.0, 1.0, 20)
    q = np.zeros((20, 5))
    Motion(pliant.robots.so101().joint_names, time, q).save(tmp_path / "wave.json")
    (tmp_path / "link.mcap").symlink_to("mine.toml")
    os.link(tmp_path / "mine.toml", tmp_path / "hard.mcap")
    return tmp_path


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    "arguments",
    [
        "teach so101 my_arm.json --calibration my_arm.json --backend sim --scripted-hand",
        "teach so101 ./my_arm.json --backend sim --scripted-hand",
        "teach mine.toml arm.urdf",
        "run mine.toml --duration 0.2 --quiet --log mine.toml",
        "run mine.toml --duration 0.2 --quiet --log arm.urdf",
        "run mine.toml --duration 0.2 --quiet --log link.mcap",
        "run mine.toml --duration 0.2 --quiet --log hard.mcap",
        "run so101 --backend sim --duration 0.2 --quiet --log wave.json",
        "run so101 --backend sim --duration 0.2 --quiet --log new.log",
        "run so101 --backend sim --duration 0.2 --targets targets.jsonl --log targets.jsonl",
        "run so101 --backend sim --calibration my_arm.json --quiet --log my_arm.json",
        "replay so101 wave.json --backend sim --log wave.json",
        "view mine.toml --log mine.toml",
    ],
)
def test_no_input_and_no_other_kind_is_written_over(arguments, folder, capsys):
    before = contents(folder)
    assert main(arguments.split()) == 2
    assert contents(folder) == before
    stderr = capsys.readouterr().err
    assert "name another file" in stderr or ".json" in stderr or ".mcap" in stderr


def test_pictures_and_tables_keep_to_their_kind(folder, capsys):
    with bare_arm("koch", on_exit="leave_enabled") as arm:
        controller = pliant.Controller(arm.model, pliant.Settings.firm(task="xyz"), arm.servos)
        for tick in pliant.Loop(arm, controller, duration=0.1, recorder=Recorder("run.mcap")):
            tick.step(arm.model.forward_kinematics(tick.q))
    (folder / "letter.png").write_text("a letter")
    (folder / "numbers.npz").write_text("a letter")
    (folder / "run_report").write_text("a letter")
    before = contents(folder)
    for command in (
        "log plot run.mcap --output letter.png",
        "log export run.mcap --output numbers.npz",
        "log report run.mcap",
    ):
        assert main(command.split()) == 2
        assert "is there and is no" in capsys.readouterr().err
    assert contents(folder) == before
    for command, file in (
        ("log plot run.mcap", "run.png"),
        ("log export run.mcap", "run.npz"),
    ):
        assert main(command.split()) == 0
        assert "will be replaced" not in capsys.readouterr().err
        assert main(command.split()) == 0
        assert f"{file}: the" in capsys.readouterr().err
    assert not [name for name in contents(folder) if name.startswith(".")]


def test_a_log_replaces_a_log_with_a_message(folder, capsys):
    argv = ["run", "koch", "--backend", "sim", "--duration", "0.2", "--quiet", "--log", "run.mcap"]
    assert main(argv) == 0
    assert "replaced" not in capsys.readouterr().err
    assert main(argv) == 0
    assert "run.mcap: the log that is there will be replaced" in capsys.readouterr().err
    assert (folder / "run.mcap").read_bytes().startswith(b"\x89MCAP0")


def test_recorder_and_motion_keep_to_their_kind_without_the_shell(folder):
    before = contents(folder)
    motion = Motion.load("wave.json")
    for name in ("my_arm.json", "mine.toml", "targets.jsonl"):
        with pytest.raises(pliant.ConfigError, match="is not a motion"):
            motion.save(name)
        with pytest.raises(pliant.ConfigError, match="is not a log"):
            Recorder(name)
    motion.save("wave.json")
    assert contents(folder) == before


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "wave.json"
    path.write_text("old")
    path.chmod(0o640)

    def fail():
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        fail()
    assert contents(tmp_path) == {"wave.json": b"old"}
    with replacing(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
    assert contents(tmp_path) == {"wave.json": b"new"}
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("kind", KINDS)
def test_files_that_cannot_be_written_give_the_reason(kind, tmp_path):
    with pytest.raises(pliant.ConfigError, match="there is no folder"):
        check_output(tmp_path / "no" / "file", kind)
    with pytest.raises(pliant.ConfigError, match="is a folder"):
        check_output(tmp_path, kind)
    (tmp_path / "empty").touch()
    assert not check_output(tmp_path / "empty", kind)
    if os.geteuid() != 0:
        tmp_path.chmod(0o500)
        with pytest.raises(pliant.ConfigError, match="permission denied"):
            check_output(tmp_path / "file", kind)


def full_disk(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_reported_before_torque_comes_on(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(Path, "write_bytes", full_disk)
    monkeypatch.setattr(pliant.arm.Arm, "enable", lambda _: pytest.fail("torque came on"))
    file = tmp_path / "run.mcap"
    assert main(["run", "so101", "--backend", "sim", "--soft", "y", "--log", str(file)]) == 2
    assert f"{file} cannot be written: No space left on device" in capsys.readouterr().err
    assert contents(tmp_path) == {}


def test_the_error_of_a_disk_that_fills_up_names_the_file(tmp_path):
    path = tmp_path / "wave.json"

    def fail(error):
        with replacing(path) as temporary:
            raise error(temporary)

    for error in (full_disk, lambda part: PermissionError(errno.EACCES, "denied", str(part))):
        with pytest.raises(OSError, match=r"space|denied") as caught:
            fail(error)
        assert caught.value.filename == str(path)
    other = tmp_path / "other"
    with pytest.raises(FileNotFoundError) as caught:
        fail(lambda _: FileNotFoundError(errno.ENOENT, "missing", str(other)))
    assert caught.value.filename == str(other)
    assert contents(tmp_path) == {}


def test_the_results_of_identify_are_printed_where_their_file_cannot_be_written(
    tmp_path, capsys, monkeypatch
):
    from pliant.cli import identify

    def _measure(_, __, ___, ____, file):
        file.add("servos", {})
        return ["kp = 4.7"]

    monkeypatch.setattr(identify, "_measure", _measure)
    monkeypatch.setattr(identify.Measurements, "start", lambda *_: None)
    monkeypatch.setattr(identify.Measurements, "save", full_disk)
    report = ["--report", str(tmp_path / "report.json")]
    arm = tmp_path / "arm.toml"
    arm.write_text(
        'backend = "sim"\nrobot.builtin = "so101"\n[settings]\ntask = "xyz"\n'
        '[life]\non_exit = "leave_enabled"\n'
    )
    assert main(["identify", str(arm), "servos", *report]) == 2
    output = capsys.readouterr()
    assert "kp = 4.7" in output.out
    assert "No space left on device" in output.err
