"""Programs that end by signals, errors and exits; each is a process on an emulated bus."""

from __future__ import annotations

import os
import signal
import time

import pytest

pytest.importorskip("mujoco", reason="the arm behind the servos needs the extra sim")
pytest.importorskip("rustypot", reason="the bus needs the extra servo")
pytest.importorskip("pydantic", reason="the configurations need the extra config")

from programs import Program
from soak.recorded_arm import so101

from pliant.emulator import EmulatorProcess

# A test run in the background ignores Ctrl-C, and its children would inherit that.
PROGRAM = """
import os, signal, sys, pliant
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
options = {{"comm_timeout": 20.0, "guardian": {guardian}}}
with pliant.connect("so101", port=sys.argv[1], **options) as arm:
    print("torque", flush=True)
    for tick in pliant.Loop(arm, max_step_time=20.0):
        tick.skip()
        if tick.index == 5 and len(sys.argv) > 2:
            exec(sys.argv[2])
"""


#: A pose 9 cm above the rest pose [rad]: a short descent.
LOW_POSE = [0.0, -1.5, 1.4, 0.3, 0.0]


def start(bus, *arguments, guardian=True):
    # Start a new session: a signal to its process group then acts like Ctrl-C in a terminal.
    program = Program(
        "-c", PROGRAM.format(guardian=guardian), bus.port, *arguments, start_new_session=True
    )
    assert program.stdout.readline() == "torque\n", program.communicate()[1]
    return program


@pytest.mark.parametrize(
    ("ending", "code"),
    [
        ("SIGINT", {130, -signal.SIGINT}),
        ("sys.exit(3)", {3}),
        pytest.param("SIGTERM", {128 + signal.SIGTERM}, marks=pytest.mark.full),
        pytest.param("raise KeyError('policy')", {1}, marks=pytest.mark.full),
    ],
)
def test_the_arm_is_lowered(ending, code):
    with EmulatorProcess(so101, LOW_POSE) as bus:
        program = start(bus, *([] if ending.startswith("SIG") else [ending]))
        # Record from here on, because the sag at torque on is not part of the descent.
        bus.call("recorder.begin")
        high = bus.call("recorder.start")
        if ending.startswith("SIG"):
            os.killpg(program.pid, getattr(signal, ending))
        _, stderr = program.communicate(timeout=120)
        assert program.returncode in code, stderr
        # A fall would reach 1 m/s; a busy machine makes a descent faster than usual.
        assert not bus.call("has_torque")
        assert bus.call("plant.tool.tolist")[2][3] < high - 0.02
        assert bus.call("recorder.speeds")[False] < 0.25


@pytest.mark.parametrize("guardian", [True, False])
def test_killed_it_is_lowered_by_its_guardian_and_keeps_its_last_order_without(guardian):
    with EmulatorProcess(so101, LOW_POSE) as bus:
        program = start(bus, guardian=guardian)
        height = bus.call("plant.tool.tolist")[2][3]
        program.kill()
        # The guardian keeps the program's stderr open until it has ended.
        program.communicate(timeout=120)
        if guardian:
            assert not bus.call("has_torque")
            assert bus.call("plant.tool.tolist")[2][3] < height - 0.02
        else:
            time.sleep(1.0)  # the emulator runs in real time
            assert bus.call("has_torque")
            assert bus.call("plant.tool.tolist")[2][3] == pytest.approx(height, abs=0.01)
