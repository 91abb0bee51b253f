"""Fixtures for tests of the simulator: an arm, and a loop with gravity compensation."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the simulator's tests need the extra sim")

import pliant.robots


@pytest.fixture(scope="session")
def arm():
    return pliant.robots.arm7()


@pytest.fixture
def floating():
    """Return a function that runs a plant whose goals track the arm and compensate gravity."""

    def run(plant, ticks):
        for _ in range(ticks):
            gravity = np.asarray(plant.model.gravity(plant.q))
            plant.write(plant.q + gravity / plant.gains.kp, plant.gains.torque)
            plant.advance()

    return run
