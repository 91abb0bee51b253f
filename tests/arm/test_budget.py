"""Heat, temperature and supply: limits come down before the hardware trips."""

import numpy as np
import pytest

import pliant
from pliant.arm import Budget, ServoStatus
from pliant.arm.thermal import ThermalModel


def meter(**options):
    return ThermalModel(Budget(**options), np.array([10.0, 10.0]), np.array([2.0, 2.0]))


def test_full_torque_is_over_after_five_seconds_and_continuous_torque_never():
    it = meter()
    for _ in range(500):
        it.update(np.array([10.0, 4.0]), 0.01)
    assert it.heat[0] == pytest.approx(1.0, abs=0.05)
    for _ in range(60000):
        it.update(np.array([0.0, 4.0]), 0.01)
    assert it.heat[1] == pytest.approx(1.0)
    assert it.ceiling()[1] == pytest.approx(4.0)
    assert it.faults(("a", "b")) == []


def test_a_hot_servo_gets_less_then_none():
    it = meter(hottest=70.0)
    it.temperature[:] = 64.0, 69.0
    assert it.ceiling() == pytest.approx([5.0, 0.0])
    assert "b has 69" in it.faults(("a", "b"))[0]


def test_the_supply_is_shared_above_the_weight():
    it = meter(supply=2.0)
    limit = it.limit_current(np.array([10.0, -10.0]), np.array([10.0, 10.0]), np.array([3.0, 1.0]))
    assert 0.2 * limit.sum() == pytest.approx(2.0, abs=0.01)
    assert np.all(limit >= [3.0, 1.0])
    # What is not drawn is not cut.
    assert it.limit_current(np.array([4.0, 4.0]), np.full(2, 10.0), np.zeros(2)) == pytest.approx(
        [10, 10]
    )


def test_a_supply_needs_known_currents():
    with pytest.raises(pliant.ConfigError, match="stall currents"):
        ThermalModel(Budget(supply=5.0), np.ones(2), np.array([1.0, np.nan]))
    with pytest.raises(pliant.ConfigError, match="continuous"):
        Budget(continuous=0.0)


@pytest.mark.parametrize("name", ["continuous", "seconds", "supply", "hottest"])
def test_what_is_not_a_number_is_no_budget(name):
    with pytest.raises(pliant.ConfigError, match=f"{name} must be"):
        Budget(**{name: np.nan})


def test_limits_of_an_arm_come_down_with_its_heat_but_carry_its_weight(make):
    arm = make()
    with arm:
        torque, q = np.asarray(arm.servos.max_torque), arm.read().q
        for heat, share in ((0.5, 1.0), (0.9, 0.7), (1.1, 0.4)):
            arm.clock.wait_until(arm.clock.now() + 0.6)  # limits have risen
            arm.read()
            arm._io.thermal.heat[:] = heat
            arm.write(q, torque)
            _, _, sent = arm.drive.diary[-1]
            weight = 1.1 * np.abs(arm.model.gravity(q))
            assert sent == pytest.approx(np.maximum(share * torque, weight))
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
