"""`pliant ros` with a client of zenoh-ros2-sdk, another implementation of rmw_zenoh's protocol."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("zenoh", reason="ROS 2 needs zenoh: pip install 'pliant[ros]'")

import zenoh

import pliant
from pliant.ros import ros_link, wire
from tests.ros.conftest import answer, axis_values, free_port, run_node, send_until

SOFT = pliant.Settings.soft("x y", task="xyz")


@pytest.fixture(scope="module")
def port():
    return free_port()


@pytest.fixture(scope="module")
def running(port, tmp_path_factory):
    with run_node(port, tmp_path_factory, SOFT) as node:
        yield node


@pytest.fixture(scope="module")
def client(running, port, client_of):
    return client_of(port)


def pose_fields(client, pose, frame="base", xyzw=None, stamp=(0, 0)):
    x, y, z, w = pliant.Pose(pose).xyzw if xyzw is None else xyzw
    xyz = dict(zip("xyz", map(float, pose[:3, 3]), strict=True))
    point = client.make("geometry_msgs/msg/Point", **xyz)
    rotation = client.make(
        "geometry_msgs/msg/Quaternion", x=float(x), y=float(y), z=float(z), w=float(w)
    )
    sec, nanosec = stamp
    time_ = client.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return {
        "header": client.make("std_msgs/msg/Header", stamp=time_, frame_id=frame),
        "pose": client.make("geometry_msgs/msg/Pose", position=point, orientation=rotation),
    }


def test_state_arrives_with_names_frames_and_values(running, client):
    kinds = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/pliant/current_pose": "geometry_msgs/msg/PoseStamped",
        "/pliant/external_wrench": "geometry_msgs/msg/WrenchStamped",
    }
    subscribers = [client.subscribe(topic, kind) for topic, kind in kinds.items()]
    running.until(
        lambda: all(client.received[topic] for topic in kinds), "a message of every topic"
    )
    for subscriber in subscribers:
        subscriber.close()
    joints, tf, pose, wrench = (client.received[topic][-1] for topic in kinds)
    model = running.arm.model
    assert list(joints.name) == [*model.joint_names, "gripper"]
    q = joints.position[: model.n]
    tool = model.forward_kinematics(q)
    assert pose.header.frame_id == model.base
    assert wrench.header.frame_id == model.tip
    # The transforms of all links, followed from the base, lead to the tool.
    links = {t.child_frame_id: t for t in tf.transforms}
    assert set(links) == set(model.frames) - {model.base}
    chained, frame = np.eye(4), model.tip
    while frame != model.base:
        transform = links[frame].transform
        p, r = transform.translation, transform.rotation
        chained = pliant.Pose.from_xyzw((p.x, p.y, p.z), (r.x, r.y, r.z, r.w)).matrix @ chained
        frame = links[frame].header.frame_id
    same_time = [
        p
        for p in client.received["/pliant/current_pose"]
        if p.header.stamp == tf.transforms[0].header.stamp
    ]
    assert same_time, "no pose with the time of the transforms"
    assert np.allclose(
        chained[:3, 3], [getattr(same_time[0].pose.position, axis) for axis in "xyz"], atol=1e-9
    )
    assert np.allclose(tool[:3, 3], chained[:3, 3], atol=0.01)


def test_description_arrives_at_a_subscriber_that_comes_later(running, client):
    messages = []
    # Subscribe as rmw_zenoh does for a transient-local topic.
    subscriber = zenoh.ext.declare_advanced_subscriber(
        client.session.session,
        wire.key_expression(0, "/robot_description", "std_msgs/msg/String"),
        messages.append,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
    )
    running.until(lambda: messages, "the description")
    subscriber.undeclare()
    text = wire.decode("std_msgs/msg/String", messages[0].payload.to_bytes()).data
    assert text == running.arm.model.source[0]
    assert len(messages[0].attachment.to_bytes()) == 8 + 8 + 1 + 16


def test_sdk_gets_the_description_by_its_own_query(running, client):
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile

    qos = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)
    # The constructor itself waits for the answer to its query.
    subscriber = answer(
        running, lambda: client.subscribe("/robot_description", "std_msgs/msg/String", qos=qos)
    )
    running.until(lambda: client.received["/robot_description"], "the description")
    subscriber.close()
    assert client.received["/robot_description"][0].data == running.arm.model.source[0]


def test_graph_shows_node_topics_and_services(running, client):
    topics = dict(client.sdk.get_topic_names_and_types(domain_id=0, timeout=5.0))
    for topic, kind in {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/robot_description": "std_msgs/msg/String",
        "/pliant/target_pose": "geometry_msgs/msg/PoseStamped",
        "/pliant/target_joint": "sensor_msgs/msg/JointState",
        "/pliant/target_stiffness": "std_msgs/msg/Float64MultiArray",
        "/pliant/target_softness": "std_msgs/msg/Float64MultiArray",
    }.items():
        assert topics[topic] == [kind]
    services = dict(client.sdk.get_service_names_and_types(domain_id=0, timeout=5.0))
    assert services["/pliant/set_parameters"] == ["rcl_interfaces/srv/SetParameters"]
    token = "@ros2_lv/0/*/*/*/NN/%/%/pliant"
    replies = [r for r in client.session.liveliness.get(token, timeout=5.0) if r.ok is not None]
    assert len(replies) == 1


def test_target_pose_moves_the_tool(running, client):
    start = running.tool.copy()
    goal = start.copy()
    goal[:3, 3] += (0.0, 0.03, 0.02)
    send_until(
        running,
        client,
        "/pliant/target_pose",
        pose_fields(client, goal),
        condition=lambda: np.linalg.norm(running.tool[:3, 3] - goal[:3, 3]) < 0.008,
        description="the motion to the target",
    )
    # Without further targets the arm stays at the last one.
    running.ticks_of(200)
    assert np.linalg.norm(running.tool[:3, 3] - goal[:3, 3]) < 0.008
    assert np.allclose(running.bridge.target, goal, atol=1e-9)


def test_target_joint_moves_the_joints_by_name(running, client):
    model = running.arm.model
    q = model.lower + 0.5 * (model.upper - model.lower)
    q[0] += 0.2
    names = list(model.joint_names)
    time_ = client.make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    fields = {
        "header": client.make("std_msgs/msg/Header", stamp=time_, frame_id=""),
        "name": names[::-1],
        "position": q[::-1].copy(),
        "velocity": np.zeros(0),
        "effort": np.zeros(0),
    }
    target = model.forward_kinematics(q)
    send_until(
        running,
        client,
        "/pliant/target_joint",
        fields,
        condition=lambda: np.allclose(running.bridge.target, target, atol=1e-9),
        description="the joint target",
    )


BAD_POSES = {
    "NaN": ({}, (np.nan, 0.1, 0.1), "position x [m] = NaN"),
    "frame": ({"frame": "camera"}, (0.2, 0.0, 0.2), "frame_id = 'camera' is not the base 'base'"),
    "far": ({}, (9.0, 0.0, 0.0), "[m] = 9 is outside [0, 1.055]"),
    "quaternion": ({"xyzw": (0, 0, 0, 2)}, (0.2, 0.0, 0.2), "length = 2 is outside 1 ± 0.001"),
    "old": ({"stamp": (1000, 0)}, (0.2, 0.0, 0.2), "s old, more than 0.5 s"),
}


@pytest.mark.parametrize("case", BAD_POSES)
def test_bad_target_is_refused_with_value_and_bound(running, client, case):
    extra, position, text = BAD_POSES[case]
    pose = np.eye(4)
    pose[:3, 3] = position
    before = running.bridge.target.copy()
    fields = pose_fields(client, np.eye(4), **extra)
    for axis, value in zip("xyz", position, strict=True):
        setattr(fields["pose"].position, axis, float(value))
    send_until(
        running,
        client,
        "/pliant/target_pose",
        fields,
        condition=lambda: text in running.log_text(),
        description=f"the refusal {text!r}",
    )
    running.ticks_of(20)
    assert (running.bridge.target == before).all()


def test_bytes_that_are_not_a_message_are_refused(running, client):
    key = wire.key_expression(0, "/pliant/target_pose", "geometry_msgs/msg/PoseStamped")
    before = running.bridge.target.copy()

    def refused():
        client.session.session.put(key, b"\x00\x01\x00\x00\xff\xff")
        return "6 bytes are not a geometry_msgs/msg/PoseStamped" in running.log_text()

    running.until(refused, "the refusal")
    assert (running.bridge.target == before).all()


def test_softness_from_the_client_changes_the_settings_of_the_controller(running, client):
    before = running.controller.axes["x"]
    assert before.soft == (1.0, 1.0)
    nan = float("nan")
    send_until(
        running,
        client,
        "/pliant/target_softness",
        axis_values(client, [3.0, nan, 2.5, nan, nan, nan]),
        condition=lambda: running.controller.axes["x"].soft == (3.0, 3.0),
        description="the change of the caps",
    )
    axes = running.controller.axes
    assert axes["z"].soft == (2.5, 2.5)
    assert axes["z"].yields == "both"
    assert axes["y"].soft == (1.0, 1.0)
    assert axes["x"].firm == before.firm


def test_stiffness_of_another_law_is_refused(running, client):
    text = "stiffness of x belongs to law = 'impedance', and the law is 'cap'"
    send_until(
        running,
        client,
        "/pliant/target_stiffness",
        axis_values(client, [100.0] * 6),
        condition=lambda: text in running.log_text(),
        description="the refusal",
    )


def parameter(client, name, value):
    fields = {
        "type": 3,
        "bool_value": False,
        "integer_value": 0,
        "double_value": value,
        "string_value": "",
        "byte_array_value": np.zeros(0, np.uint8),
        "bool_array_value": np.zeros(0, bool),
        "integer_array_value": np.zeros(0, np.int64),
        "double_array_value": np.zeros(0),
        "string_array_value": [],
    }
    value_ = client.make("rcl_interfaces/msg/ParameterValue", **fields)
    return client.make("rcl_interfaces/msg/Parameter", name=name, value=value_)


def test_parameters_are_listed_read_and_set(running, client):
    listing = answer(
        running,
        lambda: client.call("/pliant/list_parameters", "ListParameters", prefixes=[], depth=0),
    )
    assert {"axes.y.soft", "axes.y.firm", "axes.y.yields"} <= set(listing.result.names)
    reply = answer(
        running,
        lambda: client.call(
            "/pliant/set_parameters",
            "SetParameters",
            parameters=[
                parameter(client, "axes.y.soft", 2.0),
                parameter(client, "axes.y.soft", 150.0),
                parameter(client, "axes.w.soft", 1.0),
            ],
        ),
    )
    assert [result.successful for result in reply.results] == [True, False, False]
    assert "axes.y.soft = 150 is outside [0, firm = 4.5]" in reply.results[1].reason
    assert "there is no parameter 'axes.w.soft'" in reply.results[2].reason
    running.until(
        lambda: running.controller.axes["y"].soft == (2.0, 2.0), "the change of the settings"
    )
    values = answer(
        running,
        lambda: client.call(
            "/pliant/get_parameters", "GetParameters", names=["axes.y.soft", "axes.y.yields", "no"]
        ),
    ).values
    assert [value.type for value in values] == [3, 4, 0]
    assert (values[0].double_value, values[1].string_value) == (2.0, "both")


def test_parameters_set_atomically_change_together_or_not(running, client):
    def set_both(soft, firm):
        parameters = [
            parameter(client, "axes.y.soft", soft),
            parameter(client, "axes.y.firm", firm),
        ]
        return answer(
            running,
            lambda: client.call(
                "/pliant/set_parameters_atomically",
                "SetParametersAtomically",
                parameters=parameters,
            ),
        ).result

    assert not set_both(2.2, 1.0).successful
    assert set_both(5.0, 6.0).successful
    running.until(
        lambda: running.controller.axes["y"].firm == (6.0, 6.0), "the change of the settings"
    )
    assert running.controller.axes["y"].soft == (5.0, 5.0)


def test_taken_port_is_an_error_with_a_remedy(running, port):
    with pytest.raises(pliant.PliantError, match=f"--connect tcp/127.0.0.1:{port}"):
        ros_link(listen=f"tcp/127.0.0.1:{port}")


def test_node_joins_a_router_that_runs(running, client, port):
    with ros_link(connect=f"tcp/127.0.0.1:{port}", name="other") as link:
        assert link.address == f"tcp/127.0.0.1:{port}"
    with pytest.raises(pliant.PliantError, match="no zenoh router at") as error:
        ros_link(connect=f"tcp/127.0.0.1:{free_port()}")
    assert ".rs:" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"name": "my arm"}, "name of a node"),
        ({"namespace": "left"}, "namespace"),
        ({"namespace": "/my-arm"}, "namespace: .* letters, digits and _ after /"),
        ({"domain": 1000}, r"domain id = 1000 is outside \[0, 232\]"),
    ],
)
def test_invalid_names_are_refused(options, text):
    with pytest.raises(pliant.ConfigError, match=text):
        ros_link(**options)
