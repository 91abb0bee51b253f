"""Environments of `pliant.gym`: Gymnasium interface, determinism, actions, effect of softness."""

import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium")

import gymnasium
from gymnasium.utils.env_checker import check_env

import pliant
import pliant.gym
from pliant.gym import Door, SoftAction, TaskEnv, Wall

TASKS = ("Door", "Drawer", "Plug", "Wall", "Wipe")


def run(env, motion, softness, steps, seed=0):
    """Repeat one action; return rewards, the largest true force [N] and the last info."""
    env.reset(seed=seed)
    size = env.action_space.shape[0] - len(motion)
    action = np.concatenate([motion, np.full(size, softness)]).astype(np.float32)
    rewards, largest, info = [], 0.0, {}
    for _ in range(steps):
        _, reward, terminated, _, info = env.step(action)
        rewards.append(reward)
        largest = max(largest, info["force"])
        if terminated:
            break
    return rewards, largest, info


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_gymnasiums_own_checks_pass(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # positions and forces have no bounds
        check_env(gymnasium.make(f"pliant/{name}-v0").unwrapped)


@pytest.mark.slow
def test_the_checks_of_stable_baselines_pass():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    for name in TASKS:
        checker.check_env(gymnasium.make(f"pliant/{name}-v0").unwrapped)


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["twist", "pose", "joints"])
def test_a_seed_repeats_an_episode_bit_for_bit(motion):
    env = TaskEnv(Door(), action=SoftAction(motion=motion))
    actions = np.random.default_rng(1).uniform(-0.3, 0.3, (10, env.action_space.shape[0]))
    runs = []
    for _ in range(2):
        first, _ = env.reset(seed=3)
        steps = [env.step(action) for action in actions]
        runs.append([first, *(step[0] for step in steps)])
        forces = [step[4]["force"] for step in steps]
    for one, other in zip(*runs, strict=True):
        for key, value in one.items():
            np.testing.assert_array_equal(value, other[key])
    assert max(forces) > 0.0
    env.reset(seed=4)
    assert not np.array_equal(env.step(actions[0])[0]["force"], runs[0][1]["force"])


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["twist", "pose", "joints"])
def test_the_first_entries_move_the_target(motion):
    env = TaskEnv(Wall(distance=(0.5, 0.5)), action=SoftAction(soft="", motion=motion))
    size = env.action_space.shape[0]
    first, _ = env.reset(seed=0)
    action = np.zeros(size)
    action[0] = 1.0
    for _ in range(10):
        last, *_ = env.step(action)
    moved = last["tool"][:3] - first["tool"][:3]
    if motion == "joints":
        assert last["q"][0] - first["q"][0] > 0.1
    else:
        assert moved[0] > 0.015
        assert np.abs(moved[1:]).max() < 0.01


def test_softness_sets_cap_and_adaptation_together():
    action = SoftAction(soft="y")
    settings, hold = pliant.Settings(), {"y": 40.0}
    soft, middle, firm = (
        action.softened(settings, hold, np.array([s])).axes["y"] for s in (-1.0, 0.0, 1.0)
    )
    assert (soft.adaptation, middle.adaptation, firm.adaptation) == (0.9, 0.45, 0.0)
    assert soft.soft == pytest.approx((0.8, 0.8))
    assert middle.soft[0] == pytest.approx(40.0 * 0.02**0.5)
    assert firm.soft == pytest.approx((40.0, 40.0))


@pytest.mark.slow
def test_a_soft_policy_opens_the_door_with_less_force_than_a_firm_one():
    env = TaskEnv(Door(radius=(0.3, 0.3), friction=(0.5, 0.5)))
    pull = [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    _, soft_force, soft_info = run(env, pull, -0.5, 100)
    _, firm_force, _ = run(env, pull, 1.0, 100)
    assert soft_info["progress"] > 0.5
    assert soft_force < 0.5 * firm_force


@pytest.mark.slow
def test_too_much_force_ends_the_episode_and_costs():
    env = TaskEnv(Wall(distance=(0.03, 0.03), stiffness=(3e4, 3e4), max_force=20.0))
    rewards, force, info = run(env, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, 100)
    assert force > 20.0
    assert len(rewards) < 100
    assert rewards[-1] < -0.9
    assert not info["is_success"]


@pytest.mark.slow
def test_a_light_touch_succeeds():
    env = TaskEnv(Wall(distance=(0.03, 0.03), stiffness=(1e4, 1e4)))
    rewards, _, info = run(env, [0.4, 0.0, 0.0, 0.0, 0.0, 0.0], 0.0, 160)
    assert info["is_success"]
    assert sum(rewards) > 1.5


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"soft": "q"}, "'q' is no axis of the task, which has x, y"),
        ({"motion": "force"}, "choose from twist, pose, joints"),
        ({"max_speed": (0.0, 1.0)}, "max_speed must be above 0"),
    ],
)
def test_wrong_actions_are_refused(options, said):
    with pytest.raises(pliant.ConfigError, match=said):
        TaskEnv(Wall(), action=SoftAction(**options))


