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
from typing import TYPE_CHECKING, Literal, TypeVar

from pliant._core import ConfigError
from pliant._validation import real
from pliant.servo.models.base import Block
from pliant.servo.transport import BusError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from pliant.servo.models.base import Protocol
    from pliant.servo.models.base import Protocol as Wire
    from pliant.servo.transport import Transport


BITS_PER_BYTE = 10
#: Response delay of a servo with Return Delay 0 [s].
RESPONSE_DELAY = 30e-6
#: Largest minimum reply timeout (`reply_timeout_min`) [s].
MAX_REPLY_TIMEOUT_MIN = 1.0
#: Bytes of a packet without data: instruction and status.
OVERHEAD = {"p1": (6, 6), "p2": (10, 11)}
Kind = Literal["ping", "read", "write", "sync_read", "sync_write"]


def wire_bytes(protocol: Protocol, kind: Kind, servos: int, size: int) -> tuple[int, int]:
    """Return the bytes sent and received in a transaction.

    Args:
        protocol: `p1` (Feetech too) or `p2`.
        kind: The instruction.
        servos: Number of addressed servos.
        size: Data bytes per servo.

    Returns:
        Bytes to the servos, and bytes back. Byte stuffing of Protocol 2.0 is not counted.
    """
    request, reply = OVERHEAD[protocol]
    address, length = (1, 1) if protocol == "p1" else (2, 2)
    if kind == "ping":
        return request, reply + (0 if protocol == "p1" else 3)
    if kind == "read":
        return request + address + length, reply + size
    if kind == "write":
        return request + address + size, reply
    if kind == "sync_read":
        return request + address + length + servos, servos * (reply + size)
    return request + address + length + servos * (1 + size), 0


def wire_time(
    protocol: Protocol,
    kind: Kind,
    servos: int,
    size: int,
    *,
    baudrate: int,
    response_delay: float = RESPONSE_DELAY,
) -> float:
    """Return the time for which a transaction occupies the wire [s].

    Args:
        protocol: `p1` (Feetech too) or `p2`.
        kind: The instruction.
        servos: Number of addressed servos.
        size: Data bytes per servo.
        baudrate: Bits per second.
        response_delay: Response delay of a servo [s]; Return Delay 250 is 500 µs.
    """
    sent, received = wire_bytes(protocol, kind, servos, size)
    replies = servos if kind == "sync_read" else int(received > 0)
    return (sent + received) * BITS_PER_BYTE / baudrate + replies * response_delay


def reply_timeout(
    wire: float, latency: float, cycle: float, reply_timeout_min: float = 0.010
) -> float:
    """Return the reply timeout [s].

    It is twice the wire time, plus twice the adapter's latency timer, plus 5 ms for the host; at
    most three control cycles, but at least `reply_timeout_min`.
    """
    return max(reply_timeout_min, min(2.0 * wire + 2.0 * latency + 0.005, 3.0 * cycle))


def check_reply_timeout(reply_timeout_min: float) -> float:
    """Return a checked minimum reply timeout [s]; the bound makes a silent bus known soon.

    Raises:
        ConfigError: Not a number, or not in (0, 1] s.
    """
    if not 0.0 < real(reply_timeout_min, "reply_timeout_min") <= MAX_REPLY_TIMEOUT_MIN:
        raise ConfigError(
            f"reply_timeout_min must be above 0 s and at most {MAX_REPLY_TIMEOUT_MIN:g} s, "
            f"got {reply_timeout_min:g}: nothing else is sent while an answer is waited for"
        )
    return float(reply_timeout_min)


#: Time for which the length of a missing reply is avoided if there is a choice; and time after
#: which a reply is given up if nothing was answered since [s].
AVOID_TIME, EXPIRY = 1.0, 2.0


@dataclass
class PendingReply:
    """A missing reply.

    Attributes:
        size: Number of data bytes.
        time: Time of the request [s].
        is_superseded: Whether a later request was answered, so that this reply cannot arrive any
            more.
    """

    size: int
    time: float
    is_superseded: bool = False


