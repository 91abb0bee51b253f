"""Sources of external targets: a file, standard input, UDP datagrams on this machine."""

from __future__ import annotations

import math
import os
import socket
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

from pliant._core import ConfigError
from pliant._files import LARGE, read_text
from pliant.cli._target import Target

if TYPE_CHECKING:
    from pliant._core import Model

#: Longest line and largest datagram [bytes].
LONGEST = 4096
#: Bytes per read of a pipe, and the pause after a read [s].
CHUNK, PAUSE = 65536, 0.001
#: Largest number of datagrams read per tick.
MOST = 256
#: Least time between two messages on refused targets [s].
QUIET = 0.5


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


class Nothing:
    """No targets: the arm holds."""

    done = False

    def latest(self) -> Target | None:
        """Return None."""
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing."""


class Lines(Nothing):
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


class Refusals:
    """Reports invalid targets at a bounded rate, without stopping the loop."""

    def __init__(self) -> None:
        self._next = -math.inf
        self._more = 0

    def parse(self, line: bytes, model: Model) -> Target | None:
        """Parse a line; report an invalid one and return None."""
        try:
            if len(line) > LONGEST:
                raise ConfigError(f"a target is longer than {LONGEST} bytes")
            return Target.parse(line.decode("utf-8", errors="replace"), model)
        except ConfigError as error:
            self._say(error)
            return None

    def _say(self, error: ConfigError) -> None:
        now = time.monotonic()
        if now < self._next:
            self._more += 1
            return
        more = f" ({self._more} more since the last that was said)" if self._more else ""
        print(f"target refused: {error}{more}", file=sys.stderr)
        self._next, self._more = now + QUIET, 0

    def close(self) -> None:
        """Report the number of unreported errors."""
        if self._more:
            print(f"{self._more} more targets were refused", file=sys.stderr)


class Stream(Nothing):
    """Lines of a pipe, such as standard input, read in a thread; only the newest counts.

    An invalid line is reported and skipped.

    Args:
        pipe: File descriptor. It is read without Python's buffer: a waiting thread would hold the
            buffer's lock and block the end of the program.
        model: The arm.
    """

    def __init__(self, pipe: int, model: Model) -> None:
        self._model = model
        self._refusals = Refusals()
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
                rest = rest[: LONGEST + 1]
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
        return self._refusals.parse(self._newest.pop(), self._model) if self._newest else None

    def __exit__(self, *_: object) -> None:
        self._refusals.close()


class Datagrams(Nothing):
    """Datagrams on the loopback interface: other machines cannot control the arm."""

    def __init__(self, port: int, model: Model) -> None:
        self._model = model
        self._refusals = Refusals()
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
            for _ in range(MOST):
                newest = self._socket.recv(LONGEST + 1)
        return self._refusals.parse(newest, self._model) if newest.strip() else None

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._refusals.close()


def open_targets(source: str, model: Model) -> Targets:
    """Open the source named by `--targets`.

    Raises:
        ConfigError: It cannot be read, or is no port.
        FileNotFoundError: The file does not exist.
    """
    if not source:
        return Nothing()
    if source == "-":
        if sys.stdin is None:
            raise ConfigError("--targets - reads standard input, and it is closed")
        return Stream(sys.stdin.fileno(), model)
    if source.startswith("udp:"):
        number = source.removeprefix("udp:")
        if not (number.isdecimal() and 1024 <= int(number) <= 65535):
            raise ConfigError(f"--targets udp:PORT needs a port from 1024 to 65535, got {number!r}")
        return Datagrams(int(number), model)
    return Lines(Path(source), model)
