"""`pliant.teleop.JointFollower` on the simulator: lag, force, return and wrong stiffness."""

import math

import numpy as np
import pytest

pytest.importorskip("mujoco")

from mismatch import Mismatch, Parameters

import pliant
from pliant import config
from pliant.sim import ForceProfile, Push
from pliant.teleop import JointFollower

START_POSES = {"so101": (0.0, -0.3, 0.3, 0.9, 0.0), "koch": (0.0, -0.4, 0.8, 0.5, 0.0)}
FPS, FREQUENCY = 30, 0.5  # [Hz]


def connect(name, **options):
    return pliant.connect(
        name,
        backend="sim",
        q=START_POSES[name],
        handle_signals=False,
        on_exit="leave_enabled",
        **options,
    )


def follow(name, joint, amplitude, *, max_force=4.0, **options):
    """Let one joint follow a sine, sampled at 30 Hz; return its lag [s] and gain [1].

    The largest motion of the other joints [rad] is returned too.
    """
    times, positions = [], []
    with connect(name, table=False, **options) as arm:
        follower = JointFollower(arm.model, arm.servos, max_force=max_force)
        start = arm.read().q.copy()
        for tick in pliant.Loop(arm, follower, rate=100.0, duration=8.0):
            target = start.copy()
            step = int(tick.time * FPS + 1e-9) / FPS
            target[joint] += amplitude * math.sin(2 * math.pi * FREQUENCY * step)
            tick.step(target)
            times.append(tick.time)
            positions.append(tick.q - start)
    is_settled = np.array(times) > 4.0
    phase = 2 * math.pi * FREQUENCY * np.array(times)[is_settled]
    motions = np.array(positions)[is_settled]
    waves = np.stack([np.sin(phase), np.cos(phase), np.ones(phase.size)], axis=1)
    (sine, cosine, _), *_ = np.linalg.lstsq(waves, motions[:, joint], rcond=None)
    lag = -math.atan2(cosine, sine) / (2 * math.pi * FREQUENCY)
    others = np.abs(np.delete(motions, joint, axis=1)).max()
    return lag, math.hypot(sine, cosine) / amplitude, others


@pytest.mark.slow
@pytest.mark.parametrize("name", ["so101", "koch"])
@pytest.mark.parametrize("joint", range(5))
def test_a_follower_lags_by_less_than_70_ms(name, joint):
    lag, gain, others = follow(name, joint, math.radians(25.0))
    assert 0.0 < lag < 0.07
    assert 0.95 < gain < 1.15
    assert others < math.radians(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("kp", [0.6, 1.6])
def test_a_wrong_stiffness_costs_lag_and_sag_only(kp):
    with Mismatch(plant=Parameters(kp=kp), assumed=Parameters()):
        lag, gain, others = follow("so101", 1, math.radians(25.0), kp_scale=kp)
    reference_lag, _, _ = follow("so101", 1, math.radians(25.0))
    assert (lag > reference_lag) == (kp < 1.0)
    assert 0.85 < gain < 1.15
    assert others < math.radians(6.0)  # the wrong stiffness makes the arm sag


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_a_target_that_jumps_to_and_fro_keeps_the_speed_limit(name, frequency):
    """A target of a policy, near the frequency at which a servo's stiffness lets the arm swing."""
    for joints in ([0, 1, 2, 3], [2]):
        with connect(name, table=False) as arm:
            follower = JointFollower(arm.model, arm.servos, max_force=4.0)
            start = arm.read().q.copy()
            speeds = []
            for tick in pliant.Loop(arm, follower, rate=100.0, duration=4.0):
                target = start.copy()
                phase = 2 * math.pi * frequency * tick.time + np.array(joints)
                target[joints] += 0.5 * np.sign(np.sin(phase))
                tick.step(target)
                twist = arm.drive.plant.ground_truth.frame("tool").twist()
                speeds.append(np.linalg.norm(twist[:3]))
        assert 0.3 < max(speeds) < 1.2 * 0.6 + 0.02


def push_tool(axis, force, max_force, name="so101"):
    """Push the tool for 1.5 s; return its motion.

    Returns:
        Largest and last displacement [m], and largest speed after the push [m/s].
    """
    with connect(name, table=False) as arm:
        model, plant = arm.model, arm.drive.plant
        push = np.zeros(3)
        push[axis] = force
        course = ForceProfile(start=plant.time + 0.5, rise=0.2, end=plant.time + 2.0)
        plant.set_hands([Push(force_vector=tuple(push), course=course)])
        follower = JointFollower(model, arm.servos, max_force=max_force)
        start = arm.read().q.copy()
        position = [np.asarray(model.forward_kinematics(start))[:3, 3]]
        for tick in pliant.Loop(arm, follower, rate=100.0, duration=5.0):
            tick.step(start)
            position.append(np.asarray(model.forward_kinematics(tick.q))[:3, 3])
    displacement = np.abs(np.array(position) - position[0])[:, axis]
    speed = np.linalg.norm(np.diff(position[230:], axis=0), axis=1).max() * 100.0
    return displacement.max(), displacement[-1], speed


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
def test_a_push_above_the_force_and_friction_moves_the_arm(axis):
    """The arm resists a push below `max_force`, yields to a larger one, and returns slowly."""
    force = 2.0
    stiff, _, _ = push_tool(axis, 0.8 * force, math.inf)
    small, _, _ = push_tool(axis, 0.8 * force, force)
    largest, final, speed = push_tool(axis, 3.0 * force, force)
    stiff_yielded, _, _ = push_tool(axis, 3.0 * force, math.inf)
    assert small < 1.2 * stiff + 0.002
    assert largest > 1.5 * stiff_yielded
    assert final < 0.01
    assert speed < 1.2 * 0.6 + 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "force"), [(0, -6.0), (2, 6.0), (2, -6.0)])
