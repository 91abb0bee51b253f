"""Truncated and damaged logs: reading gives an explained error or the data before the damage."""

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
def made(tmp_path_factory):
    """Return a short log of a moving arm, its bytes and its columns."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with bare_arm("so101", on_exit="leave_enabled") as arm:
        controller = pliant.Controller(arm.model, pliant.Settings.soft("y", task="xyz"), arm.servos)
        q = arm.read().q
        for tick in pliant.Loop(arm, controller, duration=2.0, recorder=Recorder(path)):
            turned = q + 0.2 * np.sin(tick.time) * np.eye(len(q))[0]
            tick.step(arm.model.forward_kinematics(turned))
    return path.read_bytes(), read(path)


@pytest.fixture
def damaged(made, tmp_path):
    """Return a function that writes bytes to a log file and returns its path."""

    def write(content):
        path = tmp_path / "one.mcap"
        path.write_bytes(content)
        return path

    return write


def prefix(log, whole):
    """Return True if a log is a prefix of another."""
    assert log.run == whole.run
    assert len(log) <= len(whole)
    assert len(log.calls) <= len(whole.calls)
    assert [call.sequence for call in log.calls] == list(range(len(log.calls)))
    for name, column in log.columns.items():
        np.testing.assert_array_equal(column, whole.columns[name][: len(log)], err_msg=name)


def test_a_damaged_log_is_explained_or_a_prefix(made, damaged):
    content, whole = made
    seen = Counter()
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
            seen["explained"] += 1
            continue
        prefix(log, whole)
        assert not log.whole or (len(log) == len(whole) and not log.damage)
        seen["whole" if log.whole else "damaged" if log.damage else "cut"] += 1
    assert min(seen[kind] for kind in ("explained", "damaged", "cut")) > 3, seen


def test_a_log_that_was_cut_anywhere_is_a_prefix(made, damaged):
    content, whole = made
    for size in range(len(content) // 3, len(content) - len(MAGIC), len(content) // 60):
        log = read(damaged(content[:size]))
        prefix(log, whole)
        assert not log.whole
        assert not log.damage
    assert verify(log).same


def test_a_missing_chunk_is_damage(made, damaged):
    content, whole = made
    chunks, at = [], 8
    while content[at] != 2:  # footer
        length = int.from_bytes(content[at + 1 : at + 9], "little")
        chunks += [(at, at + 9 + length)] * (content[at] == 6)
        at += 9 + length
    begin, end = chunks[1]
    log = read(damaged(content[:begin] + content[end:]))
    assert "is missing" in log.damage
    prefix(log, whole)
    log = read(damaged(content[: chunks[-1][0]] + content[chunks[-1][1] :]))
    assert "other records than were counted" in log.damage


def test_a_cut_log_is_replayed_up_to_there_and_a_damaged_one_is_not(
    made, damaged, capsys, monkeypatch
):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    content, _ = made
    words = ["replay", "so101", str(damaged(content[: 3 * len(content) // 4])), "--backend", "sim"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "was cut short: it is played up to" in out
    assert "played 1 time in" in out
    broken = bytearray(content)
    broken[3 * len(content) // 4] ^= 255
    path = damaged(broken)
    assert main(words) == 2
    assert "the log is damaged and is not played: the record at byte" in capsys.readouterr().err
    with pytest.raises(pliant.ConfigError, match="is damaged"):
        Motion.load(path)
    assert main(["log", "info", str(path)]) == 0
    assert "damaged: the record at byte" in capsys.readouterr().out
