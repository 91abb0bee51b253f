"""`TransactionGuard` on a scripted bus: drain, one retry, no stale reply, bounded cycle time."""

from dataclasses import asdict

import pytest

from pliant import ServoError
from pliant.servo import BusError, get_model
from pliant.servo._transactions import Counters, TransactionGuard
from pliant.servo.eeprom import (
    RegisterChange,
    check_set_id,
    plan_restore,
    plan_setup,
    set_id,
    write_changes,
)
from pliant.servo.models import Block

SHORT, LONG, LONGER = Block(56, 15), Block(55, 16), Block(54, 17)


def guarded(bus, **options):
    options = {"baudrate": 1_000_000, "unused_id": 200, **options}
    return TransactionGuard(bus, "p1", clock=bus.clock, **options)


def failure(reason, id=None):
    return BusError("failed on purpose", reason, id)


def requests(bus):
    return [call for call in bus.calls if call[0] != "ping"]


def test_a_good_answer_costs_one_request(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.memory[1][56] = 7
    assert guard.read(1, SHORT).data[0] == 7
    assert bus.calls == [("read", 1, 56, 15)]
    assert guard.transactions == 1


def test_counters_start_at_zero(fake_bus):
    assert {guarded(fake_bus([1])).transactions, *asdict(Counters()).values()} == {0}


def test_a_lost_answer_is_drained_and_asked_for_again(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.plan = [failure("timeout", 1)]
    bus.late = 3
    assert guard.read(1, SHORT, LONG).status == 0
    # Bytes were still arriving at the first three pings of the drain; at the fourth, none were.
    assert [call[0] for call in bus.calls] == ["read", *["ping"] * 4, "read"]
    assert all(call[1] == 200 for call in bus.calls if call[0] == "ping")
    counters = guard.counters
    assert (counters.retries, counters.timeouts, counters.drains) == (1, 1, 1)


class Encoder:
    """Group of servos whose commands go to the transport's `sync_encode`."""

    def __init__(self, guard):
        self._bus = guard._io

    def write(self, *_):
        try:
            self._bus.sync_encode()
        except BusError as error:
            self._bus.lost = lambda _, lost=error: lost
            raise OSError from error


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("read", lambda guard: guard.read(1, SHORT)),
        ("sync_read", lambda guard: guard.sync_read([1], SHORT)),
        ("write", lambda guard: guard.write(1, 24, b"\1")),
        ("sync_write", lambda guard: guard.sync_write([1], 30, [b"\0\0"])),
        ("sync_encode", lambda guard: guard.sync_encode(Encoder(guard), 1, [SHORT], ())),
        ("ping", lambda guard: guard.ping(1)),
        ("reboot", lambda guard: guard.reboot(1)),
    ],
)
def test_every_request_notices_a_port_that_is_gone(fake_bus, name, call):
    bus = fake_bus([1])
    guard, sent = guarded(bus), []

    def lost(*_):
        sent.append(name)
        raise failure("gone")

    setattr(bus, name, lost)
    for _ in range(2):
        with pytest.raises(BusError) as error:
            call(guard)
        assert error.value.reason == "gone"
        assert guard.is_gone
    assert sent == [name]
    assert not bus.calls


@pytest.mark.parametrize(
    "call",
    [
        lambda guard: guard.read(2, SHORT),
        lambda guard: guard.sync_read([2], SHORT),
        lambda guard: guard.write(2, 24, b"\1"),
        lambda guard: guard.ping(2),
        lambda guard: guard.reboot(2),
    ],
)
def test_every_request_with_a_reply_waits_for_a_silent_line(fake_bus, call):
    bus = fake_bus([1, 2])
    guard = guarded(bus)
    bus.plan = [failure("timeout", 1)]
    with pytest.raises(BusError):
        guard.read(1, SHORT, again=False)
    bus.late = 2
    call(guard)
    assert [c[:2] for c in bus.calls[1:4]] == [("ping", 200)] * 3
    assert bus.calls[4][0] != "ping" or bus.calls[4][1] == 2
    assert guard.counters.drains == 1


