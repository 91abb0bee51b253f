"""Rates, latencies and losses of `pliant ros` and `pliant foxglove` with a simulated arm.

    python benches/ros.py --minutes 10
    python benches/ros.py --minutes 10 --foxglove

The arm runs in real time on this computer. A client sends a target at 50 Hz, a slow circle of the
tool, and receives the state: over a zenoh session of zenoh-ros2-sdk, or over Foxglove's WebSocket.
The log of the arm says which targets the control loop has used, and when.
"""

from __future__ import annotations

import json
import logging
import math
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import pliant.log
from pliant.cli import program
from pliant.ros import wire

#: Rate of the targets, and the default rate of the state [Hz].
RATE = 50.0
#: Radius [m] and period [s] of the circle of the tool.
RADIUS, PERIOD = 0.02, 8.0
#: Address of the node.
PORT = 7461
#: Topics of state and target, and their message type.
STATE, TARGET = "/pliant/current_pose", "/pliant/target_pose"
POSE = "geometry_msgs/msg/PoseStamped"


def run(minutes: float = 10.0, *, foxglove: bool = False) -> None:
    """Measure and print rates, latencies and losses.

    Args:
        minutes: Duration of the measurement [min].
        foxglove: True: `pliant foxglove`; False: `pliant ros`.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        command = (
            ("foxglove", "--http-port", str(PORT), "--allow-commands")
            if foxglove
            else ("ros", "--listen", f"tcp/127.0.0.1:{PORT}")
        )
        arm = subprocess.Popen(
            [
                *(sys.executable, "-m", "pliant.cli", command[0], "so101", "--backend", "sim"),
                *(*command[1:], "--log", str(path)),
            ]
        )
        try:
            client = FoxgloveClient() if foxglove else ZenohClient()
            states, targets = _exchange(client, 60.0 * minutes)
        finally:
            arm.send_signal(signal.SIGTERM)
            arm.wait()
        _print_states(states)
        _print_targets(path, targets, states)
        print(f"load of the computer: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


class ZenohClient:
    """Client of `pliant ros`: a session of zenoh-ros2-sdk.

    Attributes:
        received: Number, bytes and time of arrival [s] of each state.
    """

    def __init__(self) -> None:
        import zenoh_ros2_sdk as sdk

        logging.getLogger("zenoh_ros2_sdk").setLevel(logging.ERROR)
        self.received: list[tuple[int, bytes, float]] = []
        self._session = sdk.ZenohSession.get_instance("127.0.0.1", PORT)
        self._states = self._session.session.declare_subscriber(
            wire.key_expression(0, STATE, POSE), self._receive
        )
        self._targets = self._session.session.declare_publisher(
            wire.key_expression(0, TARGET, POSE)
        )

    def _receive(self, sample: Any) -> None:
        number = struct.unpack_from("<q", sample.attachment.to_bytes())[0]
        self.received.append((number, sample.payload.to_bytes(), time.time()))

    def send(self, index: int, now: int, message: dict[str, Any]) -> None:
        """Send a target; `index` is its number, and `now` the time [ns]."""
        attachment = wire.attachment(index, now, bytes(16))
        self._targets.put(wire.encode(POSE, message), attachment=attachment)

    def close(self) -> None:
        """End the session."""
        self._states.undeclare()
        self._session.close()


class FoxgloveClient:
    """Client of `pliant foxglove`, which speaks Foxglove's protocol over a WebSocket.

    Attributes:
        received: For each state: None, because the protocol does not number messages; the bytes;
            and the time of arrival [s].
    """

    def __init__(self) -> None:
        from websockets.sync.client import connect

        self.received: list[tuple[None, bytes, float]] = []
        deadline = time.monotonic() + 60.0
        while True:
            try:
                self._socket = connect(f"ws://127.0.0.1:{PORT}", subprotocols=["foxglove.sdk.v1"])
                break
            except OSError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)
        channel = {"id": 1, "topic": TARGET, "encoding": "json", "schemaName": POSE}
        self._request("advertise", channels=[channel])
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def _receive(self) -> None:
        from websockets.exceptions import ConnectionClosed

        with suppress(ConnectionClosed):
            while True:
                message = self._socket.recv()
                if isinstance(message, bytes):
                    self.received.append((None, message[13:], time.time()))
                    continue
                for channel in json.loads(message).get("channels", ()):
                    if channel["topic"] == STATE:
                        subscription = {"id": 1, "channelId": channel["id"]}
                        self._request("subscribe", subscriptions=[subscription])

    def _request(self, operation: str, **arguments: Any) -> None:
        self._socket.send(json.dumps({"op": operation, **arguments}))

    def send(self, _: int, __: int, message: dict[str, Any]) -> None:
        """Send a target."""
        self._socket.send(struct.pack("<BI", 1, 1) + json.dumps(message).encode())

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
        self._thread.join()


def _exchange(
    client: ZenohClient | FoxgloveClient, seconds: float
) -> tuple[list[Any], list[tuple[float, float]]]:
    """Receive states and send targets.

    Returns:
        Number (None: unknown), time stamp and time of arrival [s] and x [m] of each current pose;
        and time [s] and x [m] of each sent target.
    """
    deadline = time.monotonic() + 60.0
    while not client.received:
        if time.monotonic() > deadline:
            raise TimeoutError("no state of the arm within 60 s")
        time.sleep(0.01)
    first = wire.decode(POSE, client.received[0][1]).pose
    at, rotation = first.position, {axis: getattr(first.orientation, axis) for axis in "xyzw"}
    targets: list[tuple[float, float]] = []
    begun, start = len(client.received), time.monotonic()
    for index in range(round(RATE * seconds)):
        time.sleep(max(start + index / RATE - time.monotonic(), 0.0))
        phase = 2.0 * math.pi * index / (RATE * PERIOD)
        # 1 nm more with each target makes the x of every target unique.
        x = at.x - RADIUS * (1.0 - math.cos(phase)) + 1e-9 * index
        position = {"x": x, "y": at.y + RADIUS * math.sin(phase), "z": at.z}
        now = time.time_ns()
        stamp = {"sec": now // 10**9, "nanosec": now % 10**9}
        message = {
            "header": {"stamp": stamp, "frame_id": "base"},
            "pose": {"position": position, "orientation": rotation},
        }
        client.send(index, now, message)
        targets.append((1e-9 * now, x))
    client.close()
    states = []
    for number, data, arrival in client.received[begun:]:
        message = wire.decode(POSE, data)
        stamp = message.header.stamp
        states.append((number, stamp.sec + 1e-9 * stamp.nanosec, arrival, message.pose.position.x))
    return states, targets


def _print_states(states: list[Any]) -> None:
    numbers, stamps, times, _ = (np.array(column) for column in zip(*states, strict=True))
    is_numbered = numbers[0] is not None
    lost = numbers[-1] - numbers[0] + 1 - len(numbers) if is_numbered else "unknown"
    print(
        f"states: {len(states)} in {times[-1] - times[0]:.1f} s, "
        f"{(len(states) - 1) / (times[-1] - times[0]):.2f} Hz; lost on the way: {lost}; "
        f"largest gap {1e3 * np.diff(stamps).max():.0f} ms"
    )
    print(f"  latency, reading of the joints to client: {_quantiles(times - stamps)}")


def _print_targets(path: Path, targets: list[tuple[float, float]], states: list[Any]) -> None:
    log = pliant.log.read(path)
    # Each state carries the system time of its tick; the same x in the log identifies the tick.
    ticks = {x: tick for tick, x in enumerate(log.model().forward_kinematics_batch(log.q)[:, 0, 3])}
    offsets = [stamp - log.time[ticks[x]] for _, stamp, _, x in states if x in ticks]
    wall = log.time + np.median(offsets)
    x = log.target.reshape(len(log), 16)[:, 3]
    times, xs = (np.array(column) for column in zip(*targets, strict=True))
    # First tick of each target that the loop has used.
    new = np.flatnonzero(np.diff(x, prepend=np.nan) != 0.0)
    indices = [int(np.abs(xs - value).argmin()) for value in x[new]]
    pairs = [
        (index, tick)
        for index, tick in zip(indices, new, strict=True)
        if abs(xs[index] - x[tick]) < 1e-13
    ]
    delay = np.array([wall[tick] - times[index] for index, tick in pairs])
    print(
        f"targets: {len(targets)} sent, {len({index for index, _ in pairs})} used by the loop "
        "(a newer one replaces one that waits)"
    )
    print(f"  latency, client to the tick that uses it: {_quantiles(delay)}")
    print(f"ticks: {len(log)}, {len(log) / (log.time[-1] - log.time[0]):.1f} Hz")


def _quantiles(values: np.ndarray) -> str:
    parts = [f"{1e3 * np.percentile(values, share):.1f}" for share in (50, 99, 100)]
    return f"{' / '.join(parts)} ms (50, 99, 100 %)"


if __name__ == "__main__":
    sys.exit(program(run, "benches/ros.py", __doc__.splitlines()[0]))
