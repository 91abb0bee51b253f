"""Tracking: sinusoidal motions of the target along compliant axes, and a target out of reach."""

import pytest

from experiments import controllers, tracking
from experiments.poses import AXES
from experiments.simulation import Conditions
from pliant import NullSpace

#: Bounds by axis: RMS error over amplitude [1], and error of the other positions [m].
CAP_SHARE = {"x": 0.025, "y": 0.035, "z": 0.06, "roll": 0.025, "pitch": 0.05, "yaw": 0.03}
CAP_OTHERS = {"x": 0.007, "y": 0.007, "z": 0.007, "roll": 0.007, "pitch": 0.009, "yaw": 0.009}


@pytest.mark.parametrize("axis", AXES)
def test_rec_tracks_a_sinusoid(axis):
    result = tracking.track(controllers.rec(soft=axis, eta=0.0), axis)
    assert result.share < 0.035  # measured 0.017-0.020
    assert result.position < 0.005  # [m], measured 0.0018


@pytest.mark.parametrize("axis", AXES)
def test_cap_tracks_a_sinusoid(axis):
    result = tracking.track(controllers.cap(soft=axis, eta=0.0), axis)
    assert result.share < CAP_SHARE[axis]
    assert result.position < CAP_OTHERS[axis]


def test_limits_only_loses_height_when_the_arm_is_stretched():
    result = tracking.track(controllers.limits_only(10, soft="x"), "x")
    assert 0.035 <= result.sunk <= 0.140  # [m], measured 0.075
    assert result.left < 0.040  # [m]


@pytest.mark.parametrize(
    ("law", "delay"),
    [
        (controllers.rec_at_edge(null_space=NullSpace(gain=1.0)), (0, 0)),
        (controllers.cap_at_edge(null_space=NullSpace(gain=1.0)), (0, 0)),
        (controllers.cap_at_edge(null_space=NullSpace(gain=1.0)), (1, 1)),
    ],
    ids=["rec_at_edge", "cap_at_edge", "cap_at_edge, tick each way"],
)
def test_target_out_of_reach(law, delay):
    result = tracking.leave_reach(law, conditions=Conditions(delay=delay))
    assert result.speed < 0.1  # [rad/s] rms at the limit, measured 0.001
    assert result.farthest > 0.66  # [m]
    assert result.error < 0.005  # [m] at the end, measured 0.0002
