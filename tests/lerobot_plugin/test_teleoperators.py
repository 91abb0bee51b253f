"""Teleoperators `pliant_leader` and `pliant_softness`, and calibration files of LeRobot."""

import json
import math
import shutil

import numpy as np
import pytest
from lerobot_plugin.helpers import (
    MOTORS,
    arm_of,
    calibrations,
    plant_of,
    positions,
    powered,
    wait,
    wait_for,
)

import pliant


@pytest.fixture(scope="module")
def leader(plugin):
    leader = plugin.PliantLeader(plugin.PliantLeaderConfig(backend="sim", on_exit="leave_enabled"))
    leader.connect()
    yield leader
    if leader.is_connected:
        leader.disconnect()


def largest_speed(leader, seconds):
    """Return the largest joint speed [rad/s] during `seconds` of simulated time."""
    plant, samples = plant_of(leader), []
    wait_for(lambda: samples.append((plant.time, plant.q.copy())), seconds)
    times = np.array([time for time, _ in samples])
    changes = np.abs(np.diff([q for _, q in samples], axis=0)).max(axis=1)
    intervals = np.diff(times)
    is_long = intervals > 0.005  # [s]
    return float((changes[is_long] / intervals[is_long]).max())


def test_a_leader_hands_over_and_back_without_a_jump(leader):
    """The leader is ready once connected, and approaches a far target of a policy slowly."""
    guiding = leader._session.control._loop.controller
    assert guiding.ready
    assert list(leader.get_action()) == list(leader.action_features)
    start_q = plant_of(leader).q.copy()
    wait(1.0)
    assert plant_of(leader).q == pytest.approx(start_q, abs=0.02)

    leader.send_feedback({"shoulder_pan.pos": 60.0})
    wait(0.5)
    assert plant_of(leader).q == pytest.approx(start_q, abs=0.02)

    leader.enable_torque()
    with pytest.raises(ValueError, match="nan"):
        leader.send_feedback({"shoulder_pan.pos": math.nan})
    start = leader.get_action()
    leader.send_feedback({"shoulder_pan.pos": start["shoulder_pan.pos"] + 40.0, "other.pos": 1.0})
    assert largest_speed(leader, 3.0) < 0.9
    assert leader.get_action()["shoulder_pan.pos"] == pytest.approx(
        start["shoulder_pan.pos"] + 40.0, abs=2.0
    )

    final_q = plant_of(leader).q.copy()
    leader.disable_torque()
    assert largest_speed(leader, 4.0) < 0.2
    assert guiding.ready
    assert plant_of(leader).q == pytest.approx(final_q, abs=0.03)


def test_a_gap_in_the_loop_does_not_swing_the_leader_again(leader):
    """The swing that begins hand guiding is not repeated: a hand on the arm would block it."""
    loop, start = leader._session.control._loop, plant_of(leader).q.copy()
    loop._restart(arm_of(leader).read().q, first=False)
    assert loop.controller.ready
    assert largest_speed(leader, 2.0) < 0.2
    assert plant_of(leader).q == pytest.approx(start, abs=0.03)
    assert leader.get_action()


def test_a_leader_that_fails_is_lowered(plugin, errors, monkeypatch):
    leader = plugin.PliantLeader(plugin.PliantLeaderConfig(backend="sim"))
    leader.connect()
    with pytest.raises(errors.DeviceAlreadyConnectedError):
        leader.connect()
    arm = arm_of(leader)
    monkeypatch.setattr(leader._session.behavior, "step", lambda *_: 1 / 0)
    assert wait_for(lambda: not powered(arm), 60.0)
    with pytest.raises(errors.DeviceNotConnectedError, match="division by zero"):
        leader.get_action()
    assert leader.is_connected
    leader.disconnect()
    with pytest.raises(errors.DeviceNotConnectedError, match="not connected"):
        leader.get_action()


def test_a_leader_that_cannot_swing_does_not_connect(plugin, errors, monkeypatch):
    class Stuck(pliant.HandGuiding):
        def step(self, q, *, dt=None):
            raise pliant.ServoError("a joint does not follow")

    monkeypatch.setattr(pliant, "HandGuiding", Stuck)
    leader = plugin.PliantLeader(plugin.PliantLeaderConfig(backend="sim", on_exit="leave_enabled"))
    with pytest.raises(errors.DeviceNotConnectedError, match="does not follow"):
        leader.connect()
    assert not leader.is_connected


