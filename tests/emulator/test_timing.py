"""Transmission times on the serial line, and delays of the USB adapter."""

from __future__ import annotations

import pytest
from emulator.helpers import le16, p1

from pliant import ConfigError
from pliant.emulator import Device, SerialLine, Timing
from pliant.emulator.packets import packet_2

IDS = list(range(1, 8))


def cycle(model, requests, baud=1_000_000, delay=0, **timing):
    """Return the frequency of a cycle of these requests on the wire [Hz]."""
    name = "return_delay_time"
    servos = [Device(model, id, **{name: delay}).build(baud) for id in IDS]
    line = SerialLine(servos, timing=Timing(wire=True, **timing))
    for request in requests:
        line.feed(request, baud)
    return 1.0 / sum(transaction.duration for transaction in line.log)


def sync_2(instruction, address, length, data=None):
    parts = b"".join(bytes([id]) + (bytes(length) if data else b"") for id in IDS)
    return packet_2(0xFE, instruction, bytes([*le16(address), *le16(length)]) + parts)


P1_RX = [p1(id, 2, 36, 8) for id in IDS] + [
    p1(0xFE, 0x83, 30, 6, *(byte for id in IDS for byte in (id, 0, 2, 0, 0, 0, 1)))
]
P1_MX = [p1(0xFE, 0x92, 0, *(byte for id in IDS for byte in (8, id, 36))), P1_RX[-1]]
P2_X = [sync_2(0x82, 126, 10), sync_2(0x83, 102, 18, data=True)]
P2_FAST = [sync_2(0x8A, 126, 10), sync_2(0x83, 224, 6, data=True)]
STS = [
    p1(0xFE, 0x82, 56, 15, *IDS),
    p1(0xFE, 0x83, 42, 8, *(byte for id in IDS for byte in (id, 0, 8, 0, 0, 0, 0, 0, 1))),
]


@pytest.mark.parametrize(
    ("model", "requests", "baud", "delay", "hertz"),
    [
        # Calculated by hand for the three families: 10 bits per byte and 30 us per reply, with
        # return delay 0 and with the factory value of 500 us.
        ("RX-64", P1_RX, 1_000_000, 0, 431),
        ("RX-64", P1_RX, 1_000_000, 250, 178),
        ("MX-64", P1_MX, 1_000_000, 0, 490),
        ("XM430-W350", P2_X, 1_000_000, 0, 298),
        ("XM430-W350", P2_X, 1_000_000, 250, 150),
        ("XM430-W350", P2_X, 4_000_000, 0, 1003),
        ("STS3215", STS, 1_000_000, 0, 394),
    ],
)
def test_cycles_per_second_on_the_wire(model, requests, baud, delay, hertz):
    turnaround = 30e-6 if delay == 0 else 0.0
    assert cycle(model, requests, baud, delay, turnaround=turnaround) == pytest.approx(
        hertz, rel=0.02
    )


def test_a_fast_read_pays_the_return_delay_once():
    fast = cycle("XM430-W350", P2_FAST, delay=250, turnaround=0.0)
    slow = cycle("XM430-W350", [P2_X[0], P2_FAST[1]], delay=250, turnaround=0.0)
    assert fast == pytest.approx(417, rel=0.02)
    assert slow == pytest.approx(172, rel=0.02)


def test_a_short_answer_waits_for_the_latency_timer():
    timing = Timing(usb_latency=0.016)
    assert timing.deliveries([(0.0, 0.001, b"x" * 6)])[0][0] == pytest.approx(0.016, rel=0.02)
    parts = timing.deliveries([(0.0, 0.001, b"x" * 100)])
    assert [len(data) for _, data in parts] == [62, 38]
    assert parts[0][0] == pytest.approx(0.00062)
    assert parts[1][0] == pytest.approx(0.00063 + 0.016, rel=0.01)


def test_seven_single_reads_through_a_16_ms_timer_take_a_tenth_of_a_second():
    line = SerialLine(
        [Device("RX-64", id, return_delay_time=0).build(1_000_000) for id in IDS],
        timing=Timing(wire=True, usb_latency=0.016),
    )
    total = sum(line.feed(request, 1_000_000)[-1].after for request in P1_RX[:-1])
    assert total == pytest.approx(0.114, abs=0.003)


def test_a_request_waits_until_the_wire_is_free():
    line = SerialLine(
        [Device("STS3215", id).build(1_000_000) for id in IDS],
        timing=Timing(wire=True, turnaround=0.0),
    )
    write_request, read_request = STS[1], p1(1, 2, 56, 15)
    (delivery,) = line.feed(write_request + read_request, 1_000_000)
    assert delivery.after == pytest.approx((len(write_request) + len(read_request) + 21) * 10e-6)
    assert line.occupied == pytest.approx(delivery.after)


def test_off_means_at_once():
    line = SerialLine([Device("STS3215", 1).build(None)])
    assert [d.after for d in line.feed(p1(1, 1))] == [0.0]


def test_errors():
    with pytest.raises(ConfigError, match="usb_latency"):
        Timing(usb_latency=-1.0)
