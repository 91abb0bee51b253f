"""Requests of Protocol 1.0 through the descriptor of the port, and readings that contain status."""

import math
import os
import select
import subprocess
import sys
import threading
import time
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rustypot", reason="the tests of servo buses need the extra servo")

from pliant import emulator
from pliant._core import BusCycle, BusStatus, JointReadings, OutOfRangeError, ServoCodec
from pliant.emulator.pty import Pty
from pliant.servo import BusError, RustypotTransport, ServoSpec, transport
from pliant.servo._device import Device
from pliant.servo._transactions import TransactionGuard

SIZE = 4


def packet(id, data=b"\1\2\3\4", status=0):
    body = bytes((id, len(data) + 2, status)) + data
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


if transport.sys.platform != "win32":
    from pliant._core import ServoGroup

READINGS = ("position", "ok", "time", "velocity", "load", "current")


class Answering:
    """Port whose other end answers each request with the same bytes, and stores the requests."""

    def __init__(self, *, with_descriptor=True, monkeypatch=None):
        self.pty, self.reply, self.requests = Pty("answering"), b"", []
        if not with_descriptor:
            monkeypatch.setattr(transport, "_descriptors", lambda path: set())
        self.io = RustypotTransport(self.pty.path, 1_000_000, "p1", 0.05)
        assert (self.io.serial is not None) == with_descriptor
        self._open = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        while self._open:
            if select.select([self.pty.master], [], [], 0.02)[0]:
                self.requests.append(os.read(self.pty.master, 4096))
                os.write(self.pty.master, self.reply)

    def wait_for(self, size):
        """Wait until the requests have this number of bytes."""
        while sum(map(len, self.requests)) < size:
            time.sleep(0.001)

    def stop(self):
        self._open = False
        self._thread.join()

    def close(self):
        self.stop()
        self.io.close()
        self.pty.close()


@pytest.fixture(params=[True, False], ids=["descriptor", "rustypot"])
def port(request, monkeypatch):
    answering = Answering(with_descriptor=request.param, monkeypatch=monkeypatch)
    yield answering
    answering.close()


def test_requests_and_valid_replies_are_those_of_rustypot(port):
    port.reply = packet(3, status=32)
    assert port.io.read(3, 56, SIZE) == (b"\1\2\3\4", 32)
    port.reply = packet(3) + packet(5, b"\5\6\7\xff", 1)
    assert port.io.sync_read([3, 5], 56, SIZE) == [(b"\1\2\3\4", 0), (b"\5\6\7\xff", 1)]
    port.reply = b""
    port.io.sync_write([3, 5], 42, [b"\1\2", b"\3\4"])
    while len(port.requests) < 3:
        time.sleep(0.001)
    # Bytes that arrived before the request are not part of its reply.
    os.write(port.pty.master, packet(9))
    time.sleep(0.05)
    port.reply = packet(3)
    assert port.io.read(3, 56, SIZE)[0] == b"\1\2\3\4"
    assert [request[:-1] for request in port.requests] == [
        bytes((255, 255, 3, 4, 2, 56, SIZE)),
        bytes((255, 255, 254, 6, 130, 56, SIZE, 3, 5)),
        bytes((255, 255, 254, 10, 131, 42, 2, 3, 1, 2, 5, 3, 4)),
        bytes((255, 255, 3, 4, 2, 56, SIZE)),
    ]
    assert all(sum(request[2:]) % 256 == 255 for request in port.requests)


@pytest.mark.parametrize(
    ("reply", "reason", "id"),
    [
        (b"", "timeout", 3),
        (packet(3), "timeout", 5),
        (packet(3) + packet(5)[:-1], "timeout", 5),
        (packet(5), "corrupt", 3),
        (packet(3) + packet(4), "corrupt", 5),
        (packet(3)[:-1] + b"\0" + packet(5), "corrupt", 3),
        (b"\0" + packet(3) + packet(5), "corrupt", 3),
    ],
)
def test_wrong_replies(port, reply, reason, id):
    port.reply = reply
    with pytest.raises(BusError) as error:
        port.io.sync_read([3, 5], 56, SIZE)
    assert error.value.reason == reason
    if port.io.serial is not None:
        assert error.value.id == id


