"""Friction by speed and load: the formula, and simulated joints compared with it."""

import numpy as np
import pytest

import pliant.robots
from pliant import ConfigError, OutOfRangeError, ShapeError
from pliant.sim import MX64, MX106, STS3215, Friction, Plant
from pliant.sim.postures import VERTICAL


def test_stribeck_share_falls_from_one_to_zero():
    gear = Friction(base=0.1, stribeck=0.3, speed=0.5, exponent=2.0)
    speeds = np.array([0.0, 0.5, -0.5, 50.0])
    share = np.array([1.0, np.exp(-1.0), np.exp(-1.0), 0.0])
    np.testing.assert_allclose(gear.largest(0.0, 0.0, speeds), 0.1 + 0.3 * share, atol=1e-15)


def test_motor_and_external_torque_add_friction():
    gear = Friction(base=0.1, motor=0.2, external=0.1, motor_stribeck=0.3, speed=1.0)
    at_rest = 0.1 + abs(0.1 * -2.0 - 0.2 * 3.0) + abs(0.3 * 3.0)
    assert gear.largest(3.0, -2.0, 0.0) == pytest.approx(at_rest)
    fast = 0.1 + abs(0.1 * -2.0 - 0.2 * 3.0)
    assert gear.largest(3.0, -2.0, 100.0) == pytest.approx(fast)


@pytest.mark.parametrize(
    ("motor", "external", "expected"),
    [(2.0, -1.0, 0.5 * 1.0), (1.0, -2.0, 0.25 * 1.0), (2.0, 1.0, 0.0), (2.0, -2.0, 0.0)],
)
def test_quadratic_part_acts_only_between_opposed_torques(motor, external, expected):
    gear = Friction(motor_quadratic=0.25, external_quadratic=0.5)
    assert gear.largest(motor, external, 0.0) == pytest.approx(expected)


@pytest.mark.parametrize("gear", [MX106, MX64, STS3215])
def test_identified_gears_have_more_friction_at_rest_and_under_load(gear):
    assert gear.at_rest(2.0) > gear.at_rest(0.5) > gear.at_rest(0.0) > 0.0
    assert gear.largest(1.0, -1.0, 0.0) >= gear.largest(1.0, -1.0, 5.0)


def test_gears_of_an_arm_are_those_of_its_joints():
    arm = Friction.of([MX106] * 4 + [MX64] * 3)
    assert arm.at_rest(np.ones(7))[[0, 6]] == pytest.approx([MX106.at_rest(1), MX64.at_rest(1)])


def test_simulated_joint_breaks_away_at_the_friction_of_its_load():
    """A joint without gravity load moves once its torque exceeds base and load friction."""
    arm = pliant.robots.arm7(gravity=(0.0, 0.0, 0.0))
    gear = Friction(base=0.2, motor=0.5)  # stands still while τ ≤ 0.2 + 0.5 τ: up to 0.4 N·m
    for torque, moves in ((0.35, False), (0.6, True)):
        plant = Plant(arm, friction=gear)
        plant.reset(VERTICAL)
        goal = VERTICAL + 0.5 * (np.arange(7) == 0)  # [rad], so far that the servo exerts its limit
        for _ in range(30):
            plant.write(goal, np.full(7, torque))
            plant.advance()
        assert (abs(plant.q[0] - VERTICAL[0]) > 5e-3) == moves


def test_simulated_friction_is_the_formula_at_the_load_of_the_pose():
    arm = pliant.robots.arm7()
    plant = Plant(arm, friction=MX106)
    plant.reset(VERTICAL)
    gravity = arm.gravity(VERTICAL)
    for _ in range(100):
        plant.write(VERTICAL + gravity / arm.servos.kp)
        plant.advance()
    formula = MX106.largest(plant.torque, -arm.gravity(plant.q), 0.0)
    np.testing.assert_allclose(plant.friction, formula, rtol=0.02, atol=5e-3)


def test_coulomb_friction_is_that_of_the_table():
    arm = pliant.robots.arm7()
    np.testing.assert_array_equal(Plant(arm).friction, arm.servos.friction)


def test_invalid_friction_is_refused():
    with pytest.raises(ConfigError, match=r"Friction\.motor must be at least 0"):
        Friction(motor=-0.1)
    with pytest.raises(ConfigError, match="speed must be above 0"):
        Friction(speed=0.0)
    with pytest.raises(ConfigError, match="friction is 'coulomb' or"):
        Plant(pliant.robots.arm7(), friction="stribeck")
    with pytest.raises(ShapeError, match="base has shape"):
        Plant(pliant.robots.arm7(), friction=Friction(base=[0.1, 0.2]))


def test_the_friction_model_matches_the_gears():
    """The friction model (linear in load, rational in speed) fits slow gears within 20 %."""
    servos = Friction.of([MX106]).assumed(pliant.Servos(kp=[100.0], max_torque=10.0, friction=0.3))
    assert servos.friction.tolist() == [0.0]
    for load in (0.5, 2.0, 4.0):
        for speed in (0.0, 0.3, 1.0):
            x = speed / servos.stribeck_speed
            share = 1.0 / (1.0 + x + x**2)
            assumed = share * servos.stribeck + load * (
                servos.load_friction + share * servos.load_stribeck
            )
            assert assumed == pytest.approx(MX106.largest(load, -load, speed), rel=0.2)


def slide(creep, seconds=4.0):
    """Return the motion (n,) [rad] of joints without torque whose friction exceeds gravity."""
    arm = pliant.robots.so101()
    plant = Plant(arm, friction_scale=12.0, friction_creep=creep)
    plant.reset(np.zeros(arm.n))
    plant.write(np.zeros(arm.n), np.zeros(arm.n))
    for _ in range(round(seconds * plant.rate)):
        plant.advance()
    return np.abs(plant.q)


def test_joints_held_by_friction_slide_in_proportion_to_the_creep():
    default, slow = slide(1.0), slide(0.1)
    assert default.max() > 1e-3
    np.testing.assert_allclose(slow[default > 1e-3], 0.1 * default[default > 1e-3], rtol=0.1)
    with pytest.raises(OutOfRangeError, match="friction_creep must be in"):
        Plant(pliant.robots.so101(), friction_creep=0.0)
