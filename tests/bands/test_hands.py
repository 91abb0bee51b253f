"""A hand drags the tool along a soft axis: force, drift of the stiff axes, and return."""

import pytest

from experiments import controllers, disturbances
from pliant.sim import DRAG_15N, DRAG_80N
from pliant.sim.postures import HORIZONTAL


def test_rec_follows_a_15_newton_hand():
    result = disturbances.drag(controllers.rec(), DRAG_15N)
    assert result.moved > 0.23  # [m], measured 0.25
    assert result.force < 9.0  # [N], measured 5.6
    assert result.position < 0.008  # [m], measured 0.0026
    assert result.rotation < 0.04  # [rad], measured 0.011
    assert result.stays < 0.030  # [m]


def test_cap_follows_a_15_newton_hand():
    result = disturbances.drag(controllers.cap(), DRAG_15N)
    assert result.moved > 0.23
    assert result.force < 7.5  # [N], measured 5.6
    assert result.position < 0.005  # [m], measured 0.0023
    assert result.rotation < 0.03  # [rad], measured 0.012
    assert result.stays < 0.015  # [m], measured 0.0006


def test_cap_follows_a_strong_hand():
    result = disturbances.drag(controllers.cap(), DRAG_80N)
    assert result.force < 6.0  # [N], measured 4.0
    assert result.position < 0.005  # [m], measured 0.0025


def test_rec_comes_back_with_eta_below_one():
    result = disturbances.drag(controllers.rec(eta=0.9), DRAG_15N)
    assert result.moved > 0.15  # [m], measured 0.24
    assert result.position < 0.012  # [m], measured 0.0069
    assert result.back < 0.015  # [m] after 1 s, measured 0.001


def test_cap_comes_back_with_eta_below_one():
    result = disturbances.drag(controllers.cap(eta=0.9), DRAG_15N, duration=12.0)
    assert result.moved > 0.2  # [m], measured 0.24
    assert result.force < 13.0  # [N], measured 9.4
    assert result.end < 0.015  # [m] after 7 s, measured 0.002


def test_paper_without_gravity_model_drifts_before_the_hand_comes():
    result = disturbances.drag(controllers.paper(10), DRAG_15N)
    assert 0.040 <= result.before <= 0.130  # [m], measured 0.079
    assert result.moved > 0.2  # [m], measured 0.24
    assert result.drift < 0.012  # [m], measured 0.0055


def test_paper_without_gravity_model_comes_back_with_eta_below_one():
    result = disturbances.drag(controllers.paper(10, eta=0.9), DRAG_15N)
    assert 0.09 <= result.moved <= 0.24  # [m], measured 0.13
    assert result.drift < 0.012  # [m], measured 0.0048
    start = result.trace.moved[result.trace.at(2.0), 1]
    back = result.trace.moved[result.trace.at(6.0), 1]
    assert abs(back - start) < 0.015  # [m], from the tool's position when the hand came


def test_rec_without_adaptation():
    result = disturbances.drag(controllers.rec(eta=0.0), DRAG_80N)
    assert 4.0 <= result.held <= 10.0  # [N], measured 6.5
    assert result.drift < 0.008  # [m], measured 0.0046
    assert result.back < 0.005  # [m]


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["+y", "-y"])
def test_cap_keeps_its_promise(sign):
    hand = DRAG_80N if sign > 0.0 else disturbances.opposite(DRAG_80N)
    result = disturbances.drag(controllers.cap(eta=0.0), hand)
    assert 11.5 <= sign * result.held <= 18.5  # [N], measured 14.3, 14.8
    assert result.position < 0.005  # [m], measured 0.0023
    assert result.back < 0.015  # [m], measured 0.0015


def test_cap_yields_to_one_side_only():
    law = controllers.cap(eta=0.0, axis={"yields": "-"})
    assert disturbances.push(law, 20.0, at="tool").moved < 0.040  # [m], measured 0.035
    assert disturbances.push(law, -20.0, at="tool").moved > 0.060  # [m], measured 0.385


def test_limits_only_lets_the_stiff_axes_go():
    gentle = disturbances.push(controllers.limits_only(6), 5.0)
    assert 0.008 <= gentle.moved <= 0.035  # [m], measured 0.018
    hard = disturbances.push(controllers.limits_only(6), 15.0)
    assert 0.070 <= hard.moved <= 0.170  # [m], measured 0.117
    assert hard.position > 0.020  # [m], measured 0.045
    assert max(gentle.back, hard.back) < 0.005  # [m]
    assert disturbances.push(controllers.limits_only(20), 15.0).moved < 0.030  # [m], measured 0.017


def test_rec_in_the_horizontal_grasp():
    result = disturbances.drag(controllers.rec(), DRAG_80N, q=HORIZONTAL)
    assert result.moved > 0.14  # [m], measured 0.15
    assert result.force < 9.0  # [N], measured 4.0
    assert result.position < 0.008  # [m], measured 0.0013
    assert result.rotation < 0.04  # [rad], measured 0.012


def test_cap_in_the_horizontal_grasp():
    result = disturbances.drag(controllers.cap(), DRAG_80N, q=HORIZONTAL)
    assert result.force < 6.0  # [N], measured 3.9
    assert result.position < 0.005  # [m], measured 0.0022
