"""Simulated doors: path of the handle, friction, seal, forces at the grip, end stops."""

import numpy as np
import pytest

import pliant
from pliant.sim import Door, Drive, ForceProfile, Plant, Push, door, fridge, oven
from pliant.sim.postures import AT_DOOR, AT_DOOR_HORIZONTAL


def pull(force, start=0.6, torque=(0.0, 0.0, 0.0)):
    course = ForceProfile(start=start, rise=0.3, end=60.0)
    return Push(force_vector=force, torque_vector=torque, course=course)


def scene(arm, leaf, *hands, **options):
    return Plant(arm, friction_scale=0.0, damping_scale=0.2, scene=[leaf, *hands], **options)


@pytest.mark.parametrize("grip", ["rigid", "turning"])
@pytest.mark.parametrize("start", [AT_DOOR, AT_DOOR_HORIZONTAL], ids=["vertical", "horizontal"])
def test_the_handle_runs_on_its_circle(arm, floating, grip, start):
    leaf = door(grip=grip)
    plant = scene(arm, leaf, pull((-16.0, 0.0, 0.0)))
    plant.reset(start)
    hinge = plant.tool[:3, 3] + (0.0, -0.3, 0.0)
    first = plant.tool[:3, :3].copy()
    for _ in range(18):
        floating(plant, 10)
        offset = plant.tool[:3, 3] - hinge
        assert np.linalg.norm(offset[:2]) == pytest.approx(0.3, abs=2e-3)
        assert abs(offset[2]) < 2e-3
        assert leaf.angle == pytest.approx(np.arctan2(-offset[0], offset[1]), abs=0.01)
    assert leaf.angle > 0.3
    rotation = plant.tool[:3, :3] @ first.T
    if grip == "rigid":
        assert np.arctan2(rotation[1, 0], rotation[0, 0]) == pytest.approx(leaf.angle, abs=0.01)


def test_hinge_friction_holds_a_weak_pull(arm, floating):
    weak, strong = door(friction=1.5), door(friction=1.5)
    for leaf, force in ((weak, -3.0), (strong, -12.0)):
        plant = scene(arm, leaf, pull((force, 0.0, 0.0)))
        plant.reset(AT_DOOR)
        floating(plant, 150)
    assert weak.angle < 0.03
    assert strong.angle > 0.1


@pytest.mark.parametrize(("force", "opens"), [(15.0, False), (26.0, True)])
def test_the_seal_breaks_at_its_force(arm, floating, force, opens):
    leaf = fridge()
    plant = scene(arm, leaf, pull((-force, 0.0, 0.0)))
    plant.reset(AT_DOOR)
    floating(plant, 150)
    assert (leaf.angle > 0.05) is opens
    if not opens:
        assert leaf.angle < 0.002


def test_the_grip_reports_force_and_torque(arm, floating):
    """If the door is pushed against its closed stop, the grip transmits all force and torque."""
    for force, torque in (((6.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (0.0, 0.0, -2.0))):
        leaf = door()
        plant = scene(arm, leaf, pull(force, torque=torque))
        plant.reset(AT_DOOR)
        floating(plant, 300)
        assert leaf.angle == pytest.approx(0.0, abs=0.02)
        assert leaf.force == pytest.approx(np.linalg.norm(force), abs=0.3)
        assert leaf.torque == pytest.approx(np.linalg.norm(torque), abs=0.1)
        assert leaf.peak_force >= leaf.force
        assert leaf.peak_torque >= leaf.torque


def test_a_turning_grip_carries_no_torque(arm, floating):
    leaf = door(grip="turning")
    plant = scene(arm, leaf, pull((-8.0, 0.0, 0.0)))
    plant.reset(AT_DOOR)
    floating(plant, 150)
    assert leaf.torque == leaf.peak_torque == 0.0


def test_the_stop_ends_the_motion_and_a_reset_forgets(arm, floating):
    leaf = door(stop=np.deg2rad(20.0))
    plant = scene(arm, leaf, pull((-8.0, 0.0, 0.0)))
    plant.reset(AT_DOOR)
    floating(plant, 400)
    assert np.rad2deg(leaf.angle) == pytest.approx(20.0, abs=1.0)
    assert leaf.widest >= leaf.angle
    plant.reset(AT_DOOR)
    assert leaf.angle == leaf.widest == leaf.peak_force == 0.0


def test_a_balanced_leaf_stays_where_it_is(arm, floating):
    angles = []
    for balanced in (True, False):
        leaf = oven(friction=0.0, balanced=balanced)
        plant = scene(arm, leaf, pull((-4.0, 0.0, 0.0), start=0.3))
        plant.reset(AT_DOOR_HORIZONTAL)
        floating(plant, 100)
        leaf.release(plant)
        plant.mj_data.qvel[:] = 0.0
        before = float(plant.mj_data.joint("oven:hinge").qpos[0])
        for _ in range(50):
            plant.advance()
        angles.append(float(plant.mj_data.joint("oven:hinge").qpos[0]) - before)
        assert leaf.force == 0.0
    assert abs(angles[0]) < 1e-3
    assert abs(angles[1]) > 0.1


def test_a_driven_hinge_takes_the_closed_door_along(arm, floating):
    drive = Drive(direction=(1.0, 0.0, 0.0), speed=0.05, start=0.5, distance=0.02)
    leaf = door(drive=drive)
    plant = scene(arm, leaf)
    plant.reset(AT_DOOR)
    start = plant.tool[:3, 3]
    floating(plant, 200)
    hinge = plant.mj_data.body("door:frame").xpos
    np.testing.assert_allclose(hinge - start, (0.02, -0.3, 0.0), atol=1e-9)
    assert [drive.at(t) for t in (0.0, 0.7, 2.0)] == pytest.approx([0.0, 0.01, 0.02])


def test_the_same_door_is_hung_at_every_pose(arm):
    leaf = door()
    plant = scene(arm, leaf)
    for pose in (AT_DOOR, AT_DOOR_HORIZONTAL, AT_DOOR):
        plant.reset(pose)
        handle = plant.mj_data.site("door:handle")
        np.testing.assert_allclose(handle.xpos, plant.tool[:3, 3], atol=1e-12)
        np.testing.assert_allclose(handle.xmat.reshape(3, 3), plant.tool[:3, :3], atol=1e-12)
        plant.advance()
        assert leaf.force < 50.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": (0.0, 0.0, 2.0)}, "unit vector"),
        ({"hinge": (0.0, 0.0, -0.3)}, "on the hinge axis"),
        ({"grip": "loose"}, "'rigid' or 'turning'"),
        ({"mass": 0.0}, "mass"),
        ({"friction": -1.0}, "at least 0"),
    ],
)
def test_bad_doors_are_named(changes, message):
    with pytest.raises(pliant.ConfigError, match=message):
        Door(**changes)
