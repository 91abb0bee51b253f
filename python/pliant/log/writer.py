"""Writer process of a log: ``python -m pliant.log.writer FILE``, with frames on standard input.

The process writes chunks of about half a second. It completes the file when the input ends, so a
crash of the program that runs the loop leaves a valid file.
"""

from __future__ import annotations

import itertools
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap_ros2.writer import Writer

from pliant._files import replacing
from pliant._processes import lower_priority
from pliant._ros_messages import (
    DEFINITIONS,
    JOINT_STATE,
    POSE_STAMPED,
    STRING,
    TF_MESSAGE,
    joint_state,
    pose_stamped,
    tf_message,
)
from pliant.log import frames, layout, serialization
from pliant.log.journal import STEP

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import BinaryIO

    from pliant._typing import Array


#: Time span of the ticks in one chunk of the MCAP file [s].
CHUNK_TIME = 0.5
#: Number of messages per tick, for the estimate of the chunk size.
MESSAGES = 8
#: Size of a message without its numbers [bytes], for the chunk size.
OVERHEAD = 150
#: Standard ROS 2 messages of a log.
STANDARD = (JOINT_STATE, POSE_STAMPED, TF_MESSAGE, STRING)


class LogFile:
    """An MCAP file that is being written, in the layout that module `layout` defines.

    Attributes:
        run: Description of the run: joints, axes, rate, model, settings, servos, ...
    """

    def __init__(self, stream: BinaryIO, run: dict[str, Any]) -> None:
        """Write the message definitions and the attachments of a run."""
        self.run = run
        self._model = serialization.model(run["model"])
        n, axes = len(run["joints"]), run["axes"]
        self._tick = layout.tick(n, None if axes is None else len(axes), len(run["extra"]))
        self._step = layout.step(n)
        size = 16 * (self._tick.size + self._step.size) + MESSAGES * (OVERHEAD + 12 * n)
        self._writer = Writer(stream, chunk_size=round(CHUNK_TIME * run["rate"] * size / 2))
        self._count = itertools.count()
        self._begin = round(run["wall"] * 1e9)
        self._now = self._begin
        self._schemas = {
            name: self._writer.register_msgdef(name, text)
            for name, text in (
                *((name, DEFINITIONS[name]) for name in STANDARD),
                ("pliant_msgs/msg/Tick", layout.tick_message(self._tick)),
                ("pliant_msgs/msg/Call", layout.CALL),
            )
        }
        self._attach(run)

    def _attach(self, run: dict[str, Any]) -> None:
        """Write attachments: description of the run, URDF, settings and configuration."""
        texts = {
            layout.RUN: ("application/json", serialization.write(run)),
            layout.URDF: ("application/xml", run["model"]["urdf"]),
            layout.SETTINGS: ("text/plain", f"{run['settings']!r}\n{run['servos']!r}\n"),
            layout.CONFIG: ("application/json", run["config"]),
        }
        for name, (kind, text) in texts.items():
            if text is not None:
                self._writer.add_attachment(self._begin, self._begin, name, kind, text.encode())
        self._write_message("/robot_description", STRING, {"data": run["model"]["urdf"]})

    def tick(self, body: bytes) -> None:
        """Write a tick: a message with all numbers, and standard ROS messages for viewers.

        `body` is the body of the frame of the tick.
        """
        pieces = self._tick.split(np.frombuffer(body))
        elapsed = float(pieces["time"][0]) - self.run["clock"]
        self._now = self._begin + round(elapsed * 1e9)
        names = [name for name, _ in self._tick.pieces]
        self._write_message("/pliant/tick", "pliant_msgs/msg/Tick", layout.numbers(pieces, names))
        joints = [*self.run["joints"], *self.run["extra"]]
        positions = np.concatenate((pieces["q"], pieces["extra"]))
        self._joints("/joint_states", joints, positions, pieces["dq"], pieces["load"])
        goal, torque, speed = (pieces[name] for name in layout.COMMAND)
        self._joints("/command/joint_states", self.run["joints"], goal, speed, torque)
        actual = self._model.forward_kinematics(pieces["q"])
        poses = {"actual": actual}
        if self.run["axes"] is not None:
            task = [pieces[name] for name in ("deviation", "task_velocity", "axis_strength")]
            self._joints("/task/joint_states", self.run["axes"], *task)
            poses["target"] = pieces["target"].reshape(4, 4)
            poses["intermediate"] = pieces["reference"].reshape(4, 4)
        base, tip = self._model.base, self._model.tip
        for name, pose in poses.items():
            self._write_message(f"/tcp/{name}", POSE_STAMPED, pose_stamped(self._now, base, pose))
        self._write_message("/tf", TF_MESSAGE, tf_message(self._now, [(base, tip, actual)]))

    def step(self, body: bytes) -> None:
        """Write a message with a call of `step` or `step_joints`, from the body of its frame."""
        sequence, joints = STEP.unpack_from(body)
        pieces = self._step.split(np.frombuffer(body, offset=STEP.size))
        message = {"sequence": sequence, "what": "step_joints" if joints else "step"}
        self._call({**message, "arguments": "", **layout.numbers(pieces, pieces)})

    def call(self, body: bytes) -> None:
        """Write a message with a call of the controller that is not a step.

        `body` is the body of the frame that the recorder sent.
        """
        record = serialization.read(body.decode())
        empty: dict[str, Any] = {name: [] for name, _ in self._step.pieces}
        arguments = serialization.write(record.pop("arguments"))
        self._call({**empty, **record, "dt": np.nan, "arguments": arguments})

    def end(self, body: bytes) -> None:
        """Write the counters at the end of the run, `body`, as an attachment."""
        self._writer.add_attachment(self._now, self._now, layout.END, "application/json", body)

    def finish(self) -> None:
        """Write the index and the end of the MCAP file."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _call(self, message: dict[str, Any]) -> None:
        self._write_message("/pliant/call", "pliant_msgs/msg/Call", message)

    def _joints(self, topic: str, names: Sequence[str], *values: Array) -> None:
        self._write_message(topic, JOINT_STATE, joint_state(self._now, names, *values))

    def _write_message(self, topic: str, kind: str, message: dict[str, Any]) -> None:
        self._writer.write_message(
            topic, self._schemas[kind], message, self._now, sequence=next(self._count)
        )


def main() -> None:
    """Write the frames from standard input to the log `sys.argv[1]`, until the input ends."""
    lower_priority()
    path, source = Path(sys.argv[1]), sys.stdin.buffer
    try:
        write(path, source)
    except OSError as error:
        # Say so now: the program learns it from the exit code at the end of its run.
        sys.exit(f"pliant: {path}: {error.strerror or error}; the log ends here")


def write(path: Path, source: BinaryIO) -> None:
    """Write the frames from `source` to the log `path`, until they end.

    Raises:
        OSError: The disk rejects the file. What was written before can be read as a log.
    """
    first = frames.receive(source)
    if first is None:
        return
    with ExitStack() as stack:
        with replacing(path) as temporary:
            stream = stack.enter_context(temporary.open("wb"))
            log = LogFile(stream, serialization.read(first[1].decode()))
            stream.flush()
        # From here on, the file has its final name: after a crash, it can be read as a log.
        handlers = {
            frames.TICK: log.tick,
            frames.STEP: log.step,
            frames.CALL: log.call,
            frames.END: log.end,
        }
        while (frame := frames.receive(source)) is not None:
            kind, body = frame
            handlers[kind](body)
            stream.flush()
        log.finish()


if __name__ == "__main__":
    main()
