"""Doors: law `cap` opens each of them with little force; other laws need more force, or jam."""

import pytest

from experiments import controllers, doors

#: Smallest angle [deg] and largest force [N] by scene and grip.
CAP = {
    ("door", "rigid"): (64.0, 32.0),  # measured 67.7, 24.4
    ("door", "turning"): (64.0, 25.0),  # measured 69.3, 9.8
    ("fridge", "rigid"): (64.0, 34.0),  # measured 67.9, 26.5
    ("fridge", "turning"): (64.0, 32.0),  # measured 70.0, 23.3
    ("horizontal", "rigid"): (64.0, 33.0),  # measured 67.6, 25.5
    ("horizontal", "turning"): (64.0, 25.0),  # measured 69.2, 8.8
    ("oven", "rigid"): (57.0, 26.0),  # measured 60.8, 18.1
    ("oven", "turning"): (57.0, 15.0),  # measured 60.2, 5.3
    ("base door", "rigid"): (63.0, 52.0),  # measured 66.5, 41
    ("base door", "turning"): (65.0, 25.0),  # measured 68.8, 9.2
    ("base fridge", "rigid"): (63.0, 52.0),  # measured 66.7, 40
    ("base fridge", "turning"): (65.0, 32.0),  # measured 69.8, 23.2
}
RESISTING = ("door", "fridge", "horizontal", "oven")


def all_stiff(*, soft, null_space):
    """Return `controllers.all_stiff`; the argument `soft` is ignored."""
    return controllers.all_stiff(null_space=null_space)


def cap_stiff(*, soft, null_space):
    """Return `controllers.cap` without a soft axis; the argument `soft` is ignored."""
    return controllers.cap(soft="", null_space=null_space)


@pytest.mark.parametrize(("scene", "grip"), CAP, ids=" ".join)
def test_cap_opens(scene, grip):
    angle, force = CAP[scene, grip]
    result = doors.open_door(controllers.cap, scene, grip)
    assert result.angle > angle
    assert result.force < force
    if (scene, grip) == ("door", "rigid"):
        assert result.torque < 3.0  # [N·m], measured 2.1


def test_rows_free_opens_a_rigidly_gripped_door():
    result = doors.open_door(controllers.rows_free)
    assert result.angle > 60.0  # [deg], measured 66
    assert result.force < 60.0  # [N], measured 42
    assert result.torque < 6.0  # [N·m], measured 4.0


def test_rec_jams_on_a_rigidly_gripped_door():
    assert 42.0 <= doors.open_door(controllers.rec).angle <= 66.0  # [deg], measured 55


@pytest.mark.parametrize("law", [controllers.rec, controllers.rows_free], ids=["rec", "rows_free"])
def test_jacobian_forms_open_a_door_whose_handle_turns(law):
    result = doors.open_door(law, "door", "turning")
    assert result.angle > 60.0  # [deg], measured 69
    assert result.force < 25.0  # [N], measured 13


def test_all_stiff_jams_and_pulls_hard():
    rigid_grip = doors.open_door(all_stiff)
    assert rigid_grip.angle < 35.0  # [deg], measured 22
    assert rigid_grip.force >= 2.0 * doors.open_door(controllers.cap).force
    turning_grip = doors.open_door(all_stiff, "door", "turning")
    # Measured: 4.0 times.
    assert turning_grip.force >= 2.0 * doors.open_door(controllers.rec, "door", "turning").force


def test_cap_without_a_soft_axis_pulls_twice_as_hard():
    assert doors.open_door(cap_stiff).force >= 2.0 * doors.open_door(controllers.cap).force


@pytest.mark.parametrize("grip", ["rigid", "turning"])
@pytest.mark.parametrize("scene", RESISTING)
def test_cap_opens_and_closes_by_resistance(scene, grip):
    result = doors.open_and_close(controllers.cap, scene, grip)
    assert len(result.ends) == 2
    open_angle, closed_angle = result.ends
    assert open_angle == pytest.approx(45.0, abs=1.0)  # [deg], measured 45.1
    assert closed_angle == pytest.approx(0.0, abs=1.0)  # [deg], measured -0.2
    assert result.force < 65.0  # [N], measured 53