@pytest.mark.parametrize("data", [b"", b"\1\2\3", b"\1\2\3\4\5", b"\1" * 20])
def test_a_reply_of_another_length_is_no_reply_to_this_request(port, data):
    port.reply = packet(3, data)
    assert len(port.io.read(3, 56, SIZE)[0]) != SIZE
    port.reply = packet(3, data) + packet(5)
    assert len(port.io.sync_read([3, 5], 56, SIZE)[0][0]) != SIZE


def test_a_port_that_vanishes():
    answering = Answering()
    answering.stop()
    answering.pty.hang_up()
    with pytest.raises(BusError, match="gone") as error:
        answering.io.sync_read([3, 5], 56, SIZE)
    assert error.value.reason == "gone"
    answering.close()


def codec_of_two():
    """Return a codec of two servos with readings at time 0, and their block without status."""
    codec = ServoCodec(2, 2)
    for i in range(2):
        Device(ServoSpec(name="pan", model="STS3215", id=i, port="a"), i, i, 1).attach(codec, i)
    family = ServoSpec(name="pan", model="STS3215", id=1, port="a").row.family
    return codec, family, family.read[0]


@pytest.mark.skipif(transport.sys.platform == "win32", reason="readings are decoded in Python")
def test_readings_decoded_with_the_request_are_those_decoded_after_it():
    rng = np.random.default_rng(0)
    port = Answering()
    (codec, family, block), (other, _, _) = codec_of_two(), codec_of_two()
    group = ServoGroup(port.io.serial, codec, [0, 1], [3, 5])
    results = set()
    for cycle in range(60):
        time = 0.01 * cycle + (1.0 if cycle > 40 else 0.0)
        values = [
            {
                "position": int(2000 + rng.integers(3) + 1500 * (rng.random() < 0.1)),
                "speed": int(rng.integers(100)),
                "voltage": 70 + (cycle == 20),
            }
            for _ in range(2)
        ]
        statuses = [int(rng.random() < 0.05) for _ in range(2)]
        data = [family.layout(block).encode(row) for row in values]
        port.reply = b"".join(map(packet, (3, 5), data, statuses))
        is_regular = bool(cycle % 3)
        decoded = group.read(block, 0.05, time, 0.5, is_regular)
        answers = list(zip(data, statuses, strict=True))
        notable = other.decode([0, 1], answers, block.address, time, 0.5)
        is_usual = is_regular and not notable
        assert isinstance(decoded, JointReadings) if is_usual else decoded == (answers, notable)
        for name in READINGS:
            readings = decoded if is_usual else codec.joints([0, 1])
            np.testing.assert_array_equal(
                getattr(readings, name), getattr(other.joints([0, 1]), name)
            )
        for i, result in notable:
            if result is None:
                codec.decode([i], [answers[i]], block.address, time, math.inf)
                other.decode([i], [answers[i]], block.address, time, math.inf)
        results |= {result for _, result in notable} | {is_usual}
    assert results == {None, False, True}
    port.close()


