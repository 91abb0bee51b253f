"""Target poses for `pliant run`: parser, checks, and readers of files, standard input and UDP."""

from __future__ import annotations

import json
import math
import os
import socket
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from pliant._core import ConfigError, PliantError, Pose
from pliant._files import LARGE, read_text
from pliant._refusals import Refusals

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pliant._core import Model
    from pliant._typing import Array


#: Keys allowed in the JSON object of a target.
KEYS = ("position", "wxyz", "xyzw", "q")


@dataclass(frozen=True)
class Target:
    """A parsed target of the tool.

    Attributes:
        position: Position of the tool (3,) [m], base axes; None keeps the last target position.
        rotation: Order of the components (`wxyz` or `xyzw`) and quaternion of the tool (4,); None
            keeps the last target orientation.
        q: Joint positions (n,) [rad] whose tool pose is the target; None: the target is given by
            `position` and `rotation`.
    """

    position: tuple[float, ...] | None = None
    rotation: tuple[str, tuple[float, ...]] | None = None
    q: tuple[float, ...] | None = None

    @classmethod
    def parse(cls, line: str, model: Model) -> Target:
        """Parse a line of JSON, and check its target for an arm.

        Raises:
            ConfigError: The line is not a JSON object of `KEYS` with finite numbers, or the method
                `check` rejects the target.
        """
        try:
            data: Any = json.loads(line)
        except RecursionError:
            raise ConfigError(f"target {_short(line)} is nested too deeply") from None
        except ValueError as error:  # also an integer of more digits than Python reads
            raise ConfigError(f"target {_short(line)} is not JSON: {error}") from error
        if not isinstance(data, dict) or not data or set(data) - set(KEYS):
            raise ConfigError(f"a target is an object of {', '.join(KEYS)}; got {_short(line)}")
        numbers = {key: _numbers(key, value, line) for key, value in data.items()}
        if len({"wxyz", "xyzw"} & set(numbers)) == 2 or ("q" in numbers and len(numbers) > 1):
            raise ConfigError(f"a target is q, or position with one quaternion; got {_short(line)}")
        order = next((key for key in ("wxyz", "xyzw") if key in numbers), None)
        rotation = None if order is None else (order, numbers[order])
        target = cls(numbers.get("position"), rotation, numbers.get("q"))
        try:
            target.check(model)
        except PliantError as error:
            raise ConfigError(f"target {_short(line)}: {error}") from error
        return target

    def check(self, model: Model) -> None:
        """Check that the target is plausible for an arm.

        Raises:
            OutOfRangeError: The position is far out of reach, or a joint far beyond its limits.
            ShapeError, ConfigError: The number of joints is wrong, or the quaternion is invalid.
        """
        if self.q is not None:
            model.check_joint_target(np.array(self.q))
        pose = self.pose(model, np.eye(4))
        if self.position is not None:
            model.check_target(pose)

    def pose(self, model: Model, before: Array) -> Array:
        """Return the target pose (4, 4); parts without a target come from the pose `before`."""
        if self.q is not None:
            return model.forward_kinematics(np.array(self.q))
        pose = before.copy()
        if self.position is not None:
            pose[:3, 3] = self.position
        if self.rotation is not None:
            order, quaternion = self.rotation
            make = Pose.from_wxyz if order == "wxyz" else Pose.from_xyzw
            pose[:3, :3] = make(pose[:3, 3], quaternion).rotation
        return pose


def _numbers(key: str, value: object, line: str) -> tuple[float, ...]:
    size = {"position": 3, "wxyz": 4, "xyzw": 4}.get(key)
    if not (
        isinstance(value, list)
        and all(type(v) in (int, float) for v in value)
        and (size is None or len(value) == size)
    ):
        raise ConfigError(f"{key} is a list of {size or 'n'} numbers, got {_short(line)}")
    try:
        numbers = tuple(map(float, value))
    except OverflowError:
        raise ConfigError(f"{key} is larger than any number: {_short(line)}") from None
    if not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{key} is not finite: {_short(line)}")
    return numbers


def _short(text: str) -> str:
    text = text.strip()
    return repr(text if len(text) < 60 else f"{text[:57]}...")


#: Maximum size of one target, a line or a datagram [bytes].
MAX_LINE = 4096
#: Maximum number of bytes per read of a pipe.
READ_SIZE = 65536
#: Pause after each read of a pipe [s].
READ_PAUSE = 0.001
#: Number of lines above which a message says that the file is being checked, which takes seconds.
MANY_TARGETS = 50_000
#: Maximum number of datagrams read per control cycle.
MAX_DATAGRAMS = 256
#: Maximum number of lines or datagrams checked per control cycle, namely the newest; a check takes
#: up to 0.3 ms, usually 0.02 ms.
MAX_CHECKED = 32


