"""Poses that the tests of identification share."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arm that identifies itself is simulated")

import pliant.robots

#: A grasp pose of arm7 [rad].
GRASP = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])


@pytest.fixture(scope="session")
def arm():
    return pliant.robots.arm7()


@pytest.fixture
def grasp():
    return GRASP.copy()
