"""`capture_gravity`: measured offset, check, remedy and errors."""

import numpy as np
import pytest
from bare_arm import bare_arm
from mismatch import Mismatch, Parameters

import pliant
import pliant.robots
from experiments.gravity_capture import try_capture
from pliant import identify
from pliant.sim import Plant

COUNT = np.deg2rad(0.088)
FOLLOWING = pliant.Settings(
    axes={"y": pliant.Axis(soft=4.0, adaptation=0.999)}, accept_high_adaptation=True
)


def arm_in_pose(arm, q, settings=FOLLOWING, **differs):
    """Return an arm in pose q and a controller; `differs`: true values that it does not assume."""
    if differs:
        gap = Mismatch(plant=Parameters(**differs), assumed=Parameters())
        plant = gap.build(arm, encoder_step=COUNT)
    else:
        plant = Plant(arm, encoder_step=COUNT)
    plant.reset(q)
    controller = pliant.Controller(arm, settings, arm.servos.replace(encoder_step=COUNT))
    if differs:
        gap.check(controller)
    return plant, controller


@pytest.mark.parametrize("kp", [0.5, 0.8, 1.25, 2.0])
def test_an_arm_that_would_drift_stays_after_the_capture(arm, grasp, kp):
    plant, controller = arm_in_pose(arm, grasp, kp=kp)
    capture = identify.capture_gravity(plant, controller)
    assert capture.stays, str(capture)
    assert capture.drift < 2e-3  # measured 0.0007
    assert controller.settings == FOLLOWING
    heavy = np.abs(capture.gravity) > 1.0
    assert np.abs(capture.stiffness[heavy] / (kp * capture.assumed[heavy]) - 1.0).max() < 0.3
    assert sum("captured" in text for text in capture.summary()) == capture.captured.sum()


def test_a_drifting_arm_is_stopped_with_a_remedy():
    """With twice the assumed k_p the friction feed-forward is twice too large: the tool drifts."""
    so101 = pliant.robots.so101()
    settings = FOLLOWING.replace(
        task="xyz", axes={"y": pliant.Axis(yields="both", adaptation=0.999)}
    )
    plant, controller = arm_in_pose(so101, [0.2, -0.3, 0.3, 0.9, 0.0], settings, kp=2.0)
    start = plant.tool[:3, 3]
    capture = identify.capture_gravity(plant, controller)
    assert not capture.stays
    assert capture.bound < capture.drift < 5e-3
    assert np.linalg.norm(plant.tool[:3, 3] - start) < 0.02
    assert controller.settings == settings
    assert capture.remedy is not None
    assert capture.remedy.compensation.friction < settings.compensation.friction
    assert "controller.update(found.remedy)" in str(capture)


def test_the_report_names_a_payload_that_was_clipped(arm, grasp):
    plant, controller = arm_in_pose(arm, grasp, payload=1.2, kp=0.4)
    capture = identify.capture_gravity(plant, controller, check=0.0)
    assert capture.clipped.any()
    assert not capture.stays
    assert any("clipped" in text and "wrong payload" in text for text in capture.summary())


@pytest.mark.parametrize("check", [0.0, 0.5])
def test_the_gravity_in_the_result_is_that_of_the_controller(arm, grasp, check):
    plant, controller = arm_in_pose(arm, grasp, payload=0.5)
    controller.set_payload(0.5)
    capture = identify.capture_gravity(plant, controller, seconds=1.0, check=check)
    loaded = pliant.robots.arm7(payload=pliant.Payload(0.5))
    np.testing.assert_allclose(capture.gravity, loaded.gravity(plant.q), atol=0.1)
    assert np.abs(capture.gravity - arm.gravity(plant.q)).max() > 1.0


def test_settings_come_back_after_an_exception(arm, grasp):
    plant, controller = arm_in_pose(arm, grasp)
    procedure = identify.capture_gravity.procedure(controller)
    for _ in range(5):
        plant.write(procedure.step(plant.read().q).goal)
        plant.advance()
    assert controller.settings.tracking.integrate == 4.0
    assert controller.settings.compensation == pliant.Compensation(friction=0.0, damping=0.0)
    with pytest.raises(pliant.ShapeError):
        procedure.step(np.full(7, np.nan))
    with pytest.raises(pliant.PliantError):
        procedure.step(np.zeros(3))  # positions of an arm with three joints
    assert controller.settings == FOLLOWING


def test_it_runs_on_a_connected_arm():
    with bare_arm("arm7") as connected:
        controller = pliant.Controller(connected.model, pliant.Settings.soft("y"))
        capture = identify.capture_gravity(connected, controller, seconds=1.0, check=0.5)
        assert capture.captured.sum() >= 3
        assert capture.drift < 2e-3


def test_numbers_out_of_range_are_refused(arm):
    controller = pliant.Controller(arm)
    with pytest.raises(pliant.OutOfRangeError, match="seconds"):
        identify.capture_gravity.procedure(controller, seconds=0.2)
    plain_controller = pliant.Controller(arm, pliant.Settings.paper())
    assert plain_controller.servos is not None  # built-in models have servo parameters


@pytest.mark.parametrize("kp", [0.8, 2.0])
def test_the_check_predicts_the_motion_afterwards(kp):
    with Mismatch(plant=Parameters(kp=kp), assumed=Parameters()):
        result = try_capture("arm7", 0, kp)
    assert result.stays or result.remedied
    assert result.later < 5e-3
