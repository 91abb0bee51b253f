"""Forged logs with valid checksums: reading raises typed errors and uses bounded memory."""

import json
import os
import struct
import zlib

import pytest

pytest.importorskip("mujoco", reason="runs need the extra sim")
pytest.importorskip("mcap_ros2", reason="logs need the extra log")

from bare_arm import bare_arm

import pliant
from pliant._files import printable
from pliant.cli import main
from pliant.config.lerobot import read_calibration
from pliant.log import Recorder, layout, read, verify
from pliant.teach import Motion

HEAD = struct.Struct("<BQ")
CHUNK, ATTACHMENT = 0x06, 0x09
INVALID_VALUES = [
    None,
    True,
    0,
    -1,
    1.5,
    "x",
    "",
    [],
    [1],
    {},
    {"table": []},
    {"tuple": [None]},
    {"table": 3},
]
INVALID_VALUES += [
    {"type": "Settings", "fields": {}},
    {"type": "Nothing", "fields": {}},
    {"type": "Task"},
    1e400,
]


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """Return the bytes of a complete log."""
    path = tmp_path_factory.mktemp("logs") / "run.mcap"
    with bare_arm("koch", on_exit="leave_enabled") as arm:
        controller = pliant.Controller(arm.model, pliant.Settings.soft("y", task="xyz"), arm.servos)
        recorder = Recorder(path, note="[/x] [the] \x1b]0;title\x07")
        loop = pliant.Loop(arm, controller, duration=0.2, recorder=recorder)
        loop.controller.set_delay(0.01)
        for tick in loop:
            tick.step(arm.model.forward_kinematics(tick.q))
    return path.read_bytes()


def records(content):
    """Return kind and body of every record of an MCAP file."""
    offset = 8
    while offset < len(content) - 8:
        kind, length = HEAD.unpack_from(content, offset)
        yield kind, content[offset + HEAD.size : offset + HEAD.size + length]
        offset += HEAD.size + length


def rebuild(content, change):
    """Return the file with its records changed by `change`, a function of kind and body."""
    out = [content[:8]]
    for kind, body in records(content):
        new = change(kind, body)
        out += [HEAD.pack(kind, len(new)), new]
    return b"".join([*out, content[-8:]])


def with_run(content, run):
    """Return the file with another description of the run and a valid checksum."""

    def change(kind, body):
        if kind != ATTACHMENT:
            return body
        name, offset = attachment(body)
        if name != layout.RUN:
            return body
        text = json.dumps(run).encode()
        body = body[:offset] + struct.pack("<Q", len(text)) + text
        return body + struct.pack("<I", zlib.crc32(body))

    return rebuild(content, change)


def attachment(body):
    """Return the name of an attachment, and the offset of its field for the data length [bytes]."""
    offset = 16
    size = struct.unpack_from("<I", body, offset)[0]
    name = body[offset + 4 : offset + 4 + size].decode()
    offset += 4 + size
    return name, offset + 4 + struct.unpack_from("<I", body, offset)[0]


def description_of(content):
    """Return the description of the run from the file."""
    for kind, body in records(content):
        if kind == ATTACHMENT:
            name, offset = attachment(body)
            if name == layout.RUN:
                # Times and lengths before the data may contain the byte of an opening brace.
                return json.loads(body[offset + 8 : -4])
    raise AssertionError("no description")


def mutants(run):
    """Yield invalid descriptions of a run: each entry missing, or with an invalid value."""
    table = run["table"]
    for i, (key, _) in enumerate(table):
        yield f"without {key}", {"table": table[:i] + table[i + 1 :]}
        for value in INVALID_VALUES:
            yield f"{key} = {value!r}", {"table": [*table[:i], [key, value], *table[i + 1 :]]}
    row = next(i for i, (key, _) in enumerate(table) if key == "model")
    inner = table[row][1]["table"]
    for i, (key, _) in enumerate(inner):
        for value in INVALID_VALUES:
            model = {"table": [*inner[:i], [key, value], *inner[i + 1 :]]}
            yield (
                f"model {key} = {value!r}",
                {"table": [*table[:row], ["model", model], *table[row + 1 :]]},
            )


def test_a_log_read_as_written(content, tmp_path):
    path = tmp_path / "run.mcap"
    path.write_bytes(with_run(content, description_of(content)))
    assert verify(read(path)).same


def test_crafted_descriptions_are_typed_errors(content, tmp_path):
    path, count, accepted = tmp_path / "run.mcap", 0, []
    for name, run in mutants(description_of(content)):
        path.write_bytes(with_run(content, run))
        count += 1
        try:
            log = read(path)
        except pliant.PliantError:
            continue
        accepted.append(name)
        for call in (
            log.model,
            lambda log=log: log.settings,
            lambda log=log: log.servos,
            lambda log=log: verify(log),
            lambda log=log: Motion.from_log(log),
            lambda log=log: repr(log),
        ):
            try:
                call()
            except pliant.PliantError:
                continue
        assert main(["log", "verify", str(path)]) in (0, 2), name
    assert count > 200
    assert len(accepted) < 0.4 * count, accepted


@pytest.mark.parametrize("gigabytes", [0.08, 6.0])
def test_a_chunk_that_unpacks_to_too_much_is_refused(content, gigabytes, tmp_path):
    """The size in the header of the chunk and the size of its data are both limited."""
    import zstandard

    size = int(gigabytes * 2**30)
    zeros = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    block = bytes(1 << 24)
    packed, remaining = [], size
    while remaining:
        packed.append(zeros.compress(block[: min(remaining, len(block))]))
        remaining -= min(remaining, len(block))
    data = b"".join([*packed, zeros.flush()])

    for declared_size in (size, 1000):
        first = []

        def change(kind, body, declared_size=declared_size, first=first):
            if kind != CHUNK or first:
                return body
            first.append(1)
            name = b"zstd"
            return (
                body[:16]
                + struct.pack("<QI", declared_size, 0)
                + struct.pack("<I", len(name))
                + name
                + struct.pack("<Q", len(data))
                + data
            )

        path = tmp_path / "bomb.mcap"
        path.write_bytes(rebuild(content, change))
        log = read(path)
        assert "unpacks to" in log.damage
        assert len(log) == 0


def test_notes_are_plain_text(content, tmp_path, capsys):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    assert main(["log", "info", str(path)]) == 0
    output = capsys.readouterr().out
    assert "[/x] [the]" in output
    assert "\x1b" not in output
    assert "\x07" not in output
    assert printable("a\x9bb\tc\u202ed") == "a�b\tc�d"


def test_files_without_an_end_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.json")
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "folder.json").mkdir()
    with (tmp_path / "large.json").open("wb") as stream:
        stream.truncate(1 << 30)
    for name in (
        "/dev/zero",
        *(str(tmp_path / f"{kind}.json") for kind in ("pipe", "folder", "large")),
    ):
        for load in (read_calibration, Motion.load):
            with pytest.raises(pliant.ConfigError, match=r"pipe or a device|a folder|larger than"):
                load(name)
    with pytest.raises(pliant.ConfigError):
        pliant.config.load(tmp_path / "pipe.toml")
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(pliant.ConfigError, match="a pipe or a device: name a file"):
        read(tmp_path / "pipe.mcap")
