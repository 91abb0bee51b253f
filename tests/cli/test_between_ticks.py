"""Commands in their own process: no imports between ticks, and complete files after a signal."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import programs
import pytest
from bare_arm import left_enabled
from programs import Program
from teach.test_teach import assert_scripted_motion

pytest.importorskip("mujoco", reason="these commands drive an emulated arm: extra sim")
pytest.importorskip("rustypot")

import pliant
from pliant.teach import Motion

#: Program that runs a command and prints its exit code and the modules that were imported between
#: two ticks. After each tick it executes the statement `{each}`.
PROGRAM = """
import json, os, signal, sys
import pliant.cli, pliant.loop, pliant.teach.teacher
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
turns, loaded = pliant.loop.Loop.__iter__, set()
start, ticks_recorded = pliant.teach.teacher.Teacher.start, []

def started(self):
    ticks_recorded.append(1)
    start(self)

pliant.teach.teacher.Teacher.start = started

def watched(self):
    before = set(sys.modules)
    try:
        for tick in turns(self):
            yield tick
            {each}
    finally:
        loaded.update(set(sys.modules) - before)

pliant.loop.Loop.__iter__ = watched
code = pliant.cli.main(sys.argv[1:])
sys.stdout.flush()
print()
print(json.dumps([code, sorted(loaded)]))
"""


def run_alone(*arguments):
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, timeout=120, check=False
    )


@pytest.fixture
def command(tmp_path):
    """Return a function that runs a command on an emulated SO-101 that keeps its torque at exit.

    It returns exit code, modules imported between ticks, and the ended process.
    """
    arm = left_enabled(tmp_path)

    def run(name, *flags, statement="pass", backend="emulator"):
        arguments = (name, arm, *flags, "--backend", backend)
        # Use a new process: a fork of the server has imported the modules already.
        start = run_alone if backend == "emulator" else programs.run
        result = start("-c", PROGRAM.replace("{each}", statement), *arguments)
        assert result.stdout, result.stderr
        code, modules = json.loads(result.stdout.splitlines()[-1])
        return code, modules, result

    return run


def moved(path):
    model = pliant.robots.so101()
    time = np.linspace(0.0, 1.0, 51)
    q = np.tile([0.0, -0.3, 0.3, 0.9, 0.0], (51, 1))
    q[:, 0] = 0.1 * time
    Motion(model.joint_names, time, q).save(path)
    return str(path)


@pytest.mark.parametrize(
    "name", ["teach", *(pytest.param(n, marks=pytest.mark.full) for n in ("run", "replay"))]
)
def test_nothing_is_loaded_between_two_ticks(command, tmp_path, name):
    flags = {
        "teach": [str(tmp_path / "m.json"), "--scripted-hand"],
        "run": ["--duration", "1"],
        "replay": [moved(tmp_path / "r.json")],
    }
    code, modules, result = command(name, *flags[name])
    assert code == 0, result.stderr
    assert not modules
    if name == "teach":
        assert "pliant replay" in result.stdout
        assert_scripted_motion(flags[name][0])


def test_a_recording_outlives_ctrl_c(command, tmp_path):
    file = tmp_path / "m.json"
    statement = (
        "ticks_recorded and (ticks_recorded.append(1), "
        "len(ticks_recorded) == 300 and os.kill(os.getpid(), signal.SIGINT))"
    )
    code, _, result = command(
        "teach", str(file), "--scripted-hand", statement=statement, backend="sim"
    )
    assert code == 130, result.stderr
    motion = Motion.load(file)
    assert 0.5 < motion.duration < 4.0
    assert f"{file}: " in result.stdout
    assert "a rest of 3 s ends the recording" in result.stdout


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_a_run_that_a_signal_ends_has_its_summary_and_code(command, name, code):
    statement = f"if tick.index == 20: os.kill(os.getpid(), signal.{name})"
    exit_code, _, result = command("run", statement=statement, backend="sim")
    assert exit_code == code, result.stderr
    assert "ticks, late by" in result.stdout
    assert "torque ON" in result.stderr


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGHUP", pytest.param("SIGTERM", marks=pytest.mark.full)])
def test_an_emulator_removes_its_folder_at_a_signal(name):
    with Program("-m", "pliant.cli", "servos", "emulate", "so101") as process:
        path = process.stdout.readline().partition(": ")[2].strip()
        assert os.path.exists(path)
        process.send_signal(getattr(signal, name))
        assert process.wait(60) == 128 + getattr(signal, name)
    assert not os.path.exists(os.path.dirname(path))
