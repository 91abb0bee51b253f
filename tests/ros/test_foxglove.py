"""`pliant foxglove` with a WebSocket client that speaks Foxglove's protocol."""

from __future__ import annotations

import contextlib
import json
import struct
import time

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="Foxglove needs its SDK: pip install 'pliant[foxglove]'")

import pliant
from pliant.ros import foxglove_link
from tests.ros.conftest import Foxglove, Running, stderr_to

SOFT = pliant.Settings.soft("x y", task="xyz")


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with run_arm(tmp_path_factory, allow_commands=True) as arm_loop:
        yield arm_loop


@contextlib.contextmanager
def run_arm(tmp_path_factory, *, allow_commands):
    stderr = tmp_path_factory.mktemp("foxglove") / "stderr"
    with stderr_to(stderr):
        link = foxglove_link(port=0, allow_commands=allow_commands)
    with link, pliant.connect("so101", backend="sim", on_exit="leave_enabled") as arm:
        running = Running(arm, SOFT, link, stderr)
        running.ticks_of(5)
        yield running
        running.close()


def client_of(running):
    client = Foxglove(running.link.address)

    def ready():
        client.poll()
        return len(client.channels) >= 5

    running.until(ready, "the list of channels")
    return client


@pytest.fixture(scope="module")
def client(running):
    foxglove = client_of(running)
    yield foxglove
    foxglove.socket.close()


def wait(running, client, condition, description):
    def check():
        client.poll()
        return condition()

    running.until(check, description)


def test_state_and_description_arrive(running, client):
    topics = [
        "/joint_states",
        "/tf",
        "/pliant/current_pose",
        "/pliant/external_wrench",
        "/robot_description",
    ]
    for topic in topics:
        client.subscribe(topic)
    wait(
        running, client, lambda: all(client.received.get(topic) for topic in topics), "all messages"
    )
    model = running.arm.model
    joints = client.decode("/joint_states")
    assert list(joints.name) == [*model.joint_names, "gripper"]
    assert client.decode("/robot_description").data == model.source[0]
    assert {t.child_frame_id for t in client.decode("/tf").transforms} == set(model.frames) - {
        model.base
    }
    pose = client.decode("/pliant/current_pose")
    assert pose.header.frame_id == model.base
    position = [getattr(pose.pose.position, axis) for axis in "xyz"]
    assert np.linalg.norm(running.tool[:3, 3] - position) < 0.01


def test_the_force_caps_of_axes_are_parameters_that_can_be_set(running, client):
    client.send(op="getParameters", parameterNames=["axes.x.soft"], id="read")
    wait(running, client, lambda: "parameterValues" in client.answers, "the parameter")
    assert client.answers["parameterValues"]["parameters"][0]["value"] == 1.0
    client.send(
        op="setParameters",
        parameters=[{"name": "axes.x.soft", "value": 3.5, "type": "float64"}],
        id="set",
    )
    wait(
        running,
        client,
        lambda: running.controller.axes["x"].soft == (3.5, 3.5),
        "the change of the settings",
    )
    client.send(
        op="setParameters",
        parameters=[{"name": "axes.x.soft", "value": 150.0, "type": "float64"}],
        id="bad",
    )
    wait(
        running,
        client,
        lambda: client.answers["parameterValues"].get("id") == "bad",
        "the answer to a bad value",
    )
    assert client.answers["parameterValues"]["parameters"][0]["value"] == 3.5
    text = "parameters refused: axes.x.soft = 150 is outside [0, firm = 4.5]"
    wait(running, client, lambda: text in running.log_text(), "the refusal")


def publish_until(running, client, message, condition, description):
    """Publish a target as JSON until the loop shows the effect."""
    channel = {"id": 1, "topic": "/pliant/target_pose", "encoding": "json"}
    client.send(
        op="advertise", channels=[{**channel, "schemaName": "geometry_msgs/msg/PoseStamped"}]
    )
    last = [0.0]

    def check():
        if time.monotonic() - last[0] > 0.3:
            client.socket.send(struct.pack("<BI", 1, 1) + json.dumps(message).encode())
            last[0] = time.monotonic()
        return condition()

    wait(running, client, check, description)
    client.send(op="unadvertise", channelIds=[1])


def test_published_target_moves_the_tool(running, client):
    goal = running.tool[:3, 3] + (0.0, 0.03, 0.02)
    x, y, z, w = pliant.Pose(running.tool).xyzw.tolist()
    message = {
        "header": {"frame_id": "base"},
        "pose": {
            "position": dict(zip("xyz", goal.tolist(), strict=True)),
            "orientation": {"x": x, "y": y, "z": z, "w": w},
        },
    }
    publish_until(
        running,
        client,
        message,
        lambda: np.linalg.norm(running.tool[:3, 3] - goal) < 0.008,
        "the motion to the target",
    )


def test_json_without_a_valid_pose_is_refused(running, client):
    before = running.bridge.target.copy()
    text = "a geometry_msgs/msg/PoseStamped has the fields header, pose"
    publish_until(
        running, client, {"position": [1, 2, 3]}, lambda: text in running.log_text(), "the refusal"
    )
    assert (running.bridge.target == before).all()


def test_without_permission_it_only_shows(tmp_path_factory):
    with run_arm(tmp_path_factory, allow_commands=False) as running:
        client = client_of(running)
        wait(running, client, lambda: "serverInfo" in client.answers, "the server's description")
        assert client.answers["serverInfo"]["capabilities"] == []
        before = running.bridge.target.copy()
        client.send(
            op="setParameters",
            parameters=[{"name": "axes.x.soft", "value": 3.5, "type": "float64"}],
        )
        channel = {"id": 1, "topic": "/pliant/target_pose", "encoding": "json"}
        schema = "geometry_msgs/msg/PoseStamped"
        client.send(op="advertise", channels=[{**channel, "schemaName": schema}])
        pose = {"position": {"x": 0.2, "z": 0.2}, "orientation": {"w": 1.0}}
        client.socket.send(struct.pack("<BI", 1, 1) + json.dumps({"pose": pose}).encode())
        # The server answers in order, so the commands have been handled when a state arrives.
        client.subscribe("/joint_states")
        wait(running, client, lambda: client.received.get("/joint_states"), "a state")
        running.ticks_of(50)
        assert (running.bridge.target == before).all()
        assert running.controller.axes["x"].soft == (1.0, 1.0)
        client.socket.close()


def test_taken_port_is_an_error(running):
    port = int(running.link.address.rpartition(":")[2])
    with pytest.raises(pliant.PliantError, match=f"cannot listen on 127.0.0.1:{port}"):
        foxglove_link(port=port)
