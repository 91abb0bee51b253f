"""`pliant servos doctor --watch`: it names joints moved by hand, and the direction of the tool."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import pliant
from pliant import config
from pliant.cli import main
from pliant.cli.servos._joint_monitor import joint_directions
from pliant.config.factory import make_emulator

UPWARD = (0.0, 0.0, 1.0)


@pytest.mark.parametrize("name", ["so101", "koch", "arm7"])
def test_ways_are_those_of_finite_differences(name):
    model = getattr(pliant.robots, name)()
    q = 0.5 * np.ones(model.n) * np.where(np.arange(model.n) % 2, 1.0, -1.0)
    for is_falling, sign in ((False, 1.0), (True, -1.0)):
        for joint, phrase in enumerate(joint_directions(model, q, up=UPWARD, falling=is_falling)):
            step = 1e-5 * np.eye(model.n)[joint] * sign
            start, end = (model.forward_kinematics(p)[:3, 3] for p in (q, q + step))
            displacement = (end - start) / 1e-5
            largest = int(np.argmax(np.abs(displacement)))
            if np.linalg.norm(displacement) < 0.02:
                assert phrase.startswith("turns in place about ")
                continue
            expected = "+-"[int(displacement[largest] < 0.0)] + "xyz"[largest]
            assert phrase.startswith(f"goes {expected}"), (joint, phrase, displacement)
            assert ("(down)" in phrase) == bool(
                -displacement[2] >= 0.3 * np.linalg.norm(displacement)
            )


def test_a_joint_that_turns_the_tool_in_place_names_its_axis():
    model = pliant.robots.so101()
    roll = joint_directions(model, np.zeros(5), up=UPWARD)[4]
    assert roll == "turns in place about +x, as a screw goes in"


@pytest.fixture
def arm(tmp_path):
    """Yield an emulated SO-101, its file, and a file with the wrong sign for shoulder_lift."""
    arm_config = config.load("so101", backend="emulator")
    with make_emulator(arm_config) as bus:
        text = config.loader.builtin_text("so101").replace('path = "auto"', f'path = "{bus.port}"')
        file = tmp_path / "arm.toml"
        file.write_text(text)
        mirrored = tmp_path / "mirrored.toml"
        mirrored.write_text(text.replace("id = 2", "id = 2, sign = -1"))
        yield bus, file, mirrored


def watch_while_lifted(bus, file, capsys):
    """Return the output while a hand turns shoulder_lift by +0.4 rad and back."""

    def lift():
        for angle in (0.4, 0.0):
            time.sleep(1.5)
            bus.plant.reset([0.0, angle, 0.0, 0.0, 0.0])

    hand = threading.Thread(target=lift)
    hand.start()
    assert main(["servos", "doctor", str(file), "--watch", "--duration", "4.5"]) == 0
    hand.join()
    return capsys.readouterr().out


def test_a_moved_joint_is_named_with_the_way_of_the_tool(arm, capsys):
    bus, file, mirrored = arm
    out = watch_while_lifted(bus, file, capsys)
    assert "shoulder_lift: +0.00 rad (+0°), limits -1.75 to +1.75" in out
    assert "shoulder_pan: " in out
    assert "gripper: " in out
    increase = next(line for line in out.splitlines() if "shoulder_lift grew by 0.40 rad" in line)
    assert "the tool goes -z (down)" in increase
    decrease = next(line for line in out.splitlines() if "shoulder_lift fell by 0.40 rad" in line)
    assert "+z (up)" in decrease
    assert "elbow_flex grew" not in out
    assert not bus.log.writes("torque_enable")
    assert not bus.log.eeprom_writes()
    # With the wrong sign in the file, the program says "up" although the tool sank.
    out = watch_while_lifted(bus, mirrored, capsys)
    first, second = (
        line for line in out.splitlines() if "shoulder_lift" in line and " by " in line
    )
    assert "shoulder_lift fell by 0.40 rad" in first
    assert "+z (up)" in first
    assert "shoulder_lift grew by 0.40 rad" in second


def test_torque_that_is_on_is_in_the_way(capsys):
    assert (
        main(["servos", "doctor", "so101", "--backend", "sim", "--watch", "--duration", "0.2"]) == 0
    )
    out = capsys.readouterr().out
    assert "torque is on already" in out
    # `rich` must not take `[life]` for markup and remove it.
    assert "under [life] of its file" in out
    assert "-0.00" not in out.splitlines()[-1]


def test_ctrl_c_is_how_it_ends():
    # A test run in the background ignores Ctrl-C, and its children would inherit that.
    program = (
        "import signal, sys, pliant.cli as cli; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); "
        "sys.exit(cli.main(sys.argv[1:]))"
    )
    lines = [
        sys.executable,
        "-u",
        "-c",
        program,
        "servos",
        "doctor",
        "so101",
        "--backend",
        "sim",
        "--watch",
    ]
    with subprocess.Popen(lines, stdout=subprocess.PIPE, text=True) as running:
        try:
            assert running.stdout is not None
            while "tool at" not in running.stdout.readline():
                assert running.poll() is None
            running.send_signal(signal.SIGINT)
            assert running.wait(timeout=30) == 0
        finally:
            running.kill()


@pytest.mark.parametrize("flags", [["--duration", "1"], ["--watch", "--duration", "0"]])
def test_seconds_are_refused_where_they_mean_nothing(flags, capsys):
    assert main(["servos", "doctor", "so101", "--backend", "sim", *flags]) == 2
    assert "--duration" in capsys.readouterr().err


def test_doctor_without_problems_points_to_watch(monkeypatch, capsys):
    monkeypatch.setattr("pliant.cli.servos.doctor.examine", lambda _: iter(()))
    assert main(["servos", "doctor", "so101", "--backend", "emulator"]) == 0
    assert "the same command with --watch" in " ".join(capsys.readouterr().out.split())


def test_the_table_names_units_and_is_not_read_as_markup():
    from rich.console import Console

    from pliant.cli.servos._joint_monitor import JointMonitor, _table

    arm_config = config.load("so101")
    model = arm_config.model()
    monitor = JointMonitor(arm_config, model, tuple(model.joint_names))
    monitor.update(np.zeros(model.n), np.ones(model.n, dtype=bool))
    console = Console(width=140, force_terminal=True, record=True)
    console.print(_table(monitor))
    assert "limits [rad]" in console.export_text()


def test_a_joint_that_falls_silent_does_not_show_its_last_angle():
    from pliant.cli.servos._joint_monitor import JointMonitor

    arm_config = config.load("so101")
    model = arm_config.model()
    monitor = JointMonitor(arm_config, model, tuple(model.joint_names))
    ok = np.ones(model.n, dtype=bool)
    monitor.update(np.zeros(model.n), ok)
    for is_answering in (False, True):
        ok[2] = is_answering
        monitor.update(np.zeros(model.n), ok)
        angles = [angle for _, angle, _, _ in monitor.rows]
        assert angles.count("no answer") == (not is_answering)
        assert (angles[2] == "no answer") is not is_answering
