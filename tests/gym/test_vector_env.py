"""`VectorTaskEnv`: numbers as of single environments, Gymnasium's autoreset modes, wrong input."""

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium")

import gymnasium
from gymnasium.vector import AutoresetMode

import pliant
from pliant.gym import Door, Drawer, Plug, SoftAction, VectorTaskEnv, Wall, Wipe

STEPS = 12


def make(task, mode, number, **options):
    """Return the environment of `number` arms, made by Gymnasium."""
    name = f"pliant/{type(task).__name__}-v0"
    options = {"task": task, "max_episode_steps": STEPS, "num_envs": number, **options}
    return gymnasium.make_vec(
        name, vectorization_mode="vector_entry_point", autoreset_mode=mode, **options
    )


def assert_same(ours, theirs, at=""):
    """Compare nested results of vector environments bit for bit, with their types."""
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys(), at
        for key, value in ours.items():
            assert_same(value, theirs[key], f"{at}/{key}")
    elif isinstance(ours, tuple):
        for i, (one, other) in enumerate(zip(ours, theirs, strict=True)):
            assert_same(one, other, f"{at}[{i}]")
    elif ours is not None and ours.dtype == object:
        for one, other in zip(ours, theirs, strict=True):
            assert (one is None) == (other is None), at
            assert_same(one, other, at)
    elif ours is not None:
        assert ours.dtype == theirs.dtype, at
        np.testing.assert_array_equal(ours, theirs, err_msg=at)


@pytest.mark.slow
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("task", [Door, Drawer, Plug, Wall, Wipe])
def test_it_is_a_loop_over_single_environments_bit_for_bit(task, mode):
    task = task(max_force=30.0)
    ours = make(task, mode, 3, threads=2)
    theirs = gymnasium.make_vec(
        f"pliant/{type(task).__name__}-v0",
        num_envs=3,
        vectorization_mode="sync",
        task=task,
        max_episode_steps=STEPS,
        vector_kwargs={"autoreset_mode": mode},
    )
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert_same(ours.reset(seed=4), theirs.reset(seed=4))
    rng, ends = np.random.default_rng(0), np.zeros(2, dtype=int)
    for step in range(30):
        actions = rng.uniform(-1.0, 1.0, ours.action_space.shape).astype(np.float32)
        got = ours.step(actions)
        assert_same(got, theirs.step(actions), f"step {step}")
        ends += [got[2].sum(), got[3].sum()]
    assert ends.sum() >= 3
    ours.close()


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["pose", "joints"])
def test_other_motions_are_those_of_a_single_environment(motion):
    action = SoftAction(motion=motion)
    envs = VectorTaskEnv(Door(), num_envs=2, action=action, threads=1)
    alone = pliant.gym.TaskEnv(Door(), action=action)
    first, _ = envs.reset(seed=[7, 3])
    single, _ = alone.reset(seed=3)
    rng = np.random.default_rng(1)
    for _ in range(5):
        for key, value in single.items():
            np.testing.assert_array_equal(first[key][1], value, err_msg=key)
        actions = rng.uniform(-0.5, 0.5, envs.action_space.shape)
        first, *_ = envs.step(actions)
        single, *_ = alone.step(actions[1])


@pytest.mark.slow
def test_without_autoreset_an_arm_stands_still_until_its_reset():
    envs = make(Wall(max_force=20.0, distance=(0.03, 0.03)), "Disabled", 2, max_episode_steps=60)
    envs.reset(seed=0)
    push = np.zeros(envs.action_space.shape)
    push[0, 0] = push[0, 6] = 1.0  # one arm, with firm axes, moves into the wall
    for _ in range(50):
        before, _, terminated, truncated, info = envs.step(push)
    assert terminated.tolist() == [True, False]
    assert info["force"][0] > 20.0
    after, rewards, terminated, *_ = envs.step(push)
    assert terminated.tolist() == [True, False]
    assert rewards[0] == 0.0
    np.testing.assert_array_equal(after["q"][0], before["q"][0])
    place = after["q"][1].copy()
    start, info = envs.reset(options={"reset_mask": np.array([True, False])})
    assert info["_force"].tolist() == [True, False]
    assert not np.array_equal(start["q"][0], after["q"][0])
    np.testing.assert_array_equal(start["q"][1], place)
    _, _, terminated, truncated, _ = envs.step(push)
    assert not terminated.any()
    assert not truncated.any()


@pytest.mark.slow
def test_each_arm_has_its_own_softness():
    door = Door(radius=(0.3, 0.3), friction=(0.5, 0.5))
    envs = VectorTaskEnv(door, num_envs=2, autoreset_mode="Disabled", threads=1)
    envs.reset(seed=[0, 0])
    actions = np.zeros(envs.action_space.shape)
    actions[:, 0], actions[0, 6:], actions[1, 6:] = -0.5, -0.5, 1.0
    largest = np.zeros(2)
    for _ in range(60):
        observation, *_, info = envs.step(actions)
        largest = np.maximum(largest, info["force"])
    assert largest[0] < 0.5 * largest[1]
    assert (observation["caps"][0] < 0.2 * observation["caps"][1]).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"num_envs": 0}, "num_envs must be at least 1, got 0"),
        ({"threads": 0}, "threads must be at least 1, got 0"),
        ({"autoreset_mode": "Never"}, "'Never'; choose from NextStep, SameStep, Disabled"),
        ({"action": SoftAction(soft="q")}, "'q' is no axis of the task"),
    ],
)
def test_wrong_options_are_refused(options, said):
    with pytest.raises(pliant.ConfigError, match=said):
        VectorTaskEnv(Wall(), **options)


def test_wrong_calls_are_refused():
    envs = VectorTaskEnv(Wall(), num_envs=2, threads=1)
    with pytest.raises(pliant.ConfigError, match=r"call reset\(\) first"):
        envs.step(np.zeros((2, 7)))
    with pytest.raises(pliant.ConfigError, match="seed has 3 entries for 2 arms"):
        envs.reset(seed=[1, 2, 3])
    for mask in (np.array([True]), np.array([1, 0]), np.array([False, False])):
        with pytest.raises(pliant.ConfigError, match="reset_mask must be a mask"):
            envs.reset(options={"reset_mask": mask})
    envs.reset(seed=1)
    with pytest.raises(pliant.ConfigError, match=r"actions have shape \(7,\), expected \(2, 7\)"):
        envs.step(np.zeros(7))
    actions = np.zeros((2, 7))
    actions[1, 3] = np.nan
    with pytest.raises(pliant.ConfigError, match="the action of arm 1 has an entry NaN or inf"):
        envs.step(actions)
    observations, *_ = envs.step(np.zeros((2, 7)))
    assert all(np.isfinite(values).all() for values in observations.values())