@pytest.fixture
def softness(plugin):
    def make(**options):
        options = {"inner": {"type": "wave"}, "soft": {"z": 2.0}} | options
        return plugin.PliantSoftness(plugin.PliantSoftnessConfig(**options))

    return make


def test_softness_adds_the_force_of_each_axis(softness):
    teleoperator = softness(soft={"x": 1.0, "z": 2.0}, firm={"z": 7.0})
    teleoperator.inner.connect()
    action = teleoperator.get_action()
    assert list(action) == list(teleoperator.action_features)
    assert (action["cap_x.vel"], action["cap_z.vel"]) == (1.0, 2.0)
    teleoperator.toggle()
    action = teleoperator.get_action()
    assert (action["cap_x.vel"], action["cap_z.vel"]) == (10.0, 7.0)
    teleoperator.disconnect()
    assert not teleoperator.is_connected


def test_softness_passes_the_hand_over_on(softness):
    """`pliant_softness` forwards both methods that LeRobot needs to move a leader."""
    teleoperator = softness()
    assert not hasattr(teleoperator, "enable_torque")
    teleoperator.inner.enable_torque = teleoperator.inner.disable_torque = lambda: "done"
    assert teleoperator.enable_torque() == teleoperator.disable_torque() == "done"


def test_softness_checks_its_options(softness):
    with pytest.raises(ValueError, match="needs the teleoperator"):
        softness(inner={})
    with pytest.raises(ValueError, match="axis 'w'"):
        softness(soft={"w": 1.0})


@pytest.fixture
def write_calibration(plugin, tmp_path):
    """Write a calibration for an id into one of LeRobot's folders."""
    folders = []

    def write(folder, middle):
        folder.mkdir(parents=True, exist_ok=True)
        table = {
            motor: {
                "id": i,
                "drive_mode": 0,
                "homing_offset": 0,
                "range_min": middle - 1000,
                "range_max": middle + 1000,
            }
            for i, motor in enumerate(MOTORS, 1)
        }
        (folder / "black.json").write_text(json.dumps(table), "utf-8")
        folders.append(folder)
        return folder

    yield write
    for folder in folders:
        shutil.rmtree(folder)


@pytest.mark.parametrize("folder", ["so_follower", "so101_follower"])
def test_the_calibration_of_the_stock_follower_is_found(plugin, write_calibration, folder):
    write_calibration(calibrations() / "robots" / folder, 2000)
    config = plugin.PliantFollowerConfig(id="black", port="unused")
    assert plugin.PliantFollower(config)._units["elbow_flex"].range_min == 1000


def test_a_named_calibration_folder_comes_first(plugin, write_calibration, tmp_path):
    write_calibration(calibrations() / "robots" / "so_follower", 2000)
    folder = write_calibration(tmp_path / "mine", 2100)
    config = plugin.PliantFollowerConfig(id="black", port="unused", calibration_dir=folder)
    assert plugin.PliantFollower(config)._units["elbow_flex"].range_min == 1100


def test_the_calibration_of_a_leader_is_another(plugin, write_calibration):
    write_calibration(calibrations() / "teleoperators" / "so_leader", 2050)
    leader = plugin.PliantLeader(plugin.PliantLeaderConfig(id="black", port="unused"))
    assert leader._units["elbow_flex"].range_min == 1050
    with pytest.raises(pliant.ConfigError, match="no calibration with id 'black'"):
        plugin.PliantFollower(plugin.PliantFollowerConfig(id="black", port="unused"))


def test_without_an_id_the_error_says_how_to_give_one(plugin):
    with pytest.raises(pliant.ConfigError, match=r"--robot\.id"):
        plugin.PliantFollower(plugin.PliantFollowerConfig(port="unused"))


def test_a_leader_moves_a_follower(plugin, leader):
    """The two arms are equal, so the follower copies the leader's joints."""
    config = plugin.PliantFollowerConfig(backend="sim", on_exit="leave_enabled")
    robot = plugin.PliantFollower(config)
    robot.connect()
    leader.enable_torque()
    leader.send_feedback({"shoulder_pan.pos": 20.0, "elbow_flex.pos": 10.0})
    for _ in range(60):
        robot.send_action(leader.get_action())
        wait(1 / 15)
    leader_q, follower_q = leader.get_action(), positions(robot)
    assert leader_q["shoulder_pan.pos"] == pytest.approx(20.0, abs=2.0)
    assert follower_q == pytest.approx(leader_q, abs=3.0)
    robot.disconnect()
