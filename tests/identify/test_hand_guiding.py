"""Hand guiding with any k_p: an untouched arm stays, and a small force moves it."""

from contextlib import nullcontext

import numpy as np
import pytest
from mismatch import Mismatch, Parameters

import pliant
from experiments import descent, steps
from experiments.arms import BESIDE, ROBOTS
from experiments.hand_guiding import SWING_SEED, guide, swing
from pliant import robots
from pliant.identify._excitation import opposing_signs
from pliant.sim import Plant


def guide_arm(arm, pose, kp):
    """Run hand guiding with a true stiffness of `kp` times the assumed one; return the result."""
    is_known = kp == 1.0
    with nullcontext() if is_known else Mismatch(plant=Parameters(kp=kp), assumed=Parameters()):
        return guide(arm, pose, kp)


@pytest.mark.parametrize(
    ("arm", "pose", "kp"), [("arm7", 1, 0.5), ("arm7", 1, 2.0), ("arm7", 2, 2.0), ("so101", 0, 1.0)]
)
def test_an_untouched_arm_stays_and_can_be_guided(arm, pose, kp):
    result = guide_arm(arm, pose, kp)
    assert result.idle < 2e-3
    assert result.force < (12.0 if arm == "arm7" else 2.0)
    assert result.led > 0.04
    assert result.later < 4e-3
    # In pose 1 of `arm7` with twice the stiffness, the arm rests while the hand still pulls.
    assert result.sag < 0.02


@pytest.mark.parametrize(("arm", "number"), [("so101", 1), ("so101", 5), ("koch", 3), ("arm7", 3)])
def test_the_swing_is_slow_and_small_whatever_the_stiffness(arm, number):
    """The true stiffness of the joints is up to 2.2 times as large or small as assumed."""
    model = descent.robot(arm)
    _, truth = descent.random_parameters(model, number + 1, seed=SWING_SEED)[number]
    assert np.abs(np.log(truth.stiffness)).max() > 0.3
    found = swing(arm, number, 0.0)
    assert found.speed < 0.2
    assert found.moved < 0.05
    assert found.left < 0.015
    assert found.later < 5e-3


def test_an_unknown_load_is_refused_where_the_weight_does_not_explain_the_goals():
    arm, number, load = "koch", 7, 0.1
    assert swing(arm, number, 0.0) is not None
    assert swing(arm, number, load) is None


def test_goals_of_the_swing_move_slowly(arm, grasp):
    guiding, q, goals = pliant.HandGuiding(arm), np.array(grasp), []
    while not guiding.ready:
        command = guiding.step(q)
        goals.append(command.goal)
        q = command.goal - np.asarray(arm.gravity(q)) / arm.servos.kp
    speeds = np.abs(np.diff(goals, axis=0)).max(axis=0) / 0.01
    assert (speeds > 0.05).all()
    assert (speeds < 0.5).all()


@pytest.mark.parametrize("name", ["so101", "arm7"])
def test_joints_swing_against_each_other(name):
    model = pliant.robots.load(name)
    columns = np.asarray(model.jacobian(descent.READY[name]))[:3]
    signs = opposing_signs(columns)
    assert set(np.abs(signs)) == {1.0}
    moved = np.linalg.norm(columns @ signs)
    assert moved < 0.5 * np.linalg.norm(columns @ np.ones(model.n))


def test_captured_goals_carry_the_arm_from_the_first_command_on(arm, grasp):
    guiding, kp = pliant.HandGuiding(arm), np.asarray(arm.servos.kp)
    ratio = np.array([0.6, 0.6, 1.7, 1.7, 1.0, 1.0, 1.0])
    needed = np.asarray(arm.gravity(grasp))
    goal = grasp + needed / (ratio * kp)
    first = guiding.step(grasp).goal
    loaded = np.abs(needed) > 3.0 * np.asarray(arm.servos.friction)
    assert loaded[:4].any()
    assert np.abs(first - goal)[loaded].max() > 3e-3
    stiffness = guiding.capture_gravity(grasp, goal)
    assert stiffness[loaded] == pytest.approx((ratio * kp)[loaded], rel=1e-6)
    assert stiffness[~loaded] == pytest.approx(kp[~loaded])
    guiding.reset(grasp)
    assert guiding.step(grasp).goal == pytest.approx(goal, abs=1e-3)
    with pytest.raises(pliant.ShapeError, match="goal"):
        guiding.capture_gravity(grasp, goal[:3])


def test_the_tool_is_followed_slowly(arm, grasp):
    """An arm that falls, or is torn away, is held back by its servos."""
    guiding = pliant.HandGuiding(arm)
    while not guiding.ready:
        guiding.step(grasp)
    q, law = np.array(grasp), guiding._law
    before = guiding.step(q).goal
    for _ in range(20):
        q[1] += 0.02  # 2 rad/s
        goal = guiding.step(q).goal
        followed = np.asarray(arm.jacobian(q))[:3] @ (goal - before)
        before = goal
    assert law.speed[1] > 1.0
    # 0.25 m/s, and the change of the leads with the weight.
    assert 0.2 < np.linalg.norm(followed) / 0.01 < 0.3


