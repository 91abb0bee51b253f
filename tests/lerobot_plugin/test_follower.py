"""`pliant_follower` on the simulator, over one connection; the last test ends it."""

import ctypes
import math

import numpy as np
import pytest
from lerobot_plugin.helpers import MOTORS, arm_of, plant_of, positions, powered, wait

import pliant


@pytest.fixture(scope="module")
def robot(plugin):
    config = plugin.PliantFollowerConfig(
        id="shared",
        backend="sim",
        soft="x=1 y=1 z=3",
        observe=["force", "deviation"],
        soft_action=["z"],
        rest_q=[0.0, -1.2, 1.2, 0.6, 0.0],
    )
    robot = plugin.PliantFollower(config)
    features = dict(robot.observation_features), dict(robot.action_features)
    robot.connect()
    assert features == (robot.observation_features, robot.action_features)
    arm = arm_of(robot)
    yield robot
    if robot.is_connected:
        robot.disconnect()
    assert not powered(arm)


def test_features_are_the_keys_of_observation_and_action(robot):
    observation = robot.get_observation()
    assert list(observation) == list(robot.observation_features)
    assert {type(value) for value in observation.values()} == {float}
    assert list(robot.action_features) == [*(f"{m}.pos" for m in MOTORS), "cap_z.vel"]
    # LeRobot's rollout uses only these names.
    names = [*robot.observation_features, *robot.action_features]
    assert all(name.endswith((".pos", ".vel")) for name in names)
    action = dict.fromkeys(robot.action_features, 1.0)
    assert list(robot.send_action(action)) == list(action)
    assert robot.cameras == {}
    assert robot.is_calibrated


def test_a_second_connect_is_refused(robot, errors):
    with pytest.raises(errors.DeviceAlreadyConnectedError):
        robot.connect()
    assert robot.is_connected


def test_a_partial_action_leaves_the_other_targets(robot):
    robot.send_action({f"{motor}.pos": 0.0 for motor in MOTORS[:5]} | {"gripper.pos": 30.0})
    wait(2.0)
    assert robot.send_action({"shoulder_pan.pos": np.float32(10.0)}) == {
        "shoulder_pan.pos": pytest.approx(10.0)
    }
    wait(2.0)
    values = positions(robot)
    assert values["shoulder_pan.pos"] == pytest.approx(10.0, abs=1.5)
    assert values["shoulder_lift.pos"] == pytest.approx(0.0, abs=1.5)
    assert values["gripper.pos"] == pytest.approx(30.0, abs=2.0)


def test_targets_are_clipped_and_the_clipped_ones_returned(robot):
    target = robot._session.behavior.target
    action = robot.send_action({"shoulder_lift.pos": 500.0, "gripper.pos": -7.0, "cap_z.vel": -1.0})
    highest = math.degrees(arm_of(robot).model.upper[1])
    # A turn has 4096 counts, but LeRobot's unit is 360° / 4095.
    assert action["shoulder_lift.pos"] == pytest.approx(highest * 4096 / 4095)
    assert action["gripper.pos"] == pytest.approx(0.0, abs=1e-9)
    assert action["cap_z.vel"] == 0.0
    robot._session.behavior.target = target


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ({"shoulder_pan.pos": math.nan}, "shoulder_pan.pos is nan"),
        ({"shoulder_lift.pos": 1.0, "gripper.pos": math.inf}, "gripper.pos is inf"),
        ({"cap_z.vel": math.nan}, "cap_z.vel is nan"),
        (
            {"elbow.pos": 1.0, "hand.pos": 2.0},
            "no motor elbow, hand; there are shoulder_pan.*, and the action has wrist_flex, elbow, "
            r"hand. Take a leader .*--teleop.arm=so101\)",
        ),
        ({"cap_x.vel": 1.0}, "soft_action"),
    ],
)
def test_a_wrong_action_changes_nothing(robot, action, message):
    before = robot._session.behavior.target
    with pytest.raises(ValueError, match=message):
        robot.send_action({"wrist_flex.pos": 3.0} | action)
    assert robot._session.behavior.target is before


def test_observations_in_an_action_are_ignored(robot):
    assert robot.send_action({"force_x.vel": 3.0, "deviation_z.vel": 0.1, "other": 1.0}) == {}


