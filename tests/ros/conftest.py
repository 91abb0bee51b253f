"""A simulated arm that a network process commands, and an independent ROS 2 client."""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import os
import socket
import struct
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import pliant
from pliant.ros import Bridge

#: Time after which a test stops waiting for an event [s]; some take seconds on a loaded machine.
DEADLINE = 60.0
#: Pause after every tick [s], in which the other processes can run.
PAUSE = 0.002


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Running:
    """An arm with its loop, which advances only in `until`."""

    def __init__(self, arm, settings, link, stderr):
        self.arm, self.link, self._stderr = arm, link, stderr
        self.controller = pliant.Controller(arm.model, settings, arm.servos)
        self.loop = pliant.Loop(arm, self.controller)
        self.bridge = Bridge(arm, self.loop, link)
        self.ticks = iter(self.loop)
        self.tool = np.eye(4)

    def until(self, condition, description):
        """Run the loop until `condition()` is true; fail after `DEADLINE`."""
        end = time.monotonic() + DEADLINE
        while not condition():
            assert time.monotonic() < end, f"{description} did not happen within {DEADLINE:g} s"
            self.ticks_of(1)

    def ticks_of(self, count):
        """Run the loop for a number of ticks."""
        for tick in itertools.islice(self.ticks, count):
            self.bridge.step(tick)
            self.tool = self.arm.model.forward_kinematics(tick.q)
            time.sleep(PAUSE)

    def close(self):
        self.ticks.close()

    def log_text(self):
        """Return the text on stderr of the process that runs the network."""
        return self._stderr.read_text()


@contextlib.contextmanager
def stderr_to(path):
    """Redirect stderr to a file in this context: processes started in it inherit the file."""
    original = os.dup(2)
    with path.open("wb") as file:
        os.dup2(file.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(original, 2)
        os.close(original)


class Foxglove:
    """Client of Foxglove's protocol: channels, raw messages by topic, answers by operation."""

    def __init__(self, address):
        from websockets.sync.client import connect

        self.socket = connect(address, subprotocols=["foxglove.sdk.v1"])
        self.channels, self.received, self.answers = {}, {}, {}
        self._topics = {}

    def poll(self):
        """Store all messages that have arrived, without waiting."""
        while True:
            try:
                message = self.socket.recv(timeout=0)
            except TimeoutError:
                return
            if isinstance(message, bytes):
                kind, subscription, _ = struct.unpack_from("<BIQ", message)
                assert kind == 1
                self.received.setdefault(self._topics[subscription], []).append(message[13:])
                continue
            answer = json.loads(message)
            self.answers[answer["op"]] = answer
            if answer["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in answer["channels"]}

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def subscribe(self, topic):
        number = len(self._topics) + 1
        self._topics[number] = topic
        request = {"id": number, "channelId": self.channels[topic]["id"]}
        self.send(op="subscribe", subscriptions=[request])

    def decode(self, topic):
        """Decode the last message of a topic with the definition that the server announced."""
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        channel = self.channels[topic]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
        return store.deserialize_cdr(self.received[topic][-1], channel["schemaName"])


@contextlib.contextmanager
def run_node(port, tmp_path_factory, settings):
    """Start a node on a port; yield the `Running` loop of a simulated SO-101 that it commands."""
    from pliant.ros import ros_link

    stderr = tmp_path_factory.mktemp("node") / "stderr"
    with stderr_to(stderr):
        link = ros_link(listen=f"tcp/127.0.0.1:{port}")
    with link, pliant.connect("so101", backend="sim", on_exit="leave_enabled") as arm:
        running = Running(arm, settings, link, stderr)
        running.ticks_of(5)
        yield running
        running.close()


#: Definitions of message types as ROS 2 ships them, without comments and constants.
MESSAGES = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "std_msgs/msg/String": "string data\n",
    "std_msgs/msg/MultiArrayDimension": "string label\nuint32 size\nuint32 stride\n",
    "std_msgs/msg/MultiArrayLayout": "MultiArrayDimension[] dim\nuint32 data_offset\n",
    "std_msgs/msg/Float64MultiArray": "MultiArrayLayout layout\nfloat64[] data\n",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/msg/Pose": "Point position\nQuaternion orientation\n",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\nPose pose\n",
    "geometry_msgs/msg/Transform": "Vector3 translation\nQuaternion rotation\n",
    "geometry_msgs/msg/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\nTransform transform\n"
    ),
    "geometry_msgs/msg/Wrench": "Vector3 force\nVector3 torque\n",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\nWrench wrench\n",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
        "float64[] effort\n"
    ),
    "rcl_interfaces/msg/ParameterValue": (
        "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\n"
        "string string_value\nbyte[] byte_array_value\nbool[] bool_array_value\n"
        "int64[] integer_array_value\nfloat64[] double_array_value\nstring[] string_array_value\n"
    ),
    "rcl_interfaces/msg/Parameter": "string name\nParameterValue value\n",
    "rcl_interfaces/msg/SetParametersResult": "bool successful\nstring reason\n",
    "rcl_interfaces/msg/ListParametersResult": "string[] names\nstring[] prefixes\n",
    "rcl_interfaces/msg/FloatingPointRange": (
        "float64 from_value\nfloat64 to_value\nfloat64 step\n"
    ),
    "rcl_interfaces/msg/IntegerRange": "int64 from_value\nint64 to_value\nuint64 step\n",
    "rcl_interfaces/msg/ParameterDescriptor": (
        "string name\nuint8 type\nstring description\nstring additional_constraints\n"
        "bool read_only false\nbool dynamic_typing false\n"
        "FloatingPointRange[<=1] floating_point_range\nIntegerRange[<=1] integer_range\n"
    ),
}
SERVICES = {
    "GetParameters": "string[] names\n---\nrcl_interfaces/ParameterValue[] values\n",
    "ListParameters": (
        "uint64 DEPTH_RECURSIVE=0\nstring[] prefixes\nuint64 depth\n---\n"
        "rcl_interfaces/ListParametersResult result\n"
    ),
    "SetParameters": (
        "rcl_interfaces/Parameter[] parameters\n---\nrcl_interfaces/SetParametersResult[] results\n"
    ),
    "SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters\n---\nrcl_interfaces/SetParametersResult result\n"
    ),
}


