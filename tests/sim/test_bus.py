"""Simulated bus: lost data, delays, resolution; equal seeds give equal results."""

import numpy as np
import pytest

import pliant
from pliant.sim import Plant


def move_joints(plant, start, ticks, speed=0.5):
    """Move all joints; return readings, true positions and freshness of the reading, by tick."""
    plant.reset(start)
    readings, true, freshness = [], [], []
    for tick in range(ticks):
        state = plant.read()
        readings.append(state.q)
        true.append(plant.q)
        freshness.append(state.fresh)
        plant.write(start + speed * np.sin(0.1 * tick))
        plant.advance()
    return np.array(readings), np.array(true), np.array(freshness)


@pytest.mark.parametrize("ticks", [0, 1, 3])
def test_read_delay_is_exact(arm, grasp, ticks):
    readings, true, _ = move_joints(Plant(arm, delay=(ticks, 0)), grasp, 30)
    np.testing.assert_array_equal(readings[ticks:], true[: 30 - ticks])
    np.testing.assert_array_equal(readings[:ticks], np.tile(grasp, (ticks, 1)))


@pytest.mark.parametrize("ticks", [1, 3])
def test_write_delay_is_exact(arm, grasp, ticks):
    delayed, prompt = Plant(arm, delay=(0, ticks)), Plant(arm)
    for plant in (delayed, prompt):
        plant.reset(grasp)
    goals = grasp + np.random.default_rng(1).uniform(-0.5, 0.5, (30, 7))
    for tick in range(30):
        delayed.write(goals[tick])
        if tick >= ticks:
            prompt.write(goals[tick - ticks])
        delayed.advance()
        prompt.advance()
        np.testing.assert_array_equal(delayed.q, prompt.q)
    assert np.abs(delayed.q - grasp).max() > 1e-2


def test_a_command_holds_until_the_next(arm, grasp):
    once, often = Plant(arm, delay=(0, 2)), Plant(arm, delay=(0, 2))
    for plant in (once, often):
        plant.reset(grasp)
        plant.write(grasp + 0.1)
    for _ in range(20):
        often.write(grasp + 0.1)
        once.advance()
        often.advance()
        np.testing.assert_array_equal(once.q, often.q)


def test_readings_and_goals_lie_on_counts(arm, grasp):
    count = 2 * np.pi / 4096
    plant = Plant(arm, encoder_step=count, encoder_flicker=1)
    readings, true, _ = move_joints(plant, grasp, 200)
    steps = readings / count
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    errors = np.round((readings - np.round(true / count) * count) / count).astype(int)
    share = [np.mean(errors == k) for k in (-1, 0, 1)]
    np.testing.assert_allclose(share, [0.25, 0.5, 0.25], atol=0.04)
    goals = plant.mj_data.ctrl / count
    np.testing.assert_allclose(goals, np.round(goals), atol=1e-9)


def test_noise_has_the_given_standard_deviation(arm, grasp):
    readings, true, _ = move_joints(Plant(arm, noise=1e-3), grasp, 300)
    assert np.std(readings - true) == pytest.approx(1e-3, rel=0.05)


def test_losses_have_the_given_rate_and_repeat_the_last_reading(arm, grasp):
    readings, _, freshness = move_joints(Plant(arm, read_loss=0.3, seed=4), grasp, 1000)
    assert 1.0 - freshness.mean() == pytest.approx(0.3, abs=0.05)
    losses = np.flatnonzero(~freshness[1:]) + 1
    np.testing.assert_array_equal(readings[losses], readings[losses - 1])


def test_lost_writes_change_the_motion(arm, grasp):
    without_loss = move_joints(Plant(arm), grasp, 50)[1]
    with_loss = move_joints(Plant(arm, write_loss=0.5), grasp, 50)[1]
    assert np.abs(with_loss - without_loss).max() > 1e-4
    plant, unwritten = Plant(arm, write_loss=1.0), Plant(arm)
    unwritten.reset(grasp)
    motion = move_joints(plant, grasp, 50)[1]
    for row in motion:
        np.testing.assert_array_equal(row, unwritten.q)
        unwritten.advance()