def test_two_failures_are_reported(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.plan = [failure("timeout"), failure("corrupt")]
    guard.start_cycle(1.0)
    with pytest.raises(BusError) as error:
        guard.read(1, SHORT, LONG)
    assert error.value.reason == "corrupt"
    assert len(requests(bus)) == 2
    assert (guard.counters.timeouts, guard.counters.corrupt) == (1, 1)


def test_nothing_is_asked_before_a_noisy_line_is_silent(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.plan, bus.late = [failure("timeout")], 10**6
    guard.start_cycle(0.03)
    with pytest.raises(BusError):
        guard.read(1, SHORT)
    count = len(requests(bus))
    guard.start_cycle(0.03)
    with pytest.raises(BusError) as error:
        guard.read(1, SHORT)
    assert error.value.reason == "late"
    assert len(requests(bus)) == count == 1
    bus.late = 0
    guard.start_cycle(0.03)
    assert guard.read(1, SHORT, LONG).status == 0


def test_an_answer_to_the_last_request_is_kept_out(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.memory[1][56] = 1
    bus.plan = [failure("timeout")]
    with pytest.raises(BusError):
        guard.read(1, SHORT, LONG, again=False)
    bus.memory[1][56] = 2
    bus.plan = ["stale"]
    reply = guard.read(1, SHORT, LONG, LONGER)
    assert reply.data[56 - reply.block.address] == 2
    assert reply.block == LONGER
    assert guard.counters.stale == 1


def test_a_stale_sync_read_is_kept_out(fake_bus):
    bus = fake_bus([1, 2])
    guard = guarded(bus)
    bus.plan = [failure("timeout")]
    with pytest.raises(BusError):
        guard.sync_read([1, 2], SHORT, LONG)
    bus.plan = ["stale"]
    with pytest.raises(BusError) as error:
        guard.sync_read([1, 2], SHORT, LONG)
    assert error.value.reason == "stale"


def test_a_length_is_not_requested_while_it_is_outstanding(fake_bus):
    bus = fake_bus([1, 2])
    guard = guarded(bus)
    guard.start_cycle(10.0)
    bus.plan = [failure("timeout"), failure("corrupt")]
    with pytest.raises(BusError):
        guard.read(1, SHORT, LONG)
    # Replies of both lengths are now outstanding from this servo.
    with pytest.raises(BusError) as error:
        guard.read(1, SHORT, LONG)
    assert error.value.reason == "late"
    assert guard.read(2, SHORT, LONG).block == SHORT
    with pytest.raises(BusError):
        guard.sync_read([1, 2], SHORT, LONG)
    # After a reply of a third length, both lengths are allowed, but others are preferred.
    assert guard.read(1, SHORT, LONG, LONGER).block == LONGER
    assert guard.read(1, SHORT, LONG, LONGER).block == LONGER
    assert guard.read(1, SHORT, LONG).block == SHORT
    bus.now += 1.5
    assert guard.read(1, SHORT, LONG, LONGER).block == SHORT


def test_a_servo_that_was_silent_for_long_is_asked_again(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    guard.start_cycle(10.0)
    bus.plan = [failure("timeout")]
    with pytest.raises(BusError):
        guard.read(1, SHORT, again=False)
    with pytest.raises(BusError) as error:
        guard.read(1, SHORT, again=False)
    assert error.value.reason == "late"
    bus.now += 2.5
    assert guard.read(1, SHORT).block == SHORT


def test_a_servo_with_missing_replies_of_all_lengths_is_not_asked(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    guard._pending.add([1], SHORT.size, bus.now)
    for size in range(1, 13):
        guard._pending.add([1], size, bus.now)
    with pytest.raises(BusError, match="too many answers missing") as error:
        guard.read(1, SHORT, again=False)
    assert error.value.reason == "late"
    assert not requests(bus)


def test_a_reading_of_another_length_settles_an_outstanding_one(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.plan = [failure("timeout")]
    assert guard.read(1, SHORT).block == SHORT
    assert [call[:4] for call in requests(bus)] == [
        ("read", 1, 56, 15),
        ("read", 1, 0, 12),
        ("read", 1, 56, 15),
    ]


def test_a_ping_of_protocol_2_looks_like_three_bytes(fake_bus):
    bus = fake_bus([])
    guard = guarded(bus)
    guard._protocol = "p2"
    assert not guard.ping(1)
    bus.memory[1] = bytearray(256)
    guard.start_cycle(1.0)
    with pytest.raises(BusError) as error:
        guard.read(1, Block(144, 3))
    assert error.value.reason == "late"


def test_no_retry_that_could_not_be_answered_in_time(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.plan = [failure("timeout")]
    # A timeout of 10 ms and a drain of 3 ms leave less time than the 10 ms of a retry.
    guard.start_cycle(0.016)
    with pytest.raises(BusError):
        guard.read(1, SHORT)
    assert len(requests(bus)) == 1
    assert bus.now < 0.016


def test_a_port_that_is_gone_is_asked_nothing_more(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.plan = [failure("gone")]
    for _ in range(2):
        with pytest.raises(BusError) as error:
            guard.read(1, SHORT)
        assert error.value.reason == "gone"
    assert len(bus.calls) == 1


@pytest.mark.parametrize(
    ("size", "status", "reason"), [(0, 7, "refused"), (0, 0, "stale"), (14, 7, "stale")]
)
def test_a_refused_read_is_not_mistaken_for_a_stale_one(fake_bus, size, status, reason):
    bus = fake_bus([1])
    bus.read = lambda *_: (bytes(size), status)
    guard = guarded(bus)
    with pytest.raises(BusError) as error:
        guard.read(1, SHORT)
    assert error.value.reason == reason


def test_drains_ping_an_unused_id(fake_bus):
    bus = fake_bus([253, 252, 1])
    guard = guarded(bus, unused_id=0)
    guard.find_unused_id({1}, 253)
    bus.calls.clear()
    bus.plan = [failure("timeout")]
    guard.read(1, SHORT)
    assert ("ping", 251) in bus.calls


def test_timeouts_follow_the_wire(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus, baudrate=57_600, cycle=0.1)
    guard.start_cycle(1.0)
    guard.read(1, SHORT)
    # Expected: twice the wire time of 8 + 21 bytes at 57600 baud (5.0 ms), twice the latency of
    # 1 ms, and 5 ms.
    assert bus.timeout == pytest.approx(0.0171, abs=2e-4)


def test_without_a_cycle_there_is_no_hurry(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    bus.plan = [failure("timeout"), failure("timeout")]
    assert guard.read(1, SHORT).status == 0
    assert guard.counters.retries == 2
    assert bus.now > 0.1


def test_a_write_goes_out_although_the_line_is_not_silent(fake_bus):
    bus = fake_bus([1])
    guard = guarded(bus)
    guard.start_cycle(0.01)
    bus.plan = [failure("timeout")]
    with pytest.raises(BusError):
        guard.read(1, SHORT)
    guard.sync_write([1], 42, [b"abcdefgh"])
    assert bus.memory[1][42:50] == b"abcdefgh"


def test_eeprom_of_another_model_or_with_torque_is_not_touched(fake_bus):
    bus, row = fake_bus([1, 2]), get_model("MX-64")
    guard, change = guarded(bus), RegisterChange("pan", 1, "shutdown", 36, 4, "why")
    calls = (
        lambda: plan_setup(guard, "pan", 1, row),
        lambda: plan_restore(guard, "pan", 1, row, [change]),
        lambda: check_set_id(guard, "pan", row, 1, 3),
        lambda: set_id(guard, "pan", row, 1, 3),
    )
    for call in calls:
        with pytest.raises(ServoError, match="is model number 0, the configuration says MX-64"):
            call()
    assert plan_restore(guard, "pan", 2, row, [change]) == []
    assert plan_restore(guard, "lift", 1, row, [change]) == []
    bus.memory[1][0:2] = row.model_number.to_bytes(2, "little")
    changed = {change.register for change in plan_setup(guard, "pan", 1, row)}
    assert changed == {"return_level", "position_max"}
    (restored,) = plan_restore(guard, "pan", 1, row, [change])
    assert (restored.old, restored.new) == (0, 36)
    check_set_id(guard, "pan", row, 1, 3)
    with pytest.raises(ServoError, match="answers to id 2 already"):
        check_set_id(guard, "pan", row, 1, 2)
    bus.memory[1][row.family.registers["torque_enable"].address] = 1
    for call in (*calls[2:], lambda: write_changes(guard, row.family, [change])):
        with pytest.raises(ServoError, match=r"torque of .* is on"):
            call()
    assert not any(call[0] in {"write", "sync_write"} for call in bus.calls)


@pytest.mark.parametrize("is_taken", [True, False])
def test_eeprom_is_locked_again_after_changes(fake_bus, is_taken):
    bus, family = fake_bus([1]), get_model("STS3215-7.4V").family
    guard, lock = guarded(bus), family.registers["lock"].address
    address = family.registers["mode"].address
    change = RegisterChange("pan", 1, "mode", 1, 0, "why")
    bus.memory[1][address], write = 1, bus.write

    def watched(number, first, data):
        assert first == lock or bus.memory[1][lock] == 0
        return write(number, first, data) if is_taken or first == lock else 0

    bus.write = watched
    if is_taken:
        write_changes(guard, family, [change])
    else:
        with pytest.raises(ServoError, match="mode reads 1 after 0 was written"):
            write_changes(guard, family, [change])
    assert bus.memory[1][lock] == 1