class Client:
    """Client zenoh-ros2-sdk; `received` has the messages that it has received, by topic."""

    def __init__(self, sdk, port, folder):
        self.sdk, self.port = sdk, port
        # Definitions in this folder save the client a download.
        for name, text in MESSAGES.items():
            self._write(folder / f"{name}.msg", text)
        for name, text in SERVICES.items():
            self._write(folder / "rcl_interfaces" / "srv" / f"{name}.srv", text)
        self.session = sdk.ZenohSession.get_instance("127.0.0.1", port)
        self.registry = sdk.get_registry()
        self.registry.messages_dir = folder
        # The registry is global: forget types that belong to the session of an earlier client.
        self.registry._loaded_types.clear()
        self.received: dict[str, list] = {}
        self._publishers: dict[str, object] = {}

    @staticmethod
    def _write(path: Path, text: str):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def subscribe(self, topic, kind, **extra):
        messages = self.received.setdefault(topic, [])
        return self.sdk.ROS2Subscriber(
            topic, kind, callback=messages.append, router_port=self.port, domain_id=0, **extra
        )

    def publish(self, topic, kind, **fields):
        if topic not in self._publishers:
            self._publishers[topic] = self.sdk.ROS2Publisher(
                topic, kind, router_port=self.port, domain_id=0
            )
        self._publishers[topic].publish(**fields)

    def make(self, kind, **fields):
        assert self.registry.load_message_type(kind)
        return self.session.store.types[kind](**fields)

    def call(self, name, kind, **request):
        client = self.sdk.ROS2ServiceClient(
            name, f"rcl_interfaces/srv/{kind}", router_port=self.port, domain_id=0, timeout=DEADLINE
        )
        answer = client.call(**request)
        client.close()
        return answer


def answer(running, call):
    """Run the loop until a service call has returned, and return its result."""
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(call)
        running.until(future.done, "the answer of the service")
    assert future.result() is not None, "the service did not answer"
    return future.result()


def axis_values(client, values):
    """Return the fields of a `Float64MultiArray` message with one number per axis."""
    layout = client.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return {"layout": layout, "data": np.array(values, dtype=float)}


def send_until(running, client, topic, fields, *, condition, description):
    """Publish every 0.3 s until `condition()` is true: discovery of the subscriber takes time."""
    from pliant.ros.interface import SUBSCRIBED

    kind, last = SUBSCRIBED[topic.replace("/pliant", "~")], [0.0]

    def check():
        if time.monotonic() - last[0] > 0.3:
            client.publish(topic, kind, **fields)
            last[0] = time.monotonic()
        return condition()

    running.until(check, description)


@pytest.fixture(scope="module")
def client_of(tmp_path_factory):
    """Return a function that connects the client to a port."""
    sdk = pytest.importorskip("zenoh_ros2_sdk", reason="the client: pip install zenoh-ros2-sdk")
    logging.getLogger("zenoh_ros2_sdk").setLevel(logging.ERROR)
    clients = []

    def connect(port):
        clients.append(Client(sdk, port, tmp_path_factory.mktemp("messages")))
        return clients[-1]

    yield connect
    for client in clients:
        client.session.close()
