"""Load-dependent friction: compensation by the feed-forward once it is known."""

import numpy as np
import pytest
from mismatch import under

from experiments import controllers, disturbances, goals
from experiments.campaign import REAL_GEARS
from experiments.simulation import Conditions
from pliant.sim import DRAG_15N

UNKNOWN = Conditions(gears=REAL_GEARS["arm7"])
KNOWN = Conditions(gears=REAL_GEARS["arm7"], gears_known=True)


def test_a_known_load_is_fed_forward():
    drag = goals.dragged(controllers.cap(), DRAG_15N)
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
