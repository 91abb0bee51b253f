"""Requests to emulated servos as bytes, built without the emulator's own packet functions."""

from __future__ import annotations

import os
import termios
import time
import tty

from pliant._extras import missing
from pliant.emulator import Device, SerialLine

BAUD = 1_000_000


def wire(*devices, **options):
    """Return a serial line with servos, without a pseudo-terminal."""
    return SerialLine([device.build(BAUD) for device in devices], **options)


def single_servo(model, **registers):
    """Return a serial line with one servo of id 1, and this servo."""
    line = wire(Device(model, 1, **registers))
    return line, line.servos[0]


def p1(id, instruction, *params):
    body = [id, len(params) + 2, instruction, *params]
    return bytes([0xFF, 0xFF, *body, ~sum(body) & 0xFF])


def ask(line, request):
    """Send a request; return all reply bytes that no fault delays."""
    return b"".join(d.data for d in line.feed(request, BAUD) if d.after is not None)


def address_of(line, register):
    """Return the address of a register of the first servo, given by its name or address."""
    return register if isinstance(register, int) else line.servos[0].table[register].address


def write1(line, register, *data, id=1):
    """Write `data` by Protocol 1.0; return the error byte of the reply."""
    return ask(line, p1(id, 3, address_of(line, register), *data))[4]


def read1(line, register, length, id=1):
    """Read `length` bytes by Protocol 1.0; return error byte and data of the reply."""
    answer = ask(line, p1(id, 2, address_of(line, register), length))
    return answer[4], answer[5:-1]


def pass_time(servo, seconds, dt=0.01):
    """Let time pass for a servo [s] without physics: only its protections are updated."""
    for _ in range(round(seconds / dt)):
        servo.now += dt
        servo.update(dt)


def le16(value):
    """Return the two bytes of a value, little-endian."""
    return value & 0xFF, value >> 8 & 0xFF


def le32(value):
    """Return the four bytes of a value, little-endian."""
    return tuple(value >> 8 * k & 0xFF for k in range(4))


class Host:
    """Minimal serial client that sends and receives raw bytes, with a timeout."""

    def __init__(self, path, speed=termios.B1000000):
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.fd)
        settings = termios.tcgetattr(self.fd)
        settings[4] = settings[5] = speed
        termios.tcsetattr(self.fd, termios.TCSANOW, settings)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        os.close(self.fd)

    def ask(self, request, length, patience=2.0):
        """Write `request`; return the reply: `length` bytes, or fewer after `patience` [s]."""
        os.write(self.fd, request)
        answer, end = b"", time.monotonic() + patience
        while len(answer) < length and time.monotonic() < end:
            try:
                answer += os.read(self.fd, 4096)
            except BlockingIOError:
                time.sleep(0.0005)
        return answer


def without_extra():
    """Raise the error of an emulator factory if the simulator is not installed."""
    raise ImportError(missing("pliant.sim", "sim"))