class PendingReplies:
    """Missing replies of the servos on one port, by id."""

    def __init__(self) -> None:
        """Start without missing replies."""
        self._missing: dict[int, list[PendingReply]] = {}

    def add(self, ids: Iterable[int], size: int, time: float) -> None:
        """Record missing replies of this length, requested at `time` [s]."""
        for id in ids:
            self._missing.setdefault(id, []).append(PendingReply(size, time))

    def mark_superseded(self, ids: Iterable[int]) -> None:
        """Mark all missing replies of these servos as settled, after a reply of another length."""
        for id in ids if self._missing else ():
            for reply in self._missing.get(id, ()):
                reply.is_superseded = True

    def ambiguous_lengths(self, id: int) -> set[int]:
        """Return the lengths that a late reply of this servo may have."""
        return {reply.size for reply in self._missing.get(id, ()) if not reply.is_superseded}

    def choose(self, ids: Sequence[int], blocks: Sequence[Block], now: float) -> Block | None:
        """Return the first block whose length fits no missing reply, preferably no recent one."""
        if not self._missing:
            return blocks[0]
        for id in ids:
            self._expire(id, now)
        recent_lengths = {reply.size for id in ids for reply in self._missing.get(id, ())}
        ambiguous_lengths = {size for id in ids for size in self.ambiguous_lengths(id)}
        for sizes in (recent_lengths, ambiguous_lengths):
            for block in blocks:
                if block.size not in sizes:
                    return block
        return None

    def _expire(self, id: int, now: float) -> None:
        remaining = [
            reply
            for reply in self._missing.get(id, ())
            if now - reply.time < (AVOID_TIME if reply.is_superseded else EXPIRY)
        ]
        if remaining:
            self._missing[id] = remaining
        else:
            self._missing.pop(id, None)


T = TypeVar("T")

NOISE_MESSAGE = (
    "the line is never silent: an adapter that hears its own requests (switch its echo off), or "
    "noise (cable, ground, termination)"
)

#: Minimum silence of a drain, as a share of `reply_timeout_min`: tolerance for a busy host.
SILENCE_SHARE = 0.2
#: Outside of a cycle: factor of the timeout, and number of tries. A try that receives a late reply
#: counts too.
RELAXED_FACTOR, TRIES = 5.0, 6
#: Longest drain outside of a cycle [s], and after a failed one: an adapter with echo or noise may
#: never be silent.
DRAIN, DRAIN_AGAIN = 0.5, 0.05
#: Data bytes of a ping reply by protocol; and the number of bytes that every servo has from address
#: 0 on without a gap.
PING_SIZE, MIN_REGISTERS = {"p1": 0, "p2": 3}, 12
#: Number of ids tried to find an unused one.
UNUSED_ID_TRIES = 8
#: Counter for each kind of failure.
_COUNTER_OF_REASON = {
    "timeout": "timeouts",
    "corrupt": "corrupt",
    "stale": "stale",
    "refused": "refused",
}


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


