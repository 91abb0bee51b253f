"""`estimate_payload`: the error bars contain the true values as often as stated."""

import numpy as np
import pytest
from mismatch import Mismatch, Parameters

import pliant
from experiments.identification import COUNT, LIFTS, STARTS
from pliant import identify, robots
from pliant.identify._segments import first_moments, payload_rows


def test_rows_are_what_a_payload_adds_to_gravity(arm, grasp):
    mass, com = 0.37, (0.03, -0.05, 0.11)
    loaded_model = robots.arm7(payload=(mass, com))
    added = loaded_model.gravity(grasp) - arm.gravity(grasp)
    rows = payload_rows(arm, grasp) @ first_moments(mass, com)
    np.testing.assert_allclose(rows, added, atol=1e-12)


def weigh(name, seed):
    """Weigh a random payload.

    Returns:
        Errors of mass and first moments over their standard deviations (4,) [1], estimate, true
        mass [kg], and controller.
    """
    rng, model = np.random.default_rng(seed), robots.load(name)
    mass, com = rng.uniform(0.15, 1.0) * LIFTS[name], rng.uniform(-0.05, 0.05, 3)
    table = model.servos.replace(encoder_step=COUNT)
    side = Parameters(
        kp=rng.normal(1.0, 0.04, model.n), friction=rng.uniform(0.7, 1.5), payload=mass
    )
    gap = Mismatch(plant=side, assumed=Parameters())
    plant = gap.build(model, table, encoder_step=COUNT, payload=(mass, com))
    plant.reset(STARTS[name] + rng.uniform(-0.15, 0.15, model.n))
    task = "xyz rpy" if model.n > 5 else "xyz"
    controller = pliant.Controller(model, pliant.Settings(task=task), table)
    gap.check(controller)
    estimate = identify.estimate_payload(plant, controller)
    truth = first_moments(mass, com)
    return (
        (estimate.moments - truth) / np.sqrt(np.diag(estimate.covariance)),
        estimate,
        mass,
        controller,
    )


@pytest.mark.parametrize("name", ["arm7", "so101", "koch"])
def test_a_payload_is_weighed_within_its_error_bars(name):
    errors, estimate, mass, controller = weigh(name, 3)
    assert np.abs(errors).max() < 3.0
    assert estimate.found
    assert estimate.mass == pytest.approx(mass, rel=0.35)
    # From now on the controller compensates the estimated payload.
    q = STARTS[name]
    controller.step(q, controller.model.forward_kinematics(q))
    expected = controller.model.gravity(q) + payload_rows(controller.model, q) @ estimate.moments
    np.testing.assert_allclose(controller.diagnostics.gravity, expected, atol=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("name", ["arm7", "so101", "koch"])
def test_error_bars_contain_the_true_values_as_often_as_they_claim(name):
    bars = np.array([weigh(name, seed)[0] for seed in range(40)])
    assert (np.abs(bars) < 1.0).mean() >= 0.65
    assert (np.abs(bars) < 2.0).mean() >= 0.94


def test_poses_without_information_are_reported():
    """If the tool axis is vertical in all poses, the height of the centre of mass is unknown."""
    model = robots.so101()
    gap = Mismatch(plant=Parameters(payload=0.1), assumed=Parameters())
    plant = gap.build(model, payload=(0.1, (0.0, 0.0, 0.05)))
    plant.reset(STARTS["so101"])
    controller = pliant.Controller(model, pliant.Settings(task="xyz"), model.servos)
    gap.check(controller)
    estimate = identify.estimate_payload(plant, controller, poses=1)
    weak = [text for text in estimate.summary() if "cannot be told" in text]
    assert (estimate.sigma_reduction < 0.5).sum() >= 1
    assert len(weak) == 1
    assert "span" in weak[0]
