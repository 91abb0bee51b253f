"""Instructions of Dynamixel Protocol 2.0."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant.emulator._protocol1 import Slot, act
from pliant.emulator._x_series import CRC, INSTRUCTION, LENGTH, XServo
from pliant.emulator.packets import BROADCAST, HEADER_2, LONGEST, STATUS, crc16, status_2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.emulator.packets import Frame

PING, READ, WRITE, REG_WRITE, ACTION, RESET, REBOOT, CLEAR = 1, 2, 3, 4, 5, 6, 8, 0x10
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
NAMES = {
    PING: "ping", READ: "read", WRITE: "write", REG_WRITE: "reg_write", ACTION: "action",
    RESET: "factory_reset", REBOOT: "reboot", CLEAR: "clear", SYNC_READ: "sync_read",
    SYNC_WRITE: "sync_write", FAST_SYNC_READ: "fast_sync_read", BULK_READ: "bulk_read",
    BULK_WRITE: "bulk_write", FAST_BULK_READ: "fast_bulk_read",
}  # fmt: skip


def handle(servos: Sequence[XServo], frame: Frame) -> list[Slot]:
    """Let the servos execute a packet from the host; return their replies in order of sending."""
    if not frame.ok:
        slot: Slot = [
            (s, status_2(s.id, s.status() | CRC)) for s in servos if s.id == frame.id and s.level
        ]
        return [slot] if slot else []
    for servo in servos:
        servo.on_instruction()
    if frame.id == BROADCAST:
        return _broadcast(servos, frame)
    slot = []
    for servo in servos:
        if servo.id == frame.id:
            packet = _single(servo, frame.instruction, frame.params)
            if packet:
                slot.append((servo, packet))
    return [slot] if slot else []


def _identity(servo: XServo) -> bytes:
    number, firmware = servo.get("model_number"), servo.get("firmware_version")
    return status_2(servo.id, servo.status(), number.to_bytes(2, "little") + bytes((firmware,)))


def _single(servo: XServo, instruction: int, params: bytes) -> bytes:
    """Let a servo execute an instruction; return its reply, empty if it does not reply."""
    # Smallest Status Return Level at which a servo replies to the instruction.
    min_level = 2
    id, data, error = servo.id, b"", 0
    alert = servo.status()
    if instruction == PING:
        return _identity(servo)
    if instruction == READ:
        error, min_level = LENGTH, 1
        if len(params) == 4:
            error, data = servo.read(_word(params, 0), _word(params, 2))
    elif instruction == WRITE:
        error = servo.write(_word(params, 0), params[2:]) if len(params) > 2 else LENGTH
    elif instruction == REG_WRITE:
        error = servo.check_write(_word(params, 0), params[2:]) if len(params) > 2 else LENGTH
        if not error:
            servo.registered = (_word(params, 0), params[2:])
    elif instruction == ACTION:
        error = INSTRUCTION if servo.registered is None else act(servo)
    elif instruction == REBOOT:
        servo.power_up()
    else:
        # Reject other instructions, also factory reset: it clears the id, and no driver needs it.
        error = INSTRUCTION
    if servo.level < min_level:
        return b""
    return status_2(id, alert | servo.status() | error, data)


def _word(params: bytes, index: int) -> int:
    return int.from_bytes(params[index : index + 2], "little")


def _broadcast(servos: Sequence[XServo], frame: Frame) -> list[Slot]:
    params, instruction = frame.params, frame.instruction
    if instruction == PING:
        by_id: dict[int, Slot] = {}
        for servo in sorted(servos, key=lambda servo: servo.id):
            by_id.setdefault(servo.id, []).append((servo, _identity(servo)))
        return list(by_id.values())
    if instruction in {SYNC_READ, FAST_SYNC_READ} and len(params) >= 4:
        address, length = _word(params, 0), _word(params, 2)
        blocks = [(id, address, length) for id in params[4:]]
        is_fast = instruction == FAST_SYNC_READ
        return _fast_reads(servos, blocks) if is_fast else _reads(servos, blocks)
    if instruction in {BULK_READ, FAST_BULK_READ} and len(params) % 5 == 0:
        blocks = [
            (params[k], _word(params, k + 1), _word(params, k + 3))
            for k in range(0, len(params), 5)
        ]
        is_fast = instruction == FAST_BULK_READ
        return _fast_reads(servos, blocks) if is_fast else _reads(servos, blocks)
    if instruction == SYNC_WRITE and len(params) >= 4:
        address, length = _word(params, 0), _word(params, 2)
        for start in range(4, len(params) - length, length + 1):
            data = params[start + 1 : start + 1 + length]
            _write(servos, params[start], address, data, "sync_write")
    elif instruction == BULK_WRITE:
        index = 0
        while index + 5 <= len(params):
            length = _word(params, index + 3)
            data = params[index + 5 : index + 5 + length]
            if len(data) == length:
                _write(servos, params[index], _word(params, index + 1), data, "bulk_write")
            index += 5 + length
    elif instruction in {WRITE, REG_WRITE, ACTION, REBOOT}:
        for servo in servos:
            _single(servo, instruction, params)
    return []


def _write(servos: Sequence[XServo], id: int, address: int, data: bytes, name: str) -> None:
    for servo in servos:
        if servo.id == id:
            servo.write(address, data, name)


def _reads(servos: Sequence[XServo], blocks: list[tuple[int, int, int]]) -> list[Slot]:
    """Return the replies to a read of several servos, in the order of `blocks`.

    `blocks` contains id, address and length [bytes] of each block. Each servo waits for the reply
    of the previous one, so a missing servo ends the replies.
    """
    slots: list[Slot] = []
    for id, address, length in blocks:
        slot: Slot = []
        for servo in servos:
            if servo.id == id and servo.level:
                error, data = servo.read(address, length)
                packet = status_2(id, servo.status() | error, data)
                slot.append((servo, packet))
        if not slot:
            break
        slots.append(slot)
    return slots


def _fast_reads(servos: Sequence[XServo], blocks: list[tuple[int, int, int]]) -> list[Slot]:
    """Return the reply to a fast read: one status packet, to which the servos append in turn.

    `blocks` contains id, address and length [bytes] of each block to read. Each servo's part ends
    with the CRC of all bytes sent so far. The packet has no byte stuffing. MX(2.0) servos do not
    support the instruction.
    """
    length = 1 + sum(4 + size for _, _, size in blocks)
    if length > LONGEST:
        return []
    sent = HEADER_2 + bytes((BROADCAST,)) + length.to_bytes(2, "little") + bytes((STATUS,))
    slots: list[Slot] = []
    for id, address, size in blocks:
        readable = [s for s in servos if s.id == id and not s.model.name.startswith("MX")]
        if not readable:
            break
        error, data = readable[0].read(address, size)
        body = bytes((readable[0].status() | error, id)) + data.ljust(size, b"\0")
        start = b"" if slots else sent
        sent = sent + body
        crc = crc16(sent).to_bytes(2, "little")
        sent += crc
        slots.append([(readable[0], start + body + crc)])
    return slots
