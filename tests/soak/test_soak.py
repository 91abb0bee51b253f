"""Control over an emulated bus with faults in 1 % of all transactions, in emulated time."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arm behind the servos needs the extra sim")
pytest.importorskip("rustypot", reason="the bus needs the extra servo")
pytest.importorskip("pydantic", reason="the configurations need the extra config")

from experiments import soak
from experiments.emulated_arm import FAMILIES, stepped
from experiments.soak import Audit


@pytest.mark.parametrize(
    ("family", "seconds"),
    [
        *((family, 7.0) for family in FAMILIES),
        *(pytest.param(family, 20.0, marks=pytest.mark.full) for family in FAMILIES),
    ],
)
def test_faults_break_no_rule(family, seconds):
    run = soak.soak_stepped(family, seconds)
    assert not run.ended
    assert not run.broken
    assert run.stale == run.late == 0
    assert run.above == 0
    assert run.off <= 1.0
    # Check the test itself: enough ticks ran, faults of every kind occurred, and stale data would
    # have been noticed.
    assert run.loop["ticks"] >= 97.5 * seconds
    # With `sts`, which has fewer transactions, no reply is lost within 7 s.
    absent = {"lose"} if (family, seconds) == ("sts", 7.0) else set()
    assert set(run.struck) >= set(soak.KINDS) - absent
    assert run.bus["retries"] > 0
    # A register differs from the written value only after the injected loss of a packet, which
    # contains the values for all servos. Feetech and Protocol 1.0 servos are all read back in one
    # cycle, Protocol 2.0 servos one per cycle.
    registers = 1 if family == "x" else len(FAMILIES[family].models)
    assert run.bus["mismatches"] <= registers * run.struck["deaf"]
    assert run.telling > 0.3


def test_every_family_is_soaked():
    assert set(FAMILIES) == {"sts", "x", "p1"}


def test_forbidden_behaviour_is_detected():
    with stepped("sts", arm={}, log=10) as (bus, arm):
        arm.open()
        audit = bus.log.watch = Audit(bus, machine=False)
        io = arm.drive._ports[0]._io
        io.sync_write([1], 48, [bytes((232, 3))])  # limit 1000, as high as the ceiling allows
        io.sync_write([2], 42, [bytes((0, 8))])
        io.write(3, 40, b"\x01")
        io.write(4, 9, bytes((10, 0)))
        bus.servo(5).put("max_torque_limit", 500)
        io.sync_write([5], 48, [bytes((245, 1))])
        bus.sync()
    assert audit.report()["broken"] == {
        "EEPROM written": 1,
        "goal before limit": 1,
        "torque before goal": 1,
        "goal without torque on after it": 1,
        "limit above the ceiling": 1,
    }


def test_a_position_from_before_is_stale():
    count = np.array([0.001, 0.001])
    truth = np.array([[0.00, 0.100, 0.5], [0.01, 0.103, 0.5], [0.02, 0.106, 0.5]])
    true = (0, 0.106, 0.015, 0.025)
    old = (0, 0.103, 0.015, 0.025)
    unread = (1, 0.500, 0.050, 0.060)
    assert soak.stale([true, old, unread], truth, count) == pytest.approx([0.0, 3.0, np.inf])
