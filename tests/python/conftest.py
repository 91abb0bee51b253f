"""Fixtures: model of the arm in the golden data, joint positions and a target."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pliant

GOLDEN = Path(__file__).resolve().parents[1] / "data" / "golden"


@pytest.fixture(scope="session")
def servos() -> pliant.Servos:
    return pliant.Servos(
        kp=[150.0] * 4 + [60.0] * 3,
        max_torque=[10.7] * 4 + [6.4] * 3,
        friction=[0.2] * 4 + [0.1] * 3,
        damping=[1.2] * 4 + [0.8] * 3,
        kv=[1.5] * 4 + [0.5] * 3,
        stiffness_known=True,
    )


@pytest.fixture(scope="session")
def model(servos) -> pliant.Model:
    return pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool", servos=servos)


@pytest.fixture
def q() -> np.ndarray:
    return np.array([0.3, -0.4, 0.2, -1.2, 0.5, 0.6, -0.3])


@pytest.fixture
def target(model, q) -> np.ndarray:
    pose = model.forward_kinematics(q)
    pose[:3, 3] += [0.02, -0.03, 0.01]
    return pose


@pytest.fixture
def controller(model) -> pliant.Controller:
    return pliant.Controller(model, pliant.Settings.soft("y"))