def test_silence_freezes_both_directions(arm, grasp):
    readings, _, freshness = move_joints(Plant(arm, bus_outage=(0.1, 0.3)), grasp, 50)
    assert freshness[:10].all()
    assert not freshness[11:29].any()
    assert freshness[31:].all()
    np.testing.assert_array_equal(readings[12], readings[28])


def test_equal_seeds_are_equal_bit_for_bit_and_resets_start_anew(arm, grasp):
    options = {
        "encoder_step": 1e-3,
        "encoder_flicker": 1,
        "noise": 1e-4,
        "read_loss": 0.2,
        "write_loss": 0.2,
    }
    plant = Plant(arm, seed=5, **options)
    first, again = move_joints(plant, grasp, 60), move_joints(plant, grasp, 60)
    other = move_joints(Plant(arm, seed=5, **options), grasp, 60)
    for run in (again, other):
        for left, right in zip(first, run, strict=True):
            np.testing.assert_array_equal(left, right)
    other_run = move_joints(Plant(arm, seed=6, **options), grasp, 60)
    assert np.any(other_run[0] != first[0])


def test_kept_readings_never_change(arm, grasp):
    plant = Plant(arm)
    state = plant.reset(grasp)
    copy = state.q.copy()
    plant.write(grasp + 0.2)
    plant.advance()
    np.testing.assert_array_equal(state.q, copy)
    plant.read().q[:] = 0.0
    assert np.abs(plant.q).max() > 0.1


def test_the_gripper_rides_along(grasp):
    arm = pliant.robots.so101()
    plant = Plant(arm)
    plant.reset(np.zeros(5))
    for _ in range(100):
        plant.write(np.zeros(5), extra={"gripper": (0.5, 1.0)})
        plant.advance()
    assert plant.read().extra["gripper"] == pytest.approx(0.5, abs=0.02)
    with pytest.raises(pliant.ConfigError, match=r"no off-chain joint 'claw'.*gripper"):
        plant.write(np.zeros(5), extra={"claw": (0.0, 1.0)})
    assert not Plant(arm, off_chain="welded").read().extra


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": 0.0}, "dt must be"),
        ({"rate": 0.0}, "rate must be"),
        (
            {"rate": 333.0},
            r"rate = 333 Hz: its period is not a whole number of the simulator's steps of "
            r"0\.001 s; rates that fit: 250, 500 Hz",
        ),
        ({"rate": 30.0}, r"rates that fit: 25, 31\.25 Hz"),
        ({"rate": 30.0, "dt": 0.002}, r"rates that fit: 25, 31\.25 Hz"),
        ({"rate": 1500.0}, r"rates that fit: 500, 1000 Hz"),
        ({"rate": 1e-5 * np.pi}, "rates that fit: "),
        ({"delay": (-1, 0)}, "delay must be"),
        ({"delay": 2}, "delay must be"),
        ({"encoder_step": -1.0}, "encoder_step must be at least 0"),
        ({"encoder_flicker": 1}, "encoder_flicker is in encoder counts"),
        ({"noise": np.nan}, "noise is not finite"),
        ({"read_loss": 1.5}, "read_loss"),
        ({"write_loss": -0.1}, "write_loss"),
        ({"deadband": [0.1, 0.1]}, "deadband has shape"),
        ({"kp_scale": -1.0}, "kp_scale"),
        ({"payload": (-1.0, (0, 0, 0))}, "payload"),
    ],
)
def test_bad_options_are_named(arm, options, message):
    with pytest.raises(pliant.PliantError, match=message):
        Plant(arm, **options)


@pytest.mark.parametrize(
    ("goal", "limit", "message"),
    [
        (np.zeros(6), None, r"goal has shape \(6,\), expected \(7,\)"),
        (np.full(7, np.nan), None, "goal is not finite"),
        (np.zeros(7), np.zeros(8), "limit has shape"),
        (np.zeros(7), np.full(7, -1.0), "limit must be at least 0"),
        (np.zeros(7), np.full(7, np.inf), "limit is not finite"),
    ],
)
def test_bad_writes_are_named_and_change_nothing(arm, grasp, goal, limit, message):
    plant, reference = Plant(arm), Plant(arm)
    for sim in (plant, reference):
        sim.reset(grasp)
    with pytest.raises(pliant.PliantError, match=message):
        plant.write(goal, limit)
    plant.advance()
    reference.advance()
    np.testing.assert_array_equal(plant.q, reference.q)
