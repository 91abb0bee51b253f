"""LeRobot's environment factory, its rollout and `lerobot-eval` on the tasks."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("lerobot", reason="needs LeRobot: make test-lerobot")

import torch
from lerobot.envs.factory import make_env, make_env_config
from lerobot.scripts.lerobot_eval import rollout
from lerobot.utils.import_utils import register_third_party_plugins


@pytest.fixture(scope="module", autouse=True)
def plugins():
    register_third_party_plugins()


class Constant(torch.nn.Module):
    """A policy that repeats one action, and stores its observations."""

    def __init__(self, action):
        super().__init__()
        self.action, self.batches = torch.tensor(action), []

    def reset(self):
        pass

    def select_action(self, batch):
        self.batches.append(batch)
        return self.action.repeat(len(batch["task"]), 1)


def same(value):
    """Return the value unchanged, in place of a processor."""
    return value


def rolled_out(config, policy, envs=2):
    (vector,) = make_env(config, n_envs=envs)["pliant"].values()
    before, after = config.get_env_processors()
    try:
        return rollout(vector, policy, before, after, same, same, seeds=[*range(envs)])
    finally:
        vector.close()


def test_lerobots_rollout_opens_doors_softly():
    config = make_env_config("pliant", task="Door-v0")
    policy = Constant([-0.5, 0.1, 0.0, 0.0, 0.0, -0.3, -0.5, -0.5])
    result = rolled_out(config, policy)
    assert result["success"].any(dim=1).all()
    assert result["reward"].sum(dim=1).min() > 1.0
    batch = policy.batches[0]
    assert batch["task"] == ["Open the door."] * 2
    assert batch["observation.state"].shape == (2, *config.features["agent_pos"].shape)
    assert batch["observation.environment_state"].dtype == torch.float32


def evaluate(folder, *options):
    words = (
        *("--policy.type=act", "--policy.device=cpu", "--policy.push_to_hub=false"),
        *("--policy.chunk_size=10", "--policy.n_action_steps=10", "--policy.dim_model=64"),
        *("--env.type=pliant", "--env.seconds=1", "--eval.n_episodes=2", "--eval.batch_size=2"),
        *(f"--output_dir={folder}", *options),
    )
    run = subprocess.run(
        [Path(sys.executable).with_name("lerobot-eval"), *words],
        env={**os.environ, "HF_HUB_OFFLINE": "1", "MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")},
        capture_output=True,
        text=True,
        timeout=600.0,
        check=False,
    )
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-3000:]
    return json.loads((folder / "eval_info.json").read_text("utf-8"))


def test_lerobot_eval_runs_a_new_policy_in_processes_and_draws_videos(tmp_path):
    """LeRobot takes the sizes of a new policy from the environment; any action is accepted."""
    out = evaluate(tmp_path / "out", "--env.task=Wall-v0", "--eval.use_async_envs=true")
    assert out["overall"]["n_episodes"] == 2
    videos = sorted((tmp_path / "out" / "videos").rglob("*.mp4"))
    assert len(videos) == 2
    assert all(video.stat().st_size > 1000 for video in videos)


def test_lerobot_eval_records_a_dataset_with_pictures(tmp_path):
    options = ("--env.obs_type=pixels_state", "--policy.pretrained_backbone_weights=null")
    record = ("--eval.recording=true", "--eval.use_async_envs=false")
    evaluate(tmp_path / "out", "--env.task=Drawer-v0", *options, *record)
    infos = sorted((tmp_path / "out" / "recordings").rglob("info.json"))
    assert len(infos) == 2
    info = json.loads(infos[0].read_text("utf-8"))
    assert info["total_frames"] == 20
    assert info["fps"] == 20
    assert info["features"]["pixels"]["shape"] == [240, 320, 3]
    assert info["features"]["agent_pos"]["shape"] == [23]