def test_a_light_arm_returns_at_the_speed_limit(axis, force):
    _, final, speed = push_tool(axis, force, 2.0, "koch")
    assert final < 0.01
    assert 0.3 < speed < 1.2 * 0.6 + 0.02


@pytest.mark.slow
def test_a_target_inside_the_table_is_pressed_with_the_force():
    """Compare a follower with `max_force` and one without a limit, with equal joint targets."""
    contact_forces = {}
    for max_force in (2.0, math.inf):
        with connect("so101", table=0.0) as arm:
            model = arm.model
            follower = JointFollower(model, arm.servos, max_force=max_force)
            start = arm.read().q.copy()
            q = start.copy()
            for _ in range(400):
                position = np.asarray(model.forward_kinematics(q))[:3, 3]
                rows = np.asarray(model.jacobian(q))[:3]
                error = np.array([0.0, 0.0, -0.05 - position[2]])
                q += 0.2 * rows.T @ np.linalg.solve(rows @ rows.T + 1e-4 * np.eye(3), error)
            forces = []
            for tick in pliant.Loop(arm, follower, rate=100.0, duration=4.0):
                tick.step(start + (q - start) * min(1.0, tick.time / 1.5))
                forces.append(arm.drive.plant.fixtures[0].force)
            contact_forces[max_force] = np.median(forces[-100:])
    assert 1.0 < contact_forces[2.0] < 2.0 + 1.5  # gear friction adds to the limit
    assert contact_forces[math.inf] > 1.5 * contact_forces[2.0]


def test_arguments_are_checked():
    model = config.load("so101").model()
    for value in (-1.0, [1.0, 2.0, math.nan]):
        with pytest.raises(pliant.OutOfRangeError, match="max_force"):
            JointFollower(model, max_force=value)
    with pytest.raises(pliant.ShapeError, match="max_force"):
        JointFollower(model, max_force=[1.0, 2.0])
    with pytest.raises(pliant.OutOfRangeError, match="max_tool_speed"):
        JointFollower(model, max_force=1.0, max_tool_speed=0.0)
    with pytest.raises(pliant.ConfigError, match="servo table"):
        JointFollower(pliant.robots.so101(servos=None), max_force=1.0)
    follower = JointFollower(model, max_force=[1.0, 2.0, 3.0])
    follower.max_force = 4.0
    assert follower.max_force.tolist() == [4.0, 4.0, 4.0]
    with pytest.raises(pliant.OutOfRangeError, match=r"q_target\[1\]"):
        follower.step(np.zeros(5), [0.0, math.nan, 0.0, 0.0, 0.0], dt=0.01)
