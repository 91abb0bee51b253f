"""Motions with invalid numbers, and files that cannot be written: errors before torque on."""

import json

import numpy as np
import pytest

import pliant
from pliant.cli import main
from pliant.teach import Motion

NAMES = tuple(pliant.robots.so101().joint_names)


@pytest.fixture
def motion_file(tmp_path):
    """Return a valid motion file and its data."""
    path = tmp_path / "m.json"
    time = np.linspace(0.0, 1.0, 11)
    Motion(NAMES, time, 0.1 * np.tile(time[:, None], 5), start=(0.1, 0.0, 0.2)).save(path)
    return path, json.loads(path.read_text())


@pytest.mark.parametrize(
    "start",
    ["[NaN, NaN, NaN]", "[0.1, Infinity, 0]", "[1, 2]", "[1" + "0" * 400 + ", 0, 0]", '"abc"', "3"],
)
def test_an_invalid_start_is_refused(motion_file, start):
    path, data = motion_file
    path.write_text(json.dumps({**data, "start": "HERE"}).replace('"HERE"', start))
    with pytest.raises(pliant.ConfigError, match=r"m\.json"):
        Motion.load(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "is not a motion file: it is nested too deeply"),
        ('{"format": ' + "1" * 5000 + "}", "is not a motion file"),
        (None, "is not a motion file: int too"),
    ],
)
def test_numbers_and_nesting_that_are_too_large(motion_file, text, message, capsys):
    path, data = motion_file
    if text is None:
        data["samples"][3][1] = 10**400
        text = json.dumps(data)
    path.write_text(text)
    with pytest.raises(pliant.ConfigError, match=message):
        Motion.load(path)
    assert main(["replay", "so101", str(path), "--backend", "sim"]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("row", [[], [0.3, 0.1], 3.0, None, [0.3, *[0.1] * 6]])
def test_a_sample_of_another_length_is_named(motion_file, row):
    path, data = motion_file
    data["samples"][3] = row
    path.write_text(json.dumps(data))
    with pytest.raises(pliant.ConfigError, match="sample 4 of 11 must be 6 numbers: a time, 5"):
        Motion.load(path)
    with pytest.raises(pliant.ConfigError, match="arrays of real numbers"):
        Motion(NAMES, [0.0, 1.0], [[0.0] * 5, row])


@pytest.mark.parametrize("factor", [1e-300, 1e-6, 1e6, 1e300])
def test_times_that_are_not_in_seconds_are_refused(motion_file, factor):
    path, data = motion_file
    for row in data["samples"]:
        row[0] *= factor
    path.write_text(json.dumps(data))
    with pytest.raises(pliant.ConfigError, match="its times are in seconds"):
        Motion.load(path)


def test_samples_that_are_microseconds_apart_come_back(tmp_path):
    # Rounded to 1e-5 s like positions, these times would be equal.
    time = 2e-6 * np.arange(20)
    Motion(("a",), time, np.linspace(0.0, 1.0, 20)[:, None]).save(tmp_path / "m.json")
    assert np.array_equal(Motion.load(tmp_path / "m.json").time, time)


def test_another_format_is_named_once(motion_file):
    path, data = motion_file
    path.write_text(json.dumps({**data, "format": "pliant motion 9"}))
    with pytest.raises(pliant.ConfigError) as error:
        Motion.load(path)
    message = str(error.value)
    assert message == f"{path}: format is 'pliant motion 9', this pliant reads 'pliant motion 1'"


def test_a_motion_as_long_as_floats_is_refused():
    with pytest.raises(pliant.ConfigError, match="its times are in seconds"):
        Motion(("a",), [-1.7e308, 1.7e308], [[0.0], [1.0]])


def test_smoothing_refuses_invalid_widths_and_rates(motion_file):
    motion = Motion.load(motion_file[0])
    for width in (np.inf, np.nan, -1.0):
        with pytest.raises(pliant.ConfigError, match="width must be at least 0 s"):
            motion.smoothed(width)
    with pytest.raises(pliant.ConfigError, match="both finite"):
        motion.smoothed(rate=np.inf)
    with pytest.raises(pliant.ConfigError, match=r"1e\+12 samples, at most 1e\+07 are made"):
        motion.smoothed(rate=1e12)
    assert motion.smoothed(1e308).duration == motion.duration


@pytest.mark.parametrize(
    "command",
    [
        ["teach", "so101", "FILE.json"],
        ["run", "so101", "--log", "FILE.mcap"],
        ["replay", "so101", "m.json", "--log", "FILE.mcap"],
    ],
)
@pytest.mark.parametrize("folder", ["folder", "/proc", "none"])
def test_a_file_that_cannot_be_written_is_reported_before_torque_comes_on(
    motion_file, command, folder, capsys, monkeypatch
):
    pytest.importorskip("mcap", reason="logs need the extra log")
    path, _ = motion_file
    monkeypatch.chdir(path.parent)
    switched = []
    monkeypatch.setattr(pliant.arm.Arm, "enable", lambda *_: switched.append(1))
    *others, file = command
    for suffix in (".json", ".mcap"):
        (path.parent / f"folder{suffix}").mkdir()
    names = {"folder": "folder", "/proc": "/proc/pliant", "none": "none/x"}
    file = file.replace("FILE", names[folder])
    assert main([*others, file, "--backend", "sim"]) == 2
    error = capsys.readouterr().err
    assert ("there is no folder" if folder == "none" else f"{file} cannot be written") in error
    assert error.count("\n") == 1
    assert not switched


def test_looking_whether_a_file_can_be_written_changes_nothing(tmp_path):
    from pliant._files import check_output

    new, old = tmp_path / "new.json", tmp_path / "old.json"
    old.write_text('{"format": "pliant motion 1"}')
    assert not check_output(new, "motion")
    assert check_output(old, "motion")
    assert not new.exists()
    assert old.read_text() == '{"format": "pliant motion 1"}'


@pytest.mark.parametrize("key", ["joints", "extra"])
@pytest.mark.parametrize("names", ["abcde", [None, "b", "c", "d", "e"], {"a": 1}, 3])
def test_names_that_are_no_names_are_refused(motion_file, key, names):
    path, data = motion_file
    path.write_text(json.dumps({**data, key: names}))
    with pytest.raises(pliant.ConfigError, match=rf"{path.name}: {key} must be a list of names"):
        Motion.load(path)
