"""Thread that connects the pseudo-terminals to the emulated buses."""

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

#: Source of the emulated time: `real`: the wall clock; `steps`: only calls of `Emulator.advance`
#: and, with wire timing, the duration of transactions.
Clock = Literal["real", "steps"]

#: Period of the physics updates while no request arrives, with the clock `real` [s].
TICK = 0.005
#: Largest lag of the physics behind the wall clock [s]; a larger lag is skipped.
LARGEST_LAG = 0.1
#: Bytes that a noisy line sends to the host every `TICK`; they contain no packet header.
NOISE = b"\x55\x12\xfd"
#: Pause after which servos discard an unfinished request [s].
GAP = 0.020
#: Time after which a call that waits for the emulator's thread fails [s].
SYNC_TIME = 10.0


@dataclass
class Port:
    """State of one port, with the bytes that are not processed or not sent yet.

    Attributes:
        line: The bus.
        pty: Pseudo-terminal of the port.
        marker: Bytes that `Server.sync` waits for; empty: no call of `sync` waits.
        waiting: Event that is set when the marker has been read.
        partial_marker: Bytes from the host that may be the beginning of the marker.
        last: Time of the last bytes from the host [s].
        busy: Time until which the transactions occupy the bus [s].
        due: Time to send [s] and bytes of each delayed reply.
        stale: Replies that are sent just before those to the next request.
    """

    line: SerialLine
    pty: Pty
    marker: bytes = b""
    waiting: threading.Event = field(default_factory=threading.Event)
    partial_marker: bytes = b""
    last: float = -math.inf
    busy: float = -math.inf
    due: list[tuple[float, bytes]] = field(default_factory=list)
    stale: list[bytes] = field(default_factory=list)


