"""Instructions of Dynamixel Protocol 1.0 and of Feetech servos, which share the framing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant.emulator._dynamixel1 import BIT_INSTRUCTION
from pliant.emulator._feetech import StsServo
from pliant.emulator.packets import BROADCAST, packet_1

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.emulator.packets import Frame
    from pliant.emulator.servo import Servo

PING, READ, WRITE, REG_WRITE, ACTION, RESET, REBOOT = 1, 2, 3, 4, 5, 6, 8
SYNC_READ, SYNC_WRITE, BULK_READ = 0x82, 0x83, 0x92
BIT_CHECKSUM = 0x10
NAMES = {
    PING: "ping", READ: "read", WRITE: "write", REG_WRITE: "reg_write", ACTION: "action",
    RESET: "factory_reset", REBOOT: "reboot", SYNC_READ: "sync_read", SYNC_WRITE: "sync_write",
    BULK_READ: "bulk_read",
}  # fmt: skip

#: Servos that send at the same time, with their replies; several replies collide on the wire.
Slot = list[tuple["Servo", bytes]]


def handle(servos: Sequence[Servo], frame: Frame) -> list[Slot]:
    """Let the servos execute a packet from the host; return their replies in order of sending."""
    if not frame.ok:
        # Only Dynamixel servos report a checksum error; a Feetech servo does not reply.
        return _slot(
            [
                (servo, _status(servo, BIT_CHECKSUM))
                for servo in servos
                if servo.id == frame.id and not isinstance(servo, StsServo) and servo.level == 2
            ]
        )
    if frame.id == BROADCAST:
        return _broadcast(servos, frame)
    answers: Slot = []
    for servo in servos:
        if servo.id == frame.id:
            packet = _single(servo, frame.instruction, frame.params)
            if packet:
                answers.append((servo, packet))
    return _slot(answers)


def _slot(answers: Slot) -> list[Slot]:
    return [answers] if answers else []


def _status(servo: Servo, error: int, data: bytes = b"") -> bytes:
    # The error byte of a Feetech servo reports conditions, not rejected instructions: omit `error`.
    refusal = 0 if isinstance(servo, StsServo) else error
    return packet_1(servo.id, servo.status() | refusal, data)


def _single(servo: Servo, instruction: int, params: bytes) -> bytes:
    """Let a servo execute an instruction; return its reply, empty if it does not reply."""
    id, data, error, level = servo.id, b"", 0, 2
    if instruction == PING:
        level = 0
    elif instruction == READ and len(params) == 2:
        error, data = servo.read(params[0], params[1])
        level = 1
    elif instruction == WRITE and len(params) >= 2:
        error = servo.write(params[0], params[1:])
    elif instruction == REG_WRITE and len(params) >= 2:
        error = servo.check_write(params[0], params[1:])
        if not error:
            servo.registered = (params[0], params[1:])
    elif instruction == ACTION:
        error = BIT_INSTRUCTION if servo.registered is None else act(servo)
    elif instruction == REBOOT and isinstance(servo, StsServo):
        servo.power_up()
    else:
        # Reject other instructions, also factory reset: it clears the id, and no driver needs it.
        error = BIT_INSTRUCTION
    if servo.level < level:
        return b""
    refusal = 0 if isinstance(servo, StsServo) else error
    return packet_1(id, servo.status() | refusal, data)


def act(servo: Servo) -> int:
    """Execute the write that REG_WRITE stored; return its error code, 0 if nothing was stored."""
    stored, servo.registered = servo.registered, None
    return servo.write(*stored, "reg_write") if stored else 0


def _broadcast(servos: Sequence[Servo], frame: Frame) -> list[Slot]:
    params = frame.params
    if frame.instruction == PING:
        feetech = sorted((s for s in servos if isinstance(s, StsServo)), key=lambda s: s.id)
        others: Slot = [(s, _status(s, 0)) for s in servos if not isinstance(s, StsServo)]
        slots = _slot(others)
        for feetech_servo in feetech:
            slots.append([(feetech_servo, _status(feetech_servo, 0))])
        return slots
    if frame.instruction == WRITE and len(params) >= 2:
        for servo in servos:
            servo.write(params[0], params[1:])
    elif frame.instruction == REG_WRITE and len(params) >= 2:
        for servo in servos:
            if not servo.check_write(params[0], params[1:]):
                servo.registered = (params[0], params[1:])
    elif frame.instruction == ACTION:
        for servo in servos:
            act(servo)
    elif frame.instruction == SYNC_WRITE and len(params) >= 2:
        _sync_write(servos, params)
    elif frame.instruction == SYNC_READ and len(params) >= 2:
        sts = [servo for servo in servos if isinstance(servo, StsServo)]
        return _reads(sts, [(id, params[0], params[1]) for id in params[2:]], chain=False)
    elif frame.instruction == BULK_READ and len(params) % 3 == 1:
        blocks = [(params[k + 1], params[k + 2], params[k]) for k in range(1, len(params), 3)]
        mx = [servo for servo in servos if "p_gain" in servo.table]
        return _reads(mx, blocks, chain=True)
    return []


def _sync_write(servos: Sequence[Servo], params: bytes) -> None:
    address, length = params[0], params[1]
    for start in range(2, len(params) - length, length + 1):
        for servo in servos:
            if servo.id == params[start]:
                data = params[start + 1 : start + 1 + length]
                servo.write(address, data, "sync_write")


def _reads(
    servos: Sequence[Servo], blocks: list[tuple[int, int, int]], *, chain: bool
) -> list[Slot]:
    """Return the replies to a read of several servos, in the order of `blocks`.

    Args:
        servos: Servos on the bus.
        blocks: Id, address and length [bytes] of each block to read.
        chain: True if each servo waits for the reply of the previous one, so that a missing servo
            ends the replies.
    """
    slots: list[Slot] = []
    for id, address, length in blocks:
        slot: Slot = []
        for servo in servos:
            if servo.id == id:
                error, data = servo.read(address, length)
                slot.append((servo, _status(servo, error, data)))
        if slot:
            slots.append(slot)
        elif chain:
            break
    return slots
