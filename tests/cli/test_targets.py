"""Targets from other programs: errors are reported, and no stream ends or delays the loop."""

import os
import re
import socket
import subprocess
import threading
import time

import numpy as np
import programs
import pytest
from programs import PIPE, Program

import pliant
from pliant.cli import main
from pliant.cli._targets import MAX_LINE, StreamTargets, Target, open_targets

MODEL = pliant.robots.so101()
TARGET_LINE = b'{"position": [0.2, 0.0, 0.2]}\n'
TARGET = Target(position=(0.2, 0.0, 0.2))
PORT = 20177


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "is not JSON"),
        ("[1]", "an object of"),
        ('{"pos": [1, 2, 3]}', "an object of"),
        ('{"position": [1, 2]}', "3 numbers"),
        ('{"position": [1, 2, NaN]}', "not finite"),
        ('{"position": [1, 2, true]}', "3 numbers"),
        ('{"q": [1], "position": [1, 2, 3]}', "q, or position"),
        ('{"q": [0, 0, 0]}', "expected (5,)"),
        ('{"wxyz": [0, 0, 0, 0]}', "quaternion"),
        ('{"position": [5, 0, 0.2]}', "is outside [0, 1.055]: the arm reaches 0.478 m"),
        ('{"position": [200, 0, 150]}', "in millimetres"),
        ('{"position": [1e300, 0, 0]}', "from shoulder_pan [m] = 1e300"),
        ('{"position": [1' + "0" * 400 + ", 0, 0]}", "position is larger than any number"),
        ('{"position": [1' + "0" * 5000 + ", 0, 0]}", "is not JSON"),
        ("[" * 100_000, "is nested too deeply"),
        ('{"q": [50, 0, 0, 0, 0]}', "q[0] (shoulder_pan) [rad] = 50 is outside"),
        ('{"wxyz": [1, 0, 0, 0], "xyzw": [0, 0, 0, 1]}', "one quaternion"),
    ],
)
def test_invalid_targets(line, message, tmp_path, capsys):
    file = tmp_path / "bad.jsonl"
    file.write_text(f'{{"position": [0.2, 0, 0.2]}}\n{line}\n')
    assert main(["run", "so101", "--backend", "sim", "--targets", str(file)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "line 2" in error


@pytest.mark.parametrize("name", ["so101", "koch", "arm7"])
def test_every_pose_of_an_arm_is_within_its_reach(name):
    model = getattr(pliant.robots, name)()
    q = np.random.default_rng(0).uniform(model.lower, model.upper, (2000, model.n))
    for pose in model.forward_kinematics_batch(q):
        assert np.linalg.norm(pose[:3, 3] - model.reach_origin) <= model.reach
        Target(position=tuple(pose[:3, 3])).check(model)


def test_reach_counts_from_the_first_joint_that_moves():
    lift = """<robot name="lift">
    <link name="base"/><link name="column"/><link name="arm"/><link name="tool"/>
    <joint name="lift" type="prismatic"><parent link="base"/><child link="column"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="2" effort="9" velocity="1"/></joint>
    <joint name="turn" type="revolute"><parent link="column"/><child link="arm"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" velocity="1"/></joint>
    <joint name="end" type="fixed"><parent link="arm"/><child link="tool"/>
    <origin xyz="0.4 0 0"/></joint></robot>"""
    model = pliant.Model.from_urdf_str(lift, locked={"lift": 1.0})
    assert np.allclose(model.reach_origin, [0.0, 0.0, 1.0])
    Target(position=(0.4, 0.0, 1.0)).check(model)
    message = r"from turn \[m\] = 1\.5 is outside \[0, 0\.900\]: the arm reaches 0\.400 m"
    with pytest.raises(pliant.OutOfRangeError, match=message):
        Target(position=(0.0, 0.0, 2.5)).check(model)


def test_joints_may_be_a_little_beyond_their_limits():
    for q in (MODEL.upper + 0.1, MODEL.lower - 0.1):
        Target(q=tuple(q)).check(MODEL)
    with pytest.raises(pliant.OutOfRangeError, match=r"wrist_roll\) \[rad\] = .* degrees"):
        Target(q=(0.0, 0.0, 0.0, 0.0, MODEL.upper[4] + 0.3)).check(MODEL)


@pytest.fixture
def pipe():
    """Yield a stream of targets, and a function that writes to it and waits until it was read."""
    ends = os.pipe()
    source = StreamTargets(ends[0], MODEL)

    def write(*lines):
        for line in lines:
            os.write(ends[1], line)
        time.sleep(0.1)

    yield source, write, lambda: os.close(ends[1])
    source.__exit__()


INVALID_LINES = [
    b'{"position": [200, 0, 200]}\n',
    b'{"position": [1e300, 0, 0]}\n',
    b'{"position": [' + b"1" * 400 + b", 0, 0]}\n",
    b'{"position": [' + b"1" * 5000 + b", 0, 0]}\n",
    b"[" * 3000 + b"\n",
    b"[" * 30_000 + b"\n",
    b'\xff\xfe{"position": [0.2, 0, 0.2]}\n',
    b'{"q": [50, 0, 0, 0, 0]}\n',
]


@pytest.mark.parametrize("line", INVALID_LINES)
def test_an_invalid_line_of_a_stream_is_reported_and_skipped(line, pipe, capsys):
    source, write, end = pipe
    write(line)
    assert source.latest() is None
    stderr = capsys.readouterr().err
    assert stderr.startswith("target refused: ")
    assert len(stderr) < 400
    write(b"\n", TARGET_LINE)
    assert source.latest() == TARGET
    assert not source.done
    write(TARGET_LINE.strip())
    end()
    time.sleep(0.1)
    assert source.latest() == TARGET, "also a last line without an end"
    assert source.done


def test_of_many_lines_the_newest_counts(pipe):
    source, write, _ = pipe
    write(b'{"position": [0.1, 0.0, 0.2]}\n' * 50 + TARGET_LINE)
    assert source.latest() == TARGET
    assert source.latest() is None


def check_mixed(source, capsys):
    """Check a source that got, between two ticks, three invalid targets and one valid one."""
    assert source.latest() == TARGET
    assert source.latest() is None
    source.__exit__()
    first, rest = capsys.readouterr().err.splitlines()
    assert first.startswith("target refused: target 'nonsense' is not JSON")
    assert rest == "2 more targets were refused"


MIXED = (b"nonsense\n", b'{"q": [0]}\n', TARGET_LINE, b'{"position": [200, 0, 200]}\n')


def test_an_invalid_line_does_not_hide_a_valid_one_before_it(pipe, capsys):
    source, write, _ = pipe
    write(b"".join(MIXED))
    check_mixed(source, capsys)


def test_an_invalid_datagram_does_not_hide_a_valid_one_before_it(capsys):
    source = open_targets(f"udp:{PORT + 2}", MODEL)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for line in MIXED:
            sender.sendto(line, ("127.0.0.1", PORT + 2))
    time.sleep(0.1)
    check_mixed(source, capsys)


def test_refusals_are_reported_a_few_times_per_second(pipe, capsys):
    source, write, _ = pipe
    for _ in range(6):
        write(b"nonsense\n")
        source.latest()
    source.__exit__()
    stderr = capsys.readouterr().err.splitlines()
    assert len(stderr) < 4
    shown = sum("target refused" in line for line in stderr)
    omitted = sum(int(count) for count in re.findall(r"(\d+) more", "\n".join(stderr)))
    assert shown + omitted == 6


def complaints(text):
    """Return the lines of standard error that are not about the descent."""
    return [line for line in text.splitlines() if not line.startswith("pliant: so101")]


def test_a_flood_on_standard_input_does_not_hold_the_loop():
    argv = ["run", "so101", "--backend", "sim", "--quiet", "--targets", "-", "--duration", "2"]
    with subprocess.Popen(["yes", TARGET_LINE.decode().strip()], stdout=subprocess.PIPE) as flood:
        result = programs.run("-m", "pliant.cli", *argv, stdin=flood.stdout)
        flood.terminate()
    assert result.returncode == 0, result.stderr
    assert "200 ticks" in result.stdout
    assert not complaints(result.stderr)


def test_a_run_ends_while_standard_input_is_open():
    argv = ["run", "so101", "--backend", "sim", "--quiet", "--targets", "-", "--duration", "0.5"]
    with Program("-m", "pliant.cli", *argv, stdin=PIPE) as running:
        assert running.wait(timeout=60) == 0
        assert not complaints(running.stderr.read())


def test_datagrams_come_from_this_machine_only(capsys):
    with (
        open_targets(f"udp:{PORT}", MODEL) as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        assert source.latest() is None
        for text in (b"nonsense", b'{"q": [0, 0]}', TARGET_LINE):
            sender.sendto(text, ("127.0.0.1", PORT))
        time.sleep(0.1)
        assert source.latest() == TARGET
        for line in (*INVALID_LINES[:3], b" " * MAX_LINE + TARGET_LINE):
            sender.sendto(line, ("127.0.0.1", PORT))
            time.sleep(0.1)
            assert source.latest() is None
        assert "target refused" in capsys.readouterr().err


def test_a_flood_of_datagrams_does_not_hold_a_tick():
    is_over = threading.Event()

    def flood():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not is_over.is_set():
                sender.sendto(TARGET_LINE, ("127.0.0.1", PORT + 1))

    with open_targets(f"udp:{PORT + 1}", MODEL) as source:
        thread = threading.Thread(target=flood)
        thread.start()
        try:
            time.sleep(0.1)
            start = time.monotonic()
            targets = [source.latest() for _ in range(5)]
            assert time.monotonic() - start < 10.0
            assert TARGET in targets
        finally:
            is_over.set()
            thread.join()


def test_a_target_that_was_not_reached_is_reported(tmp_path, capsys):
    file = tmp_path / "targets"
    file.write_bytes(TARGET_LINE)
    argv = ["run", "so101", "--backend", "sim", "--quiet", "--targets", str(file)]
    assert main([*argv, "--duration", "0.1"]) == 0
    assert re.search(r"the tool is 1\d\d mm off its last target\n", capsys.readouterr().out)


def test_joints_at_their_limits_are_named_where_a_target_was_not_reached():
    """An SO-101 in its rest pose cannot reach a target above it, because of its joint limits."""
    from pliant.cli.run import _describe_target_error

    folded_q = np.array([0.0, -1.75, 1.7, 0.0, 0.0])
    target = MODEL.forward_kinematics([0.0, -0.3, 0.3, 0.9, 0.0])
    (sentence,) = _describe_target_error(MODEL, folded_q, target)
    assert "at their limits: shoulder_lift, elbow_flex" in sentence
    assert "another pose" in sentence
    assert not _describe_target_error(MODEL, folded_q, MODEL.forward_kinematics(folded_q))