@pytest.mark.skipif(transport.sys.platform == "win32", reason="commands are encoded in Python")
def test_a_command_encoded_with_its_packet_is_the_command_encoded_before_it():
    port = Answering()
    codec, family, _ = codec_of_two()
    ids, command = [3, 5], ([0.1, -0.2], [0.5, 0.25], [1.0, math.inf], 2.0)
    group, blocks = ServoGroup(port.io.serial, codec, [0, 1], ids), family.write_blocks
    goals, limits, _, packets, _ = codec.encode([0, 1], *command)
    assert codec.sent(0)[::3] == (None, b"")
    group.write(blocks, 0.05, *command)
    size = 8 + len(ids) * (1 + len(packets[0]))
    port.wait_for(size)
    port.io.sync_write(ids, family.write_blocks[0].address, packets)
    port.wait_for(2 * size)
    sent = b"".join(port.requests)
    assert sent[:size] == sent[size:]
    counts = [codec.sent(i)[2] for i in range(2)]
    assert [codec.sent(i)[0] for i in range(2)] == goals
    assert [codec.sent(i)[1] for i in range(2)] == limits
    assert [codec.sent(i)[3] for i in range(2)] == packets
    # The first servo's command is valid, the other's is not: nothing is sent.
    for bad in (([0.3, math.nan], [0.5, 0.5], None, 2.0), ([0.3, 0.3], [0.5, -1.0], None, 2.0)):
        with pytest.raises(OutOfRangeError, match="command"):
            ServoGroup(port.io.serial, codec, [0], ids[:1]).write(blocks, 0.05, *bad)
    address, block_size = blocks[0]
    with pytest.raises(ValueError, match="one row of the size of the block"):
        group.write([(address, block_size - 1)], 0.05, *command)
    port.reply = packet(3)
    port.io.read(3, 56, SIZE)
    assert b"".join(port.requests)[2 * size :] == bytes((255, 255, 3, 4, 2, 56, SIZE, 186))
    # If the port is gone, the command is not recorded as sent.
    port.stop()
    port.pty.hang_up()
    guard = TransactionGuard(port.io, "p1", baudrate=1_000_000)
    with pytest.raises(BusError, match="gone"):
        guard.sync_encode(group, 2, blocks, ([0.3] * 2, [0.1] * 2, None, 0))
    assert guard.is_gone
    assert [codec.sent(i)[0] for i in range(2)] == goals
    assert [codec.sent(i)[2] for i in range(2)] == counts
    port.close()


@pytest.mark.skipif(transport.sys.platform == "win32", reason="readings are decoded in Python")
@pytest.mark.parametrize("at_once", [False, True])
def test_no_reading_is_stored_unless_all_replies_are_valid(at_once):
    port = Answering()
    codec, family, block = codec_of_two()
    group = ServoGroup(port.io.serial, codec, [0, 1], [3, 5])

    class Bus(BusCycle):
        """Bus of the two servos on the port of `guard`."""

        def __init__(self, guard):
            self.guard, status = guard, BusStatus([0.0, 0.0])
            status.set_new(1, True)
            numbers = (*block, *block, 0.05, 0.05, 1, 9.0, 1.0)
            self.set_reading(guard, status, group, {}, numbers)

        def _finish_read(self, found, has_status, times):
            assert not has_status
            assert times[1] == 0.01
            return self.guard.finish_sync_read([3, 5], block, times, found)

    def read():
        # Use a new guard, because after a failure a guard first waits for late replies.
        guard = TransactionGuard(port.io, "p1", baudrate=1_000_000, sample_clock=lambda: 0.01)
        try:
            if at_once:
                Bus(guard).read()
            else:
                guard.start_cycle(1.0)
                guard.sync_decode([3, 5], [block], group, 9.0, usual=True)
        finally:
            counters = guard.counters
            assert (guard.transactions, counters.timeouts + counters.corrupt) in {(1, 1), (1, 0)}
            assert guard.missing.keys() == {3, 5}
            assert guard.is_dirty

    def values():
        return [getattr(codec.joints([0, 1]), name).tolist() for name in READINGS]

    first = family.layout(block).encode({"position": 2000})
    codec.decode([0, 1], [(first, 0), (first, 0)], block.address, 0.0, 9.0)
    before = values()
    valid = packet(3, family.layout(block).encode({"position": 2001}))
    other = packet(5, family.layout(block).encode({"position": 2001}))
    for reply, reason in (
        (valid, "timeout"),
        (valid + other[:-1] + b"\0", "corrupt"),
        (valid + packet(7, b"\0" * block.size), "corrupt"),
    ):
        port.reply = reply
        with pytest.raises(BusError) as error:
            read()
        assert (error.value.reason, error.value.id) == (reason, 5)
    port.reply = valid + packet(5, b"\0" * (block.size - 1))
    with pytest.raises(BusError) as error:
        read()
    assert (error.value.reason, error.value.id) == ("stale", 5)
    assert values() == before
    port.reply = valid + packet(5, family.layout(block).encode({"position": 2001}))
    guard = TransactionGuard(port.io, "p1", baudrate=1_000_000, sample_clock=lambda: 0.01)
    found = Bus(guard).read()
    assert isinstance(found, JointReadings)
    assert not guard.is_dirty
    assert not guard.missing
    assert values() == [getattr(found, name).tolist() for name in READINGS] != before
    port.close()
    with pytest.raises(OSError, match="serial port"):
        group.read(block, 0.05, 0.01, 9.0, True)
    with pytest.raises(BusError, match="another thread"):
        port.io.read(3, 56, SIZE)


