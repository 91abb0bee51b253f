"""Late replies: a reply after its timeout is not taken for the reply to a later request."""

import numpy as np
import pytest

from pliant.servo import BusError
from pliant.servo._transactions import Reply, TransactionGuard
from pliant.servo.models import get_model

#: Size of the position that servos report [byte]: here it is the time of the request [µs].
STAMP = 8


class LateLine:
    """Serial line with delayed replies, in simulated time.

    Args:
        ids: Servos.
        arrival: Function that returns the arrival time of a byte sent at a given time [s].
        keeps_order: True if replies arrive in the order in which they were sent.
    """

    def __init__(self, ids, arrival, *, keeps_order):
        self.ids, self._held, self._keeps_order = ids, arrival, keeps_order
        self.now, self.timeout = 0.0, 0.01
        self._coming, self._latest = [], 0.0

    def clock(self):
        return self.now

    def _ask(self, ids, size):
        # Discard bytes that have arrived, as rustypot does before a request.
        self._coming = [packet for packet in self._coming if packet[0] > self.now]
        for k, id in enumerate(ids):
            if id in self.ids:
                send_time = self.now + 0.0002 * (k + 1)
                arrival_time = max(
                    self._held(send_time), self._latest if self._keeps_order else 0.0
                )
                self._latest = arrival_time
                data = int(send_time * 1e6).to_bytes(STAMP, "little").ljust(size, b"\0")
                self._coming.append((arrival_time, id, data))

    def _take(self, id, end):
        """Return the next packet that arrives, from any servo and of any length."""
        self._coming.sort(key=lambda packet: packet[0])
        if not self._coming or self._coming[0][0] > end:
            self.now = end + 1e-6  # the time is past the timeout
            raise BusError("nothing came", "timeout", id)
        arrival_time, sender, data = self._coming.pop(0)
        self.now = max(self.now, arrival_time)
        if sender != id:
            raise BusError(f"{sender} answered", "corrupt", id)
        return data, 0

    def read(self, id, address, size):
        self._ask([id], size)
        return self._take(id, self.now + self.timeout)

    def sync_read(self, ids, address, size):
        self._ask(ids, size)
        end = self.now + self.timeout
        return [self._take(id, end) for id in ids]

    def ping(self, id):
        self._ask([id], 3)
        begin = self.now
        try:
            self._take(id, begin + self.timeout)
        except BusError as error:
            if error.reason == "timeout":
                return False
            raise
        return True

    def set_timeout(self, seconds):
        self.timeout = seconds


def stalls(rng, longest):
    """Return the argument `arrival` of a `LateLine` that stalls at random, up to `longest` [s].

    Bytes sent during a stall arrive at its end.
    """
    ends = np.cumsum(rng.exponential([[0.2], [0.1]], (2, 4000)).T.ravel())
    lengths = np.minimum(np.diff(ends)[::2], longest)
    begins = ends[:-1:2]

    def held(time):
        k = int(np.searchsorted(begins, time)) - 1
        return max(time, begins[k] + lengths[k]) if k >= 0 else time

    return held


@pytest.mark.parametrize("keeps_order", [True, False])
@pytest.mark.parametrize("model", ["STS3215-7.4V", "XM430-W350", "EX-106+"])
@pytest.mark.parametrize("patience", [0.002, 0.02])
def test_no_answer_from_before_a_stall_is_taken(model, patience, keeps_order):
    rng = np.random.default_rng(5)
    if keeps_order:
        arrival = stalls(rng, 1.5)
    else:
        arrival = lambda time: time + rng.choice([0.0, 0.3], p=[0.97, 0.03]) * rng.random()  # noqa: E731
    family = get_model(model).family
    blocks = [type(block)(block.address, block.size) for block in family.read]
    bus = LateLine([1, 2, 3], arrival, keeps_order=keeps_order)
    guard = TransactionGuard(
        bus,
        family.protocol,
        baudrate=1_000_000,
        reply_timeout_min=patience,
        unused_id=200,
        clock=bus.clock,
    )
    accepted = 0
    for cycle in range(6000):
        bus.now = max(bus.now, 0.01 * cycle)
        guard.start_cycle(0.03)
        replies = {}
        try:
            block, answers, time = guard.sync_read(bus.ids, *blocks)
            replies = {
                id: Reply(block, *answer, time) for id, answer in zip(bus.ids, answers, strict=True)
            }
        except BusError:
            for id in bus.ids:
                try:
                    replies[id] = guard.read(id, *blocks, again=False)
                except BusError:
                    continue
        for reply in replies.values():
            request_time = int.from_bytes(reply.data[:STAMP], "little") * 1e-6
            assert reply.time <= request_time <= bus.now
            accepted += 1
    # Most positions arrived, and some late replies had to be discarded.
    assert accepted > 6000
    assert guard.counters.stale > 10