@pytest.mark.full
@pytest.mark.parametrize("kp", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("arm", ["arm7", "so101", "koch"])
def test_nineteen_of_twenty_poses_stay(arm, kp):
    idle = np.array([guide_arm(arm, pose, kp).idle for pose in range(20)])
    assert np.median(idle) < 1.2e-3
    assert (idle < 2e-3).mean() >= 0.95


def test_goals_of_an_arm_at_rest_do_not_move(arm, grasp):
    """The law has no integrator, so that the goal of an arm at rest is constant."""
    floating = pliant.HandGuiding(arm)
    orders = []
    for _ in range(3000):
        orders.append(floating.step(grasp))
        if floating.ready and len(orders) > 2000:
            break
    assert floating.ready
    goals = np.array([floating.step(grasp).goal for _ in range(100)])
    assert np.ptp(goals, axis=0).max() == 0.0


@pytest.mark.parametrize("dt", [0.005, 0.02])
def test_it_takes_the_time_of_a_loop_at_another_rate(arm, grasp, dt):
    """The motion that begins hand guiding, and estimated speeds, do not depend on the time step."""
    at_100_hz, at_other_rate = pliant.HandGuiding(arm), pliant.HandGuiding(arm)
    times, speeds = [], []
    for floating, step in ((at_100_hz, 0.01), (at_other_rate, dt)):
        ticks = 0
        while not floating.ready:
            floating.step(grasp, dt=step)
            ticks += 1
        times.append(ticks * step)
        q = np.array(grasp)
        for _ in range(round(0.5 / step)):
            q[0] += 0.2 * step
            floating.step(q, dt=step)
        speeds.append(floating._law.speed[0])
    assert times[0] == pytest.approx(times[1], abs=0.5)
    assert speeds == pytest.approx([0.2, 0.2], rel=0.02)
    with pytest.raises(pliant.OutOfRangeError, match="dt"):
        at_other_rate.step(grasp, dt=0.0)


def test_only_a_known_stiffness_is_assumed(arm):
    known = pliant.HandGuiding(arm, arm.servos.replace(stiffness_known=True)).stiffness
    open_ = pliant.HandGuiding(arm, arm.servos.replace(stiffness_known=False)).stiffness
    assert (known[1] / known[0]).max() == pytest.approx(1.21)
    assert (open_[1] / open_[0]).min() > 4.0


def test_invalid_arguments_of_hand_guiding_are_refused(arm, grasp):
    with pytest.raises(pliant.OutOfRangeError, match="rate"):
        pliant.HandGuiding(arm, rate=1.0)
    floating = pliant.HandGuiding(arm)
    with pytest.raises(pliant.ShapeError):
        floating.step(grasp[:3])
    with pytest.raises(pliant.ShapeError):
        floating.step(np.full(7, np.nan))
    assert not floating.ready


def test_a_joint_that_does_not_swing_does_not_oscillate_later():
    """The joint's friction is unknown: feed-forward above it lets the shoulder swing by ±9 mm."""
    if not (ROBOTS / BESIDE["vx300s"][0]).exists():
        pytest.skip("no URDF of vx300s beside this checkout")
    arm = steps.arm("vx300s")
    count = float(np.deg2rad(0.088))
    servos = arm.servos.replace(encoder_step=count, stiffness_known=False)
    plant = Plant(
        arm.model, servos, kp_scale=1.25, encoder_step=count, deadband=1e-3, friction_creep=0.1
    )
    plant.reset(steps.steps("vx300s", 1)[0].q)
    guiding = pliant.HandGuiding(arm.model, servos)
    height = []
    while plant.time < 14.0:
        command = guiding.step(plant.read().q)
        plant.write(command.goal, command.torque_limit)
        plant.advance()
        if plant.time > 10.0:
            height.append(plant.tool[2, 3])
    assert guiding.ready
    assert np.ptp(height) < 2e-3


def test_a_payload_that_is_set_is_that_of_the_constructor(grasp):
    model, q = robots.load("arm7", payload=(0.1, (0.0, 0.02, 0.0))), np.array(grasp)
    stated = pliant.HandGuiding(model, payload=(0.3, (0.0, 0.0, 0.04)))
    guiding = pliant.HandGuiding(model)
    assert guiding.payload == model.payload
    guiding.set_payload(stated.payload.mass, stated.payload.com)
    assert stated.payload.mass == pytest.approx(0.4)
    assert stated.payload.com == pytest.approx([0.0, 0.005, 0.03])
    for _ in range(20):
        assert guiding.step(q).goal == pytest.approx(stated.step(q).goal, abs=1e-12)
    assert pliant.HandGuiding(robots.load("arm7")).payload is None
    for mass in (0.05, -1.0, np.nan):
        with pytest.raises(pliant.OutOfRangeError, match=r"mass \[kg\]"):
            guiding.set_payload(mass)
    with pytest.raises(pliant.ConfigError, match="mass"):
        guiding.set_payload("a")
    assert guiding.payload == stated.payload
    guiding.set_payload(0.2, None)
    assert guiding.payload == pliant.Payload(0.2)
