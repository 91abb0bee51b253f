"""Poses that the tests of identification share."""

import pytest

pytest.importorskip("mujoco", reason="the arm that identifies itself is simulated")

import pliant.robots
from pliant.sim.postures import VERTICAL as GRASP


@pytest.fixture(scope="session")
def arm():
    return pliant.robots.arm7()


@pytest.fixture
def grasp():
    return GRASP.copy()
