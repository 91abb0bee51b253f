"""The registers of emulated servos are coded as their tables say."""

import pytest

from pliant.emulator import Device
from pliant.emulator.models import MODELS

#: Numbers at and beyond the bounds of all codings, and numbers that are rounded.
NUMBERS = [
    *(-1.5, -0.4, 0, 0.5, 1.5, 300.7, -300.7),
    *(sign * 2**bits + more for bits in (7, 8, 10, 11, 15, 16, 31, 32) for sign in (1, -1)
      for more in (-1, 0, 1)),
]  # fmt: skip


@pytest.mark.parametrize("name", MODELS)
def test_a_register_reads_and_stores_as_its_coding_says(name):
    servo = Device(name, id=1).build(None)
    for register in servo.table:
        span = slice(register.address, register.address + register.size)
        for number in NUMBERS:
            servo.put(register.name, number)
            assert bytes(servo.memory[span]) == register.encode(round(number)), register
            assert servo.get(register.name) == register.decode(servo.memory[span]), register
        for raw in (0x00, 0x01, 0x7F, 0x80, 0xFF):
            servo.memory[span] = bytes([raw ^ 0x05] * (register.size - 1) + [raw])
            assert servo.get(register.name) == register.decode(servo.memory[span]), register
