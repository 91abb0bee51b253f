"""A guard around every transaction of one port.

The protocols carry no sequence number, so a late answer to an earlier request looks like the answer
to this one, but for its length. So the length is the number: a request that was not answered well
*owes* an answer, and no other of that servo asks for as many bytes before one of another length
has been answered. A servo answers in order and a line keeps it: that answer proves that nothing
older can still come. Where there is a choice, the length is avoided for a second in any case,
should something between host and servo not keep the order. What is owed for two seconds is given
up: an arm without positions for so long is on its way down.

What is late still spoils the next answers. So after a failure the line is drained too, by pings to
an id that nobody has, until it has been silent for as long as an answer may take.
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

#: Least window of silence, as a share of the patience: a host that was busy for a moment.
SILENCE_SHARE = 0.2
#: Outside of a cycle there is no hurry: so many times the patience, and so many tries. One that
#: brings an answer to an earlier request is a try too.
UNHURRIED, TRIES = 5.0, 6
#: Longest drain outside of a cycle [s], and of those that follow one that failed: a line that an
#: adapter's echo or noise never leaves silent must not hold anybody up.
DRAIN, DRAIN_AGAIN = 0.5, 0.05
#: Data bytes that a ping is answered with, and the most that any servo has at address 0 without a
#: gap.
PING, FIRST = {"p1": 0, "p2": 3}, 12
#: So many ids are tried for one that nobody has.
ABSENT_TRIES = 8
#: Which counter a failure counts in.
_COUNTED = {"timeout": "timeouts", "corrupt": "corrupt", "stale": "stale", "refused": "refused"}


@dataclass
class Counters:
    """What has happened on one port since it was opened.

    Attributes:
        transactions: Requests sent, retries included, pings of drains not.
        retries: Requests sent once more.
        timeouts: No or no whole answer.
        corrupt: Answers with a wrong checksum, frame or id.
        stale: Answers that were not to the request they came after: kept out.
        drains: How often the line had to be drained.
        refused: Requests that a servo answered with a refusal.
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
    """An answer of one servo.

    Attributes:
        block: What was read.
        data: Its bytes.
        status: The error byte.
        time: When the request was sent [s].
    """

    block: Block
    data: bytes
    status: int
    time: float


class Guard:
    """Transactions of one port with drain, one retry and counters.

    Args:
        transport: The port.
        protocol: `p1` or `p2`.
        baudrate: Bits per second.
        latency: The adapter's latency timer [s].
        cycle: Control period [s].
        patience: Least time to wait for an answer [s].
        absent: An id that no servo on the port has; drains listen behind it.
        clock: The time by which it waits.
        stamp: The time that replies carry; default the same.

    Attributes:
        counters: What has happened so far.
        turn: Time of the slowest servo to begin its answer [s].
        latency: The adapter's latency timer [s].
        held_back: Least time that an answer to a reading came later than the wire takes [s].
        gone: Whether the port has vanished; every call then fails at once.
        is_noisy: Whether the last drain without a budget never found the line silent.
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
        """Take over the port; nothing is sent yet."""
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
        """Start a cycle: no retry and no drain goes on after `budget` [s] from now.

        Without a budget there is no hurry: longer waits, and more tries.
        """
        self._deadline = self._clock() + budget

    def read(self, id: int, *blocks: Block, again: bool = True) -> Reply:
        """Read a block of one servo; after a failure drain and try once more.

        Args:
            id: The servo.
            *blocks: What will do, of different lengths; the first is read whose length no answer
                owed has.
            again: Whether a failure is followed by a second try.

        Raises:
            BusError: All tries failed, or there was no time for another; `late` where every length
                is owed, until a reading of another length has been answered.
        """

        def once() -> Reply:
            return self._read(id, self._choose([id], blocks))

        return self._tried(once) if again else self._once(once)

    def sync_read(self, ids: Sequence[int], *blocks: Block) -> dict[int, Reply]:
        """Read a block, as `read`, of several servos with one request; not tried twice.

        It is all or nothing; after a failure ask them one by one.
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
        """Write bytes of one servo, return the status of the answer; tried twice."""

        def once() -> int:
            self._start("write", 1, len(data))
            return self._io.write(id, address, data)

        return self._tried(once)

    def sync_write(self, ids: Sequence[int], address: int, data: Sequence[bytes]) -> None:
        """Write several servos with one packet; nobody answers, so only the port can fail."""

        def once() -> None:
            self._start("sync_write", len(ids), len(data[0]))
            self._io.sync_write(ids, address, data)

        # Nobody answers, so nothing stale can come of a line that is not silent.
        self.check_port()
        self._counted(once)

    def ping(self, id: int) -> bool:
        """Whether a servo answers; not tried twice."""

        def once() -> bool:
            self._start("ping", 1, 0, hurry=True)
            before = self._clock()
            answered = self._io.ping(id)
            if not answered:
                # Whoever was late, or two at once, may still be talking.
                self._dirty = True
                self._owed.add([id], PING[self._protocol], before)
            return answered

        return self._once(once)

    def reboot(self, id: int) -> None:
        """Restart a servo; whether it answers before it goes is its own affair."""

        def once() -> None:
            self._start("write", 1, 0)
            try:
                self._io.reboot(id)
            finally:
                self._dirty = True

        self._once(once)

    def find_absent(self, taken: Iterable[int], highest: int) -> None:
        """Choose the highest id that is not taken and that nobody answers to, for drains.

        Where every id seems to answer, as on a line that echoes, the present one stays.
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
        """The first block of a length that nobody owes.

        Raises:
            BusError: All are owed still, and there is no time to find out more.
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
        """Read the first bytes of a servo, of a length that it does not owe."""
        if barred := self._owed.barred(id):
            size = next((n for n in range(FIRST, 0, -1) if n not in barred), None)
            if size is None:
                raise BusError(f"id {id} owes too many answers to be asked again", "late")
            self._read(id, Block(0, size))

    @contextmanager
    def _owing(self, ids: Sequence[int], size: int) -> Iterator[None]:
        """Inside, answers of this length are asked for; owed unless it ends well."""
        before = self._clock()
        try:
            yield
        except BusError:
            self._owed.add(ids, size, before)
            raise
        self._owed.settle(ids)

    def _checked(self, id: int, block: Block, data: bytes, status: int, start: float) -> Reply:
        """An answer of the right length; any other was not to this request."""
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
        """Set the timeout for what comes, count it, and note the time."""
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
        """Call; after a failure that can pass, drain and call again if the budget allows."""
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
        """Whether an answer to one more request could come after the deadline."""
        return self._clock() + self._waited > self._deadline

    def _once(self, call: Callable[[], T]) -> T:
        """One call on a silent line."""
        self.check_port()
        if self._dirty and not self._drain():
            if isinf(self._deadline):
                raise BusError(NOISY, "noisy")
            raise BusError("no time left in this cycle", "late")
        return self._counted(call)

    def check_port(self) -> None:
        """See that the port is there.

        Raises:
            BusError: It has vanished.
        """
        if self.gone:
            raise BusError("the port is gone: close it, plug it in and open it again", "gone")

    def _counted(self, call: Callable[[], T]) -> T:
        """Call, and count what fails."""
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
        """Listen until the line has been silent for a whole answer; False when time ran out.

        A ping to an absent id reads whatever arrives: it comes back early when there was
        something, and after its timeout when there was nothing. Without hurry it listens for as
        long as an answer is waited for, and gives up after `DRAIN`.
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
