"""The thread between pseudo-terminals and the emulated lines."""

from __future__ import annotations

import math
import os
import select
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from pliant._core import ServoError
from pliant.emulator.pty import Pty

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pliant.emulator.serial_line import SerialLine
    from pliant.emulator.simulation import Simulation

Clock = Literal["real", "steps"]

#: Period of the physics while there are no requests, in real time [s].
TICK = 0.005
#: Largest lag of the physics; a longer one is dropped [s].
LARGEST_LAG = 0.1
#: Bytes of a noisy line to the host per tick, without a header.
NOISE = b"\x55\x12\xfd"
#: A pause after which servos forget an unfinished request [s].
GAP = 0.020
#: Timeout of `sync` [s].
SYNC_TIME = 10.0


@dataclass
class Port:
    """A port with its line and pseudo-terminal."""

    line: SerialLine
    pty: Pty
    marker: bytes = b""
    waiting: threading.Event = field(default_factory=threading.Event)
    held: bytes = b""
    last: float = -math.inf
    busy: float = -math.inf
    due: list[tuple[float, bytes]] = field(default_factory=list)
    stale: list[bytes] = field(default_factory=list)


class Server:
    """Serves lines on pseudo-terminals from a thread of its own.

    Attributes:
        lock: Held while lines, servos or physics run.
        lag: Time dropped because the computer was too slow [s].
        late: Largest latency of a reply due to a busy computer, under the real clock [s].
    """

    def __init__(self, world: Simulation, lines: Mapping[str, SerialLine], clock: Clock) -> None:
        """Store the lines to serve."""
        self._world, self._lines, self._clock = world, dict(lines), clock
        self._ports: dict[str, Port] = {}
        self._thread: threading.Thread | None = None
        self._failed: BaseException | None = None
        self._errand: Callable[[], None] | None = None
        self._done = threading.Event()
        self.lock, self.lag, self.late = threading.RLock(), 0.0, 0.0
        self._marking = threading.Lock()

    def start(self) -> None:
        """Open the ports and start to answer.

        Raises:
            ServoError: It runs already, or the system has no pseudo-terminals.
        """
        if self._thread is not None:
            raise ServoError("the emulator runs already")
        self._ports = {name: Port(line, Pty(name)) for name, line in self._lines.items()}
        self._wake_r, self._wake_w = os.pipe()
        self._stopping = False
        self._began = time.perf_counter() - self._world.time
        self._thread = threading.Thread(target=self._guarded, name="pliant-emulator", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close the ports.

        Raises:
            ServoError: The thread had died; the cause is attached.
        """
        if self._thread is None:
            return
        self._stopping = True
        self.wake()
        self._thread.join()
        self._thread = None
        for port in self._ports.values():
            port.pty.close()
        os.close(self._wake_r)
        os.close(self._wake_w)
        if self._failed is not None:
            raise ServoError(f"the emulator died: {self._failed}") from self._failed

    def paths(self) -> dict[str, str]:
        """Return the paths of all ports by name.

        Raises:
            ServoError: It is not running.
        """
        if self._thread is None:
            raise ServoError("the emulator is not running: use `with Emulator(...) as bus:`")
        return {name: port.pty.path for name, port in self._ports.items()}

    def sync(self) -> None:
        """Wait until everything the host has written so far has been acted on.

        Raises:
            ServoError: The thread does not answer.
        """
        # One at a time: a second mark on the same port would hide the first.
        with self._marking:
            for port in list(self._ports.values()):
                with self.lock:
                    if self._thread is None or port.pty.master is None:
                        continue
                    port.marker = b"\x00sync" + os.urandom(11)
                    port.waiting.clear()
                    port.pty.mark(port.marker)
                if not port.waiting.wait(SYNC_TIME):
                    raise ServoError(f"the emulator does not answer: {self._failed or 'too slow'}")

    def hang_up(self, name: str | None) -> None:
        """Pull the adapter of one port, or of all; on return, hosts have noticed."""
        self.sync()

        def pull() -> None:
            for key, port in self._ports.items():
                if name in {None, key}:
                    port.pty.hang_up()
                    port.due.clear()
                    port.stale.clear()

        self._do(pull)

    def put_back(self, name: str | None) -> None:
        """Open pulled ports again, under the same path."""

        def put() -> None:
            for key, port in self._ports.items():
                if name in {None, key} and port.pty.master is None:
                    port.line.reset()
                    port.pty.open()

        self._do(put)

    def _do(self, errand: Callable[[], None]) -> None:
        """Run a function in the thread: a port cannot be closed while the thread waits on it.

        Raises:
            ServoError: The thread does not answer.
        """
        self._done.clear()
        self._errand = errand
        self.wake()
        if self._thread is not None and not self._done.wait(SYNC_TIME):
            raise ServoError(f"the emulator does not answer: {self._failed or 'too slow'}")

    def wake(self) -> None:
        """Wake the thread."""
        with suppress(OSError, AttributeError):
            os.write(self._wake_w, b"!")

    def _guarded(self) -> None:
        try:
            self._run()
        except BaseException as error:
            self._failed = error
            for port in self._ports.values():
                port.pty.hang_up()

    def _run(self) -> None:
        while not self._stopping:
            looked = time.perf_counter()
            with self.lock:
                masters = {
                    port.pty.master: port
                    for port in self._ports.values()
                    if port.pty.master is not None
                }
                pause = self._pause()
            ready, _, _ = select.select([self._wake_r, *masters], [], [], pause)
            if self._wake_r in ready:
                os.read(self._wake_r, 4096)
            with self.lock:
                self._follow()
                if self._errand is not None:
                    self._errand()
                    self._errand = None
                    self._done.set()
                for end in ready:
                    if end in masters and masters[end].pty.master == end:
                        self._note(looked, pause)
                        self._serve(masters[end])
                for port in self._ports.values():
                    self._flush(port)
                    if port.line.noisy:
                        port.pty.write(NOISE)

    def _note(self, looked: float, pause: float | None) -> None:
        """Record how long a request may have waited since the last poll."""
        if pause is not None:
            self.late = max(self.late, time.perf_counter() - looked - pause)

    def _now(self) -> float:
        real = self._clock == "real"
        return time.perf_counter() - self._began if real else self._world.time

    def _pause(self) -> float | None:
        """Return the time for which the thread may sleep [s]."""
        due = [when for port in self._ports.values() for when, _ in port.due]
        if any(port.line.noisy for port in self._ports.values()):
            return TICK
        if self._clock == "steps":
            return None
        return max(min([*(when - self._now() for when in due), TICK]), 0.0)

    def _follow(self) -> None:
        """Bring physics up to the wall clock."""
        if self._clock == "real":
            behind = self._now() - self._world.time
            if behind > LARGEST_LAG:
                self.lag += behind - LARGEST_LAG
                self._began += behind - LARGEST_LAG
                behind = LARGEST_LAG
            self._world.advance(max(behind, 0.0), settle=False)

    def _serve(self, port: Port) -> None:
        """Process the bytes of a host."""
        data = port.held + port.pty.read()
        port.held = b""
        while port.marker and data:
            before, found, after = data.partition(port.marker)
            if found:
                port.marker, data = b"", after
                self._feed(port, before)
                port.waiting.set()
                continue
            keep = next(
                (k for k in range(len(port.marker) - 1, 0, -1) if data.endswith(port.marker[:k])), 0
            )
            port.held = data[len(data) - keep :]
            data = data[: len(data) - keep]
            break
        self._feed(port, data)

    def _feed(self, port: Port, data: bytes) -> None:
        if not data:
            return
        # In emulated time: while it stands still, a computer that is busy between the two
        # halves of a packet must not lose the first.
        if self._now() - port.last > GAP:
            port.line.reset()
        port.last = self._now()
        baud, start = port.pty.baud(), max(self._now(), port.busy)
        deliveries = port.line.feed(data, baud, self._world.time)
        port.busy = start + port.line.occupied
        # Time advances before the reply leaves: a host that has it sees the later time.
        if self._clock == "steps":
            self._world.advance(max(port.line.occupied, port.line.answered))
        stale, port.stale = port.stale, []
        for late in stale:
            port.pty.write(late)
        for delivery in deliveries:
            if delivery.after is None:
                port.stale.append(delivery.data)
            elif delivery.late or (self._clock == "real" and delivery.after > 0.0):
                port.due.append((start + delivery.after, delivery.data))
            else:
                port.pty.write(delivery.data)
        self._flush(port)

    def _flush(self, port: Port) -> None:
        """Send the deliveries that are due."""
        if port.due:
            now = self._now()
            ready = sorted((item for item in port.due if item[0] <= now), key=lambda item: item[0])
            port.due = [item for item in port.due if item[0] > now]
            for _, data in ready:
                port.pty.write(data)
