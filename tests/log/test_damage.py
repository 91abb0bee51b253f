"""Truncated and damaged logs: reading gives a typed error, or the data before the damage."""

import io
import random
from collections import Counter

import numpy as np
import pytest

pytest.importorskip("mcap", reason="logs need the extra log")

from bare_arm import bare_arm

import pliant
from pliant.cli import main
from pliant.log import Recorder, read, verify
from pliant.log.records import MAGIC
from pliant.teach import Motion


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Record a moving arm for 2 s; return the bytes of the log file, and the log."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with bare_arm("so101", on_exit="leave_enabled") as arm:
        controller = pliant.Controller(arm.model, pliant.Settings.soft("y", task="xyz"), arm.servos)
        q = arm.read().q
        for tick in pliant.Loop(arm, controller, duration=2.0, recorder=Recorder(path)):
            moved_q = q + 0.2 * np.sin(tick.time) * np.eye(len(q))[0]
            tick.step(arm.model.forward_kinematics(moved_q))
    return path.read_bytes(), read(path)


@pytest.fixture
def damaged(recording, tmp_path):
    """Return a function that writes bytes to a log file and returns its path."""

    def write(content):
        path = tmp_path / "one.mcap"
        path.write_bytes(content)
        return path

    return write


def prefix(log, whole):
    """Return True if `log` is a prefix of `whole`."""
    assert log.run == whole.run
    assert len(log) <= len(whole)
    assert len(log.calls) <= len(whole.calls)
    assert [call.sequence for call in log.calls] == list(range(len(log.calls)))
    for name, column in log.columns.items():
        np.testing.assert_array_equal(column, whole.columns[name][: len(log)], err_msg=name)


def test_a_damaged_log_is_explained_or_a_prefix(recording, damaged):
    content, whole = recording
    outcomes = Counter()
    for seed in range(300):
        dice = random.Random(seed)
        copy = bytearray(content)
        for _ in range(1 + seed % 3):
            end = len(copy) if seed % 4 else 3000
            copy[dice.randrange(end)] = dice.randrange(256)
        if seed % 10 == 0:
            copy = copy[: dice.randrange(len(copy))]
        try:
            log = read(damaged(copy))
        except pliant.ConfigError as error:
            assert "is not a log of pliant" in str(error)  # noqa: PT017
            outcomes["explained"] += 1
            continue
        prefix(log, whole)
        assert not log.whole or (len(log) == len(whole) and not log.damage)
        outcomes["whole" if log.whole else "damaged" if log.damage else "cut"] += 1
    assert min(outcomes[kind] for kind in ("explained", "damaged", "cut")) > 3, outcomes


def test_a_log_that_was_cut_anywhere_is_a_prefix(recording, damaged):
    content, whole = recording
    for size in range(len(content) // 3, len(content) - len(MAGIC), len(content) // 60):
        log = read(damaged(content[:size]))
        prefix(log, whole)
        assert not log.whole
        assert not log.damage
    assert verify(log).same


def test_a_missing_chunk_is_damage(recording, damaged):
    content, whole = recording
    chunks, offset = [], 8
    while content[offset] != 2:  # footer
        length = int.from_bytes(content[offset + 1 : offset + 9], "little")
        chunks += [(offset, offset + 9 + length)] * (content[offset] == 6)
        offset += 9 + length
    begin, end = chunks[1]
    log = read(damaged(content[:begin] + content[end:]))
    assert "is missing" in log.damage
    prefix(log, whole)
    log = read(damaged(content[: chunks[-1][0]] + content[chunks[-1][1] :]))
    assert "other records than were counted" in log.damage


def test_a_cut_log_is_replayed_up_to_there_and_a_damaged_one_is_not(
    recording, damaged, capsys, monkeypatch
):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    content, _ = recording
    argv = ["replay", "so101", str(damaged(content[: 3 * len(content) // 4])), "--backend", "sim"]
    assert main(argv) == 0
    out = capsys.readouterr().out
    assert "was cut short: it is played up to" in out
    assert "played 1 time in" in out
    damaged_content = bytearray(content)
    damaged_content[3 * len(content) // 4] ^= 255
    path = damaged(damaged_content)
    assert main(argv) == 2
    assert "the log is damaged and is not played: the record at byte" in capsys.readouterr().err
    with pytest.raises(pliant.ConfigError, match="is damaged"):
        Motion.load(path)
    assert main(["log", "info", str(path)]) == 0
    assert "damaged: the record at byte" in capsys.readouterr().out


def test_the_verification_of_a_damaged_log_names_the_damage(recording, damaged, capsys):
    content, _ = recording
    broken = bytearray(content)
    broken[len(broken) * 3 // 4] ^= 0xFF
    assert len(read(damaged(broken)).calls) > 0
    assert main(["log", "verify", str(damaged(broken))]) == 0
    assert "damaged: the record at byte" in capsys.readouterr().out
    assert main(["log", "verify", str(damaged(content[: 3 * len(content) // 4]))]) == 0
    assert "the log ends early" in capsys.readouterr().out
    assert main(["log", "verify", str(damaged(content[: len(content) // 4]))]) == 2
    assert "has no command to compare" in capsys.readouterr().err