@pytest.mark.parametrize(("kind", "requests"), [("sts", 2), ("mx", 4), ("xm", 3)])
def test_status_is_read_with_the_position_where_registers_are_near(
    emulated, enabled, kind, requests
):
    n = 3
    with emulated(kind, n, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        seen_faults, cycles = {}, 4 * n
        for cycle in range(cycles):
            if cycle == n:
                before = servo_bus.counters["transactions"]
                limit = 0.5 * limit
            servo_bus.read()
            servo_bus.write(np.zeros(n), limit)
            status = servo_bus.poll_status()
            bus.advance(0.01)
            if status is not None:
                seen_faults[status.name] = status
        transactions = servo_bus.counters["transactions"] - before
        # In Protocol 2.0 the registers are far apart, so each cycle has a request for the status.
        assert transactions == pytest.approx(
            requests * (cycles - n), abs=0.4 * cycles if kind == "xm" else 0
        )
        if kind != "xm":
            assert list(seen_faults) == list(servo_bus.names)
            limits = [
                joint[0].units.torque(servo.get("torque_limit"))
                for joint, servo in zip(servo_bus._joints, bus.servos, strict=True)
            ]
            assert limits == pytest.approx(limit, rel=0.05)
        assert servo_bus.counters["mismatches"] == 0
        bus.servo(2).put("torque_enable", 0)
        faults = ()
        for _ in range(2 * n):
            servo_bus.read()
            servo_bus.write(np.zeros(n), limit)
            faults += getattr(servo_bus.poll_status(), "faults", ())
            bus.advance(0.01)
        # An MX servo (Protocol 1.0) switches torque on again with the next goal.
        assert ("torque went off by itself" in " ".join(faults)) == (kind != "mx")


@pytest.mark.parametrize(
    ("text", "id", "message", "reason", "blamed"),
    [
        ("Operation timed out", None, "p: no answer", "timeout", None),
        ("Operation timed out", 3, "p, id 3: no answer", "timeout", 3),
        ("motor 4: timeout", 3, "p, id 4: no answer", "timeout", 4),
        ("motor 4: Invalid checksum", None, "p, id 4: broken answer (Inv", "corrupt", 4),
        ("motor x: parsing", 3, "p, id 3: broken answer (parsing)", "corrupt", 3),
        ("Input/output error", 3, "p is gone (Input/output error)", "gone", None),
    ],
)
def test_errors_of_the_driver_name_port_and_servo(text, id, message, reason, blamed):
    io = object.__new__(RustypotTransport)
    io.port = "p"
    error = io._failed(RuntimeError(text), id)
    assert str(error).startswith(message)
    assert (error.reason, error.id) == (reason, blamed)


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("Permission denied", "join the group"),
        ("Access is denied.", "join the group"),
        ("Unable to acquire exclusive lock", "in use by another program"),
        ("Device or resource busy", "in use by another program"),
        ("No such file or directory", "there is no port p; there are: "),
        ("No such device", "there is no port p; there are: "),
        ("Not a typewriter", "p is not a serial port; there are: "),
        ("Inappropriate ioctl for device", "p is not a serial port; there are: "),
        ("Input/output error", "cannot open p: Input/output error"),
    ],
)
def test_a_port_that_cannot_be_opened_has_its_remedy(text, remedy):
    assert remedy in transport._cannot_open("p", text)


def test_a_port_that_this_program_has_open_is_told_apart(monkeypatch):
    monkeypatch.setattr(transport, "_OPEN", {os.path.realpath("p")})
    for port, what in (("p", "another arm or bus of this program"), ("q", "another program")):
        assert f"{port} is in use by {what}: close" in transport._cannot_open(port, "busy")


