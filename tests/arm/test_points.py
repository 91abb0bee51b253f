"""Points along the chain, against the core's own kinematics."""

import numpy as np
import pytest

import pliant.robots
from pliant.arm.points import Points
from pliant.sim import Plant


@pytest.mark.parametrize("name", pliant.robots.names())
def test_tool_and_its_speed_are_the_cores(name):
    model = pliant.robots.load(name)
    rng = np.random.default_rng(0)
    points = Points(model)
    for _ in range(20):
        q, u = rng.uniform(-2, 2, model.n), rng.normal(size=model.n)
        place, speed, _ = points.walk(q, u)
        pose, jacobian = model.kinematics(q)
        np.testing.assert_allclose(place[-1], pose[:3, 3], atol=1e-12)
        np.testing.assert_allclose(speed[-1], jacobian[:3] @ u, atol=1e-11)


def test_speeds_are_differences_of_positions():
    model = pliant.robots.arm7()
    rng = np.random.default_rng(1)
    points = Points(model)
    q, u = rng.uniform(-2, 2, 7), rng.normal(size=7)
    difference = (points(q + 1e-6 * u) - points(q - 1e-6 * u)) / 2e-6
    np.testing.assert_allclose(points.walk(q, u)[1], difference, atol=1e-8)


@pytest.mark.parametrize("name", pliant.robots.names())
def test_kinetic_energy_is_that_of_the_simulated_arm(name):
    mujoco = pytest.importorskip("mujoco")
    model = pliant.robots.load(name, payload=(0.2, (0.01, 0.0, 0.03)))
    plant = Plant(model, off_chain="welded")
    points = Points(model, model.servos.armature)
    rng = np.random.default_rng(2)
    dofs = [plant.mj_model.joint(name).dofadr[0] for name in model.joint_names]
    full = np.zeros((plant.mj_model.nv, plant.mj_model.nv))
    for _ in range(5):
        q, u = rng.uniform(-1, 1, model.n), rng.normal(size=model.n)
        plant.reset(np.clip(q, model.lower, model.upper))
        mujoco.mj_forward(plant.mj_model, plant.mj_data)
        mujoco.mj_fullM(plant.mj_model, plant.mj_data, full)
        energy = 0.5 * u @ full[np.ix_(dofs, dofs)] @ u
        assert points.walk(plant.q, u)[2] == pytest.approx(energy, rel=1e-6)