class Server:
    """Connects emulated buses to pseudo-terminals in a separate thread.

    Attributes:
        lock: Lock held while buses, servos or physics run.
        lag: Time that the emulation skipped because the computer was too slow [s].
        max_latency: Largest delay of a reply by a busy computer so far [s]; 0 with the clock
            `steps`.
    """

    def __init__(self, world: Simulation, lines: Mapping[str, SerialLine], clock: Clock) -> None:
        """Store simulation `world`, buses by port name and clock; `start` opens the ports."""
        self._world, self._lines, self._clock = world, dict(lines), clock
        self._ports: dict[str, Port] = {}
        self._thread: threading.Thread | None = None
        self._failed: BaseException | None = None
        self._pending_call: Callable[[], None] | None = None
        self._done = threading.Event()
        self.lock, self.lag, self.max_latency = threading.RLock(), 0.0, 0.0
        self._marking = threading.Lock()

    def start(self) -> None:
        """Open the ports, and start the thread that answers requests.

        Raises:
            ServoError: The server runs already, or the system has no pseudo-terminals.
        """
        if self._thread is not None:
            raise ServoError("the emulator runs already")
        self._ports = {name: Port(line, Pty(name)) for name, line in self._lines.items()}
        self._wake_r, self._wake_w = os.pipe()
        self._stopping = False
        self._began = time.perf_counter() - self._world.time
        self._thread = threading.Thread(
            target=self._run_guarded, name="pliant-emulator", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the ports.

        Raises:
            ServoError: The thread had ended with an error, which is attached as cause.
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
            ServoError: The server is not running.
        """
        if self._thread is None:
            raise ServoError("the emulator is not running: use `with Emulator(...) as bus:`")
        return {name: port.pty.path for name, port in self._ports.items()}

    def sync(self) -> None:
        """Wait until the servos have processed all bytes that the host has written so far.

        Raises:
            ServoError: The server's thread does not answer.
        """
        # One caller at a time: a second marker would overwrite the first.
        with self._marking:
            for port in list(self._ports.values()):
                with self.lock:
                    if self._thread is None or not port.pty.has_input():
                        continue
                    port.marker = b"\x00sync" + os.urandom(11)
                    port.waiting.clear()
                    port.pty.mark(port.marker)
                if not port.waiting.wait(SYNC_TIME):
                    raise ServoError(f"the emulator does not answer: {self._failed or 'too slow'}")

    def hang_up(self, name: str | None) -> None:
        """Unplug the adapter of the port `name`, or of all ports if it is None.

        Return when the pseudo-terminals are closed.
        """
        self.sync()

        def pull() -> None:
            for key, port in self._ports.items():
                if name in {None, key}:
                    port.pty.hang_up()
                    port.due.clear()
                    port.stale.clear()

        self._run_in_thread(pull)

    def put_back(self, name: str | None) -> None:
        """Open the unplugged port `name`, or all if it is None, under the same path as before."""

        def put() -> None:
            for key, port in self._ports.items():
                if name in {None, key} and port.pty.master is None:
                    port.line.reset()
                    port.pty.open()

        self._run_in_thread(put)

    def _run_in_thread(self, function: Callable[[], None]) -> None:
        """Run a function in the server's thread, and wait until it has returned.

        Only that thread may close a port, because it polls the ports.

        Raises:
            ServoError: The server's thread does not answer.
        """
        self._done.clear()
        self._pending_call = function
        self.wake()
        if self._thread is not None and not self._done.wait(SYNC_TIME):
            raise ServoError(f"the emulator does not answer: {self._failed or 'too slow'}")

    def wake(self) -> None:
        """Make the server's thread return from its wait for data."""
        with suppress(OSError, AttributeError):
            os.write(self._wake_w, b"!")

    def _run_guarded(self) -> None:
        """Serve the ports in the thread; store an error, and hang up the ports then."""
        try:
            self._run()
        except BaseException as error:
            self._failed = error
            for port in self._ports.values():
                port.pty.hang_up()

    def _run(self) -> None:
        """Wait for data, then answer requests and send delayed replies, until `stop`."""
        while not self._stopping:
            wait_start = time.perf_counter()
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
                self._advance_to_wall_clock()
                if self._pending_call is not None:
                    self._pending_call()
                    self._pending_call = None
                    self._done.set()
                for end in ready:
                    if end in masters and masters[end].pty.master == end:
                        self._record_latency(wait_start, pause)
                        self._serve(masters[end])
                for port in self._ports.values():
                    self._flush(port)
                    if port.line.noisy:
                        port.pty.write(NOISE)

    def _record_latency(self, wait_start: float, pause: float | None) -> None:
        """Update `max_latency` with the delay of the request that ended the wait for data.

        Args:
            wait_start: Start of the wait for data [s].
            pause: Time for which the thread intended to wait [s]; None: without limit.
        """
        if pause is not None:
            latency = time.perf_counter() - wait_start - pause
            self.max_latency = max(self.max_latency, latency)

    def _now(self) -> float:
        real = self._clock == "real"
        return time.perf_counter() - self._began if real else self._world.time

    def _pause(self) -> float | None:
        """Return the longest time for which the thread may sleep [s]; None for no limit."""
        due = [when for port in self._ports.values() for when, _ in port.due]
        if any(port.line.noisy for port in self._ports.values()):
            return TICK
        if self._clock == "steps":
            return None
        return max(min([*(when - self._now() for when in due), TICK]), 0.0)

    def _advance_to_wall_clock(self) -> None:
        """With the clock `real`, advance the physics to the present wall clock time."""
        if self._clock == "real":
            lag = self._now() - self._world.time
            if lag > LARGEST_LAG:
                self.lag += lag - LARGEST_LAG
                self._began += lag - LARGEST_LAG
                lag = LARGEST_LAG
            self._world.advance(max(lag, 0.0), settle=False)

    def _serve(self, port: Port) -> None:
        """Pass bytes from the host to the bus; if they contain the marker of `sync`, report it."""
        data = port.partial_marker + port.pty.read()
        port.partial_marker = b""
        while port.marker and data:
            before, separator, after = data.partition(port.marker)
            if separator:
                port.marker, data = b"", after
                self._feed(port, before)
                port.waiting.set()
                continue
            length = next(
                (k for k in range(len(port.marker) - 1, 0, -1) if data.endswith(port.marker[:k])), 0
            )
            port.partial_marker = data[len(data) - length :]
            data = data[: len(data) - length]
            break
        self._feed(port, data)

    def _feed(self, port: Port, data: bytes) -> None:
        """Pass bytes from the host to the bus; send its replies now, or queue delayed ones."""
        if not data:
            return
        # Measure the pause in emulated time: on a busy computer with the clock `steps`, servos must
        # not discard half a packet.
        if self._now() - port.last > GAP:
            port.line.reset()
        port.last = self._now()
        baud, start = port.pty.baud(), max(self._now(), port.busy)
        deliveries = port.line.feed(data, baud, self._world.time)
        port.busy = start + port.line.occupied
        # Advance the time before the replies are sent: a host that has received them then reads the
        # time of their arrival.
        if self._clock == "steps":
            self._world.advance(max(port.line.occupied, port.line.answered))
        stale, port.stale = port.stale, []
        for reply in stale:
            port.pty.write(reply)
        for delivery in deliveries:
            if delivery.after is None:
                port.stale.append(delivery.data)
            elif delivery.is_delayed or (self._clock == "real" and delivery.after > 0.0):
                port.due.append((start + delivery.after, delivery.data))
            else:
                port.pty.write(delivery.data)
        self._flush(port)

    def _flush(self, port: Port) -> None:
        """Send the replies of a port whose time of arrival has come."""
        if port.due:
            now = self._now()
            ready = sorted((item for item in port.due if item[0] <= now), key=lambda item: item[0])
            port.due = [item for item in port.due if item[0] > now]
            for _, data in ready:
                port.pty.write(data)
