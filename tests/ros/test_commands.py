"""`pliant ros` and `pliant foxglove` as a user starts them, with a client each."""

from __future__ import annotations

import os
import signal
import time

import pytest

pytest.importorskip("rosbags", reason="both commands need messages: pip install 'pliant[ros]'")

from tests.programs import Program
from tests.ros.conftest import DEADLINE, Foxglove, free_port

#: Simulated arm with a soft axis of 2 N.
ARM = ("so101", "--backend", "sim", "--soft", "y=2")


@pytest.fixture
def start():
    """Return a function that starts a command and returns it with the text of its first line."""
    programs = []

    def run(name, *flags):
        program = Program(
            "-m", "pliant.cli", name, *ARM, *flags, env={**os.environ, "COLUMNS": "200"}
        )
        programs.append(program)
        return program, program.stdout.readline()

    yield run
    for program in programs:
        program.kill()
        program.wait()


def until(condition, description):
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, f"{description} did not happen within {DEADLINE:g} s"
        time.sleep(0.01)


def ended_by_ctrl_c(program):
    """Press Ctrl-C; check the summary, the end of the torque and the exit code."""
    program.send_signal(signal.SIGINT)
    stdout, stderr = program.communicate()
    assert program.returncode == 130, stderr
    assert "ticks, late by" in stdout
    assert "torque OFF" in stderr


def test_ros_command_serves_a_node_until_ctrl_c(start, client_of):
    pytest.importorskip("zenoh", reason="ROS 2 needs zenoh: pip install 'pliant[ros]'")
    port = free_port()
    flags = ("--namespace", "/left", "--name", "arm", "--listen", f"tcp/127.0.0.1:{port}")
    program, output_file = start("ros", *flags)
    assert f"ROS 2 node /left/arm at tcp/127.0.0.1:{port}" in output_file
    client = client_of(port)
    client.subscribe("/left/joint_states", "sensor_msgs/msg/JointState")
    until(lambda: client.received["/left/joint_states"], "a state")
    answer = client.call("/left/arm/get_parameters", "GetParameters", names=["axes.y.soft"])
    assert answer.values[0].double_value == 2.0
    ended_by_ctrl_c(program)


def test_foxglove_command_shows_the_arm_until_ctrl_c(start):
    pytest.importorskip("foxglove", reason="its SDK: pip install 'pliant[foxglove]'")
    port = free_port()
    program, output_file = start("foxglove", "--http-port", str(port), "--allow-commands")
    assert f"Foxglove WebSocket: ws://127.0.0.1:{port}" in output_file
    client = Foxglove(f"ws://127.0.0.1:{port}")

    def arrived(condition, description):
        def check():
            client.poll()
            return condition()

        until(check, description)

    arrived(lambda: "/joint_states" in client.channels, "the list of channels")
    client.subscribe("/joint_states")
    arrived(lambda: client.received.get("/joint_states"), "a state")
    assert "gripper" in client.decode("/joint_states").name
    client.send(op="getParameters", parameterNames=["axes.y.soft"], id="read")
    arrived(lambda: "parameterValues" in client.answers, "the parameter")
    assert client.answers["parameterValues"]["parameters"][0]["value"] == 2.0
    client.socket.close()
    ended_by_ctrl_c(program)


@pytest.mark.parametrize("name", ["ros", "foxglove"])
def test_a_bad_flag_is_an_error_before_torque(start, name):
    program, output_file = start(name, "--duration", "0")
    _, stderr = program.communicate()
    assert (program.returncode, output_file) == (2, "")
    assert "--duration must be above 0 s, got 0" in stderr
