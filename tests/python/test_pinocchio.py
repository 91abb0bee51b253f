"""Kinematics and gravity compared with Pinocchio, on built-in arms and real robots."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pliant

pin = pytest.importorskip("pinocchio", reason="PyPI `pin` is not installed: no independent check")

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = ROOT / ".." / "shared" / "robots"
TOLERANCE = 1e-12
GRAVITY = (1.0, -2.0, -9.0)  # gravity, along none of the base axes


class Oracle:
    """A chain of a robot in Pinocchio, with joint coordinates in the order of pliant's model."""

    def __init__(self, model: pliant.Model, text: str):
        self.model, self.pin = model, pin.buildModelFromXML(text)
        self.data = self.pin.createData()
        self.base, self.tip = self.pin.getFrameId(model.base), self.pin.getFrameId(model.tip)

    def configuration(self, q):
        out = pin.neutral(self.pin)
        for joint in self.model.joints:
            if not self.pin.existJointName(joint.name) or joint.kind in {"fixed", "other"}:
                continue
            slot = self.pin.joints[self.pin.getJointId(joint.name)]
            value = joint.locked_at if joint.q_index is None else q[joint.q_index]
            if joint.mimic is not None:
                leader = self.model.joints[joint.mimic.joint]
                value = leader.locked_at if leader.q_index is None else q[leader.q_index]
                value = joint.mimic.multiplier * value + joint.mimic.offset
            if slot.nq == 2:
                out[slot.idx_q : slot.idx_q + 2] = np.cos(value), np.sin(value)
            else:
                out[slot.idx_q] = value
        return out

    def collect(self, full):
        """Convert columns of a matrix from Pinocchio's coordinates to pliant's joints."""
        out = np.zeros((full.shape[0], self.model.n))
        for joint in self.model.joints:
            if joint.q_index is not None:
                column = self.pin.joints[self.pin.getJointId(joint.name)].idx_v
                factor = 1.0 if joint.mimic is None else joint.mimic.multiplier
                out[:, joint.q_index] += factor * full[:, column]
        return out

    def kinematics(self, q):
        full = self.configuration(q)
        pin.computeJointJacobians(self.pin, self.data, full)
        pin.updateFramePlacements(self.pin, self.data)
        root_from_base, root_from_tip = self.data.oMf[self.base], self.data.oMf[self.tip]
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = self.collect(pin.getFrameJacobian(self.pin, self.data, self.tip, axes))
        rotation = root_from_base.rotation.T
        jacobian = np.vstack([rotation @ jacobian[:3], rotation @ jacobian[3:]])
        return root_from_base.actInv(root_from_tip).homogeneous, jacobian

    def gravity(self, q):
        full = self.configuration(q)
        pin.forwardKinematics(self.pin, self.data, full)
        pin.updateFramePlacements(self.pin, self.data)
        self.pin.gravity.linear = self.data.oMf[self.base].rotation @ np.array(GRAVITY)
        return self.collect(pin.computeGeneralizedGravity(self.pin, self.data, full)[None])[0]


def _samples(model, count=20):
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    generator = np.random.default_rng(7)
    return [np.clip(np.zeros(model.n), low, high), *generator.uniform(low, high, (count, model.n))]


def _agree(actual, expected):
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=TOLERANCE * scale)


def _compare(path, base=None, tip=None):
    text = path.read_text(encoding="utf-8")
    model = pliant.Model.from_urdf(path, base=base, tip=tip, gravity=GRAVITY)
    oracle = Oracle(model, text)
    for q in _samples(model):
        pose, jacobian = model.kinematics(q)
        expected_pose, expected_jacobian = oracle.kinematics(q)
        _agree(pose, expected_pose)
        _agree(jacobian, expected_jacobian)
        _agree(model.gravity(q), oracle.gravity(q))
        rotation = pose[:3, :3].T
        local = np.vstack([rotation @ jacobian[:3], rotation @ jacobian[3:]])
        _agree(model.jacobian(q, reference="local"), local)


@pytest.mark.parametrize("name", ["arm7", "so101_like", "koch_like"])
def test_built_in_arms(name):
    _compare(ROOT / "python" / "pliant" / "robots" / f"{name}.urdf", tip="tool")


def test_the_arm_of_the_golden_data():
    _compare(ROOT / "tests" / "data" / "golden" / "arm7.urdf", tip="tool")


def _references():
    return sorted(ROBOTS.glob("*/reference_*.json")) if ROBOTS.is_dir() else []


@pytest.mark.skipif(not ROBOTS.is_dir(), reason=f"no third-party robots in {ROBOTS}")
@pytest.mark.parametrize("path", _references(), ids=lambda p: f"{p.parent.name}-{p.stem}")
def test_real_robots(path):
    facts = json.loads(path.read_text(encoding="utf-8"))
    _compare(path.parent / facts["urdf"], facts["base"], facts["tip"])


def test_inverse_kinematics_reaches_the_target_or_gives_the_reason():
    model = pliant.Model.from_urdf(ROOT / "tests" / "data" / "golden" / "arm7.urdf", tip="tool")
    for q in _samples(model, 10)[1:]:
        target = model.forward_kinematics(q)
        solution = model.inverse_kinematics(target, 0.5 * q)
        assert solution
        assert solution.converged
        np.testing.assert_allclose(model.forward_kinematics(solution.q), target, atol=1e-7)
    target[:3, 3] = 5.0
    failure = model.inverse_kinematics(target, q)
    assert not failure
    assert "out of reach" in failure.reason
    assert failure.position_error > 5.0
    assert model.inverse_kinematics([0.2, 0.1, -0.3], q, axes="xyz").converged
