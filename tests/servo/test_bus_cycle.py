"""Requests that the core makes while nothing needs attention, compared with those of Python."""

import sys
from collections import Counter

import numpy as np
import pytest

from pliant.servo import BusError, ServoBus

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Python makes all requests there")

CYCLES = 45
METHODS = ("_read_each", "_write_each", "_poll_each", "_finish_read", "_finish_write")


#: Events before cycle 8, and 0.16 s later: a servo that restarts has lost its torque by then.
EVENTS = {
    "nothing": (lambda bus: None, lambda bus: None),
    **{
        fault: (lambda bus, fault=fault: bus.faults.inject(fault, 2), lambda bus: None)
        for fault in ("lose", "corrupt", "truncate", "wrong_id", "deaf")
    },
    "silence": (lambda bus: bus.unplug(2), lambda bus: bus.plug(2)),
    "restart": (lambda bus: bus.reboot(2), lambda bus: None),
    "voltage": (
        lambda bus: setattr(bus.servo(1), "supply", 7.0),
        lambda bus: setattr(bus.servo(1), "supply", 7.4),
    ),
}


def session(emulated, enabled, monkeypatch, events, *, in_core):
    """Return requests, readings, statuses and counters of a session, and the calls of METHODS."""
    calls = Counter()
    for name in METHODS:
        method = getattr(ServoBus, name)

        def counted(bus, *args, name=name, method=method):
            calls[name] += 1
            return method(bus, *args)

        monkeypatch.setattr(ServoBus, name, counted)
    with emulated("sts", 3, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        if not in_core:
            servo_bus.end_cycles()
            servo_bus._has_usual_cycles = False
        bus.sync()
        bus.log.clear()
        calls.clear()
        readings, statuses = [], []
        for cycle in range(CYCLES):
            if cycle in (8, 24):
                events[cycle // 24](bus)
            found = servo_bus.read()
            readings.append([found.position.tolist(), found.ok.tolist(), found.load.tolist()])
            speed = [None, np.full(3, 2.0)][cycle % 2]
            servo_bus.write(np.array([0.0, 0.02, -0.01]) * cycle, limit, speed)
            statuses.append(servo_bus.poll_status())
            bus.advance(0.01)
        bus.sync()
        requests = [
            (entry.instruction, entry.request) for entry in bus.log if entry.instruction != "ping"
        ]
        # The number of drains depends on the time that late replies take.
        counters = {**servo_bus.counters, "drains": None}
        return (requests, readings, statuses, counters), calls


@pytest.mark.pty
@pytest.mark.parametrize("event", EVENTS)
def test_the_core_makes_the_requests_that_python_makes(emulated, enabled, event):
    found = {}
    for in_core in (False, True):
        with pytest.MonkeyPatch.context() as patch:
            result = session(emulated, enabled, patch, EVENTS[event], in_core=in_core)
            found[in_core], calls = result
        if not in_core:
            assert all(calls[name] == CYCLES for name in METHODS[:3])
        elif event == "nothing":
            # Until Python has written and polled once, the core makes no such request.
            assert sum(calls.values()) <= 4
        else:
            assert calls["_finish_read"] > 0
            assert sum(calls.values()) < len(METHODS[:3]) * CYCLES
    assert found[True] == found[False]


@pytest.mark.pty
def test_a_port_that_hangs_up_raises_in_read_and_in_write(emulated, enabled):
    for name, arguments in (("read", ()), ("write", (np.zeros(2), np.full(2, 0.1)))):
        with emulated("sts", 2, clock="steps") as (bus, servo_bus):
            limit = enabled(servo_bus)
            for _ in range(6):
                servo_bus.read()
                servo_bus.write(np.zeros(2), limit)
                servo_bus.poll_status()
            bus.pull()
            with pytest.raises(BusError, match="gone"):
                getattr(servo_bus, name)(*arguments)
            assert servo_bus._ports[0].guard.is_gone
