"""A hand turns the tool about an axis that yields; a task's orientation is followed."""

from experiments import controllers, disturbances, tracking
from pliant.sim import TWIST_3NM


def test_rec_follows_a_turning_hand():
    seen = disturbances.drag(controllers.rec(soft="yaw"), TWIST_3NM)
    assert seen.moved > 0.75  # [rad], measured 0.80
    assert seen.force < 1.2  # [N·m], measured 0.73
    assert seen.position < 0.009  # [m], measured 0.0044
    assert seen.rotation < 0.03  # [rad]


def test_rec_turns_back_with_eta_below_one():
    seen = disturbances.drag(controllers.rec(soft="yaw", eta=0.9), TWIST_3NM)
    assert seen.moved > 0.5  # [rad]
    assert seen.position < 0.022  # [m]
    assert seen.back < 0.06  # [rad]


def test_cap_follows_a_turning_hand():
    seen = disturbances.drag(controllers.cap(soft="yaw"), TWIST_3NM)
    assert seen.moved > 0.75  # [rad], measured 0.80
    assert seen.force < 1.1  # [N·m], measured 0.83
    assert seen.position < 0.009  # [m], measured 0.0059
    assert seen.stays < 0.04  # [rad]


def test_rec_follows_a_tilt_of_the_horizontal_grasp():
    seen = tracking.tilt(controllers.rec())
    assert seen.angle < 0.01  # [rad] at 6 s
    assert seen.position < 0.030  # [m], measured 0.014
