"""`lerobot_env_pliant`: names, sizes and values as LeRobot's factory and evaluation use them."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="environments: pip install 'pliant[gym]'")

import gymnasium
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import pliant
import pliant.gym

FOLDER = Path(__file__).resolve().parents[2] / "integrations" / "lerobot_env"


@pytest.fixture(scope="module")
def envs(plugin):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [str(FOLDER), *sys.path])
        yield importlib.import_module("lerobot_env_pliant")
    del sys.modules["lerobot_env_pliant"]


@pytest.mark.parametrize("name", ["Door", "Drawer", "Plug", "Wall", "Wipe"])
def test_features_are_those_of_the_environment(envs, name):
    config = envs.PliantEnv(task=f"{name}-v0", seconds=2.0)
    env = gymnasium.make(config.gym_id, disable_env_checker=True, **config.gym_kwargs)
    observation, _ = env.reset(seed=0)
    assert config.type == "pliant"
    assert config.features["action"].shape == env.action_space.shape
    assert {name: config.features[name].shape for name in observation} == {
        name: value.shape for name, value in observation.items()
    }
    assert env.observation_space.contains(observation)
    assert config.features_map.keys() >= config.features.keys()
    assert env.get_wrapper_attr("_max_episode_steps") == 40
    assert env.get_wrapper_attr("task_description").endswith(".")


def test_vectors_hold_the_observations_of_the_task(envs):
    config = envs.PliantEnv(task="Wall-v0", motion="joints", soft="x z")
    options = config.gym_kwargs
    env = gymnasium.make(config.gym_id, disable_env_checker=True, **options)
    action = pliant.gym.SoftAction(soft="x z", motion="joints")
    inner = pliant.gym.TaskEnv(pliant.gym.Wall(), action=action)
    env.reset(seed=5)
    inner.reset(seed=5)
    move = np.linspace(-1.0, 1.0, 9)
    observation, reward, *_ = env.step(move)
    raw, expected, *_ = inner.step(move)
    assert reward == expected
    state = np.concatenate([raw["q"], raw["dq"], raw["tool"]])
    np.testing.assert_array_equal(observation["agent_pos"], state.astype(np.float32))
    others = np.concatenate([raw[k] for k in ("deviation", "force", "uncertainty", "caps")])
    np.testing.assert_array_equal(observation["environment_state"], others.astype(np.float32))


def test_a_vector_of_lerobots_mode_names_the_success(envs):
    """LeRobot reads `final_info` in the step in which an episode ends."""
    config = envs.PliantEnv(task="Wall-v0", seconds=0.1)

    def one():
        return gymnasium.make(config.gym_id, disable_env_checker=True, **config.gym_kwargs)

    vector = SyncVectorEnv([one, one], autoreset_mode=AutoresetMode.SAME_STEP)
    vector.reset(seed=[0, 1])
    vector.step(np.zeros(vector.action_space.shape))
    *_, truncated, infos = vector.step(np.zeros(vector.action_space.shape))
    assert truncated.all()
    assert infos["final_info"]["is_success"].tolist() == [False, False]
    vector.close()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"task": "Dor-v0"}, "task 'Dor-v0'; choose from Door-v0, "),
        ({"fps": 30}, "fps = 30 Hz does not divide 100 Hz"),
        ({"seconds": 0.0}, "seconds must be above 0 s, got 0"),
        ({"obs_type": "pixels"}, "obs_type 'pixels'; choose from state, pixels_state"),
        ({"soft": "w"}, "soft 'w' is no axis of the task"),
        ({"observation_width": 0}, "pictures of 0 x 240 pixels"),
    ],
)
def test_wrong_options_are_named(envs, options, text):
    with pytest.raises(pliant.ConfigError, match=text):
        envs.PliantEnv(**options)
