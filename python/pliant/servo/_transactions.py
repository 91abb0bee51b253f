"""Guarded transactions on one port: timeouts, retries, and rejection of late replies.

The servo protocols have no sequence numbers: only its length distinguishes a late reply to an
earlier request from the present reply. When a request fails, its reply is recorded as missing, and
further requests to that servo ask for another length until such a reply arrives. Servos answer in
order, so this reply proves that no older one can still come. Some adapters reorder data: requests
therefore avoid, if possible, the length of the missing reply even after such proof, for one second
after the failed request. A missing reply without such proof expires after two seconds; an arm
without positions for so long is being lowered.

A late reply also corrupts the next reply. After a failure the line is therefore drained: pings to
an unused id discard data until the line has been silent for as long as a reply may take.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Literal, NamedTuple, ParamSpec, TypeVar

from pliant._core import ConfigError, PortState
from pliant._validation import real
from pliant.servo.models.base import Block
from pliant.servo.transport import BusError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pliant._core import JointReadings, ServoGroup
    from pliant.servo.models.base import Protocol
    from pliant.servo.models.base import Protocol as Wire
    from pliant.servo.transport import Command, Transport


BITS_PER_BYTE = 10
#: Assumed time from request to reply of a servo whose register Return Delay is 0 [s].
RESPONSE_DELAY = 30e-6
#: Largest accepted value of the argument `reply_timeout_min` [s].
MAX_REPLY_TIMEOUT_MIN = 1.0
#: Number of bytes of a request to read or write, without data, and of a reply without data, by
#: protocol.
OVERHEAD = {"p1": (6, 6), "p2": (10, 11)}
Kind = Literal["ping", "read", "write", "sync_read", "sync_write"]


def wire_bytes(protocol: Protocol, kind: Kind, servos: int, size: int) -> tuple[int, int]:
    """Return the number of bytes sent and received in a transaction.

    Args:
        protocol: `p1` (Dynamixel 1.0 and Feetech) or `p2` (Dynamixel 2.0).
        kind: Instruction of the request.
        servos: Number of addressed servos.
        size: Number of data bytes per servo.

    Returns:
        Bytes to the servos, and bytes from them. Byte stuffing of Protocol 2.0 is not counted.
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
        protocol: `p1` (Dynamixel 1.0 and Feetech) or `p2` (Dynamixel 2.0).
        kind: Instruction of the request.
        servos: Number of addressed servos.
        size: Number of data bytes per servo.
        baudrate: Baud rate [bit/s].
        response_delay: Time from the request to the reply of a servo [s]; if the register Return
            Delay is 250, this is 500 µs.
    """
    sent, received = wire_bytes(protocol, kind, servos, size)
    replies = servos if kind == "sync_read" else int(received > 0)
    return (sent + received) * BITS_PER_BYTE / baudrate + replies * response_delay


def reply_timeout(
    wire: float, latency: float, cycle: float, reply_timeout_min: float = 0.010
) -> float:
    """Return the reply timeout of a request [s].

    The timeout is twice the wire time, plus twice the latency timer of the adapter, plus 5 ms for
    the host. It is at most three control periods, but at least `reply_timeout_min`.

    Args:
        wire: Time that the transaction takes on the wire [s].
        latency: Latency timer of the USB adapter [s].
        cycle: Control period [s].
        reply_timeout_min: Minimum reply timeout [s].
    """
    return max(reply_timeout_min, min(2.0 * wire + 2.0 * latency + 0.005, 3.0 * cycle))


def check_reply_timeout(reply_timeout_min: float) -> float:
    """Validate a minimum reply timeout [s] and return it as a float.

    Raises:
        ConfigError: The timeout is not a number, or not in (0, 1] s.
    """
    if not 0.0 < real(reply_timeout_min, "reply_timeout_min") <= MAX_REPLY_TIMEOUT_MIN:
        raise ConfigError(
            f"reply_timeout_min must be above 0 s and at most {MAX_REPLY_TIMEOUT_MIN:g} s, "
            f"got {reply_timeout_min:g}: nothing else is sent while an answer is waited for"
        )
    return float(reply_timeout_min)


#: Time after a failed request in which later requests avoid the length of its reply [s]: `EXPIRY`
#: always, until the servo has answered again; after that answer `AVOID_TIME`, if possible.
AVOID_TIME, EXPIRY = 1.0, 2.0


@dataclass
class PendingReply:
    """Missing reply to a failed request.

    Attributes:
        size: Number of data bytes in the reply.
        time: Time of the request [s].
        is_superseded: True if the servo has answered a later request, so that this reply can no
            longer arrive.
    """

    size: int
    time: float
    is_superseded: bool = False


class PendingReplies:
    """Missing replies of the servos on one port, to tell late replies from new ones by length.

    Attributes:
        missing: Missing replies by servo id.
    """

    def __init__(self, missing: dict[int, list[PendingReply]]) -> None:
        """Use the dictionary `missing`, which is still empty: no reply is missing."""
        self.missing = missing

    def add(self, ids: Iterable[int], size: int, time: float) -> None:
        """Record for each servo a missing reply with `size` data bytes, requested at `time` [s]."""
        for id in ids:
            self.missing.setdefault(id, []).append(PendingReply(size, time))

    def mark_superseded(self, ids: Iterable[int]) -> None:
        """Mark all missing replies of these servos as superseded by a later reply."""
        for id in ids:
            for reply in self.missing.get(id, ()):
                reply.is_superseded = True

    def ambiguous_lengths(self, id: int) -> set[int]:
        """Return the possible numbers of data bytes of a late reply of servo `id`."""
        return {reply.size for reply in self.missing.get(id, ()) if not reply.is_superseded}

    def choose(self, ids: Sequence[int], blocks: Sequence[Block], now: float) -> Block | None:
        """Return the first of `blocks` whose length differs from those of missing replies of `ids`.

        None: every block has the length of a missing reply. Lengths of recently superseded replies
        are avoided if possible. `now` is the present time [s].
        """
        for id in ids:
            self._expire(id, now)
        recent_lengths = {reply.size for id in ids for reply in self.missing.get(id, ())}
        ambiguous_lengths = {size for id in ids for size in self.ambiguous_lengths(id)}
        for sizes in (recent_lengths, ambiguous_lengths):
            for block in blocks:
                if block.size not in sizes:
                    return block
        return None

    def _expire(self, id: int, now: float) -> None:
        remaining = [
            reply
            for reply in self.missing.get(id, ())
            if now - reply.time < (AVOID_TIME if reply.is_superseded else EXPIRY)
        ]
        if remaining:
            self.missing[id] = remaining
        else:
            self.missing.pop(id, None)


P = ParamSpec("P")
T = TypeVar("T")

NOISE_MESSAGE = (
    "the line is never silent: an adapter that receives its own requests (switch its echo off), "
    "the port of a device that sends by itself (an Arduino, a GPS), or noise (cable, ground, "
    "termination)"
)

#: Share of `reply_timeout_min` that is added to wire time and adapter latency for the silence that
#: ends a drain, because the host may be busy.
SILENCE_SHARE = 0.2
#: Outside control cycles: factor on reply timeouts, and number of tries.
RELAXED_FACTOR, TRIES = 5.0, 6
#: Outside control cycles: time after which a drain gives up, in addition to the required silence
#: [s]; the second value applies if the previous drain gave up.
DRAIN, DRAIN_AGAIN = 0.5, 0.05
#: Number of data bytes of a ping reply by protocol; number of bytes from address 0 that every servo
#: has.
PING_SIZE, MIN_REGISTERS = {"p1": 0, "p2": 3}, 12
#: Largest number of ids that are pinged to find an unused id.
UNUSED_ID_TRIES = 8
#: Counter that is increased for each `BusError.reason`.
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
        retries: Number of requests sent again.
        timeouts: Number of missing or incomplete replies.
        corrupt: Number of replies with a wrong checksum, frame or id.
        stale: Number of rejected replies: late ones, or with implausible positions.
        drains: Number of times that the line was drained until it was silent.
        refused: Number of requests that a servo rejected.
    """

    retries: int = 0
    timeouts: int = 0
    corrupt: int = 0
    stale: int = 0
    drains: int = 0
    refused: int = 0