class TransactionGuard:
    """Transactions on one port, with drains, retries and counters.

    Args:
        transport: The port.
        protocol: `p1` or `p2`.
        baudrate: Bits per second.
        latency: The adapter's latency timer [s].
        cycle: Control period [s].
        reply_timeout_min: Minimum reply timeout [s].
        unused_id: Unused id on the port, for drains.
        clock: Clock for timeouts.
        sample_clock: Clock of the time in replies; default: `clock`.

    Attributes:
        counters: Event counters.
        response_delay: Longest response delay of the servos [s].
        latency: The adapter's latency timer [s].
        held_back: Shortest delay of a reply over the wire time [s].
        is_gone: Whether the port has vanished; every call then fails at once.
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
        reply_timeout_min: float = 0.010,
        unused_id: int = 252,
        clock: Callable[[], float] = time.perf_counter,
        sample_clock: Callable[[], float] | None = None,
    ) -> None:
        """Store the port; nothing is sent yet."""
        self.counters = Counters()
        self.response_delay = RESPONSE_DELAY
        self.is_gone = self.is_noisy = False
        self.latency, self.held_back = latency, float("inf")
        self._io, self._protocol, self._unused_id = transport, protocol, unused_id
        self._baudrate, self._cycle = baudrate, cycle
        self._clock, self._sample_clock = clock, sample_clock or clock
        self._deadline = float("inf")
        self._is_dirty = False
        self._timeout = self._reply_timeout = self._wire = 0.0
        self._reply_timeout_min = reply_timeout_min
        self._pending = PendingReplies()
        self._silence = SILENCE_SHARE * reply_timeout_min + latency

    def start_cycle(self, budget: float = float("inf")) -> None:
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

        return self._with_retries(once) if again else self._once(once)

    def sync_read(self, ids: Sequence[int], *blocks: Block) -> dict[int, Reply]:
        """Read a block of several servos with one request, without a retry; blocks as in `read`.

        If one reply is missing, all fail; then ask the servos one by one.
        """

        def once() -> dict[int, Reply]:
            block = self._choose(ids, blocks)
            start = self._prepare("sync_read", len(ids), block.size)
            with self._recording_failure(ids, block.size):
                answers = self._io.sync_read(ids, block.address, block.size)
                pairs = zip(ids, answers, strict=True)
                return {i: self._checked(i, block, d, s, start) for i, (d, s) in pairs}

        return self._once(once)

    def write(self, id: int, address: int, data: bytes) -> int:
        """Write bytes to one servo with a retry; return the status of the reply."""

        def once() -> int:
            self._prepare("write", 1, len(data))
            return self._io.write(id, address, data)

        return self._with_retries(once)

    def sync_write(self, ids: Sequence[int], address: int, data: Sequence[bytes]) -> None:
        """Write several servos with one packet; it has no reply, so only the port can fail."""

        def once() -> None:
            self._prepare("sync_write", len(ids), len(data[0]))
            self._io.sync_write(ids, address, data)

        # The packet has no reply, so the line need not be silent.
        self.check_port()
        self._count_failures(once)

    def ping(self, id: int) -> bool:
        """Return True if a servo answers; no retry."""

        def once() -> bool:
            self._prepare("ping", 1, 0, is_urgent=True)
            started = self._clock()
            answered = self._io.ping(id)
            if not answered:
                # A late servo, or two with the same id, may still be sending.
                self._is_dirty = True
                self._pending.add([id], PING_SIZE[self._protocol], started)
            return answered

        return self._once(once)

    def reboot(self, id: int) -> None:
        """Restart a servo; its reply is optional and ignored."""

        def once() -> None:
            self._prepare("write", 1, 0)
            try:
                self._io.reboot(id)
            finally:
                self._is_dirty = True

        self._once(once)

    def find_unused_id(self, used: Iterable[int], highest: int) -> None:
        """Find the highest unused id without an answer, for drains.

        If every id seems to answer, as on a line with echo, the present one is kept.
        """
        free = (number for number in range(highest, -1, -1) if number not in set(used))
        for _, number in zip(range(UNUSED_ID_TRIES), free, strict=False):
            try:
                if self.ping(number):
                    continue
            except BusError as error:
                error.raise_if_gone()
                continue
            self._unused_id = number
            return

    def _read(self, id: int, block: Block) -> Reply:
        start = self._prepare("read", 1, block.size)
        with self._recording_failure([id], block.size):
            started = self._clock()
            data, status = self._io.read(id, block.address, block.size)
            self.held_back = min(self.held_back, self._clock() - started - self._wire)
            return self._checked(id, block, data, status, start)

    def _choose(self, ids: Sequence[int], blocks: Sequence[Block]) -> Block:
        """Return the first block whose length fits no missing reply.

        Raises:
            BusError: All lengths fit, and there is no time to settle them.
        """
        found = self._pending.choose(ids, blocks, self._clock())
        if found is not None:
            return found
        if not isinf(self._deadline):
            raise BusError(f"id {ids[0]} still owes an answer that looks like this one", "late")
        for id in ids:
            self._resolve(id)
        return blocks[0]

    def _resolve(self, id: int) -> None:
        """Read the first bytes of a servo, with a length that fits no missing reply."""
        if ambiguous_lengths := self._pending.ambiguous_lengths(id):
            size = next(
                (n for n in range(MIN_REGISTERS, 0, -1) if n not in ambiguous_lengths), None
            )
            if size is None:
                raise BusError(f"id {id} owes too many answers to be asked again", "late")
            self._read(id, Block(0, size))

    @contextmanager
    def _recording_failure(self, ids: Sequence[int], size: int) -> Iterator[None]:
        """Return a context for a request; if it fails, its reply is recorded as missing."""
        started = self._clock()
        try:
            yield
        except BusError:
            self._pending.add(ids, size, started)
            raise
        self._pending.mark_superseded(ids)

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

    def _prepare(self, kind: Kind, servos: int, size: int, *, is_urgent: bool = False) -> float:
        """Set the timeout of a request, count it, and return the time [s]."""
        wire = wire_time(
            self._protocol,
            kind,
            servos,
            size,
            baudrate=self._baudrate,
            response_delay=self.response_delay,
        )
        self._reply_timeout = reply_timeout(
            wire, self.latency, self._cycle, self._reply_timeout_min
        )
        if isinf(self._deadline) and not is_urgent:
            self._reply_timeout *= RELAXED_FACTOR
        self._set_timeout(self._reply_timeout)
        self._silence = SILENCE_SHARE * self._reply_timeout_min + wire + self.latency
        self._wire = wire
        self.counters.transactions += 1
        return self._sample_clock()

    def _set_timeout(self, timeout: float) -> None:
        if timeout != self._timeout:
            self._io.set_timeout(timeout)
            self._timeout = timeout

    def _with_retries(self, call: Callable[[], T]) -> T:
        """Call; after a temporary failure, drain and call again if the budget allows."""
        tries = TRIES if isinf(self._deadline) else 2
        while True:
            try:
                return self._once(call)
            except BusError as error:
                tries -= 1
                if tries == 0 or error.reason in {"gone", "noisy"}:
                    raise
                if not self._drain():
                    if isinf(self._deadline):
                        raise BusError(NOISE_MESSAGE, "noisy") from error
                    raise
                if self._is_late():
                    raise
                self.counters.retries += 1

    def _is_late(self) -> bool:
        """Return True if the reply to one more request could come after the deadline."""
        return self._clock() + self._reply_timeout > self._deadline

    def _once(self, call: Callable[[], T]) -> T:
        """Drain the line if needed, then call once."""
        self.check_port()
        if self._is_dirty and not self._drain():
            if isinf(self._deadline):
                raise BusError(NOISE_MESSAGE, "noisy")
            raise BusError("no time left in this cycle", "late")
        return self._count_failures(call)

    def check_port(self) -> None:
        """Check that the port is present.

        Raises:
            BusError: It has vanished.
        """
        if self.is_gone:
            raise BusError("the port is gone: close it, plug it in and open it again", "gone")

    def _count_failures(self, call: Callable[[], T]) -> T:
        """Call, and count failures."""
        try:
            return call()
        except BusError as error:
            self._is_dirty = True
            if error.reason == "gone":
                self.is_gone = True
            name = _COUNTER_OF_REASON.get(error.reason)
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
        is_relaxed = isinf(self._deadline)
        silence = max(self._silence, self._reply_timeout) if is_relaxed else self._silence
        end = self._deadline
        if is_relaxed:
            end = self._clock() + silence + (DRAIN_AGAIN if self.is_noisy else DRAIN)
        self._set_timeout(silence)
        while (started := self._clock()) + silence <= end:
            try:
                self._io.ping(self._unused_id)
            except BusError as error:
                if error.reason == "gone":
                    self.is_gone = True
                    raise
            if self._clock() - started >= silence:
                self._is_dirty = self.is_noisy = False
                return True
        self.is_noisy = self.is_noisy or is_relaxed
        return False
