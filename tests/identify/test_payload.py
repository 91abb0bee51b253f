"""`estimate_payload`: the error bars contain the true values as often as they should."""

import numpy as np
import pytest
from mismatch import Mismatch, Parameters

import pliant
from experiments.identification import COUNT, LIFTS, STARTS
from pliant import identify, robots
from pliant.identify._segments import first_moments, payload_rows


def test_rows_are_what_a_payload_adds_to_gravity(arm, grasp):
    mass, com = 0.37, (0.03, -0.05, 0.11)
    loaded = robots.arm7(payload=(mass, com))
    added = loaded.gravity(grasp) - arm.gravity(grasp)
    rows = payload_rows(arm, grasp) @ first_moments(mass, com)
    np.testing.assert_allclose(rows, added, atol=1e-12)


def weighed(name, seed):
    """Return the errors of (m, m c) over their standard deviations, for a random payload."""
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
    found = identify.estimate_payload(plant, controller)
    truth = first_moments(mass, com)
    return (found.moments - truth) / np.sqrt(np.diag(found.covariance)), found, mass, controller


@pytest.mark.parametrize("name", ["arm7", "so101", "koch"])
def test_a_payload_is_weighed_within_its_error_bars(name):
    bars, found, mass, controller = weighed(name, 3)
    assert np.abs(bars).max() < 3.0
    assert found.found
    assert found.mass == pytest.approx(mass, rel=0.35)
    # The controller compensates the estimated payload from now on.
    q = STARTS[name]
    controller.step(q, controller.model.forward_kinematics(q))
    expected = controller.model.gravity(q) + payload_rows(controller.model, q) @ found.moments
    np.testing.assert_allclose(controller.diagnostics.gravity, expected, atol=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("name", ["arm7", "so101", "koch"])
def test_error_bars_contain_the_true_values_as_often_as_they_claim(name):
    bars = np.array([weighed(name, seed)[0] for seed in range(40)])
    assert (np.abs(bars) < 1.0).mean() >= 0.65
    assert (np.abs(bars) < 2.0).mean() >= 0.94


def test_poses_without_information_are_reported():
    """If the tool axis is vertical in every pose, the height of the centre is undetermined."""
    model = robots.so101()
    gap = Mismatch(plant=Parameters(payload=0.1), assumed=Parameters())
    plant = gap.build(model, payload=(0.1, (0.0, 0.0, 0.05)))
    plant.reset(STARTS["so101"])
    controller = pliant.Controller(model, pliant.Settings(task="xyz"), model.servos)
    gap.check(controller)
    found = identify.estimate_payload(plant, controller, poses=1)
    weak = [text for text in found.summary() if "cannot be told" in text]
    assert (found.sigma_reduction < 0.5).sum() >= 1
    assert len(weak) == 1
    assert "span" in weak[0]
