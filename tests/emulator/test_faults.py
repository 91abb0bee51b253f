"""Injected and random faults, collisions of replies, and their entries in the log."""

from __future__ import annotations

import pytest
from emulator.helpers import BAUD, ask, p1, two, wire

from pliant import ConfigError
from pliant.emulator import Device, Faults
from pliant.emulator.packets import crc16, packet_2

READ_ALL = p1(0xFE, 0x82, 56, 2, 1, 2, 3)


def bus(**shares):
    faults = Faults(seed=1, **shares)
    return wire(*(Device("STS3215", id) for id in (1, 2, 3)), faults=faults), faults


def test_lose_strikes_one_servo_so_often():
    line, faults = bus()
    faults.inject("lose", 2, count=2)
    lengths = [len(ask(line, READ_ALL)) for _ in range(4)]
    assert lengths == [16, 16, 24, 24]
    assert [t.faults for t in line.log] == [("lose 2",), ("lose 2",), (), ()]


def test_skip_lets_chances_pass():
    line, faults = bus()
    faults.inject("lose", 1, skip=2)
    assert [bool(ask(line, p1(1, 1))) for _ in range(4)] == [True, True, False, True]


def test_deaf_servos_miss_their_part_of_a_sync_write():
    line, faults = bus()
    faults.inject("deaf", 2)
    before = line.servos[1].get("torque_limit")
    ask(line, p1(0xFE, 0x83, 48, 2, 1, *two(100), 2, *two(100), 3, *two(100)))
    assert [s.get("torque_limit") for s in line.servos] == [100, before, 100]


def test_late_answers_come_before_the_next_one():
    line, faults = bus()
    faults.inject("late", 1)
    first = line.feed(p1(1, 1), BAUD)
    assert [(d.after, d.is_delayed) for d in first] == [(None, True)]
    faults.inject("late", 1, seconds=0.03)
    assert [d.after for d in line.feed(p1(1, 1), BAUD)] == [0.03]


def test_corrupt_truncate_noise():
    line, faults = bus()
    good = ask(line, p1(1, 2, 56, 2))
    faults.inject("corrupt", 1)
    bad = ask(line, p1(1, 2, 56, 2))
    assert sum(bin(a ^ b).count("1") for a, b in zip(good, bad, strict=True)) == 1
    faults.inject("truncate", 1)
    short = ask(line, p1(1, 2, 56, 2))
    assert 0 < len(short) < len(good)
    assert good.startswith(short)
    faults.inject("noise", 1)
    noisy = ask(line, p1(1, 2, 56, 2))
    assert noisy.endswith(good)
    assert len(noisy) > len(good)


def test_wrong_id_has_a_checksum_that_fits():
    line, faults = bus()
    faults.inject("wrong_id", 1)
    answer = ask(line, p1(1, 1))
    assert answer[2] == 2
    assert ~sum(answer[2:-1]) & 0xFF == answer[-1]
    made = wire(Device("XL430-W250", 1), faults=faults)
    faults.inject("wrong_id", 1)
    answer = ask(made, packet_2(1, 1))
    assert answer[4] == 2
    assert crc16(answer[:-2]).to_bytes(2, "little") == answer[-2:]


def test_chance_is_seeded_and_has_its_share():
    def run():
        line, _ = bus(lose=0.05, corrupt=0.05)
        return [bytes(ask(line, READ_ALL)) for _ in range(1000)], line.log.faulty

    (one, struck), (other, _) = run(), run()
    assert one == other
    assert 70 < struck < 130


def test_chance_can_be_set_while_it_runs():
    line, faults = bus(lose=1.0)
    assert ask(line, p1(1, 1)) == b""
    faults.by_chance()
    assert ask(line, p1(1, 1)) == p1(1, 0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Faults(loss=0.1), "no fault 'loss'; there are deaf, lose"),
        (lambda: Faults(lose=1.5), "share of 'lose'"),
        (lambda: Faults(lose=0.6, late=0.6), "add up to 1.2"),
        (lambda: Faults().inject("lose", count=-1), "count and skip"),
    ],
)
def test_errors(make, words):
    with pytest.raises(ConfigError, match=words):
        make()


def test_two_servos_on_one_id_spoil_each_other():
    line = wire(Device("STS3215", 1), Device("STS3215", 1))
    answer = ask(line, p1(1, 1))
    assert answer[:2] == b"\xff\xff"
    assert ~sum(answer[2:-1]) & 0xFF != answer[-1]
    made = wire(Device("XL430-W250", 1), Device("XL430-W250", 1))
    answer = ask(made, packet_2(1, 1))
    assert crc16(answer[:-2]).to_bytes(2, "little") != answer[-2:]


def test_a_dead_line_passes_nothing():
    line, _ = bus()
    line.dead = True
    assert ask(line, READ_ALL) == b""
    line.dead = False
    assert len(ask(line, READ_ALL)) == 24


def test_an_echoing_adapter_sends_the_request_back_first():
    line, _ = bus()
    line.echo = True
    assert ask(line, p1(1, 1)) == p1(1, 1) + p1(1, 0)


def test_the_wrong_speed_is_not_understood():
    line, _ = bus()
    assert line.feed(p1(1, 1), 115_200) == []
    assert line.feed(p1(1, 1), BAUD)


@pytest.mark.parametrize("cut", [1, 2, 3, 5])
def test_requests_may_come_in_pieces_and_behind_rubbish(cut):
    line, _ = bus()
    request = b"\x00\xff\x13" + p1(1, 1) + b"\xff\xff" + p1(2, 1)
    pieces = [request[k : k + cut] for k in range(0, len(request), cut)]
    got = b"".join(d.data for piece in pieces for d in line.feed(piece, BAUD))
    assert got == p1(1, 0) + p1(2, 0)


def test_one_stream_of_two_protocols():
    line = wire(Device("MX-28", 1), Device("XL430-W250", 1), Device("STS3215", 2))
    assert len(ask(line, p1(1, 1))) == 6
    assert len(ask(line, packet_2(1, 1))) == 14
    assert len(ask(line, p1(2, 1))) == 6
