"""`pliant.ros.wire`: names, hashes and bytes equal published values and other libraries."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="ROS 2 needs rosbags: pip install 'pliant[ros]'")

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pliant import _ros_messages as ros
from pliant.ros import wire


def test_key_and_token_are_those_of_the_design_document():
    # Values from docs/design.md of rmw_zenoh.
    type_hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    name = wire.NodeName(2, "/", "talker")
    assert (
        wire.key_expression(0, "/robot1/chatter", "std_msgs/msg/String")
        == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{type_hash}"
    )
    assert name.token("aac3178e146ba6f1fc6e6a4085e77f21") == (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/talker"
    )
    assert wire.entity_token(
        name.token("aac3178e146ba6f1fc6e6a4085e77f21", 10, "MP"),
        "/chatter",
        "std_msgs/msg/String",
        wire.QOS,
    ) == (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%chatter/"
        f"std_msgs::msg::dds_::String_/{type_hash}/::,10:,:,:,,"
    )


def test_hash_of_a_service_is_that_of_the_design_document():
    name = "example_interfaces/srv/AddTwoInts"
    store = get_typestore(Stores.EMPTY)
    names = ("builtin_interfaces/msg/Time", "service_msgs/msg/ServiceEventInfo")
    store.register({key: wire.STORE.fielddefs[key] for key in names})
    store.register(wire.service_types(name, "int64 a\nint64 b\n", "int64 sum\n"))
    assert store.hash_rihs01(name) == (
        "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    )


@pytest.mark.parametrize(
    ("topic", "full"),
    [
        ("/tf", "/tf"),
        ("joint_states", "/left/joint_states"),
        ("~/current_pose", "/left/arm/current_pose"),
    ],
)
def test_names_are_resolved_as_in_ros(topic, full):
    assert wire.NodeName(0, "/left", "arm").resolve(topic) == full


MESSAGES = {
    ros.JOINT_STATE: ros.joint_state(
        1_795_517_770_123_456_789,
        ["a", "b", "gripper"],
        np.array([0.1, -0.2, 0.3]),
        np.full(2, np.nan),
        np.array([1.5, -2.5]),
    ),
    ros.POSE_STAMPED: ros.pose_stamped(1_000_000_001, "base", np.eye(4)),
    ros.TF_MESSAGE: ros.tf_message(5, [("base", "tool", np.eye(4)), ("tool", "tip", np.eye(4))]),
    ros.WRENCH_STAMPED: ros.wrench_stamped(5, "tool", np.arange(6.0)),
    ros.STRING: {"data": "<robot/>"},
}


@pytest.mark.parametrize("name", MESSAGES)
def test_bytes_are_those_that_a_log_would_hold(name):
    dynamic = pytest.importorskip("mcap_ros2._dynamic", reason="pip install 'pliant[log]'")
    encoders = dynamic.serialize_dynamic(name, ros.DEFINITIONS[name])
    assert wire.encode(name, MESSAGES[name]) == encoders[name](MESSAGES[name])


@pytest.mark.parametrize("name", ros.DEFINITIONS)
def test_definitions_are_the_types_of_ros(name):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(ros.DEFINITIONS[name], name))
    assert store.hash_rihs01(name) == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(name)


@pytest.mark.parametrize("data", [b"", b"\x00", b"\x00\x01\x00\x00" + b"\xff" * 40])
def test_invalid_bytes_of_a_message_are_a_value_error(data):
    with pytest.raises(ValueError, match="bytes are not a"):
        wire.decode(ros.JOINT_STATE, data)


def test_attachment_is_number_time_and_id():
    attachment = wire.attachment(3, 4, bytes(range(16)))
    assert attachment == b"\x03" + bytes(7) + b"\x04" + bytes(7) + b"\x10" + bytes(range(16))
