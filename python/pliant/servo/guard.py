"""Guarded transactions on one port: timeouts, retries, and rejection of late replies.

The protocols carry no sequence number, so only its length distinguishes a late reply to an earlier
request from the reply to this one. After a failed request, the servo has a missing reply. No other
request to that servo uses the same length until a reply of another length has arrived: servos
answer in order and the line keeps the order, so that reply proves that no older one can come. If
there is a choice, the length is also avoided for one second, in case a device between host and
servo reorders data. After two seconds a missing reply is given up, because an arm without positions
for so long is being lowered.

A late reply also corrupts the next one. So after a failure the line is drained: pings are sent to
an unused id until the line has been silent for as long as a reply may take.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass
from math import isinf
from typing import TYPE_CHECKING, TypeVar

from pliant.servo.models.row import Block
from pliant.servo.owed import Owed
from pliant.servo.transport import BusError
from pliant.servo.wire import TURN, reply_timeout, wire_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from pliant.servo.models.row import Protocol as Wire
    from pliant.servo.transport import Transport
    from pliant.servo.wire import Kind

T = TypeVar("T")

NOISY = (
    "the line is never silent: an adapter that hears its own requests (switch its echo off), or "
    "noise (cable, ground, termination)"
)

#: Minimum silence of a drain, as a share of `patience`: tolerance for a busy host.
SILENCE_SHARE = 0.2
#: Outside of a cycle: factor of the timeout, and number of tries. A try that receives a late reply
#: counts too.
UNHURRIED, TRIES = 5.0, 6
#: Longest drain outside of a cycle [s], and after a failed one: an adapter with echo or noise may
#: never be silent.
DRAIN, DRAIN_AGAIN = 0.5, 0.05
#: Data bytes of a ping reply by protocol; and the number of bytes that every servo has from address
#: 0 on without a gap.
PING, FIRST = {"p1": 0, "p2": 3}, 12
#: Number of ids tried to find an unused one.
ABSENT_TRIES = 8
#: Counter for each kind of failure.
_COUNTED = {"timeout": "timeouts", "corrupt": "corrupt", "stale": "stale", "refused": "refused"}


@dataclass
class Counters:
    """Event counters of one port since it was opened.

    Attributes:
        transactions: Requests sent, with retries, without the pings of drains.
        retries: Requests sent again.
        timeouts: Missing or incomplete replies.
        corrupt: Replies with a wrong checksum, frame or id.
        stale: Late replies to earlier requests, rejected.
        drains: Number of drains.
        refused: Requests that a servo rejected.
    """

    transactions: int = 0
    retries: int = 0
    timeouts: int = 0
    corrupt: int = 0
    stale: int = 0
    drains: int = 0
    refused: int = 0


@dataclass(frozen=True)
class Reply:
    """Reply of one servo.

    Attributes:
        block: Block that was read.
        data: Its bytes.
        status: Error byte.
        time: Time of the request [s].
    """

    block: Block
    data: bytes
    status: int
    time: float


class Guard:
    """Transactions on one port, with drains, retries and counters.

    Args:
        transport: The port.
        protocol: `p1` or `p2`.
        baudrate: Bits per second.
        latency: The adapter's latency timer [s].
        cycle: Control period [s].
        patience: Minimum reply timeout [s].
        absent: Unused id on the port, for drains.
        clock: Clock for timeouts.
        stamp: Clock of the time in replies; default: `clock`.

    Attributes:
        counters: Event counters.
        turn: Longest response delay of the servos [s].
        latency: The adapter's latency timer [s].
        held_back: Shortest delay of a reply over the wire time [s].
        gone: Whether the port has vanished; every call then fails at once.
        is_noisy: Whether the last drain without a budget ended without silence.
    """

    def __init__(
        self,
        transport: Transport,
        protocol: Wire,
        *,
        baudrate: int,
        latency: float = 0.001,
        cycle: float = 0.01,
        patience: float = 0.010,
        absent: int = 252,
        clock: Callable[[], float] = time.perf_counter,
        stamp: Callable[[], float] | None = None,
    ) -> None:
        """Store the port; nothing is sent yet."""
        self.counters = Counters()
        self.turn = TURN
        self.gone = self.is_noisy = False
        self.latency, self.held_back = latency, float("inf")
        self._io, self._protocol, self._absent = transport, protocol, absent
        self._baudrate, self._cycle = baudrate, cycle
        self._clock, self._stamp = clock, stamp or clock
        self._deadline = float("inf")
        self._dirty = False
        self._timeout = self._waited = self._wire = 0.0
        self._patience = patience
        self._owed = Owed()
        self._silence = SILENCE_SHARE * patience + latency

    def begin(self, budget: float = float("inf")) -> None:
        """Start a cycle: no retry and no drain runs later than `budget` [s] from now.

        Without a budget, timeouts are longer and there are more tries.
        """
        self._deadline = self._clock() + budget

    def read(self, id: int, *blocks: Block, again: bool = True) -> Reply:
        """Read a block of one servo; after a failure, drain and retry.

        Args:
            id: The servo.
            *blocks: Alternative blocks of different lengths; the first one whose length fits no
                missing reply is read.
            again: Whether to retry after a failure.

        Raises:
            BusError: All tries failed, or there was no time for another; `late` if every length
                fits a missing reply.
        """

        def once() -> Reply:
            return self._read(id, self._choose([id], blocks))

        return self._tried(once) if again else self._once(once)

    def sync_read(self, ids: Sequence[int], *blocks: Block) -> dict[int, Reply]:
        """Read a block of several servos with one request, without a retry; blocks as in `read`.

        If one reply is missing, all fail; then ask the servos one by one.
        """

        def once() -> dict[int, Reply]:
            block = self._choose(ids, blocks)
            start = self._start("sync_read", len(ids), block.size)
            with self._owing(ids, block.size):
                answers = self._io.sync_read(ids, block.address, block.size)
                pairs = zip(ids, answers, strict=True)
                return {i: self._checked(i, block, d, s, start) for i, (d, s) in pairs}

        return self._once(once)

    def write(self, id: int, address: int, data: bytes) -> int:
        """Write bytes to one servo with a retry; return the status of the reply."""

        def once() -> int:
            self._start("write", 1, len(data))
            return self._io.write(id, address, data)

        return self._tried(once)

    def sync_write(self, ids: Sequence[int], address: int, data: Sequence[bytes]) -> None:
        """Write several servos with one packet; it has no reply, so only the port can fail."""

        def once() -> None:
            self._start("sync_write", len(ids), len(data[0]))
            self._io.sync_write(ids, address, data)

        # The packet has no reply, so the line need not be silent.
        self.check_port()
        self._counted(once)

    def ping(self, id: int) -> bool:
        """Return True if a servo answers; no retry."""

        def once() -> bool:
            self._start("ping", 1, 0, hurry=True)
            before = self._clock()
            answered = self._io.ping(id)
            if not answered:
                # A late servo, or two with the same id, may still be sending.
                self._dirty = True
                self._owed.add([id], PING[self._protocol], before)
            return answered

        return self._once(once)

    def reboot(self, id: int) -> None:
        """Restart a servo; its reply is optional and ignored."""

        def once() -> None:
            self._start("write", 1, 0)
            try:
                self._io.reboot(id)
            finally:
                self._dirty = True

        self._once(once)

    def find_absent(self, taken: Iterable[int], highest: int) -> None:
        """Find the highest unused id without an answer, for drains.

        If every id seems to answer, as on a line with echo, the present one is kept.
        """
        free = (number for number in range(highest, -1, -1) if number not in set(taken))
        for _, number in zip(range(ABSENT_TRIES), free, strict=False):
            try:
                if self.ping(number):
                    continue
            except BusError as error:
                if error.reason == "gone":
                    raise
                continue
            self._absent = number
            return

    def _read(self, id: int, block: Block) -> Reply:
        start = self._start("read", 1, block.size)
        with self._owing([id], block.size):
            before = self._clock()
            data, status = self._io.read(id, block.address, block.size)
            self.held_back = min(self.held_back, self._clock() - before - self._wire)
            return self._checked(id, block, data, status, start)

    def _choose(self, ids: Sequence[int], blocks: Sequence[Block]) -> Block:
        """Return the first block whose length fits no missing reply.

        Raises:
            BusError: All lengths fit, and there is no time to settle them.
        """
        found = self._owed.choose(ids, blocks, self._clock())
        if found is not None:
            return found
        if not isinf(self._deadline):
            raise BusError(f"id {ids[0]} still owes an answer that looks like this one", "late")
        for id in ids:
            self._settle(id)
        return blocks[0]

    def _settle(self, id: int) -> None:
        """Read the first bytes of a servo, with a length that fits no missing reply."""
        if barred := self._owed.barred(id):
            size = next((n for n in range(FIRST, 0, -1) if n not in barred), None)
            if size is None:
                raise BusError(f"id {id} owes too many answers to be asked again", "late")
            self._read(id, Block(0, size))

    @contextmanager
    def _owing(self, ids: Sequence[int], size: int) -> Iterator[None]:
        """Return a context for a request; if it fails, its reply is recorded as missing."""
        before = self._clock()
        try:
            yield
        except BusError:
            self._owed.add(ids, size, before)
            raise
        self._owed.settle(ids)

    def _checked(self, id: int, block: Block, data: bytes, status: int, start: float) -> Reply:
        """Return a reply of the right length; raise for another length, a late reply."""
        if len(data) == block.size:
            return Reply(block, data, status, start)
        if not data and status:
            raise BusError(
                f"id {id} refuses to be read at {block.address}..{block.address + block.size - 1} "
                f"(status {status})",
                "refused",
                id,
            )
        raise BusError(
            f"id {id} answered {len(data)} bytes instead of {block.size}: to an earlier request",
            "stale",
            id,
        )

    def _start(self, kind: Kind, servos: int, size: int, *, hurry: bool = False) -> float:
        """Set the timeout of a request, count it, and return the time [s]."""
        wire = wire_time(
            self._protocol, kind, servos, size, baudrate=self._baudrate, turn=self.turn
        )
        self._waited = reply_timeout(wire, self.latency, self._cycle, self._patience)
        if isinf(self._deadline) and not hurry:
            self._waited *= UNHURRIED
        self._wait(self._waited)
        self._silence = SILENCE_SHARE * self._patience + wire + self.latency
        self._wire = wire
        self.counters.transactions += 1
        return self._stamp()

    def _wait(self, timeout: float) -> None:
        if timeout != self._timeout:
            self._io.set_timeout(timeout)
            self._timeout = timeout

    def _tried(self, call: Callable[[], T]) -> T:
        """Call; after a temporary failure, drain and call again if the budget allows."""
        left = TRIES if isinf(self._deadline) else 2
        while True:
            try:
                return self._once(call)
            except BusError as error:
                left -= 1
                if left == 0 or error.reason in {"gone", "noisy"}:
                    raise
                if not self._drain():
                    if isinf(self._deadline):
                        raise BusError(NOISY, "noisy") from error
                    raise
                if self._late():
                    raise
                self.counters.retries += 1

    def _late(self) -> bool:
        """Return True if the reply to one more request could come after the deadline."""
        return self._clock() + self._waited > self._deadline

    def _once(self, call: Callable[[], T]) -> T:
        """Drain the line if needed, then call once."""
        self.check_port()
        if self._dirty and not self._drain():
            if isinf(self._deadline):
                raise BusError(NOISY, "noisy")
            raise BusError("no time left in this cycle", "late")
        return self._counted(call)

    def check_port(self) -> None:
        """Check that the port is present.

        Raises:
            BusError: It has vanished.
        """
        if self.gone:
            raise BusError("the port is gone: close it, plug it in and open it again", "gone")

    def _counted(self, call: Callable[[], T]) -> T:
        """Call, and count failures."""
        try:
            return call()
        except BusError as error:
            self._dirty = True
            if error.reason == "gone":
                self.gone = True
            name = _COUNTED.get(error.reason)
            if name is not None:
                setattr(self.counters, name, getattr(self.counters, name) + 1)
            raise

    def _drain(self) -> bool:
        """Listen until the line has been silent for one reply time; return False on timeout.

        A ping to an unused id reads all data that arrive: it returns early if there were any, and
        after its timeout otherwise. Without a budget, the silence must last as long as a reply
        timeout, and the drain ends after `DRAIN`.
        """
        self.counters.drains += 1
        unhurried = isinf(self._deadline)
        silence = max(self._silence, self._waited) if unhurried else self._silence
        end = self._deadline
        if unhurried:
            end = self._clock() + silence + (DRAIN_AGAIN if self.is_noisy else DRAIN)
        self._wait(silence)
        while (before := self._clock()) + silence <= end:
            try:
                self._io.ping(self._absent)
            except BusError as error:
                if error.reason == "gone":
                    self.gone = True
                    raise
            if self._clock() - before >= silence:
                self._dirty = self.is_noisy = False
                return True
        self.is_noisy = self.is_noisy or unhurried
        return False
