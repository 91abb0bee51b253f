"""LeRobot's programs, with the plugin found by its name."""

import json
import time

import pytest
from lerobot_policy_sway import write_checkpoint

FOLLOWER = (
    "--robot.type=pliant_follower",
    "--robot.id=test",
    "--robot.rest_q=[0.0, -1.2, 1.2, 0.6, 0.0]",
)
WAVE = (
    "--teleop.type=wave",
    "--teleop.discover_packages_path=lerobot_teleoperator_wave",
)
SOFT_WAVE = (
    "--teleop.type=pliant_softness",
    "--teleop.inner={type: wave}",
    "--teleop.discover_packages_path=lerobot_teleoperator_wave",
)
FORCE = ('--robot.observe=["force"]', '--robot.soft_action=["z"]')
BACKENDS = pytest.mark.parametrize("backend", ["sim", "emulator"])


def dataset(folder):
    return (
        "--dataset.repo_id=test/soft",
        f"--dataset.root={folder / 'soft'}",
    )


def recorded(folder):
    return (
        *dataset(folder),
        "--dataset.single_task=wave",
        "--dataset.num_episodes=2",
        "--dataset.episode_time_s=2",
        "--dataset.reset_time_s=1",
        "--dataset.push_to_hub=false",
        "--play_sounds=false",
    )


@BACKENDS
def test_teleoperate(program, backend):
    robot = (*FOLLOWER, f"--robot.backend={backend}")
    run = program("teleoperate", *robot, *WAVE, "--fps=30", "--teleop_time_s=3")
    assert run.end() == 0, run.text
    assert "Teleop loop time" in run.text
    assert "torque OFF" in run.text


@BACKENDS
def test_record_with_force_and_softness_then_replay_and_roll_out(program, backend, tmp_path):
    robot = (*FOLLOWER, f"--robot.backend={backend}", *FORCE)
    run = program("record", *robot, *SOFT_WAVE, *recorded(tmp_path))
    assert run.end(180.0) == 0, run.text
    assert "torque OFF" in run.text
    # LeRobot adds the date to the folder's name.
    (folder,) = tmp_path.glob("soft*")
    info = json.loads((folder / "meta" / "info.json").read_text("utf-8"))
    states = info["features"]["observation.state"]["names"]
    actions = info["features"]["action"]["names"]
    assert states[-3:] == ["force_x.vel", "force_y.vel", "force_z.vel"]
    assert actions[-1] == "cap_z.vel"
    assert info["total_episodes"] == 2
    assert info["total_frames"] > 60

    source = ("--dataset.repo_id=test/soft", f"--dataset.root={folder}", "--dataset.episode=1")
    run = program("replay", *robot, *source, "--play_sounds=false")
    assert run.end() == 0, run.text
    assert "torque OFF" in run.text

    checkpoint = tmp_path / "checkpoint"
    write_checkpoint(checkpoint, states, actions, force=3.0)
    policy = (
        f"--policy.path={checkpoint}",
        "--robot.discover_packages_path=lerobot_policy_sway",
    )
    run = program("rollout", *robot, *policy, "--duration=4", "--device=cpu")
    assert run.end() == 0, run.text
    assert "Duration limit reached" in run.text
    assert "Could not return" not in run.text
    assert "torque OFF" in run.text


def test_two_arms(program):
    arms = [
        f"--robot.{side}_arm_config.{option}"
        for side in ("left", "right")
        for option in ("backend=sim", "rest_q=[0.0, -1.2, 1.2, 0.6, 0.0]")
    ]
    wave = (*WAVE, '--teleop.prefixes=["left_", "right_"]')
    robot = ("--robot.type=bi_pliant_follower", "--robot.id=pair", *arms)
    run = program("teleoperate", *robot, *wave, "--fps=30", "--teleop_time_s=3")
    assert run.end() == 0, run.text
    assert run.text.count("torque OFF") == 2


def test_a_weightless_leader(program):
    """The leader swings, then the follower copies it; both are lowered."""
    leader = ("--teleop.type=pliant_leader", "--teleop.id=own", "--teleop.backend=sim")
    robot = (*FOLLOWER, "--robot.backend=sim")
    run = program("teleoperate", *robot, *leader, "--fps=30", "--teleop_time_s=2")
    assert run.end() == 0, run.text
    assert "weightless" in run.text
    assert run.text.count("torque OFF") == 2


def test_calibrate_says_whose_calibration_is_used(program):
    run = program("calibrate", *FOLLOWER, "--robot.backend=sim")
    assert run.end() == 0, run.text
    assert "so101_follower" in run.text


@pytest.mark.parametrize("leaves", [False, True])
@pytest.mark.parametrize("name", ["teleoperate", "record", "rollout"])
def test_ctrl_c_lowers_and_further_ones_leave_at_once(program, tmp_path, name, leaves):
    robot = (*FOLLOWER, "--robot.backend=emulator")
    if name == "teleoperate":
        run = program(name, *robot, *WAVE, "--fps=30")
    elif name == "record":
        run = program(name, *robot, *WAVE, *recorded(tmp_path), "--dataset.num_episodes=50")
    else:
        motors = ["pan", "lift", "elbow", "flex", "roll", "gripper"]
        write_checkpoint(tmp_path / "checkpoint", motors, motors, force=0.0)
        policy = (
            f"--policy.path={tmp_path / 'checkpoint'}",
            "--robot.discover_packages_path=lerobot_policy_sway",
        )
        run = program(name, *robot, *policy, "--device=cpu")
    begun = {"teleoperate": "Teleop loop", "record": "episode 1", "rollout": "loop started"}
    run.wait_for(begun[name])
    run.interrupt()
    run.wait_for("so101 is being lowered")
    # A repetition within 0.75 s counts as a key that is held down.
    for _ in range(2 if leaves else 0):
        time.sleep(1.0)
        if run.ended:
            break
        run.interrupt()
    run.end(8.0 if leaves else 60.0)
    assert ("was lowered: torque OFF" in run.text) != leaves
    assert ("torque ON: " in run.text) == leaves