@pytest.mark.parametrize("pause", [0.6, 3.0])
def test_a_slow_policy_is_held_and_then_approached_slowly(robot, pause):
    """The arm is held without an action; after more than 1 s it approaches slowly."""
    robot.send_action({"shoulder_pan.pos": 0.0, "cap_z.vel": 10.0})
    wait(0.5)
    robot.send_action({"shoulder_pan.pos": 0.0})
    wait(pause)
    start = positions(robot)
    wait(0.02)
    robot.send_action({"shoulder_pan.pos": 40.0})
    wait(0.5)
    change = positions(robot)["shoulder_pan.pos"] - start["shoulder_pan.pos"]
    assert abs(start["shoulder_lift.pos"]) < 2.0
    assert powered(arm_of(robot))
    limit = math.degrees(robot.config.approach_speed * 0.5)
    # Without a pause, the limit of 0.6 m/s at the tool allows about 100 °/s.
    assert (change < 1.3 * limit) == (pause > 1.0)
    robot.send_action({"shoulder_pan.pos": 0.0})
    wait(2.0)


def test_a_stall_of_the_interpreter_does_not_lower_the_arm(robot, monkeypatch):
    """The global interpreter lock is held for a while, as when a policy is loaded."""
    before = positions(robot)
    ctypes.PyDLL(None).usleep(400_000)
    behavior = robot._session.behavior
    step, stalls = behavior.step, [1.5]

    def stalled(tick, controller):
        if stalls:
            wait(stalls.pop())
        return step(tick, controller)

    monkeypatch.setattr(behavior, "step", stalled)
    wait(3.0)
    assert not stalls
    assert positions(robot) == pytest.approx(before, abs=2.0)
    assert arm_of(robot).enabled


def test_the_force_in_the_action_is_the_force_at_the_table(robot):
    """Send one target inside the table with two values of `max_force`."""
    arm, model = arm_of(robot), arm_of(robot).model
    target_q = np.array([0.0, 0.0, 0.9, 0.6, 0.0])
    assert np.asarray(model.forward_kinematics(target_q))[2, 3] < -0.02
    degrees = {
        f"{motor}.pos": robot._units[motor].value(value)
        for motor, value in zip(MOTORS, target_q, strict=False)
    }
    forces = {}
    for cap in (1.0, 8.0):
        robot.send_action({f"{m}.pos": 0.0 for m in MOTORS[:5]} | {"cap_z.vel": cap})
        wait(3.0)
        for _ in range(30):
            robot.send_action(degrees)
            wait(0.1)
        forces[cap] = plant_of(robot).fixtures[0].force
        observation = robot.get_observation()
        assert observation["deviation_z.vel"] < -0.02
    assert 0.2 < forces[1.0] < 3.0
    assert forces[8.0] > forces[1.0] + 1.0
    robot.send_action({f"{m}.pos": 0.0 for m in MOTORS[:5]})
    wait(2.0)
    assert arm.enabled


def test_disconnect_lowers_and_the_next_call_says_that_it_is_not_connected(robot, errors):
    arm = arm_of(robot)
    robot.disconnect()
    assert not powered(arm)
    assert not robot.is_connected
    for call in (robot.get_observation, lambda: robot.send_action({}), robot.disconnect):
        with pytest.raises(errors.DeviceNotConnectedError, match="not connected"):
            call()


def test_a_wrong_option_is_found_before_anything_is_opened(plugin):
    for options, message in (
        ({"soft": "w=3"}, "soft 'w=3'"),
        ({"soft": "x=2 x=3"}, "soft 'x=3'"),
        ({"soft": "x=-1"}, "one force from 0 N up"),
        ({"soft": "z=2"}, "no force for x, y"),
        ({"soft_action": ["pan"]}, "soft_action 'pan'"),
        ({"soft": "", "soft_action": ["z"]}, "soft_action needs"),
        ({"observe": ["torque"]}, "observe 'torque'"),
        ({"approach_speed": math.nan}, "approach_speed must be above 0"),
        ({"max_tool_speed": 0.0}, "max_tool_speed must be above 0"),
        ({"on_exit": "drop"}, "on_exit 'drop'"),
        ({"grip": -1.0}, "grip must be"),
    ):
        with pytest.raises(pliant.ConfigError, match=message):
            plugin.PliantFollower(plugin.PliantFollowerConfig(backend="sim", **options))
