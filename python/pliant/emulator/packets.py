"""Packets on the bus: checksum, CRC, byte stuffing, and splitting a byte stream into frames.

This code follows the makers' protocol documents and shares nothing with the drivers that it tests.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Protocol = Literal[1, 2]

BROADCAST = 0xFE
STATUS = 0x55
HEADER_1 = b"\xff\xff"
HEADER_2 = b"\xff\xff\xfd\x00"
#: Largest length field of a Protocol 2.0 packet that a servo accepts [bytes].
LONGEST = 2048

_POLYNOMIAL = 0x8005


def _crc_row(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = (crc << 1) ^ (_POLYNOMIAL if crc & 0x8000 else 0)
    return crc & 0xFFFF


_CRC_TABLE = [_crc_row(byte) for byte in range(256)]


def crc16(data: bytes) -> int:
    """Return the CRC-16 of Protocol 2.0: polynomial 0x8005, initial value 0, no reflection."""
    crc = 0
    for byte in data:
        crc = ((crc << 8) & 0xFF00) ^ _CRC_TABLE[(crc >> 8) ^ byte]
    return crc


def checksum(body: bytes) -> int:
    """Return the checksum of Protocol 1.0 and Feetech: inverted low byte of the sum of `body`."""
    return ~sum(body) & 0xFF


def stuff(body: bytes) -> bytes:
    """Return `body` with byte stuffing, so that it does not contain the packet header."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Return `body` without the bytes that `stuff` inserts."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def packet_1(id: int, code: int, params: bytes = b"") -> bytes:
    """Return a packet of Protocol 1.0 or Feetech; `code` is its instruction or error byte."""
    body = bytes((id, len(params) + 2, code)) + params
    return HEADER_1 + body + bytes((checksum(body),))


def packet_2(id: int, instruction: int, params: bytes = b"") -> bytes:
    """Return an instruction packet of Protocol 2.0, with byte stuffing."""
    body = stuff(bytes((instruction,)) + params)
    head = HEADER_2 + bytes((id,)) + (len(body) + 2).to_bytes(2, "little") + body
    return head + crc16(head).to_bytes(2, "little")


def status_2(id: int, error: int, data: bytes = b"") -> bytes:
    """Return a status packet of Protocol 2.0."""
    return packet_2(id, STATUS, bytes((error,)) + data)


@dataclass(frozen=True, slots=True)
class Frame:
    """One packet from the host.

    Attributes:
        protocol: 1 (Dynamixel 1.0 and Feetech) or 2.
        id: Addressed servo.
        instruction: The instruction byte.
        params: Parameters, without byte stuffing.
        ok: True if the checksum (Protocol 1.0) or the CRC (Protocol 2.0) is valid.
        raw: All bytes of the packet.
    """

    protocol: Protocol
    id: int
    instruction: int
    params: bytes
    ok: bool
    raw: bytes


class Framer:
    """Splits the host's bytes into packets (`Frame`); drops bytes between packets, like a servo."""

    def __init__(self) -> None:
        self._rest = b""

    def reset(self) -> None:
        """Discard the bytes of an unfinished packet."""
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the packets that `data` completes; keep the bytes of an unfinished packet."""
        buffer, start = self._rest + data, 0
        frames: list[Frame] = []
        while True:
            start = buffer.find(HEADER_1, start)
            if start < 0:
                self._rest = buffer[-1:] if buffer.endswith(b"\xff") else b""
                return frames
            if buffer.startswith(b"\xff\xff\xff", start):
                start += 1
                continue
            length = self._length(buffer, start)
            if length is None or start + length > len(buffer):
                self._rest = buffer[start:]
                return frames
            if length == 0:
                start += 1
                continue
            frames.append(_frame(buffer[start : start + length]))
            start += length

    @staticmethod
    def _length(buffer: bytes, at: int) -> int | None:
        """Return the length of the packet that starts at index `at` of `buffer` [bytes].

        None: the length is not known yet. 0: no valid packet starts there.
        """
        available = len(buffer) - at
        if available < 4:
            return None
        if buffer.startswith(HEADER_2, at):
            if available < 7:
                return None
            length = int.from_bytes(buffer[at + 5 : at + 7], "little")
            return 7 + length if 3 <= length <= LONGEST else 0
        return 4 + buffer[at + 3] if buffer[at + 3] >= 2 else 0


def _frame(raw: bytes) -> Frame:
    if raw.startswith(HEADER_2):
        ok = crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little")
        return Frame(2, raw[4], raw[7], unstuff(raw[7:-2])[1:], ok, raw)
    return Frame(1, raw[2], raw[4], raw[5:-1], checksum(raw[2:-1]) == raw[-1], raw)
