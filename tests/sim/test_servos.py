"""Servo model: torque limit, sag under gravity, and friction that the limit does not bound."""

import mujoco
import numpy as np
import pytest

import pliant
from pliant.sim import Overload, Plant


def test_no_physics_step_exceeds_the_limit(arm, grasp):
    plant = Plant(arm)
    plant.reset(grasp)
    rng = np.random.default_rng(3)
    for _ in range(100):
        limit = rng.uniform(0.0, 1.0, plant.n) ** 3 * plant.gains.torque
        plant.write(grasp + rng.uniform(-1.0, 1.0, plant.n), limit)
        for step in range(10):
            plant.advance(n_steps=1)
            assert np.all(np.abs(plant.torque) <= limit + 1e-12), step


def test_limits_above_the_usable_torque_are_cut(arm, grasp):
    plant = Plant(arm)
    plant.reset(grasp)
    plant.write(grasp + 3.0, np.full(plant.n, 1e3))
    plant.advance()
    assert np.all(np.abs(plant.torque) <= plant.gains.torque + 1e-12)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_sag_is_gravity_over_stiffness(arm, grasp, scale):
    plant = Plant(arm, kp_scale=scale, friction_scale=0.0)
    plant.reset(grasp)
    for _ in range(800):
        plant.write(grasp, plant.gains.torque)
        plant.advance()
    sag = grasp - plant.q
    assert np.abs(sag).max() > 0.01
    np.testing.assert_allclose(plant.gains.kp * sag, arm.gravity(plant.q), atol=1e-6)
    np.testing.assert_allclose(plant.torque, arm.gravity(plant.q), atol=1e-6)


def test_gravity_in_the_goal_removes_the_sag(arm, grasp):
    plant = Plant(arm)
    plant.reset(grasp)
    for _ in range(300):
        plant.write(grasp + np.asarray(arm.gravity(plant.q)) / plant.gains.kp, plant.gains.torque)
        plant.advance()
    assert np.abs(plant.q - grasp).max() < 1e-9
    assert np.linalg.norm(plant.tool[:3, 3] - arm.forward_kinematics(grasp)[:3, 3]) < 1e-9


def test_without_limits_it_falls(arm, grasp):
    plant = Plant(arm)
    plant.reset(grasp)
    for _ in range(50):
        plant.write(grasp, np.zeros(plant.n))
        plant.advance()
        assert np.all(plant.torque == 0.0)
    assert np.abs(plant.q - grasp).max() > 0.1


def test_payload_weighs_on_the_joints(arm, grasp):
    plants = [Plant(arm, friction_scale=0.0, payload=load) for load in (None, (0.3, (0.02, 0, 0)))]
    for plant in plants:
        plant.reset(grasp)
        for _ in range(800):
            plant.write(grasp, plant.gains.torque)
            plant.advance()
    pose, jacobian = arm.kinematics(plants[1].q)
    lift = np.array((0.0, 0.0, 0.3 * 9.81))
    arm_of_force = pose[:3, :3] @ (0.02, 0.0, 0.0)
    load = jacobian.T @ np.concatenate((lift, np.cross(arm_of_force, lift)))
    np.testing.assert_allclose(plants[1].torque, arm.gravity(plants[1].q) + load, atol=1e-6)
    assert np.abs(load).max() > 0.5


def test_energy_only_falls_when_nothing_drives(grasp):
    arm = pliant.robots.arm7(gravity=(0.0, 0.0, 0.0))
    plant = Plant(arm)
    plant.reset(grasp)
    plant.mj_data.qvel[:] = 1.0
    plant.mj_model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    energy = []
    for _ in range(1500):
        plant.write(plant.q, np.zeros(plant.n))
        plant.advance(n_steps=1)
        energy.append(float(plant.mj_data.energy[1]))
    assert energy[0] > 0.1
    assert np.all(np.diff(energy) <= 1e-9)
    assert energy[-1] < 1e-3 * energy[0]


def test_friction_holds_smaller_torques(arm, grasp):
    plant = Plant(arm)
    plant.reset(grasp)
    weak = 0.8 * plant.gains.friction
    for _ in range(200):
        plant.write(plant.q + (np.asarray(arm.gravity(plant.q)) + weak) / plant.gains.kp)
        plant.advance()
    assert np.abs(plant.dq).max() < 0.03


@pytest.mark.parametrize("kind", ["current", "pwm"])
def test_speed_of_a_saturated_joint(grasp, kind):
    """The final speed of an unloaded joint at its torque limit is this limit / damping."""
    arm = pliant.robots.arm7(gravity=(0.0, 0.0, 0.0))
    table = pliant.Servos(
        kp=[150.0] * 7,
        max_torque=[10.0] * 7,
        damping=[0.5] * 7,
        armature=[0.01] * 7,
        limit_type=kind,
        no_load_speed=[8.0] * 7 if kind == "pwm" else None,
    )
    plant = Plant(arm, table)
    plant.reset(np.where(np.arange(7) == 4, -2.0, 0.0))
    limit, goal = np.full(7, 10.0), np.zeros(7)
    limit[4] = 0.5
    speeds = []
    for _ in range(200):
        goal[4] = plant.q[4] + 1.0
        plant.write(goal, limit)
        plant.advance()
        speeds.append(plant.dq[4])
    resists = 0.5 + (10.0 / 8.0 if kind == "pwm" else 0.0)
    assert max(speeds) == pytest.approx(0.5 / resists, rel=0.02)


def test_dead_band_gives_no_torque_inside(grasp):
    arm = pliant.robots.arm7(gravity=(0.0, 0.0, 0.0))
    plant = Plant(arm, deadband=0.01)
    plant.reset(grasp)
    plant.write(grasp + 0.009)
    plant.advance()
    assert np.all(plant.torque == 0.0)
    plant.write(grasp + 0.02)
    plant.advance(n_steps=1)
    np.testing.assert_allclose(plant.torque, 0.01 * plant.gains.kp, rtol=1e-9)


def test_overload_cuts_the_torque_until_reset(arm, grasp):
    plant = Plant(arm, overload=Overload(threshold=0.9, seconds=0.5, remains=0.2))
    plant.reset(grasp)
    for tick in range(100):
        plant.write(grasp + np.where(np.arange(7) == 3, 9.0, 0.0))
        plant.advance()
        if tick == 45:
            assert not plant.tripped.any()
    assert plant.tripped[3]
    assert abs(plant.torque[3]) <= 0.2 * plant.gains.torque[3] + 1e-12
    plant.reset(grasp)
    assert not plant.tripped.any()
