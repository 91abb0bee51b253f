"""`wire_bytes` and `wire_time` compared with values calculated by hand."""

import numpy as np
import pytest

from pliant.emulator import Timing
from pliant.servo import wire_bytes, wire_time
from pliant.servo._transactions import RESPONSE_DELAY, reply_timeout


def rate(*transactions, baudrate):
    """Return the number of cycles of these transactions per second [Hz]."""
    return 1.0 / sum(wire_time(*t, baudrate=baudrate) for t in transactions)


@pytest.mark.parametrize(
    ("cycle", "baudrate", "expected"),
    [
        ([("p1", "read", 1, 8)] * 7 + [("p1", "sync_write", 7, 6)], 1e6, 431),
        ([("p2", "sync_read", 7, 10), ("p2", "sync_write", 7, 18)], 1e6, 298),
        ([("p2", "sync_read", 7, 10), ("p2", "sync_write", 7, 20)], 1e6, 286),
        ([("p2", "sync_read", 7, 10), ("p2", "sync_write", 7, 18)], 4e6, 1003),
        ([("p1", "sync_read", 7, 15), ("p1", "sync_write", 7, 8)], 1e6, 394),
    ],
)
def test_rates_of_seven_servos(cycle, baudrate, expected):
    assert rate(*cycle, baudrate=baudrate) == pytest.approx(expected, abs=1)


def test_bytes_of_the_packets_in_the_manuals():
    # Request FF FF 01 04 02 2B 01 CC, reply FF FF 01 03 00 20 DB.
    assert wire_bytes("p1", "read", 1, 1) == (8, 7)
    # Request FF FF FD 00 01 07 00 02 84 00 04 00 1D 15, reply with 4 data bytes.
    assert wire_bytes("p2", "read", 1, 4) == (14, 15)
    assert wire_bytes("p2", "ping", 1, 0) == (10, 14)
    assert wire_bytes("p1", "ping", 1, 0) == (6, 6)


def test_a_return_delay_counts_once_per_reply():
    quick = wire_time("p2", "sync_read", 7, 10, baudrate=1_000_000)
    delay = RESPONSE_DELAY + 500e-6
    slow = wire_time("p2", "sync_read", 7, 10, baudrate=1_000_000, response_delay=delay)
    assert slow - quick == pytest.approx(7 * 500e-6)


def test_a_timeout_is_twice_wire_and_latency_but_at_most_three_periods():
    # Arguments: time on the wire, latency of the adapter, control period [s].
    assert reply_timeout(0.001, 0.001, 0.01) == pytest.approx(0.010)
    assert reply_timeout(0.003, 0.016, 0.02) == pytest.approx(0.043)
    assert reply_timeout(0.003, 0.016, 0.01) == pytest.approx(0.030)


@pytest.mark.parametrize(
    ("kind", "cycle"),
    [
        ("sts", [("p1", "sync_read", 3, 15), ("p1", "sync_write", 3, 8)]),
        ("mx", [("p1", "read", 1, 10)] * 3 + [("p1", "sync_write", 3, 6)]),
        ("xm", [("p2", "sync_read", 3, 10), ("p2", "sync_write", 3, 18)]),
        ("xl430", [("p2", "sync_read", 3, 10), *(("p2", "sync_write", 3, n) for n in (2, 8))]),
    ],
)
def test_a_cycle_keeps_the_wire_busy_for_as_long_as_worked_out(emulated, enabled, kind, cycle):
    with emulated(kind, 3, clock="steps", timing=Timing(wire=True)) as (bus, servo_bus):
        limit = enabled(servo_bus)
        servo_bus.read()  # Some readings contain the status of the servos.
        bus.log.clear()
        servo_bus.read()
        servo_bus.write(np.zeros(3), limit)
        bus.sync()
        busy = sum(t.duration for t in bus.log)
        expected = sum(wire_time(*t, baudrate=1_000_000) for t in cycle)
        assert busy == pytest.approx(expected, rel=0.03)
