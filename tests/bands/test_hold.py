"""Holding a pose: deviation of an untouched arm, and under pushes on its stiff axes."""

import pytest

from experiments import controllers, disturbances
from experiments.simulation import Conditions


def test_paper_without_gravity_model_sags_at_10_newton_metres():
    # Measured 0.020 [m].
    assert 0.012 <= disturbances.idle(controllers.paper(10, soft="")).error <= 0.028


def test_paper_without_gravity_model_sinks_at_3_newton_metres():
    assert (
        0.080 <= disturbances.idle(controllers.paper(3, soft=""), 3.0).error <= 0.400
    )  # [m], measured 0.155


def test_rec_holds_with_a_budget_of_3_newton_metres():
    assert disturbances.idle(controllers.rec(3)).error < 0.001  # [m], measured 0.0000


@pytest.mark.parametrize("delay", [(0, 0), (1, 1)], ids=["at once", "tick each way"])
def test_cap_holds(delay):
    law = controllers.cap(soft="")
    # Measured 0.0000 [m].
    assert disturbances.idle(law, conditions=Conditions(delay=delay)).error < 0.0005


def test_cap_holds_while_an_axis_follows():
    # The arm sags by 0.14 mm in y, until the goals compensate gravity after three ticks.
    assert disturbances.idle(controllers.cap()).error < 0.0005  # [m]


@pytest.mark.parametrize(
    (
        "axis",
        "size",
        "largest",
    ),  # size [N or N·m]; largest [m or rad], measured 0.0076 (x), 0.024 (z), 0.052 (pitch)
    [
        ("x", 10.0, 0.011),
        ("x", -10.0, 0.011),
        ("z", 10.0, 0.032),
        ("z", -10.0, 0.032),
        ("pitch", 1.5, 0.07),
        ("pitch", -1.5, 0.07),
    ],
)
def test_cap_stiff_axes_have_the_servos_own_stiffness(axis, size, largest):
    assert 0.0 < disturbances.push_stiff(controllers.cap(), axis, size) < largest
