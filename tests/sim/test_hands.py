"""Hands and walls: magnitude, point of application and record of their forces."""

import numpy as np
import pytest

import pliant
from pliant.sim import (
    DRAG_15N,
    DRAG_30N,
    DRAG_80N,
    TWIST_3NM,
    Drag,
    ForceProfile,
    Plant,
    Push,
    Recorder,
    SpringConstraint,
    Twist,
    Wall,
    table,
    tap,
)

ALWAYS = ForceProfile(start=0.0, rise=0.0, end=100.0)


def settle(arm, grasp, hand, ticks=800):
    """Hold the pose with servos without friction until arm and hand are at rest."""
    plant = Plant(arm, friction_scale=0.0, scene=[hand])
    plant.reset(grasp)
    for _ in range(ticks):
        plant.write(grasp, plant.gains.torque)
        plant.advance()
    return plant


@pytest.mark.parametrize("frame", ["tool", "wrist", "forearm_link"])
def test_a_push_reaches_the_joints_as_its_frame_says(arm, grasp, frame):
    force = np.array((2.0, -3.0, 1.0))
    plant = settle(arm, grasp, Push(force_vector=force, at=frame, course=ALWAYS))
    link = {"tool": "tool", "wrist": "gripper_link"}.get(frame, frame)
    text = arm.source[0]
    part = pliant.Model.from_urdf_str(text, base="base", tip=link)
    expected = np.zeros(7)
    expected[: part.n] = part.jacobian(plant.q[: part.n])[:3].T @ force
    np.testing.assert_allclose(plant.torque, arm.gravity(plant.q) - expected, atol=1e-5)
    np.testing.assert_allclose(plant.hands[0].force, force)


def test_a_torque_reaches_the_joints(arm, grasp):
    torque = np.array((0.3, -0.2, 0.5))
    plant = settle(arm, grasp, Push(torque_vector=torque, course=ALWAYS))
    expected = arm.jacobian(plant.q)[3:].T @ torque
    np.testing.assert_allclose(plant.torque, arm.gravity(plant.q) - expected, atol=1e-5)


@pytest.mark.parametrize("hand", [DRAG_15N, DRAG_30N, DRAG_80N, TWIST_3NM])
def test_hands_are_bounded_and_let_go(arm, grasp, floating, hand):
    plant = Plant(arm, scene=[hand])
    plant.reset(grasp)
    floating(plant, 450)
    record = plant.hands[0]
    size = record.peak_torque if isinstance(hand, Twist) else record.peak_force
    assert 0.1 < size <= hand.limit + 1e-12
    floating(plant, 100)
    assert not record.force.any()
    assert not record.torque.any()


def test_a_drag_gets_where_it_wants(arm, grasp, floating):
    plant = Plant(arm, scene=[DRAG_80N])
    plant.reset(grasp)
    start = plant.tool[1, 3]
    floating(plant, 480)
    assert plant.tool[1, 3] - start == pytest.approx(0.15, abs=0.01)


def test_a_turn_gets_where_it_wants(arm, grasp, floating):
    plant = Plant(arm, scene=[Twist(angle=0.4, course=ForceProfile())])
    plant.reset(grasp)
    floating(plant, 480)
    assert plant.ground_truth.frame("tool").turn()[2] == pytest.approx(0.4, abs=0.05)


def test_forces_lie_along_the_axis(arm, grasp, floating):
    plant = Plant(arm, scene=[Drag(axis=(0.0, 3.0, 4.0), course=ForceProfile(start=0.0))])
    plant.reset(grasp)
    floating(plant, 50)
    force = plant.hands[0].force
    assert np.linalg.norm(force) > 0.1
    np.testing.assert_allclose(np.cross(force, (0.0, 0.6, 0.8)), 0.0, atol=1e-12)


def test_a_guide_holds_what_it_names(arm, grasp, floating):
    push = Push(force_vector=(4.0, 4.0, 0.0), course=ForceProfile(start=0.0, rise=0.5, end=9.0))
    plant = Plant(arm, scene=[push, SpringConstraint(axes="x z roll pitch yaw")])
    plant.reset(grasp)
    start = plant.tool[:3, 3]
    floating(plant, 100)
    shift = plant.tool[:3, 3] - start
    assert abs(shift[1]) > 0.01
    assert np.abs(shift[[0, 2]]).max() < 0.005


