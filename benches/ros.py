"""Rates, latencies and losses of `pliant ros` on this computer, with a simulated arm in real time.

    python benches/ros.py --minutes 10

A client sends a target at 50 Hz, a slow circle of the tool, over a zenoh session of zenoh-ros2-sdk,
and receives the state. The log of the arm says which targets the control loop has used, and when.
"""

from __future__ import annotations

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


def run(minutes: float = 10.0) -> None:
    """Measure and print rates, latencies and losses.

    Args:
        minutes: Duration of the measurement [min].
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        arm = subprocess.Popen(
            [
                *(sys.executable, "-m", "pliant.cli", "ros", "so101", "--backend", "sim"),
                *("--listen", f"tcp/127.0.0.1:{PORT}", "--log", str(path)),
            ]
        )
        try:
            states, targets = _exchange(60.0 * minutes)
        finally:
            arm.send_signal(signal.SIGTERM)
            arm.wait()
        _print_states(states)
        _print_targets(path, targets, states)
        print(f"load of the computer: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def _exchange(seconds: float) -> tuple[list[Any], list[tuple[float, float]]]:
    """Receive states and send targets.

    Returns:
        Number in the attachment, time stamp and time of arrival [s] and x [m] of each current pose;
        and time [s] and x [m] of each sent target.
    """
    import zenoh_ros2_sdk as sdk

    logging.getLogger("zenoh_ros2_sdk").setLevel(logging.ERROR)
    session = sdk.ZenohSession.get_instance("127.0.0.1", PORT)
    states: list[Any] = []
    kind = "geometry_msgs/msg/PoseStamped"

    def receive(sample: Any) -> None:
        now = time.time()
        message = wire.decode(kind, sample.payload.to_bytes())
        stamp, position = message.header.stamp, message.pose.position
        number = struct.unpack_from("<q", sample.attachment.to_bytes())[0]
        states.append((number, stamp.sec + 1e-9 * stamp.nanosec, now, position.x))

    pose_key = wire.key_expression(0, "/pliant/current_pose", kind)
    first: list[Any] = []
    has_begun = threading.Event()

    def begin(sample: Any) -> None:
        first.append(wire.decode(kind, sample.payload.to_bytes()).pose)
        has_begun.set()

    waiting = session.session.declare_subscriber(pose_key, begin)
    if not has_begun.wait(60.0):
        raise TimeoutError("no state of the arm within 60 s")
    waiting.undeclare()
    at = first[0].position
    subscription = session.session.declare_subscriber(pose_key, receive)
    target_key = wire.key_expression(0, "/pliant/target_pose", kind)
    publisher = session.session.declare_publisher(target_key)
    rotation = {axis: getattr(first[0].orientation, axis) for axis in "xyzw"}
    targets: list[tuple[float, float]] = []
    start = time.monotonic()
    for index in range(round(RATE * seconds)):
        time.sleep(max(start + index / RATE - time.monotonic(), 0.0))
        phase = 2.0 * math.pi * index / (RATE * PERIOD)
        # A part of 1 nm per target makes each one unique.
        x = at.x - RADIUS * (1.0 - math.cos(phase)) + 1e-9 * index
        position = {"x": x, "y": at.y + RADIUS * math.sin(phase), "z": at.z}
        now = time.time_ns()
        stamp = {"sec": now // 10**9, "nanosec": now % 10**9}
        message = {
            "header": {"stamp": stamp, "frame_id": "base"},
            "pose": {"position": position, "orientation": rotation},
        }
        publisher.put(wire.encode(kind, message), attachment=wire.attachment(index, now, bytes(16)))
        targets.append((1e-9 * now, x))
    subscription.undeclare()
    session.close()
    return states, targets


def _print_states(states: list[Any]) -> None:
    numbers, stamps, times, _ = (np.array(column) for column in zip(*states, strict=True))
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    print(
        f"states: {len(states)} in {times[-1] - times[0]:.1f} s, "
        f"{(len(states) - 1) / (times[-1] - times[0]):.2f} Hz; lost on the way {missing:.0f}; "
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
