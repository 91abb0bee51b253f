"""Limits by heat, temperature and supply current: they decrease before the servos shut down."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import pliant
from pliant.arm import Budget, ServoStatus
from pliant.arm.thermal import thermal_faults


def meter(**options):
    return Budget(**options).thermal_model([10.0, 10.0], [2.0, 2.0])


def test_full_torque_is_over_after_five_seconds_and_continuous_torque_never():
    it = meter()
    for _ in range(500):
        it.update(np.array([10.0, 4.0]), 0.01)
    assert it.heat[0] == pytest.approx(1.0, abs=0.05)
    for _ in range(60000):
        it.update(np.array([0.0, 4.0]), 0.01)
    assert it.heat[1] == pytest.approx(1.0)
    assert it.torque_ceiling()[1] == pytest.approx(4.0)
    assert thermal_faults(it, ("a", "b"), it.temperature) == []


def test_a_hot_servo_gets_less_then_none():
    it = meter(hottest=70.0)
    it.set_temperature(0, 64.0)
    it.set_temperature(1, 69.0)
    assert it.torque_ceiling() == pytest.approx([5.0, 0.0])
    assert "b is at 69" in thermal_faults(it, ("a", "b"), it.temperature)[0]


@pytest.mark.parametrize(
    ("heat", "degrees", "expected"),
    [
        (1.2, 59.0, []),
        (1.6, 59.0, ["a is at 160 % of its thermal budget"]),
        (0.5, 68.0, ["a is at 68 °C and its limit is 68 °C"]),
        (0.5, 67.9, []),
        (
            1.6,
            80.0,
            [
                "a is at 160 % of its thermal budget",
                "a is at 80 °C and its limit is 68 °C",
            ],
        ),
    ],
)
def test_a_servo_beyond_its_budget_is_named_with_the_figure(heat, degrees, expected):
    thermal = SimpleNamespace(
        heat=[heat, 0.0], temperature=[degrees, 20.0], zero_torque_temperature=68.0
    )
    faults = thermal_faults(thermal, ("a", "b"), [degrees, 20.0])
    assert [re.split(",|:", fault)[0] for fault in faults] == expected


def test_the_supply_is_shared_above_the_weight():
    it = meter(supply=2.0)
    limit = it.limit_current([10.0, -10.0], [3.0, 1.0], [10.0, 10.0])
    assert 0.2 * limit.sum() == pytest.approx(2.0, abs=0.01)
    assert np.all(limit >= [3.0, 1.0])
    # The limits of joints without current are not reduced.
    assert it.limit_current([4.0, 4.0], [0.0, 0.0], [10.0, 10.0]) == pytest.approx([10, 10])


def test_a_supply_needs_known_currents():
    with pytest.raises(pliant.ConfigError, match="stall currents"):
        Budget(supply=5.0).thermal_model(np.ones(2), [1.0, np.nan])
    with pytest.raises(pliant.ConfigError, match="continuous"):
        Budget(continuous=0.0)


@pytest.mark.parametrize("name", ["continuous", "seconds", "supply", "hottest"])
def test_a_budget_that_is_not_finite_is_refused(name):
    with pytest.raises(pliant.ConfigError, match=f"Budget.{name}: must be"):
        Budget(**{name: np.nan})


def test_limits_of_an_arm_come_down_with_its_heat_but_carry_its_weight(make):
    arm = make()
    with arm:
        torque, q = np.asarray(arm.servos.max_torque), arm.read().q
        for heat, share in ((0.5, 1.0), (0.9, 0.7), (1.1, 0.4)):
            arm.clock.wait_until(arm.clock.now() + 0.6)  # until the ramp after torque on has ended
            arm.read()
            # A joint with this constant torque settles at the thermal load `heat`.
            constant = np.sqrt(heat) * Budget().continuous * arm._io._usable
            arm._io.thermal.update(constant, 1e9)
            arm.write(q, torque)
            _, _, limit = arm.drive.diary[-1]
            weight = 1.1 * np.abs(arm.model.gravity(q))
            assert limit == pytest.approx(np.maximum(share * torque, weight))
        assert set(arm.heat.values()) == {1.1}
        arm.leave_enabled()


def test_a_servo_that_reports_a_fault_ends_the_loop(make):
    arm = make()
    arm.drive.poll_status = lambda: ServoStatus(
        "elbow_pitch", 11.1, 30.0, ("elbow_pitch: overload",)
    )
    arm.enable()
    assert arm.read().voltage[3] == 11.1
    with pytest.raises(pliant.ServoFaultError, match="overload"):
        next(iter(pliant.Loop(arm)))
    arm.leave_enabled()