def test_a_ramp_rises_linearly():
    course = ForceProfile(start=1.0, rise=2.0, end=5.0)
    times = (0.0, 1.0, 2.0, 3.0, 4.9, 5.0)
    assert [course.share(t) for t in times] == [0.0, 0.0, 0.5, 1.0, 1.0, 1.0]
    assert [course.active(t) for t in times] == [False, True, True, True, True, False]


def test_a_tap_is_over_after_an_eighth_of_a_second(arm, grasp):
    plant = Plant(arm, scene=[tap((6.0, 0.0, 0.0), start=0.1)])
    plant.reset(grasp)
    pushes = []
    for _ in range(40):
        plant.advance()
        pushes.append(plant.hands[0].force[0])
    assert max(pushes) == pytest.approx(6.0)
    assert not np.any(pushes[:10])
    assert not np.any(pushes[22:])


@pytest.mark.parametrize("stiffness", [2e3, 2e4])
def test_a_wall_pushes_back_with_its_stiffness(arm, grasp, stiffness):
    plant = Plant(arm, friction_scale=0.0, scene=[Wall(distance=0.01, stiffness=stiffness)])
    start = np.asarray(arm.forward_kinematics(grasp))
    plant.reset(grasp)
    jacobian = arm.jacobian(grasp)
    lead = np.linalg.pinv(jacobian) @ (0.03, 0.0, 0.0, 0.0, 0.0, 0.0)
    for _ in range(800):
        plant.write(grasp + lead + np.asarray(arm.gravity(plant.q)) / plant.gains.kp)
        plant.advance()
    depth = plant.tool[0, 3] - start[0, 3] - 0.01
    assert depth > 0.0
    assert -plant.hands[0].force[0] == pytest.approx(stiffness * depth, rel=1e-6)


def test_the_arm_rests_on_a_table(arm, grasp):
    height = float(arm.forward_kinematics(grasp)[2, 3]) - 0.05
    plant = Plant(arm, scene=table(height))
    plant.reset(grasp)
    for _ in range(300):
        plant.write(plant.q, np.full(7, 1.0))
        plant.advance()
    assert plant.tool[2, 3] == pytest.approx(height, abs=0.005)
    assert plant.hands[0].force[2] > 2.0


def test_hands_can_be_changed_without_building_again(arm, grasp):
    plant = Plant(arm, scene=[DRAG_80N])
    plant.reset(grasp)
    plant.set_hands([Push(force_vector=(0.0, 5.0, 0.0), course=ALWAYS)])
    plant.advance()
    np.testing.assert_allclose(plant.hands[0].force, (0.0, 5.0, 0.0))
    assert plant.hands[0].peak_force == pytest.approx(5.0)


def test_the_record_keeps_rows_and_names_missing_signals(arm, grasp):
    plant = Plant(arm, scene=[DRAG_15N])
    plant.reset(grasp)
    record = Recorder(plant)
    for tick in range(3):
        plant.advance()
        record.add(tick=float(tick))
    assert len(record) == 3
    assert record["tool"].shape == (3, 4, 4)
    assert record["force0"].shape == (3, 3)
    np.testing.assert_allclose(record["t"], (0.01, 0.02, 0.03))
    with pytest.raises(pliant.ShapeError, match="tick"):
        record.add()
    with pytest.raises(KeyError, match="no signal 'x'"):
        record["x"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Drag(axis="w"), "axis 'w'"),
        (lambda: Drag(axis=(0.0, 0.0, 0.0)), "direction"),
        (lambda: Drag(limit=-1.0), "limit must be at least 0"),
        (lambda: ForceProfile(start=2.0, end=1.0), "end >= start"),
        (lambda: Push(force_vector=(1.0, 2.0)), "three entries"),
        (lambda: SpringConstraint(axes="x q"), "not q"),
        (lambda: Wall(into=(1.0, 1.0, 0.0)), "unit vector"),
    ],
)
def test_bad_hands_are_named(make, message):
    with pytest.raises(pliant.ConfigError, match=message):
        make()


def test_an_unknown_frame_lists_those_there_are(arm):
    with pytest.raises(pliant.FrameNotFoundError, match=r"no frame 'elbow'.*forearm_link") as error:
        Plant(arm, scene=[Push(at="elbow")])
    frames = str(error.value).split("there are ")[1].split(", ")
    assert len(frames) == len(set(frames))
