"""A bus in memory with its own clock, and buses that exchange bytes with emulated servos."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rustypot", reason="the tests of servo buses need the extra servo")

from pliant.emulator import Device, Emulator, ManualClock
from pliant.servo import BusError, ServoBus, ServoSpec


class FakeBus:
    """Transport in memory: servos as byte arrays, with scripted failures and stale replies.

    `plan` has one entry per future request: None for success, a `BusError` to raise, or "stale" to
    return the reply to the previous request. While `late` is above 0, a ping that drains the
    line finds bytes on it, and decreases `late` by 1.
    """

    def __init__(self, ids):
        self.memory = {i: bytearray(256) for i in ids}
        self.plan, self.calls = [], []
        self.now, self.timeout, self.late = 0.0, 0.0, 0
        self._before = None

    def clock(self):
        return self.now

    def _request(self, name, *arguments):
        self.calls.append((name, *arguments))
        self.now += 0.0005
        failure = self.plan.pop(0) if self.plan else None
        if isinstance(failure, BusError):
            self.now += self.timeout if failure.reason == "timeout" else 0.0
            raise failure
        return failure == "stale"

    def read(self, id, address, size):
        answer = (bytes(self.memory[id][address : address + size]), 0)
        before, self._before = self._before, answer
        return before if self._request("read", id, address, size) else answer

    def write(self, id, address, data):
        self._request("write", id, address, data)
        self.memory[id][address : address + len(data)] = data
        return 0

    def sync_read(self, ids, address, size):
        answer = [(bytes(self.memory[i][address : address + size]), 0) for i in ids]
        before, self._before = self._before, answer
        return before if self._request("sync_read", tuple(ids), address, size) else answer

    def sync_write(self, ids, address, data):
        self._request("sync_write", tuple(ids), address, tuple(data))
        for i, item in zip(ids, data, strict=True):
            self.memory[i][address : address + len(item)] = item

    def ping(self, id):
        self.calls.append(("ping", id))
        if id in self.memory:
            return True
        if self.late > 0:
            self.late -= 1
            self.now += self.timeout / 4
        else:
            self.now += self.timeout
        return False

    def reboot(self, id):
        self._request("reboot", id)

    def set_timeout(self, seconds):
        self.timeout = seconds

    def close(self):
        self.calls.append(("close",))


@pytest.fixture
def fake_bus():
    return FakeBus


#: One joint of every family: emulated device, spec, and the range of its goals.
JOINTS = {
    "sts": ("STS3215", "STS3215-7.4V", {}),
    "xm": ("XM430-W350", "XM430-W350", {"operating_mode": 5, "return_delay_time": 0}),
    "xl430": ("XL430-W250", "XL430-W250", {"return_delay_time": 0}),
    "ex": ("EX-106+", "EX-106+", {"return_delay_time": 0}),
    "rx": ("RX-64", "RX-64", {"return_delay_time": 0}),
    "mx": ("MX-64", "MX-64", {"return_delay_time": 0}),
}


def devices(kind, n, port="main"):
    model, _, registers = JOINTS[kind]
    return [Device(model, id=i + 1, port=port, **registers) for i in range(n)]


@pytest.fixture
def emulated():
    """Return a context manager of an emulated bus and its driver: `emulated(kind, n)`."""
    from contextlib import contextmanager

    @contextmanager
    def start(kind, n, *, is_open=True, spec=None, patience=0.1, **options):
        rate = options.pop("rate", 100.0)
        with Emulator(devices(kind, n), **options) as bus:
            specs = [
                ServoSpec(
                    name=f"joint{i}",
                    model=JOINTS[kind][1],
                    id=i + 1,
                    port=bus.port,
                    **{"lower": -1.0, "upper": 1.0, **(spec or {})},
                )
                for i in range(n)
            ]
            clock = ManualClock(bus) if options.get("clock") == "steps" else None
            servo_bus = ServoBus(specs, rate=rate, reply_timeout_min=patience, clock=clock)
            try:
                if is_open:
                    servo_bus.open()
                yield bus, servo_bus
            finally:
                servo_bus.close()

    return start


@pytest.fixture
def enabled():
    """Return a function that enables a bus at its present position, with limited torque.

    The torque limit is a share of the usable torque.
    """

    def switch_on(servo_bus, share=0.5):
        limit = share * servo_bus.servos.max_torque
        servo_bus.enable(servo_bus.read().position, limit)
        return np.array(limit)

    return switch_on
