"""Drawer, surface, hand-over and socket: simulated forces and values calculated by hand."""

import mujoco
import numpy as np
import pytest

import pliant
from pliant.sim import Drawer, ForceProfile, HandoverObject, Plant, Push, Socket, Surface, drawer
from pliant.sim.postures import AT_DOOR


def pull(force, start=0.3):
    return Push(force_vector=force, course=ForceProfile(start=start, rise=0.3, end=60.0))


def scene(arm, *objects, **options):
    return Plant(arm, friction_scale=0.0, damping_scale=0.2, scene=objects, **options)


def test_a_drawer_slides_on_its_line_to_its_stop(arm, floating):
    axis = np.array((-0.8, 0.6, 0.0))
    box = drawer(axis=tuple(axis), stop=0.10, damping=30.0)
    plant = scene(arm, box, pull(tuple(12.0 * axis)))
    plant.reset(AT_DOOR)
    start = plant.tool[:3, 3]
    floating(plant, 300)
    displacement = plant.tool[:3, 3] - start
    assert box.opening == pytest.approx(0.10, abs=2e-3)
    np.testing.assert_allclose(displacement, box.opening * axis, atol=2e-3)
    assert box.widest == pytest.approx(box.opening, abs=3e-3)


@pytest.mark.parametrize(("side_force", "opens"), [(0.0, True), (12.0, False)])
def test_a_drawer_binds_under_a_force_across(arm, floating, side_force, opens):
    """A pull of 5 N opens a drawer with 3 N of friction, unless a side force of 12 N adds 3.6 N.

    The ratio of this friction to the side force is 0.3.
    """
    box = drawer()
    plant = scene(arm, box, pull((-5.0, side_force, 0.0)))
    plant.reset(AT_DOOR)
    floating(plant, 200)
    assert (box.widest > 0.015) is opens
    if not opens:
        assert box.widest < 0.005
    assert box.across == pytest.approx(side_force, abs=1.5)


def press_pad(arm, surface, height, grasp):
    """Return force [N], torque [N·m] and origin [m] of a pad held `height` [m] above its start."""
    plant = scene(arm, surface)
    plant.reset(grasp)
    frame = plant.ground_truth.frame("tool")
    frame.start = frame.position - (0.0, 0.0, height)
    return surface.force(plant.ground_truth, 0.0)


def test_a_surface_pushes_by_depth_and_not_from_afar(arm, grasp):
    flat = Surface(below=0.01, unevenness=0.0, stiffness=1e4, friction=0.0)
    force, torque, _ = press_pad(arm, flat, -0.012, grasp)
    np.testing.assert_allclose(force, (0.0, 0.0, 20.0), atol=0.1)
    # The pad is tilted by up to 0.01° in the grasp pose, which causes a small torque.
    np.testing.assert_allclose(torque, 0.0, atol=0.02)
    force, _, _ = press_pad(arm, flat, -0.009, grasp)
    assert not force.any()


def test_a_surface_goes_up_and_down():
    hills = Surface(unevenness=0.01, wave=0.4)
    assert hills.height(0.0, 0.1) == pytest.approx(0.01)
    assert hills.height(0.0, -0.1) == pytest.approx(-0.01)
    assert hills.height(0.2, 0.1) == pytest.approx(-0.01)


def test_friction_on_a_surface_is_mu_times_the_normal_force(arm, grasp, floating):
    surface = Surface(below=0.0, unevenness=0.0, friction=0.5)
    plant = scene(
        arm, surface, Push(force_vector=(0.0, 9.0, -8.0), course=ForceProfile(start=0.0, end=9))
    )
    plant.reset(grasp)
    ratios = []
    for _ in range(40):
        floating(plant, 1)
        force = plant.hands[0].force
        if plant.time > 0.2 and force[2] > 1.0:
            ratios.append(np.hypot(force[0], force[1]) / force[2])
    assert np.mean(ratios) == pytest.approx(0.5, abs=0.05)


def test_an_object_is_carried_taken_and_let_go(arm, grasp):
    handover_object = HandoverObject(mass=0.5, course=ForceProfile(start=2.0, rise=0.5, end=9.0))
    plant = Plant(arm, scene=[handover_object])
    plant.reset(grasp)
    ball = plant.mj_data.body("handed:ball")
    home = ball.xpos.copy()
    plant.advance(1900)
    assert handover_object.force == pytest.approx(0.5 * 9.81, rel=0.1)
    assert handover_object.effort == 0.0
    plant.advance(300)
    assert handover_object.effort > 5.0
    handover_object.release(plant)
    plant.advance(2500)
    assert handover_object.released == pytest.approx(2.2, abs=1e-6)
    assert handover_object.force == 0.0
    np.testing.assert_allclose(ball.xpos - home, handover_object.displacement, atol=5e-3)


def insert_plug(arm, socket, grasp, depth, ticks=150):
    """Move the plug straight down by position control along a path of joint positions."""
    plant = Plant(arm, friction_scale=0.0, scene=[socket])
    plant.reset(grasp)
    pose, q = plant.tool, grasp
    for tick in range(ticks):
        goal = pose.copy()
        goal[2, 3] -= depth * (tick + 1) / ticks
        q = arm.inverse_kinematics(goal, q).q
        gravity = np.asarray(arm.gravity(plant.q)) / plant.gains.kp
        plant.write(q + gravity, plant.gains.torque)
        plant.advance()
    return plant


def test_a_plug_goes_into_its_hole_and_ends_on_the_floor(arm, grasp):
    socket = Socket()
    insert_plug(arm, socket, grasp, 0.055)
    assert socket.deepest == pytest.approx(socket.depth, abs=1.5e-3)
    assert socket.peak_along > 1.0


def test_a_tilted_socket_is_turned_by_its_tilt(arm, grasp):
    plant = Plant(arm, scene=[Socket(tilt=(0.0, 0.2, 0.0))])
    plant.reset(grasp)
    mujoco.mj_kinematics(plant.mj_model, plant.mj_data)
    rotation = plant.mj_data.body("socket:frame").xmat.reshape(3, 3) @ plant.tool[:3, :3].T
    assert np.arctan2(rotation[0, 2], rotation[2, 2]) == pytest.approx(0.2, abs=1e-9)


def test_a_plug_beside_its_hole_stays_out(arm, grasp):
    socket = Socket(offset=(0.02, 0.0, -0.02))
    insert_plug(arm, socket, grasp, 0.055)
    assert socket.deepest < 0.006
    assert socket.peak_along > 3.0


def test_a_plug_in_the_air_touches_nothing(arm, grasp):
    socket = Socket()
    plant = insert_plug(arm, socket, grasp, 0.015)
    assert plant.mj_data.ncon == 0
    assert socket.force == socket.peak_along == socket.peak_across == 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Drawer(axis=(1.0, 1.0, 0.0)), "unit vector"),
        (lambda: Drawer(stop=0.0), "mass and stop > 0"),
        (lambda: Drawer(grip="loose"), "Drawer.grip must be"),
        (lambda: Surface(wave=0.0), "wave > 0"),
        (lambda: HandoverObject(displacement=(1.0,)), "three entries"),
        (lambda: HandoverObject(mass=0.0), "mass > 0"),
        (lambda: Socket(depth=0.0), "depth > chamfer"),
        (lambda: Socket(tilt=(0.0, 0.0)), "three entries"),
    ],
)
def test_bad_scenes_are_named(make, message):
    with pytest.raises(pliant.ConfigError, match=message):
        make()
