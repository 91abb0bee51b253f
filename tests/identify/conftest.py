"""The arm that the tests of identification share."""

import pytest

pytest.importorskip("mujoco", reason="the arm that identifies itself is simulated")

import pliant.robots


@pytest.fixture(scope="session")
def arm():
    return pliant.robots.arm7()
