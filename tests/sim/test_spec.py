"""Simulation built from a model: equal kinematics and gravity, for every available robot."""

import json
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pliant
import pliant.robots
from pliant.sim import Plant

ROBOTS = Path(__file__).resolve().parents[3] / "shared" / "robots"
FILES = {
    "panda": "panda.urdf",
    "so101": "so101_new_calib.urdf",
    "ur5e": "ur5e.urdf",
    "vx300s": "vx300s.urdf",
    "xarm7": "xarm7.urdf",
}
TWO_FINGERS = """
<robot name="hand">
  <link name="base"/><link name="arm"><inertial><mass value="1"/><origin xyz="0.2 0 0"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="left"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="right"/><link name="tool"/>
  <joint name="swing" type="revolute"><parent link="base"/><child link="arm"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="7" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="left"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.05" effort="20" velocity="1"/></joint>
  <joint name="twin" type="prismatic"><parent link="arm"/><child link="right"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/><mimic joint="slide" multiplier="-1" offset="0.01"/>
    <limit lower="-0.05" upper="0.05" effort="20" velocity="1"/></joint>
  <joint name="mount" type="fixed"><parent link="arm"/><child link="tool"/>
    <origin xyz="0.5 0 0" rpy="0.3 0.2 0.1"/></joint>
</robot>
"""


def hold(plant, q, ticks=200):
    """Hold q with gravity-compensated goals; return the largest position error [rad]."""
    plant.reset(q)
    for _ in range(ticks):
        gravity = np.asarray(plant.model.gravity(plant.q))
        plant.write(q + gravity / plant.gains.kp, plant.gains.torque)
        plant.advance()
    return float(np.abs(plant.q - q).max())


@pytest.mark.parametrize("name", pliant.robots.names())
def test_kinematics_and_gravity_are_the_models(name):
    arm = pliant.robots.load(name)
    plant = Plant(arm, off_chain="welded")
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = rng.uniform(arm.lower, arm.upper)
        plant.reset(q)
        np.testing.assert_allclose(plant.tool, arm.forward_kinematics(q), atol=1e-12)
        mujoco.mj_forward(plant.mj_model, plant.mj_data)
        np.testing.assert_allclose(plant.mj_data.qfrc_bias, arm.gravity(q), atol=1e-12)


@pytest.mark.parametrize("name", pliant.robots.names())
def test_built_in_arms_hold_themselves(name):
    arm = pliant.robots.load(name)
    q = 0.3 * np.asarray(arm.upper) + 0.2 * np.asarray(arm.lower)
    assert hold(Plant(arm), q) < 1e-4


def test_an_unknown_arm_lists_those_there_are():
    with pytest.raises(pliant.ConfigError, match="no built-in arm 'arm8'; there are arm7, so101"):
        pliant.robots.load("arm8")


@pytest.mark.parametrize("name", FILES)
def test_real_robots_build_and_hold(name):
    path = ROBOTS / name / FILES[name]
    if not path.exists():
        pytest.skip(f"{path} is not here")
    reference = json.loads((path.parent / "reference_fk.json").read_text(encoding="utf-8"))
    arm = pliant.Model.from_urdf(str(path), base=reference["base"], tip=reference["tip"])
    plant = Plant(arm)
    lower, upper = np.nan_to_num(arm.lower, neginf=-1.0), np.nan_to_num(arm.upper, posinf=1.0)
    q = (lower + upper) / 2 + 0.1 * (upper - lower)
    assert hold(plant, q) < 1e-3
    np.testing.assert_allclose(plant.tool, arm.forward_kinematics(plant.q), atol=1e-9)


def test_servos_are_guessed_from_efforts_or_asked_for():
    arm = pliant.Model.from_urdf_str(TWO_FINGERS, tip="tool")
    gains = Plant(arm).gains
    assert gains.kp[0] == pytest.approx(7.0 / 0.07)
    assert gains.friction[0] == pytest.approx(0.14)
    assert gains.damping[0] == pytest.approx(0.7)
    bare_model = pliant.Model.from_urdf_str(
        TWO_FINGERS.replace(' effort="7"', ' effort="0"'), tip="tool"
    )
    with pytest.raises(pliant.ConfigError, match="servos of swing"):
        Plant(bare_model)
    Plant(bare_model, pliant.Servos(kp=[10.0], max_torque=[1.0]))


def test_fingers_ride_and_follow():
    arm = pliant.Model.from_urdf_str(TWO_FINGERS, tip="tool", locked={"slide": 0.02})
    plant = Plant(arm)
    plant.reset([0.1])
    for _ in range(100):
        plant.write([0.1], extra={"slide": (0.04, 20.0)})
        plant.advance()
    left, right = (float(plant.mj_data.joint(n).qpos[0]) for n in ("slide", "twin"))
    assert left == pytest.approx(0.04, abs=1e-3)
    assert right == pytest.approx(0.01 - left, abs=1e-3)
    welded = Plant(arm, off_chain="welded")
    welded.reset([0.1])
    assert welded.mj_model.nv == 1
    np.testing.assert_allclose(
        welded.ground_truth.frame("right").position - welded.ground_truth.frame("left").position,
        (0.0, -0.03, 0.0),
        atol=1e-12,
    )


def test_the_missing_extra_is_one_line():
    code = "import sys; sys.modules['mujoco'] = None; import pliant; import pliant.sim"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert result.returncode == 1
    last = result.stderr.strip().splitlines()[-1]
    assert 'pliant.sim needs the extra "sim": ' in last
    # The command uses pip, or uv if there is no pip.
    assert re.search(r" install (--python \S+ )?'pliant\[sim\]'$", last)