@pytest.mark.parametrize("protocol", ["p1", "p2"])
def test_a_closed_port_is_free_while_another_thread_starts_a_program(protocol):
    master, slave = os.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    opened = RustypotTransport(path, 1_000_000, protocol)
    # Between fork and exec, a program that is being started has copies of the descriptors.
    copies = [os.dup(number) for number in opened._descriptors]
    opened.close()
    RustypotTransport(path, 1_000_000, protocol).close()
    for number in (*copies, master):
        os.close(number)
    assert copies


TIMED = """
import atexit, os, signal, time
from pliant.servo import BusError, RustypotTransport
master, slave = os.openpty()
transport = RustypotTransport(os.ttyname(slave), 1_000_000, {protocol!r}, 0.05)
handled = []
signal.signal(signal.SIGALRM, lambda *_: handled.append(1))
signal.setitimer(signal.ITIMER_REAL, 0.005, 0.005)
for request in (lambda: transport.ping(7), lambda: transport.write(7, 64, b"1")):
    try:
        print(request())
    except BusError as error:
        print(error.reason)
handled.clear()
while len(handled) < 3:  # the timer goes on
    time.sleep(0.001)
# A descent at the end of the program makes requests when no thread can start any more.
atexit.register(lambda: print(transport.ping(8)))
"""


@pytest.mark.parametrize("protocol", ["p1", "p2"])
def test_a_missing_reply_ends_the_wait_although_a_timer_interrupts_it(protocol):
    # Use a separate program, which can be killed: an endless wait would not return to Python.
    program = [sys.executable, "-c", TIMED.format(protocol=protocol)]
    result = subprocess.run(program, capture_output=True, text=True, timeout=30, check=False)
    assert result.stdout.split() == ["False", "timeout", "False"], result.stderr


def test_a_port_whose_link_is_gone_counts_as_closed(tmp_path):
    with emulator.Emulator([emulator.Device("STS3215", id=1)]) as bus:
        link = tmp_path / "by-id"
        link.symlink_to(bus.port)
        own = transport.RustypotTransport(str(link), 1_000_000, "p1")
        assert os.path.realpath(link) in transport._OPEN
        link.unlink()
        own.close()
        assert os.path.realpath(bus.port) not in transport._OPEN


@pytest.mark.parametrize(
    ("error", "is_closed", "reason", "text"),
    [
        (TimeoutError(), False, "timeout", "cannot be sent"),
        (OSError("unplugged"), False, "gone", "unplugged"),
        (OSError("bad file descriptor"), True, "gone", "closed by another thread"),
    ],
)
def test_an_error_of_the_port_is_named(error, is_closed, reason, text):
    port = object.__new__(RustypotTransport)
    port.port, port.serial = "p", SimpleNamespace(closed=is_closed)
    found = port.lost(error)
    assert found.reason == reason
    assert text in str(found)


@pytest.mark.parametrize(
    ("ids", "address", "data"),
    [
        ([1], 64, [b"\0"]),
        ([1, 2, 252], 116, [b"\1\2\3\4", b"\xff\xff\xfd\0", b"\xff\xff\xff\xfd"]),
    ],
)
def test_a_packet_that_needs_no_silence_is_that_of_rustypot(ids, address, data):
    with closing(Pty("p2")) as pty, closing(RustypotTransport(pty.path, 1_000_000, "p2")) as io:
        io.sync_write(ids, address, data)
        assert os.read(pty.master, 256) == transport.sync_write_packet(ids, address, data)


def test_a_packet_without_a_reply_is_sent_on_a_line_that_is_never_silent():
    """rustypot waits for silence: of 600 packets of Protocol 2.0 it sent 22."""
    part = emulator.Device("XM430-W350", 1)
    with (
        emulator.Emulator([part], clock="steps") as bus,
        closing(RustypotTransport(bus.port, 1_000_000, "p2", 0.01)) as io,
    ):
        bus.hum()
        for gain in range(800, 820):
            io.sync_write([1], 84, [gain.to_bytes(2, "little")])
            bus.sync()
            assert bus.servos[0].get("position_p_gain") == gain
