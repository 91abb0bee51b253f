"""External targets: parsing, checks, and sources: a file, standard input, or UDP datagrams."""

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
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np

from pliant._core import ConfigError, PliantError, Pose
from pliant._files import LARGE, read_text

if TYPE_CHECKING:
    from pliant._core import Model
    from pliant._typing import Array


KEYS = ("position", "wxyz", "xyzw", "q")


@dataclass(frozen=True)
class Target:
    """A parsed target.

    Attributes:
        position: (3,) [m], base axes; None: unchanged.
        rotation: Quaternion and its order; None: unchanged.
        q: Joint positions (n,) [rad] whose tool pose is the target.
    """

    position: tuple[float, ...] | None = None
    rotation: tuple[str, tuple[float, ...]] | None = None
    q: tuple[float, ...] | None = None

    @classmethod
    def parse(cls, line: str, model: Model) -> Target:
        """Parse a line for an arm.

        Raises:
            ConfigError: The line is no JSON object of the known keys with finite numbers, or its
                target is far out of the arm's reach or limits.
        """
        try:
            data: Any = json.loads(line)
        except RecursionError:
            raise ConfigError(f"target {_short(line)} is nested too deeply") from None
        except ValueError as error:  # also an integer of more digits than Python reads
            raise ConfigError(f"target {_short(line)} is no JSON: {error}") from error
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
        """Check that the arm can plausibly reach the target.

        Raises:
            OutOfRangeError: The position is far out of reach, or a joint far beyond its limits.
            ShapeError, ConfigError: It is no pose, or has other joints.
        """
        if self.q is not None:
            model.check_joint_target(np.array(self.q))
        pose = self.pose(model, np.eye(4))
        if self.position is not None:
            model.check_target(pose)

    def pose(self, model: Model, before: Array) -> Array:
        """Return the pose (4, 4); missing parts are taken from `before`."""
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


#: Longest line and largest datagram [bytes].
MAX_LINE = 4096
#: Bytes per read of a pipe, and the pause after a read [s].
CHUNK, PAUSE = 65536, 0.001
#: Largest number of datagrams read per tick.
MAX_DATAGRAMS = 256
#: Least time between two messages on refused targets [s].
REPORT_PERIOD = 0.5


class Targets(Protocol):
    """A source of targets.

    Attributes:
        done: True if there will be no more targets, so that the program may end.
    """

    done: bool

    def latest(self) -> Target | None:
        """Return the newest target since the last call, None if there is none."""

    def __enter__(self) -> Self:
        """Open."""

    def __exit__(self, *_: object) -> None:
        """Close."""


class NoTargets:
    """No targets: the arm holds."""

    done = False

    def latest(self) -> Target | None:
        """Return None."""
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing."""


class FileTargets(NoTargets):
    """A file with one line per tick; the whole file is checked before the arm moves."""

    def __init__(self, path: Path, model: Model) -> None:
        try:
            text = read_text(path, LARGE).splitlines()
        except FileNotFoundError:
            raise  # the command line lists the existing files
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path} cannot be read: {error}") from error
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
        """Return the target of the next line."""
        if self._next == len(self._targets):
            self.done = True
            return None
        self._next += 1
        return self._targets[self._next - 1]


class RejectedTargets:
    """Reports invalid targets at a bounded rate, without stopping the loop."""

    def __init__(self) -> None:
        self._next = -math.inf
        self._unreported = 0

    def parse(self, line: bytes, model: Model) -> Target | None:
        """Parse a line; report an invalid one and return None."""
        try:
            if len(line) > MAX_LINE:
                raise ConfigError(f"a target is longer than {MAX_LINE} bytes")
            return Target.parse(line.decode("utf-8", errors="replace"), model)
        except ConfigError as error:
            self._report(error)
            return None

    def _report(self, error: ConfigError) -> None:
        now = time.monotonic()
        if now < self._next:
            self._unreported += 1
            return
        more = (
            f" ({self._unreported} more since the last that was said)" if self._unreported else ""
        )
        print(f"target refused: {error}{more}", file=sys.stderr)
        self._next, self._unreported = now + REPORT_PERIOD, 0

    def close(self) -> None:
        """Report the number of unreported errors."""
        if self._unreported:
            print(f"{self._unreported} more targets were refused", file=sys.stderr)


class StreamTargets(NoTargets):
    """Lines of a pipe, such as standard input, read in a thread; only the newest counts.

    An invalid line is reported and skipped.

    Args:
        pipe: File descriptor. It is read without Python's buffer: a waiting thread would hold the
            buffer's lock and block the end of the program.
        model: The arm.
    """

    def __init__(self, pipe: int, model: Model) -> None:
        self._model = model
        self._rejected = RejectedTargets()
        self._newest: deque[bytes] = deque(maxlen=1)
        self._ended = False
        threading.Thread(
            target=self._read, args=(pipe,), daemon=True, name="pliant-targets"
        ).start()

    def _read(self, pipe: int) -> None:
        rest = b""
        try:
            while data := os.read(pipe, CHUNK):
                *lines, rest = (rest + data).split(b"\n")
                # Keep just enough of an unfinished line to detect that it is too long.
                rest = rest[: MAX_LINE + 1]
                self._newest.extend(line for line in lines if line.strip())
                # A fast sender must not take the loop's CPU time.
                time.sleep(PAUSE)
            if rest.strip():
                self._newest.append(rest)
        except OSError as error:
            print(f"targets ended: standard input: {error}", file=sys.stderr)
        finally:
            self._ended = True

    def latest(self) -> Target | None:
        """Return the newest target if it is valid."""
        self.done = self._ended  # read first, so that all lines before the end are in the queue
        return self._rejected.parse(self._newest.pop(), self._model) if self._newest else None

    def __exit__(self, *_: object) -> None:
        self._rejected.close()


class UdpTargets(NoTargets):
    """Datagrams on the loopback interface: other machines cannot control the arm."""

    def __init__(self, port: int, model: Model) -> None:
        self._model = model
        self._rejected = RejectedTargets()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"cannot listen on UDP port {port}: {error}") from error

    def latest(self) -> Target | None:
        """Return the newest target if it is valid."""
        newest = b""
        with suppress(BlockingIOError):
            for _ in range(MAX_DATAGRAMS):
                newest = self._socket.recv(MAX_LINE + 1)
        return self._rejected.parse(newest, self._model) if newest.strip() else None

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._rejected.close()


def open_targets(source: str, model: Model) -> Targets:
    """Open the source named by `--targets`.

    Raises:
        ConfigError: It cannot be read, or is no port.
        FileNotFoundError: The file does not exist.
    """
    if not source:
        return NoTargets()
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