@pytest.mark.slow
def test_pictures_follow_the_arm_and_end_with_the_scene():
    env = gymnasium.make("pliant/Drawer-v0", render_mode="rgb_array", width=160, height=120)
    env.reset(seed=0)
    first = env.render()
    assert (first.shape, first.dtype) == ((120, 160, 3), np.uint8)
    assert first.std() > 5.0, "an empty picture"
    np.testing.assert_array_equal(env.render(), first)
    for _ in range(20):
        env.step(np.array([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.5, -0.5], dtype=np.float32))
    moved = np.abs(env.render().astype(int) - first).max(axis=2) > 10
    assert moved.mean() > 0.005
    # A new episode has a new scene, with another drawer.
    env.reset(seed=1)
    assert (np.abs(env.render().astype(int) - first).max(axis=2) > 10).any()
    env.close()


def in_new_process(code, **environment):
    """Run Python code with some environment variables changed, empty ones removed."""
    changed = {**os.environ, **environment}
    return subprocess.run(
        [sys.executable, "-c", code],
        env={name: value for name, value in changed.items() if value},
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems draw without a display")
def test_a_picture_without_a_display_is_an_error_with_a_remedy():
    """After MuJoCo's own error, a second attempt to draw a picture would abort the process."""
    code = (
        "import pliant.gym as gym\n"
        "for _ in range(2):\n"
        "    env = gym.TaskEnv(gym.Wall(), render_mode='rgb_array')\n"
        "    env.reset(seed=0)\n"
        "    try: env.render()\n"
        "    except ValueError as error: print(type(error).__name__, error)\n"
    )
    out = in_new_process(code, DISPLAY="", WAYLAND_DISPLAY="", MUJOCO_GL="")
    assert out.returncode == 0, out.stderr
    message = (
        "ConfigError no display to draw on: set MUJOCO_GL=egl (or osmesa) before Python starts"
    )
    assert out.stdout.splitlines() == [message] * 2


@pytest.mark.slow
def test_an_id_with_the_module_needs_no_import():
    code = "import gymnasium; print(gymnasium.make('pliant.gym:pliant/Wall-v0').unwrapped.task)"
    out = in_new_process(code)
    assert out.stdout.startswith("Wall("), out.stderr


def test_without_a_render_mode_there_is_no_picture():
    env = TaskEnv(Wall())
    assert env.render() is None
    with pytest.raises(pliant.ConfigError, match="render_mode 'human'; choose \"rgb_array\""):
        TaskEnv(Wall(), render_mode="human")


@pytest.mark.slow
def test_pictures_may_be_larger_than_mujocos_buffer_but_not_empty():
    env = TaskEnv(Wall(), render_mode="rgb_array", width=1280, height=720)
    env.reset(seed=0)
    assert env.render().shape == (720, 1280, 3)
    env.close()
    with pytest.raises(pliant.ConfigError, match="pictures of 0 x 240 pixels"):
        TaskEnv(Wall(), width=0)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_an_action_that_is_not_finite_is_refused_and_changes_nothing(wrong):
    env = TaskEnv(Wall())
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape)
    for entry in range(action.size):
        broken = action.copy()
        broken[entry] = wrong
        with pytest.raises(pliant.ShapeError, match=r"^action must be 7 finite numbers"):
            env.step(broken)
    with pytest.raises(pliant.ShapeError, match=r"^action must be 7 finite numbers"):
        env.step(np.zeros(3))
    observation, *_ = env.step(action)
    assert all(np.isfinite(values).all() for values in observation.values())
