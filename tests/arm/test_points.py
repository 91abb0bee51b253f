"""Points along the chain, compared with the kinematics of the core."""

import numpy as np
import pytest

import pliant.robots
from pliant._core import ArmPoints
from pliant.sim import Plant


@pytest.mark.parametrize("name", pliant.robots.names())
def test_tool_and_its_speed_are_the_cores(name):
    model = pliant.robots.load(name)
    rng = np.random.default_rng(0)
    points = ArmPoints(model)
    for _ in range(20):
        q, u = rng.uniform(-2, 2, model.n), rng.normal(size=model.n)
        pose, jacobian = model.kinematics(q)
        np.testing.assert_allclose(points.position(q)[-1], pose[:3, 3], atol=1e-12)
        np.testing.assert_allclose(points.velocity(q, u)[-1], jacobian[:3] @ u, atol=1e-11)


def test_speeds_are_differences_of_positions():
    model = pliant.robots.arm7()
    rng = np.random.default_rng(1)
    points = ArmPoints(model)
    q, u = rng.uniform(-2, 2, 7), rng.normal(size=7)
    difference = (points.position(q + 1e-6 * u) - points.position(q - 1e-6 * u)) / 2e-6
    np.testing.assert_allclose(points.velocity(q, u), difference, atol=1e-8)


@pytest.mark.parametrize("name", pliant.robots.names())
def test_inertia_is_that_of_the_simulated_arm(name):
    mujoco = pytest.importorskip("mujoco")
    model = pliant.robots.load(name, payload=(0.2, (0.01, 0.0, 0.03)))
    plant = Plant(model, off_chain="welded")
    points = ArmPoints(model, model.servos.armature)
    rng = np.random.default_rng(2)
    dofs = [plant.mj_model.joint(name).dofadr[0] for name in model.joint_names]
    full = np.zeros((plant.mj_model.nv, plant.mj_model.nv))
    for _ in range(5):
        q = rng.uniform(-1, 1, model.n)
        plant.reset(np.clip(q, model.lower, model.upper))
        mujoco.mj_forward(plant.mj_model, plant.mj_data)
        mujoco.mj_fullM(plant.mj_model, plant.mj_data, full)
        expected = full[np.ix_(dofs, dofs)]
        inertia = points.inertia(plant.q)
        np.testing.assert_allclose(inertia, expected, atol=1e-6 * np.abs(expected).max())


def test_effective_mass_is_what_an_impulse_at_the_point_meets():
    model = pliant.robots.arm7()
    points = ArmPoints(model, model.servos.armature)
    rng = np.random.default_rng(3)
    q, u = rng.uniform(-1, 1, 7), rng.normal(size=7)
    jacobian, inertia = model.jacobian(q)[:3], points.inertia(q)
    speed = points.velocity(q, u)[-1]
    push = speed / np.linalg.norm(speed)
    velocity = jacobian @ np.linalg.solve(inertia, jacobian.T @ push)
    assert points.effective_mass(q, u)[-1] == pytest.approx(1.0 / (push @ velocity), rel=1e-9)
    assert points.effective_mass(q, np.zeros(7)).max() == 0.0
