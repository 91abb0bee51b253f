"""Arbitrary bytes in place of a reply, in both protocols: the requested data or `BusError`."""

from __future__ import annotations

import os
import select
import threading
from collections import deque
from time import monotonic

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("rustypot", reason="the tests of servo buses need the extra servo")

from pliant.emulator.packets import packet_1, status_2
from pliant.emulator.pty import Pty
from pliant.servo import BusError
from pliant.servo._transactions import Reply, TransactionGuard
from pliant.servo.models import Block
from pliant.servo.transport import RustypotTransport

#: A reply comes immediately or never; a rejected one costs this time [s].
TIMEOUT = 0.004
SIZE, IDS = 6, (1, 2)
BLOCK = Block(56, SIZE)


class Replies:
    """Port whose other end answers every request with the next bytes of a queue."""

    def __init__(self, protocol):
        self.next, self.protocol = deque(), protocol
        self._pty, self._open = Pty("replies"), True
        self.transport = RustypotTransport(self._pty.path, 1_000_000, protocol, TIMEOUT)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        while self._open:
            readable, _, _ = select.select([self._pty.master], [], [], 0.05)
            if readable and os.read(self._pty.master, 4096) and self.next:
                os.write(self._pty.master, self.next.popleft())

    def close(self):
        self._open = False
        self._thread.join()
        self.transport.close()
        self._pty.hang_up()


@pytest.fixture(scope="module", params=["p1", "p1 by rustypot", "p2"])
def port(request):
    protocol, *others = request.param.split()
    replies = Replies(protocol)
    if others:
        replies.transport.serial = None
    yield replies, packet_1 if protocol == "p1" else status_2
    replies.close()


@st.composite
def damage(draw):
    """Return a function that damages the bytes of a valid reply."""
    kind = draw(st.integers(0, 5))
    position, byte = draw(st.integers(0, 63)), draw(st.integers(0, 255))
    rubbish = draw(st.binary(max_size=40))

    def apply(reply):
        at_here = position % len(reply)
        match kind:
            case 0:
                return reply[:at_here] + bytes([byte]) + reply[at_here + 1 :]
            case 1:
                return reply[:at_here]
            case 2:
                return reply[:at_here] + rubbish + reply[at_here:]
            case 3:
                return reply + reply
            case 4:
                return rubbish + reply
            case _:
                return rubbish

    return apply


#: Data, id and error byte of a reply with a valid checksum.
LIES = st.tuples(st.binary(max_size=20), st.integers(0, 253), st.integers(0, 255))


@pytest.mark.parametrize("call", ["read", "sync_read", "write", "ping"])
@settings(
    max_examples=12,
    deadline=None,
    derandomize=True,  # one damaged packet in 256 has a valid eight-bit checksum
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(damage_reply=damage(), lie=st.one_of(st.none(), LIES))
def test_a_damaged_reply(port, call, damage_reply, lie):
    replies, packet = port
    # Use a new guard for each input: after a failure a guard first waits for late replies.
    guard = TransactionGuard(
        replies.transport, replies.protocol, baudrate=1_000_000, unused_id=200, clock=monotonic
    )
    data = bytes(range(1, 1 + SIZE))
    answer = packet(IDS[0], 0, data if "read" in call else b"")
    if call == "sync_read":
        answer += packet(IDS[1], 0, data)
    replies.next.append(packet(lie[1], lie[2], lie[0]) if lie else damage_reply(answer))
    decoded = []
    try:
        match call:
            case "read":
                decoded = [guard.read(IDS[0], BLOCK)]
            case "sync_read":
                block, answers, time = guard.sync_read(IDS, BLOCK)
                decoded = [Reply(block, *answer, time) for answer in answers]
            case "write":
                assert 0 <= guard.write(IDS[0], 30, b"\x01") <= 255
            case _:
                assert guard.ping(IDS[0]) in (True, False)
    except BusError as error:
        assert error.reason != "gone", error  # noqa: PT017
    for reply in decoded:
        assert len(reply.data) == SIZE
        assert lie or reply.data == data, "a damaged packet is taken for another one"
    replies.next.clear()
