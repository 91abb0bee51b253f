"""`pliant servos setup --undo`: a backup of another arm is rejected before any write."""

import errno
import io
import json
import shlex
from pathlib import Path

import pytest

from pliant.cli import main
from pliant.emulator import Device, Emulator

pytest.importorskip("rustypot", reason="the bus needs the extra servo")

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


@pytest.fixture
def arm(tmp_path):
    """Return an emulated bus of new servos, the file of their arm, and a path for the backup.

    The name of the folder contains a space, which the printed commands must quote.
    """
    folder = tmp_path / "my arms"
    folder.mkdir()
    file = folder / "arm.toml"
    with Emulator([Device("XL430-W250", id=i) for i in range(1, 6)]) as bus:
        servos = "".join(
            f'{name} = {{ model = "XL430-W250", id = {i} }}\n' for i, name in enumerate(JOINTS, 1)
        )
        file.write_text(
            f'robot.builtin = "so101"\n[[port]]\npath = "{bus.port}"\n[servo]\n{servos}'
        )
        yield bus, file, folder / "old.json"


@pytest.fixture
def after_setup(arm, capsys):
    """Run `setup`; return the values of the fixture `arm`, and the text that it printed."""
    bus, file, backup = arm
    assert (
        main(["servos", "setup", str(file), "--port", bus.port, "--yes", "--backup", str(backup)])
        == 0
    )
    output = capsys.readouterr().out
    bus.log.clear()
    return bus, file, backup, output


def test_the_printed_command_puts_the_values_back(after_setup, capsys, monkeypatch):
    bus, file, backup, output = after_setup
    old = json.loads(backup.read_text())
    assert f"{len(old['changes'])} registers written" in output
    (line,) = [line for line in output.splitlines() if "puts them back" in line]
    name, *argv = shlex.split(line.partition("back: ")[2])
    assert (name, argv[:2]) == ("pliant", ["servos", "setup"])
    assert argv[2] == str(file)
    assert argv[-2:] == ["--port", bus.port]
    assert main([*argv, "--yes"]) == 0
    assert f"{len(old['changes'])} registers written" in capsys.readouterr().out
    assert len(bus.log.eeprom_writes()) == len(old["changes"])
    # A second undo changes nothing, because it reads the registers first.
    assert main([*argv, "--yes"]) == 0
    assert "nothing to change" in capsys.readouterr().out


def test_the_column_is_shows_what_the_servo_has(after_setup, capsys, monkeypatch):
    bus, file, backup, _ = after_setup
    data = json.loads(backup.read_text())
    change = next(c for c in data["changes"] if c["register"] == "return_delay" and c["id"] == 2)
    change["new"] = 77  # differs from the value in the servo
    backup.write_text(json.dumps(data))
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["servos", "setup", str(file), "--undo", str(backup)]) == 1
    both = capsys.readouterr()
    assert "77" not in both.out
    assert both.err.strip() == "cancelled: nothing was written", "an end of input is no"
    assert not bus.log.eeprom_writes()


def test_a_backup_from_before_is_still_read(after_setup, capsys):
    bus, file, backup, _ = after_setup
    entries = json.loads(backup.read_text())["changes"]
    for entry in entries:
        del entry["model"]
    backup.write_text(json.dumps(entries))
    assert main(["servos", "setup", str(file), "--undo", str(backup), "--yes"]) == 0
    assert f"{len(entries)} registers written" in capsys.readouterr().out
    assert len(bus.log.eeprom_writes()) == len(entries)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint": "nope"}, "has values of nope (id 1), which the configuration does not have"),
        ({"id": 77}, "shoulder_pan (id 77), which the configuration does not have; it has"),
        ({"model": "MX-28"}, "was MX-28, the configuration says XL430-W250"),
        ({"model": "nope"}, "no servo model 'nope'"),
        (
            {"register": "nope"},
            "'nope' is not a register that setup writes on XL430-W250; those are",
        ),
        ({"register": "id", "old": 1}, "'id' is not a register that setup writes"),
        ({"old": -1}, "takes 0 to 255, got -1"),
        ({"old": 256}, "takes 0 to 255, got 256"),
        ({"old": 10**30}, "takes 0 to 255"),
        ({"old": "x"}, "is not a backup of pliant servos setup: old is a whole number"),
        ({"old": True}, "old is a whole number"),
        ({"old": None}, "old is a whole number"),
        ({"joint": [1]}, "joint is text"),
        ({"foo": 1}, "an entry has joint, id, register"),
    ],
)
def test_a_backup_that_does_not_match_is_refused_before_the_first_write(
    change, message, after_setup, capsys
):
    bus, file, backup, _ = after_setup
    data = json.loads(backup.read_text())
    data["changes"][0].update(change)
    # The invalid change comes last: the valid changes before it must not be written either.
    data["changes"].append(data["changes"].pop(0))
    backup.write_text(json.dumps(data))
    assert main(["servos", "setup", str(file), "--undo", str(backup), "--yes"]) == 2
    assert message in capsys.readouterr().err
    assert not bus.log.eeprom_writes()


@pytest.mark.parametrize(
    "text", ["{}", "null", "5", '"abc"', "[1, 2]", "[" * 100_000, "1" * 5000, '{"format": 3}']
)
def test_invalid_backups_are_refused(text, after_setup, capsys):
    _, file, backup, _ = after_setup
    backup.write_text(text)
    assert main(["servos", "setup", str(file), "--undo", str(backup), "--yes"]) == 2
    error = capsys.readouterr().err
    assert "is not a backup of pliant servos setup" in error or "is 3, this pliant reads" in error


def test_a_backup_of_another_arm_or_a_register_twice(after_setup, capsys):
    bus, file, backup, _ = after_setup
    data = json.loads(backup.read_text())
    data["changes"].append(data["changes"][0])
    backup.write_text(json.dumps(data))
    assert main(["servos", "setup", str(file), "--undo", str(backup), "--yes"]) == 2
    assert "comes twice" in capsys.readouterr().err
    backup.write_text(json.dumps({**data, "arm": "left.toml"}))
    assert main(["servos", "setup", str(file), "--undo", str(backup), "--yes"]) == 2
    assert "holds the old values of left.toml, not of" in capsys.readouterr().err
    assert not bus.log.eeprom_writes()


def test_a_full_disk_leaves_no_backup_and_no_change(arm, capsys, monkeypatch):
    bus, file, backup = arm
    write = Path.write_text

    def write_the_start(path, text, **options):
        write(path, text[:10], **options)
        raise OSError(errno.ENOSPC, "No space left on device")

    bus.log.clear()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", write_the_start)
        argv = ["servos", "setup", str(file), "--port", bus.port, "--yes"]
        assert main([*argv, "--backup", str(backup)]) == 2
    assert f"{backup}: No space left on device" in capsys.readouterr().err
    assert list(backup.parent.iterdir()) == [file]
    assert bus.log.eeprom_writes() == []
