"""A hand turns the tool about a soft axis; the tool follows a rotation of its target."""

from experiments import controllers, disturbances, tracking
from pliant.sim import TWIST_3NM


def test_rec_follows_a_turning_hand():
    result = disturbances.drag(controllers.rec(soft="yaw"), TWIST_3NM)
    assert result.moved > 0.75  # [rad], measured 0.80
    assert result.force < 1.2  # [N·m], measured 0.73
    assert result.position < 0.009  # [m], measured 0.0044
    assert result.rotation < 0.03  # [rad]


def test_rec_turns_back_with_eta_below_one():
    result = disturbances.drag(controllers.rec(soft="yaw", eta=0.9), TWIST_3NM)
    assert result.moved > 0.5  # [rad]
    assert result.position < 0.022  # [m]
    assert result.back < 0.06  # [rad]


def test_cap_follows_a_turning_hand():
    result = disturbances.drag(controllers.cap(soft="yaw"), TWIST_3NM)
    assert result.moved > 0.75  # [rad], measured 0.80
    assert result.force < 1.1  # [N·m], measured 0.83
    assert result.position < 0.009  # [m], measured 0.0059
    assert result.stays < 0.04  # [rad]


def test_rec_follows_a_tilt_of_the_horizontal_grasp():
    result = tracking.tilt(controllers.rec())
    assert result.angle < 0.01  # [rad] at 6 s
    assert result.position < 0.030  # [m], measured 0.014
