"""Closed loop at several rates, delays and encoder resolutions, and with wrong friction values."""

import numpy as np
import pytest
from mismatch import Mismatch, Parameters

from experiments import controllers, disturbances, doors, metrics
from experiments.simulation import Conditions
from pliant.sim import DRAG_15N, DRAG_30N

ROUGH = {"noise": np.deg2rad(0.05), "read_loss": 0.05, "write_loss": 0.05}
CONDITIONS = {
    "20 Hz": Conditions(rate=20.0),
    "50 Hz, 1+1": Conditions(rate=50.0, delay=(1, 1)),
    "100 Hz, 2+2": Conditions(delay=(2, 2)),
    "250 Hz": Conditions(rate=250.0),
    "100 Hz, 1+1, rough": Conditions(delay=(1, 1), encoder_step=np.deg2rad(0.088), plant=ROUGH),
}
#: Bounds of law `cap` with delay under a hand of at most 15 N, by loop: conditions, force [N]
#: (measured 7.0, 5.9, 7.8), drift [m] (measured .0028, .0024, .0035).
DELAYED = {
    "100 Hz, 1+1": (Conditions(delay=(1, 1)), 9.0, 0.005),
    "200 Hz, 1+1": (Conditions(rate=200.0, delay=(1, 1)), 8.0, 0.0045),
    "100 Hz, 2+2": (Conditions(delay=(2, 2)), 10.0, 0.006),
}
#: Rates and delays of the loop for the test with wrong friction and damping.
LOOP_TIMINGS = {
    "100 Hz": Conditions(),
    "100 Hz, 1+1": Conditions(delay=(1, 1)),
    "200 Hz, 1+1": Conditions(rate=200.0, delay=(1, 1)),
}
#: Bounds by encoder resolution [deg]: idle speed [rad/s], force of a slow drag [N], and drift of
#: the idle tool in 2 s [m].
COUNTS = {
    0.06: (0.006, 4.0, 0.003),  # measured 0.002, 1.9
    0.088: (0.01, 4.0, 0.003),  # measured 0.004, 1.8
    0.29: (0.09, 5.0, 0.012),  # measured 0.044, 3.3
}


@pytest.mark.parametrize("name", CONDITIONS)
def test_rec_at_other_rates_and_delays(name):
    result = disturbances.drag(controllers.rec(), DRAG_30N, conditions=CONDITIONS[name])
    assert result.moved > 0.19  # [m]
    assert result.position < 0.010  # [m], measured 0.0029, 0.0042, 0.0040, 0.0016, 0.0029
    assert metrics.speed(result.trace, 1.0, 2.0) < 0.03  # [rad/s], before the hand
    assert metrics.speed(result.trace, 8.0, 9.0) < 0.03  # [rad/s], after it


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_rec_does_not_ring_at_50_hz(axis):
    conditions = CONDITIONS["50 Hz, 1+1"]
    assert (
        disturbances.speed_after_tap(controllers.rec(), axis, conditions=conditions) < 0.01
    )  # [rad/s]


@pytest.mark.parametrize("loop", DELAYED)
def test_cap_predicts_over_the_delay(loop):
    conditions, force, drift = DELAYED[loop]
    result = disturbances.drag(controllers.cap(), DRAG_15N, conditions=conditions)
    assert result.force < force
    assert result.position < drift
    assert doors.open_door(controllers.cap, conditions=conditions).force < 28.0  # [N], measured 21


@pytest.mark.parametrize("loop", DELAYED)
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_cap_does_not_ring_with_a_delay(loop, axis):
    assert (
        disturbances.speed_after_tap(controllers.cap(), axis, conditions=DELAYED[loop][0]) < 0.01
    )  # [rad/s]


@pytest.mark.parametrize("ratio", [0.7, 1.3])
@pytest.mark.parametrize("loop", LOOP_TIMINGS)
def test_cap_with_friction_known_to_30_percent(loop, ratio):
    conditions = Conditions(
        rate=LOOP_TIMINGS[loop].rate, delay=LOOP_TIMINGS[loop].delay, assumed_ratio=ratio
    )
    delay = sum(conditions.delay) / conditions.rate
    assumed = Parameters(friction=ratio, damping=ratio, delay=delay)
    with Mismatch(plant=Parameters(delay=delay), assumed=assumed):
        result = disturbances.drag(controllers.cap(), DRAG_15N, conditions=conditions)
        door = doors.open_door(controllers.cap, conditions=conditions)
    assert result.force < 9.0  # [N], measured 5.3-7.3
    assert result.position < 0.006  # [m], measured 0.0024-0.0040
    assert door.force < 40.0  # [N], measured 14-31


@pytest.mark.parametrize("rate", [100.0, 200.0])
@pytest.mark.parametrize("count", COUNTS)
def test_cap_with_a_flickering_encoder(count, rate):
    speed, force, drift = COUNTS[count]
    conditions = Conditions(rate=rate, encoder_step=np.deg2rad(count), encoder_flicker=1)
    idle = disturbances.idle(controllers.cap(), 6.0, conditions=conditions)
    assert idle.speed < speed
    assert idle.walk < drift
    slow = disturbances.drag(
        controllers.cap(), disturbances.SLOW, duration=7.0, conditions=conditions
    )
    assert slow.force < force
    light = disturbances.drag(controllers.cap(), DRAG_15N, duration=5.5, conditions=conditions)
    assert light.force < 9.0  # [N]
