"""Arbitrary bytes: no crash, and no register leaves its range."""

from __future__ import annotations

from emulator.helpers import ask, p1, wire
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pliant.emulator import Device
from pliant.emulator.packets import LONGEST, packet_2

MODELS = ["MX-64", "RX-64", "XM430-W350", "XL330-M077", "STS3215"]
INSTRUCTIONS = st.sampled_from([1, 2, 3, 4, 5, 6, 8, 16, 0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A, 200])
IDS = st.sampled_from([0, 1, 2, 3, 4, 5, 250, 253, 254])


def bus():
    return wire(*(Device(model, id) for id, model in enumerate(MODELS, 1)))


def check(line):
    """Check that every register of every servo is in its range and readable by the protections."""
    for servo in line.servos:
        for register in servo.table:
            if register.writable:
                assert register.low <= servo.get(register.name) <= register.high, register
        servo.drive()
        servo.refresh()
        servo.update(0.01)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=6))
@example([b"\xff\xff\xfd\x00", b"\x00\x00\x02"])
def test_rubbish(pieces):
    line = bus()
    for piece in pieces:
        ask(line, piece)
    check(line)
    rest = bytes(7 + LONGEST)  # completes any packet that the rubbish has begun
    assert ask(line, rest + p1(1, 1)), "it hears again after the rubbish"


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(IDS, INSTRUCTIONS, st.binary(max_size=30)), max_size=8))
def test_any_instruction_with_a_checksum_that_fits(requests):
    line = bus()
    for id, instruction, params in requests:
        ask(line, p1(id, instruction, *params))
        ask(line, packet_2(id, instruction, params))
    check(line)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(1, 5), st.integers(0, 255), st.binary(min_size=1, max_size=8)),
        max_size=12,
    )
)
def test_any_write(writes):
    line = bus()
    for id, address, data in writes:
        ask(line, p1(id, 3, address, *data))
        ask(line, packet_2(id, 3, bytes([address, 0]) + data))
    check(line)