class Reply(NamedTuple):
    """Reply of one servo.

    Attributes:
        block: Block of registers that was read.
        data: Bytes of the block.
        status: Error byte of the reply.
        time: Time of the request [s].
    """

    block: Block
    data: bytes
    status: int
    time: float


if TYPE_CHECKING:
    #: Results of `SerialPort.exchange` and `ServoCodec.decode`.
    Received = tuple[list[tuple[bytes, int]] | bytes, list[tuple[int, bool | None]]]


class GroupReplies(NamedTuple):
    """Replies of several servos to one request, whose readings the core has decoded.

    Attributes:
        block: Block of registers that was read.
        answers: Bytes of the block, and error byte, of each servo.
        notable: Readings that need attention, see `ServoCodec.decode`.
        time: Time of the request [s].
    """

    block: Block
    answers: list[tuple[bytes, int]]
    notable: list[tuple[int, bool | None]]
    time: float


class TransactionGuard(PortState):
    """Requests on one port, with timeouts, retries, counters and rejection of late replies.

    After a failure the line is drained: the received bytes are discarded until the line is silent.

    Args:
        transport: Access to the port.
        protocol: `p1` (Dynamixel 1.0 and Feetech) or `p2` (Dynamixel 2.0).
        baudrate: Baud rate [bit/s].
        latency: Latency timer of the USB adapter [s].
        cycle: Control period [s].
        reply_timeout_min: Minimum reply timeout [s].
        unused_id: Id without a servo; pings to it drain the line.
        clock: Function that returns the time for timeouts [s].
        sample_clock: Function that returns the times in replies [s]; default: `clock`.

    Attributes:
        counters: Event counters.
        held_back: Shortest delay of a reply beyond its wire time [s].
        unused_id: Id without a servo; pings to it drain the line.
        is_noisy: True if the last drain outside of a control cycle ended without silence.
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
        """Store the parameters of the port; send no request yet."""
        self.counters = Counters()
        self._response_delay, self._latency = RESPONSE_DELAY, latency
        self.is_noisy = False
        self.held_back = float("inf")
        self._io, self._protocol, self.unused_id = transport, protocol, unused_id
        self._baudrate, self._cycle = baudrate, cycle
        self.clock, self.sample_clock = clock, sample_clock or clock
        self._timeout = self._reply_timeout = self._wire = 0.0
        self._reply_timeout_min = reply_timeout_min
        self._pending = PendingReplies(self.missing)
        # Wire time and reply timeout [s] of each kind of request so far.
        self._times: dict[tuple[Kind, int, int], tuple[float, float]] = {}

    @property
    def response_delay(self) -> float:
        """Longest time from request to reply of a servo [s]."""
        return self._response_delay

    @response_delay.setter
    def response_delay(self, seconds: float) -> None:
        self._response_delay = seconds
        self._times.clear()

    @property
    def latency(self) -> float:
        """Latency timer of the USB adapter [s]."""
        return self._latency

    @latency.setter
    def latency(self, seconds: float) -> None:
        self._latency = seconds
        self._times.clear()

    def start_cycle(self, budget: float = float("inf")) -> None:
        """Start a control cycle: retries and drains end within `budget` [s] from now.

        Outside of control cycles the budget is infinite, with longer timeouts and more tries.
        """
        self.deadline, self.is_relaxed = self.clock() + budget, budget == inf

    def expect_late_replies(self) -> None:
        """Drain the line before the next request: replies to an ended program may still come."""
        self.is_dirty = True

    def may_get_late_reply(self, id: int, block: Block) -> bool:
        """Return True if a reply of servo `id` with the length of `block` is still missing."""
        return block.size in self._pending.ambiguous_lengths(id)

    def read(self, id: int, *blocks: Block, again: bool = True) -> Reply:
        """Read a block of registers of one servo; after a failure, drain the line and retry.

        Args:
            id: Id of the servo.
            *blocks: Alternative blocks of different lengths. The first block whose length differs
                from those of missing replies is read.
            again: True: retry after a failure.

        Raises:
            BusError: All tries failed, or the budget allowed no further try. The reason is `late`
                if every length equals that of a missing reply.
        """
        if again:
            return self._with_retries(self._read, id, blocks)
        return self._read(id, blocks)

    def sync_read(
        self, ids: Sequence[int], *blocks: Block
    ) -> tuple[Block, list[tuple[bytes, int]], float]:
        """Read a block of registers of several servos with one request, without a retry.

        Args:
            ids: Ids of the servos.
            *blocks: Alternative blocks of different lengths, see `read`.

        Returns:
            Block that was read; its bytes and the error byte of each servo; time of the request
            [s].

        Raises:
            BusError: At least one reply is missing or corrupt.
        """
        found = self.sync_decode(ids, blocks, None)
        assert isinstance(found, GroupReplies), "only a decoder leaves the bytes out"
        return found.block, found.answers, found.time

    def sync_decode(
        self,
        ids: Sequence[int],
        blocks: Sequence[Block],
        decoder: ServoGroup | None,
        longest: float = inf,
        *,
        usual: bool = False,
    ) -> GroupReplies | JointReadings | None:
        """Make a `sync_read`, and let the core store the readings.

        Args:
            ids: Ids of the servos.
            blocks: Alternative blocks of different lengths, see `read`.
            decoder: These servos, where the readings are stored; None: nowhere.
            longest: Age of the previous reading above which a new one is not stored [s].
            usual: True: return readings instead of replies if the first of `blocks` is read and no
                reading needs attention, see `ServoGroup.read`.

        Returns:
            The replies; instead of them, see `usual`, the readings of all joints, or None if there
            are other servos.

        Raises:
            BusError: At least one reply is missing or corrupt; nothing is stored.
        """
        if self.is_dirty or self.is_gone:
            self._clear_line()
        try:
            block = self._choose(ids, blocks) if self._pending.missing else blocks[0]
        except BusError as error:
            self._note_failure(error)
            raise
        start = self._prepare("sync_read", len(ids), block.size)
        started = self.clock()
        found: JointReadings | Received | None
        try:
            if decoder is None:
                found = self._io.sync_read(ids, block.address, block.size), []
            else:
                is_usual = usual and block is blocks[0]
                found = decoder.read(block, self._timeout, start, longest, is_usual)
        except BusError as error:
            self._note_missing(ids, block, started, error)
            raise
        except OSError as error:
            raise self._lost(ids, block, started, error) from error
        result = (
            self._checked(ids, block, (started, start), found)
            if isinstance(found, tuple)
            else found
        )
        if self._pending.missing:
            self._pending.mark_superseded(ids)
        return result

    def finish_sync_read(
        self,
        ids: Sequence[int],
        block: Block,
        times: tuple[float, float],
        found: Received | OSError,
    ) -> GroupReplies:
        """Return the replies to a sync read that `BusCycle.read` has made.

        Args:
            ids: Ids of the servos.
            block: Block that was requested.
            times: Time of the request on the clocks of timeouts and of readings [s].
            found: The replies, or the error of the port.

        Raises:
            BusError: At least one reply is missing or corrupt; nothing is stored.
        """
        self._wire, self._reply_timeout = self.request_times("sync_read", len(ids), block.size)
        if isinstance(found, OSError):
            raise self._lost(ids, block, times[0], found) from found
        return self._checked(ids, block, times, found)

    def _checked(
        self,
        ids: Sequence[int],
        block: Block,
        times: tuple[float, float],
        found: Received,
    ) -> GroupReplies:
        """Return replies to a sync read, after a check that they have the length of the block.

        Args:
            ids: Ids of the servos.
            block: Block that was requested.
            times: Time of the request on the clocks of timeouts and of readings [s].
            found: The replies, or bytes that are no valid replies; see `GroupReplies.notable`.

        Raises:
            BusError: At least one reply is missing or corrupt.
        """
        received, notable = found
        started, start = times
        try:
            answers: list[tuple[bytes, int]] = (
                self._io.broken(received, ids, block.size)  # type: ignore[attr-defined]
                if isinstance(received, bytes)
                else received
            )
            for id, (data, status) in zip(ids, answers, strict=True):
                if len(data) != block.size:
                    raise _mismatch(id, block, data, status)
        except BusError as error:
            self._note_missing(ids, block, started, error)
            raise
        return GroupReplies(block, answers, notable, start)

    def _lost(self, ids: Sequence[int], block: Block, started: float, error: OSError) -> BusError:
        """Note that a sync read has failed because of the port, and return the error to raise."""
        failure: BusError = self._io.lost(error)  # type: ignore[attr-defined]
        self._note_missing(ids, block, started, failure)
        return failure

    def _note_missing(
        self, ids: Sequence[int], block: Block, started: float, error: BusError
    ) -> None:
        """Note that replies to a sync read, made at the time `started` [s], are missing."""
        self._pending.add(ids, block.size, started)
        self._note_failure(error)

    def write(self, id: int, address: int, data: bytes) -> int:
        """Write bytes to one servo, with retries; return the error byte of the reply."""
        return self._with_retries(self._write, id, address, data)

    def sync_write(self, ids: Sequence[int], address: int, data: Sequence[bytes]) -> None:
        """Write bytes from `address` on to several servos, with one packet, which has no reply.

        Raises:
            BusError: The port is gone.
        """
        # No drain: a packet without a reply does not need a silent line.
        if self.is_gone:
            self.check_port()
        self._prepare("sync_write", len(ids), len(data[0]))
        try:
            self._io.sync_write(ids, address, data)
        except BusError as error:
            self._note_failure(error)
            raise

    def sync_encode(
        self, encoder: ServoGroup, size: int, blocks: Sequence[Block], command: Command
    ) -> None:
        """Let the core encode a command, and send it with one packet per block, without reply.

        Args:
            encoder: The servos.
            size: Their number.
            blocks: Block of each packet.
            command: Command for all joints.

        Raises:
            ShapeError, OutOfRangeError: The command is invalid; nothing was sent.
            BusError: The port is gone.
        """
        if self.is_gone:
            self.check_port()
        self._note_sync_write(size, blocks)
        self.transactions += len(blocks)
        try:
            encoder.write(blocks, self._reply_timeout, *command)
        except OSError as error:
            self.finish_sync_write(size, blocks, error)

    def finish_sync_write(self, size: int, blocks: Sequence[Block], error: OSError) -> None:
        """Raise the `BusError` for the failure of a `sync_encode` or of `BusCycle.write`.

        Args:
            size: Number of servos.
            blocks: Block of each packet.
            error: Error of the port.
        """
        self._note_sync_write(size, blocks)
        failure: BusError = self._io.lost(error)  # type: ignore[attr-defined]
        self._note_failure(failure)
        raise failure from error

    def _note_sync_write(self, size: int, blocks: Sequence[Block]) -> None:
        """Store wire time and timeout of a packet with the last of `blocks` for `size` servos."""
        self._wire, timeout = self.request_times("sync_write", size, blocks[-1].size)
        self._reply_timeout = timeout * RELAXED_FACTOR if self.is_relaxed else timeout

    def ping(self, id: int) -> bool:
        """Return True if a servo answers one ping."""
        self._clear_line()
        self._prepare("ping", 1, 0, is_urgent=True)
        started = self.clock()
        try:
            answered = self._io.ping(id)
        except BusError as error:
            self._note_failure(error)
            raise
        if not answered:
            # Drain before the next request: a late servo, or two servos with one id, may still be
            # sending.
            self.is_dirty = True
            self._pending.add([id], PING_SIZE[self._protocol], started)
        return answered

    def reboot(self, id: int) -> None:
        """Restart a servo; discard its reply, which not every servo sends."""
        self._clear_line()
        self._prepare("write", 1, 0)
        try:
            self._io.reboot(id)
        except BusError as error:
            self._note_failure(error)
            raise
        finally:
            self.is_dirty = True

    def find_unused_id(self, used: Iterable[int], highest: int) -> None:
        """Find the highest id without a servo, for the pings that drain the line.

        Keep the present id if all of the first `UNUSED_ID_TRIES` ids seem to answer, as on a line
        with echo.

        Args:
            used: Ids of the servos.
            highest: Highest id to try.
        """
        free = (number for number in range(highest, -1, -1) if number not in set(used))
        for _, number in zip(range(UNUSED_ID_TRIES), free, strict=False):
            try:
                if self.ping(number):
                    continue
            except BusError as error:
                error.raise_if_gone()
                continue
            self.unused_id = number
            # There is no servo that could still answer.
            self._pending.missing.pop(number, None)
            return

    def _read(self, id: int, blocks: Sequence[Block]) -> Reply:
        """Read one of the blocks of one servo, without a retry; see `read`."""
        if self.is_dirty or self.is_gone:
            self._clear_line()
        try:
            is_clear = id not in self._pending.missing
            block = blocks[0] if is_clear else self._choose((id,), blocks)
            return self._read_block(id, block)
        except BusError as error:
            self._note_failure(error)
            raise

    def _read_block(self, id: int, block: Block) -> Reply:
        start = self._prepare("read", 1, block.size)
        started = self.clock()
        try:
            data, status = self._io.read(id, block.address, block.size)
            self.held_back = min(self.held_back, self.clock() - started - self._wire)
            if len(data) != block.size:
                raise _mismatch(id, block, data, status)
        except BusError:
            self._pending.add((id,), block.size, started)
            raise
        if id in self._pending.missing:
            self._pending.mark_superseded((id,))
        return Reply(block, data, status, start)

    def _write(self, id: int, address: int, data: bytes) -> int:
        """Write bytes to one servo, without a retry; see `write`."""
        self._clear_line()
        self._prepare("write", 1, len(data))
        try:
            return self._io.write(id, address, data)
        except BusError as error:
            self._note_failure(error)
            raise

    def _choose(self, ids: Sequence[int], blocks: Sequence[Block]) -> Block:
        """Return the first of `blocks` whose length differs from those of missing replies of `ids`.

        Raises:
            BusError: Every block has the length of a missing reply, and no time is left in the
                cycle to read another length first.
        """
        found = self._pending.choose(ids, blocks, self.clock())
        if found is not None:
            return found
        if not self.is_relaxed:
            raise BusError(f"id {ids[0]} may still send a late answer like this one", "late")
        for id in ids:
            self._resolve(id)
        return blocks[0]

    def _resolve(self, id: int) -> None:
        """Read a block of another length: its reply proves that no missing reply can come."""
        if ambiguous_lengths := self._pending.ambiguous_lengths(id):
            size = next(
                (n for n in range(MIN_REGISTERS, 0, -1) if n not in ambiguous_lengths), None
            )
            if size is None:
                raise BusError(f"id {id} has too many answers missing to be asked again", "late")
            self._read_block(id, Block(0, size))

    def _prepare(self, kind: Kind, servos: int, size: int, *, is_urgent: bool = False) -> float:
        """Set the reply timeout for a request, count the request, and return the present time [s].

        An urgent request has the same timeout outside of control cycles as within.
        """
        times = self._times.get((kind, servos, size)) or self.request_times(kind, servos, size)
        self._wire, timeout = times
        if self.is_relaxed and not is_urgent:
            timeout *= RELAXED_FACTOR
        self._reply_timeout = timeout
        if timeout != self._timeout:
            self._set_timeout(timeout)
        self.transactions += 1
        return self.sample_clock()

    def request_times(self, kind: Kind, servos: int, size: int) -> tuple[float, float]:
        """Return the wire time of a request, and its timeout within a cycle [s]."""
        times = self._times.get((kind, servos, size))
        if times is None:
            wire = wire_time(
                self._protocol,
                kind,
                servos,
                size,
                baudrate=self._baudrate,
                response_delay=self.response_delay,
            )
            timeout = reply_timeout(wire, self.latency, self._cycle, self._reply_timeout_min)
            times = self._times[kind, servos, size] = wire, timeout
        return times

    def _set_timeout(self, timeout: float) -> None:
        self._io.set_timeout(timeout)
        self._timeout = timeout

    def _with_retries(self, call: Callable[P, T], *args: P.args, **options: P.kwargs) -> T:
        """Return the result of `call(*args)`, a function that makes one request.

        After a temporary failure, drain the line and call again if the time in the cycle allows.
        """
        tries = TRIES if self.is_relaxed else 2
        while True:
            try:
                return call(*args, **options)
            except BusError as error:
                tries -= 1
                if tries == 0 or error.reason in {"gone", "noisy"}:
                    raise
                if not self._drain():
                    if self.is_relaxed:
                        raise BusError(NOISE_MESSAGE, "noisy") from error
                    raise
                if self._is_late():
                    raise
                self.counters.retries += 1

    def _is_late(self) -> bool:
        """Return True if a request that is sent now could time out after the end of the cycle."""
        return self.clock() + self._reply_timeout > self.deadline

    def _clear_line(self) -> None:
        """Drain the line if the last request failed.

        Raises:
            BusError: The port is gone, or the line cannot be drained.
        """
        self.check_port()
        if self.is_dirty and not self._drain():
            if self.is_relaxed:
                raise BusError(NOISE_MESSAGE, "noisy")
            raise BusError("no time left in this cycle", "late")

    def check_port(self) -> None:
        """Check that the port is present.

        Raises:
            BusError: The port has vanished.
        """
        if self.is_gone:
            raise BusError("the port is gone: close it, plug it in and open it again", "gone")

    def _note_failure(self, error: BusError) -> None:
        """Count a failed request by its reason; the line is drained before the next one."""
        self.is_dirty = True
        if error.reason == "gone":
            self.is_gone = True
        name = _COUNTER_OF_REASON.get(error.reason)
        if name is not None:
            setattr(self.counters, name, getattr(self.counters, name) + 1)

    def _drain(self) -> bool:
        """Wait until the line has been silent for the time of a reply; return False on timeout.

        Pings to an unused id discard the data on the line: a ping returns early if data arrive,
        else after its timeout. In a control cycle, the drain ends with the cycle. Outside, the line
        must be silent for a reply timeout, and the drain gives up after `DRAIN` plus this time.
        """
        self.counters.drains += 1
        is_relaxed = self.is_relaxed
        silence = SILENCE_SHARE * self._reply_timeout_min + self._wire + self.latency
        if is_relaxed:
            silence = max(silence, self._reply_timeout)
        end = self.deadline
        if is_relaxed:
            end = self.clock() + silence + (DRAIN_AGAIN if self.is_noisy else DRAIN)
        self._set_timeout(silence)
        while (started := self.clock()) + silence <= end:
            try:
                self._io.ping(self.unused_id)
            except BusError as error:
                if error.reason == "gone":
                    self.is_gone = True
                    raise
            if self.clock() - started >= silence:
                self.is_dirty = self.is_noisy = False
                return True
        self.is_noisy = self.is_noisy or is_relaxed
        return False


def _mismatch(id: int, block: Block, data: bytes, status: int) -> BusError:
    """Return the error for a reply whose length differs from the length of the block.

    Either the servo rejected the request, or the reply belongs to an earlier request.
    """
    if not data and status:
        return BusError(
            f"id {id} refuses to be read at {block.address}..{block.address + block.size - 1} "
            f"(status {status})",
            "refused",
            id,
        )
    return BusError(
        f"id {id} answered {len(data)} bytes instead of {block.size}: to an earlier request",
        "stale",
        id,
    )
