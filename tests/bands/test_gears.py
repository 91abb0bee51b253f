"""Load-dependent friction: the feed-forward compensates it if the controller knows it."""

import numpy as np
import pytest
from mismatch import under

from experiments import controllers, disturbances, gears, goals
from experiments.campaign import REAL_GEARS
from experiments.simulation import Conditions
from pliant.sim import DRAG_15N

UNKNOWN = Conditions(gears=REAL_GEARS["arm7"])
KNOWN = Conditions(gears=REAL_GEARS["arm7"], gears_known=True)


def test_a_known_load_is_fed_forward():
    drag = goals.measure_drag(controllers.cap(), DRAG_15N)
    with under(UNKNOWN):
        assert drag(UNKNOWN)["force [N]"] > 14.0  # measured 15.0: the hand's largest force
    assert drag(KNOWN)["force [N]"] < 8.5  # measured 7.6


def test_the_rigid_door_opens_as_with_light_gears():
    door = goals.door("door")(KNOWN)
    assert door["force [N]"] < 26.0  # measured 22.9; 57 with unknown friction
    assert door["angle [deg]"] > 66.0  # measured 67.1; 64 with unknown friction


@pytest.mark.parametrize("delay", [(0, 0), (1, 1)])
def test_the_arm_stays_at_rest(delay):
    idle = disturbances.idle(
        controllers.cap(), conditions=Conditions(gears=KNOWN.gears, gears_known=True, delay=delay)
    )
    assert idle.error < 2e-3  # measured 6e-4
    assert np.abs(idle.speed) < 0.02  # measured 0.008


def test_dither_makes_the_drag_lighter_and_costs_reversals():
    """Compare two rows of `experiments.gears`: the present law, and dither."""
    case, rows = gears.Case(arm="arm7"), ("present law", "dither 0.6")
    present, dither = (gears.drag(case, gears.REMEDIES[row]) for row in rows)
    assert present == pytest.approx(8.0, abs=0.3)  # measured 8.04
    assert dither < 0.93 * present  # measured 7.1
    still, shaken = (gears.rest(case, row, 0.0, to_the_end=False) for row in rows)
    assert still.reversals < 1.0  # [1/s]
    assert shaken.reversals > 20.0
    assert shaken.heat > still.heat


@pytest.mark.parametrize("arm", ["arm7", "so101"])
def test_a_drag_needs_at_least_the_static_friction_of_one_joint(arm):
    case = gears.Case(arm=arm, encoder_step=gears.COUNT)
    smallest = gears.bound(case)
    strong = gears.bound(gears.Case(arm=arm, friction=1.3))
    assert 1.1 * smallest.moves < strong.moves < 1.5 * smallest.moves
    assert smallest.counts > 0.0
    assert gears.drag(case, gears.REMEDIES["present law"]) > smallest.moves