class Targets:
    """Source of targets; this base class has none, so that the arm holds its first pose.

    Attributes:
        done: True once the source has ended.
    """

    done = False

    def latest(self) -> Target | None:
        """Return the newest valid target since the last call; None if there is none."""
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file, pipe or socket of the targets."""


class FileTargets(Targets):
    """Targets in a file: one line per control cycle. The constructor checks the whole file."""

    def __init__(self, path: Path, model: Model) -> None:
        try:
            text = read_text(path, LARGE).splitlines()
        except FileNotFoundError:
            raise  # the command line lists the existing files
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path} cannot be read: {error}") from error
        if len(text) > MANY_TARGETS:
            print(f"checking the {len(text)} lines of {path} …", file=sys.stderr, flush=True)
        self._targets = []
        for number, line in enumerate(text, 1):
            if line.strip():
                try:
                    self._targets.append(Target.parse(line, model))
                except ConfigError as error:
                    raise ConfigError(f"{path}, line {number}: {error}") from error
        if not self._targets:
            raise ConfigError(f"{path} has no target")
        self._next = 0

    def latest(self) -> Target | None:
        """Return the target of the next line of the file; None after the last line."""
        if self._next == len(self._targets):
            self.done = True
            return None
        self._next += 1
        return self._targets[self._next - 1]


class ReceivedTargets(Targets):
    """Base class of sources that receive targets; errors are printed at a limited rate."""

    def __init__(self, model: Model) -> None:
        self._model, self._refusals = model, Refusals("target")

    def _parse(self, line: bytes) -> Target | None:
        """Return the target in a line; if the line is invalid, print the error and return None."""
        try:
            if len(line) > MAX_LINE:
                raise ConfigError(f"a target is longer than {MAX_LINE} bytes")
            return Target.parse(line.decode("utf-8", errors="replace"), self._model)
        except ConfigError as error:
            self._refusals.report(error)
            return None

    def _newest_valid(self, lines: Iterable[bytes]) -> Target | None:
        """Return the newest valid target of `lines`, oldest first; None if there is none.

        All lines are parsed, so that also invalid ones before a valid one are reported.
        """
        targets = [self._parse(line) for line in lines]
        return next((target for target in reversed(targets) if target is not None), None)

    def __exit__(self, *_: object) -> None:
        """Print the number of invalid targets whose errors the rate limit has suppressed."""
        self._refusals.close()


class StreamTargets(ReceivedTargets):
    """Targets read from a pipe, such as standard input; a thread keeps the newest lines.

    Args:
        pipe: File descriptor. It is read without Python's buffered reader, whose lock would be held
            while the thread waits and would block the end of the program.
        model: The arm.
    """

    def __init__(self, pipe: int, model: Model) -> None:
        super().__init__(model)
        self._newest: deque[bytes] = deque(maxlen=MAX_CHECKED)
        self._ended = False
        threading.Thread(
            target=self._read, args=(pipe,), daemon=True, name="pliant-targets"
        ).start()

    def _read(self, pipe: int) -> None:
        rest = b""
        try:
            while data := os.read(pipe, READ_SIZE):
                *lines, rest = (rest + data).split(b"\n")
                # Bound the memory of an unfinished line; one extra byte marks it as too long.
                rest = rest[: MAX_LINE + 1]
                self._newest.extend(line for line in lines if line.strip())
                # Without a pause, a fast sender would take the CPU time of the control loop.
                time.sleep(READ_PAUSE)
            if rest.strip():
                self._newest.append(rest)
        except OSError as error:
            print(f"targets ended: standard input: {error}", file=sys.stderr)
        finally:
            self._ended = True

    def latest(self) -> Target | None:
        """Return the newest valid target; None if there is no new one."""
        self.done = self._ended  # read before the queue, so that the last line is not lost
        # The thread appends meanwhile: a count taken once bounds the lines of this cycle.
        lines = [self._newest.popleft() for _ in range(len(self._newest))]
        return self._newest_valid(lines)


class UdpTargets(ReceivedTargets):
    """Targets received in UDP datagrams; listens on 127.0.0.1 only."""

    def __init__(self, port: int, model: Model) -> None:
        super().__init__(model)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"cannot listen on UDP port {port}: {error}") from error

    def latest(self) -> Target | None:
        """Return the newest valid target; None if there is no new one."""
        newest: deque[bytes] = deque(maxlen=MAX_CHECKED)
        with suppress(BlockingIOError):
            for _ in range(MAX_DATAGRAMS):
                if (datagram := self._socket.recv(MAX_LINE + 1)).strip():
                    newest.append(datagram)
        return self._newest_valid(newest)

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        super().__exit__()


def open_targets(source: str, model: Model) -> Targets:
    """Return the source of targets that `--targets` names.

    Args:
        source: Path of a file, "-" for standard input, "udp:PORT", or "" for no targets.
        model: The arm.

    Raises:
        ConfigError: The source cannot be read, or the port is invalid.
        FileNotFoundError: The file does not exist.
    """
    if not source:
        return Targets()
    if source == "-":
        if sys.stdin is None:
            raise ConfigError("--targets - reads standard input, and it is closed")
        return StreamTargets(sys.stdin.fileno(), model)
    if source.startswith("udp:"):
        number = source.removeprefix("udp:")
        if not (number.isdecimal() and 1024 <= int(number) <= 65535):
            raise ConfigError(f"--targets udp:PORT needs a port from 1024 to 65535, got {number!r}")
        return UdpTargets(int(number), model)
    return FileTargets(Path(source), model)
