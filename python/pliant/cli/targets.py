"""Targets from outside: a file, standard input, datagrams on this machine."""

from __future__ import annotations

import json
import queue
import select
import socket
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np

import pliant
from pliant import ConfigError, PliantError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant import Model

    Array = NDArray[np.float64]

KEYS = ("position", "wxyz", "xyzw", "q")
#: Largest datagram [bytes].
DATAGRAM = 4096


@dataclass(frozen=True)
class Target:
    """What one line says.

    Attributes:
        position: (3,) [m], base axes; None: as it is.
        rotation: Quaternion and its order; None: as it is.
        q: Joint positions (n,) [rad] whose tool pose is the target.
    """

    position: tuple[float, ...] | None = None
    rotation: tuple[str, tuple[float, ...]] | None = None
    q: tuple[float, ...] | None = None

    @classmethod
    def parse(cls, line: str, model: Model) -> Target:
        """Read a line for an arm.

        Raises:
            ConfigError: It is no JSON object of the known keys with finite numbers, or no target of
                this arm.
        """
        try:
            data: Any = json.loads(line)
        except json.JSONDecodeError as error:
            raise ConfigError(f"target {_short(line)} is no JSON: {error}") from error
        if not isinstance(data, dict) or not data or set(data) - set(KEYS):
            raise ConfigError(f"a target is an object of {', '.join(KEYS)}; got {_short(line)}")
        numbers = {key: _numbers(key, value) for key, value in data.items()}
        if len({"wxyz", "xyzw"} & set(numbers)) == 2 or ("q" in numbers and len(numbers) > 1):
            raise ConfigError(f"a target is q, or position with one quaternion; got {_short(line)}")
        order = next((key for key in ("wxyz", "xyzw") if key in numbers), None)
        rotation = None if order is None else (order, numbers[order])
        target = cls(numbers.get("position"), rotation, numbers.get("q"))
        try:
            target.pose(model, np.eye(4))
        except PliantError as error:
            raise ConfigError(f"target {_short(line)}: {error}") from error
        return target

    def pose(self, model: Model, before: Array) -> Array:
        """Pose (4, 4); what the line leaves out stays as it was."""
        if self.q is not None:
            return model.forward_kinematics(np.array(self.q))
        pose = before.copy()
        if self.position is not None:
            pose[:3, 3] = self.position
        if self.rotation is not None:
            order, quaternion = self.rotation
            make = pliant.Pose.from_wxyz if order == "wxyz" else pliant.Pose.from_xyzw
            pose[:3, :3] = make(pose[:3, 3], quaternion).rotation
        return pose

    def check_reach(self, model: Model) -> None:
        """See that the arm could get there, stretched.

        Raises:
            ConfigError: It is farther from the first joint than the arm is long.
        """
        if self.position is None:
            return
        away = float(np.linalg.norm(np.array(self.position) - model.reach_from))
        if away > model.reach:
            raise ConfigError(
                f"position {list(self.position)} is {away:.3g} m from {model.joint_names[0]}, and "
                f"the arm reaches {model.reach:.3g} m: is it in millimetres, or in other axes than "
                f"those of {model.base}?"
            )


class Targets(Protocol):
    """Where targets come from.

    Attributes:
        done: Whether there will be no more, and the program may end.
    """

    done: bool

    def latest(self) -> Target | None:
        """The newest target since the last call, None without news."""

    def __enter__(self) -> Self:
        """Open."""

    def __exit__(self, *_: object) -> None:
        """Close."""


class Nothing:
    """No targets: the arm holds."""

    done = False

    def latest(self) -> Target | None:
        """Nothing."""
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to close."""


class Lines(Nothing):
    """A file, one line a tick; the whole file is checked before anything moves."""

    def __init__(self, path: Path, model: Model) -> None:
        try:
            text = path.read_text(encoding="utf-8").splitlines()
        except FileNotFoundError:
            raise  # the command line says which files there are
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path} cannot be read: {error}") from error
        self._targets = []
        for number, line in enumerate(text, 1):
            if line.strip():
                try:
                    target = Target.parse(line, model)
                    target.check_reach(model)
                    self._targets.append(target)
                except ConfigError as error:
                    raise ConfigError(f"{path}, line {number}: {error}") from error
        if not self._targets:
            raise ConfigError(f"{path} has no target")
        self._next = 0

    def latest(self) -> Target | None:
        """The next line."""
        if self._next == len(self._targets):
            self.done = True
            return None
        self._next += 1
        return self._targets[self._next - 1]


class Stream(Nothing):
    """Standard input, read by a thread; a line that is wrong is said and skipped."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True, name="pliant-targets").start()

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)
        self._lines.put(None)

    def latest(self) -> Target | None:
        """The newest good line."""
        found = None
        while not self._lines.empty():
            line = self._lines.get()
            if line is None:
                self.done = True
            elif line.strip():
                found = _lenient(line, self._model) or found
        return found


class Datagrams(Nothing):
    """Datagrams on the loopback: nobody outside this machine can steer the arm."""

    def __init__(self, port: int, model: Model) -> None:
        self._model = model
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"cannot listen on UDP port {port}: {error}") from error

    def latest(self) -> Target | None:
        """The newest good datagram."""
        found = None
        while select.select([self._socket], [], [], 0.0)[0]:
            data = self._socket.recv(DATAGRAM)
            found = _lenient(data.decode("utf-8", errors="replace"), self._model) or found
        return found

    def __exit__(self, *_: object) -> None:
        self._socket.close()


def open_targets(source: str, model: Model) -> Targets:
    """Open what `--targets` names, for an arm.

    Raises:
        ConfigError: It cannot be read, or is no port.
        FileNotFoundError: There is no such file.
    """
    if not source:
        return Nothing()
    if source == "-":
        return Stream(model)
    if source.startswith("udp:"):
        number = source.removeprefix("udp:")
        if not (number.isdecimal() and 1024 <= int(number) <= 65535):
            raise ConfigError(f"--targets udp:PORT needs a port from 1024 to 65535, got {number!r}")
        return Datagrams(int(number), model)
    return Lines(Path(source), model)


def _lenient(line: str, model: Model) -> Target | None:
    """A line that came while the arm moves: what is wrong with it must not stop the loop."""
    try:
        return Target.parse(line, model)
    except PliantError as error:
        print(f"target refused: {error}", file=sys.stderr)
        return None


def _numbers(key: str, value: object) -> tuple[float, ...]:
    size = {"position": 3, "wxyz": 4, "xyzw": 4}.get(key)
    good = isinstance(value, list) and all(type(v) in (int, float) for v in value)
    if not (good and isinstance(value, list) and (size is None or len(value) == size)):
        raise ConfigError(f"{key} is a list of {size or 'n'} numbers, got {value!r}")
    if not np.isfinite(value).all():
        raise ConfigError(f"{key} is not finite: {value}")
    return tuple(float(v) for v in value)


def _short(text: str) -> str:
    text = text.strip()
    return repr(text if len(text) < 60 else f"{text[:57]}...")
