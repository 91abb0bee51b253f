"""Simulated bus: lost data, delay and resolution, reproducible with the same seed."""

import numpy as np
import pytest

import pliant
from pliant.sim import Plant


def moving(plant, start, ticks, speed=0.5):
    """Move all joints; return readings, true positions and freshness, one row per tick."""
    plant.reset(start)
    read, true, fresh = [], [], []
    for tick in range(ticks):
        state = plant.read()
        read.append(state.q)
        true.append(plant.q)
        fresh.append(state.fresh)
        plant.write(start + speed * np.sin(0.1 * tick))
        plant.advance()
    return np.array(read), np.array(true), np.array(fresh)


@pytest.mark.parametrize("ticks", [0, 1, 3])
def test_read_delay_is_exactly_so_many_ticks(arm, grasp, ticks):
    read, true, _ = moving(Plant(arm, delay=(ticks, 0)), grasp, 30)
    np.testing.assert_array_equal(read[ticks:], true[: 30 - ticks])
    np.testing.assert_array_equal(read[:ticks], np.tile(grasp, (ticks, 1)))


@pytest.mark.parametrize("ticks", [1, 3])
def test_write_delay_is_exactly_so_many_ticks(arm, grasp, ticks):
    late, prompt = Plant(arm, delay=(0, ticks)), Plant(arm)
    for plant in (late, prompt):
        plant.reset(grasp)
    goals = grasp + np.random.default_rng(1).uniform(-0.5, 0.5, (30, 7))
    for tick in range(30):
        late.write(goals[tick])
        if tick >= ticks:
            prompt.write(goals[tick - ticks])
        late.advance()
        prompt.advance()
        np.testing.assert_array_equal(late.q, prompt.q)
    assert np.abs(late.q - grasp).max() > 1e-2


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
    read, true, _ = moving(plant, grasp, 200)
    steps = read / count
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    off = np.round((read - np.round(true / count) * count) / count).astype(int)
    share = [np.mean(off == k) for k in (-1, 0, 1)]
    np.testing.assert_allclose(share, [0.25, 0.5, 0.25], atol=0.04)
    goals = plant.mj_data.ctrl / count
    np.testing.assert_allclose(goals, np.round(goals), atol=1e-9)


def test_noise_has_the_asked_spread(arm, grasp):
    read, true, _ = moving(Plant(arm, noise=1e-3), grasp, 300)
    assert np.std(read - true) == pytest.approx(1e-3, rel=0.05)


def test_losses_have_the_asked_rate_and_repeat_the_last(arm, grasp):
    read, _, fresh = moving(Plant(arm, read_loss=0.3, seed=4), grasp, 1000)
    assert 1.0 - fresh.mean() == pytest.approx(0.3, abs=0.05)
    lost = np.flatnonzero(~fresh[1:]) + 1
    np.testing.assert_array_equal(read[lost], read[lost - 1])


def test_lost_writes_change_the_motion_and_all_lost_is_no_write(arm, grasp):
    none = moving(Plant(arm), grasp, 50)[1]
    some = moving(Plant(arm, write_loss=0.5), grasp, 50)[1]
    assert np.abs(some - none).max() > 1e-4
    plant, still = Plant(arm, write_loss=1.0), Plant(arm)
    still.reset(grasp)
    moved = moving(plant, grasp, 50)[1]
    for row in moved:
        np.testing.assert_array_equal(row, still.q)
        still.advance()


def test_silence_freezes_both_directions(arm, grasp):
    read, _, fresh = moving(Plant(arm, bus_outage=(0.1, 0.3)), grasp, 50)
    assert fresh[:10].all()
    assert not fresh[11:29].any()
    assert fresh[31:].all()
    np.testing.assert_array_equal(read[12], read[28])


def test_equal_seeds_are_equal_bit_for_bit_and_resets_start_anew(arm, grasp):
    options = {
        "encoder_step": 1e-3,
        "encoder_flicker": 1,
        "noise": 1e-4,
        "read_loss": 0.2,
        "write_loss": 0.2,
    }
    plant = Plant(arm, seed=5, **options)
    first, again = moving(plant, grasp, 60), moving(plant, grasp, 60)
    other = moving(Plant(arm, seed=5, **options), grasp, 60)
    for run in (again, other):
        for left, right in zip(first, run, strict=True):
            np.testing.assert_array_equal(left, right)
    changed = moving(Plant(arm, seed=6, **options), grasp, 60)
    assert np.any(changed[0] != first[0])


def test_kept_readings_never_change(arm, grasp):
    plant = Plant(arm)
    state = plant.reset(grasp)
    kept = state.q.copy()
    plant.write(grasp + 0.2)
    plant.advance()
    np.testing.assert_array_equal(state.q, kept)
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
        ({"rate": 333.0}, "not a whole number"),
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
    plant, same = Plant(arm), Plant(arm)
    for one in (plant, same):
        one.reset(grasp)
    with pytest.raises(pliant.PliantError, match=message):
        plant.write(goal, limit)
    plant.advance()
    same.advance()
    np.testing.assert_array_equal(plant.q, same.q)
