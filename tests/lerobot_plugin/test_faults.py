"""Failures of bus, camera, program and cable, and the reaction of the plugin's arm."""

import atexit
import gc
import importlib
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from lerobot_plugin.helpers import (
    MOTORS,
    arm_of,
    plant_of,
    positions,
    powered,
    wait,
    wait_for,
)

import pliant

#: Initial joint positions near the table [rad], so that the descent is short.
LOW_POSE = [0.0, -1.2, 1.2, 0.6, 0.0]


@pytest.fixture
def make(plugin):
    """Return a function that makes robots; they are disconnected at the end of the test."""
    robots = []

    def build(**options):
        robot = plugin.PliantFollower(plugin.PliantFollowerConfig(backend="sim", **options))
        robots.append(robot)
        return robot

    yield build
    while robots:
        if robots[-1].is_connected:
            robots[-1].disconnect()
        robots.pop()


def test_a_bus_that_fails_lowers_the_arm_once_it_is_back(make, errors, monkeypatch):
    """The control loop lowers the arm without a call by the program."""
    robot = make(rest_q=LOW_POSE)
    robot.connect()
    arm = arm_of(robot)
    original_read = arm.drive.read
    is_broken = threading.Event()

    def unplugged():
        if is_broken.is_set():
            raise pliant.ServoError("unplugged")
        return original_read()

    monkeypatch.setattr(arm.drive, "read", unplugged)
    is_broken.set()
    wait(0.5)
    is_broken.clear()
    assert wait_for(lambda: not powered(arm))
    for call in (robot.get_observation, lambda: robot.send_action({})):
        with pytest.raises(errors.DeviceNotConnectedError, match="unplugged"):
            call()
    # LeRobot's programs call `disconnect` only if `is_connected` is True.
    assert robot.is_connected
    robot.disconnect()
    assert not robot.is_connected
    robot.connect()
    assert robot.get_observation()


def test_an_error_in_the_loop_lowers_the_arm_at_once(make, errors, monkeypatch):
    robot = make(rest_q=LOW_POSE)
    robot.connect()
    arm = arm_of(robot)

    def fail(*_):
        raise RuntimeError("a defect")

    monkeypatch.setattr(robot._session.behavior, "step", fail)
    assert wait_for(lambda: not powered(arm))
    with pytest.raises(errors.DeviceNotConnectedError, match="a defect"):
        robot.get_observation()


def test_an_error_in_the_loop_leaves_the_arm_held_if_wanted(make, errors, monkeypatch):
    robot = make(on_exit="leave_enabled")
    robot.connect()
    arm, start = arm_of(robot), plant_of(robot).q.copy()
    monkeypatch.setattr(robot._session.behavior, "step", lambda *_: 1 / 0)
    assert wait_for(lambda: not arm.enabled)
    wait(1.0)
    arm.drive.read()
    assert powered(arm)
    assert plant_of(robot).q == pytest.approx(start, abs=0.02)
    robot.disconnect()
    assert powered(arm)


def test_a_robot_that_is_deleted_lowers_its_arm(make, plugin):
    robot = plugin.PliantFollower(plugin.PliantFollowerConfig(backend="sim", rest_q=LOW_POSE))
    robot.connect()
    arm = arm_of(robot)
    del robot
    gc.collect()
    assert not powered(arm)


def test_a_descent_by_the_loop_is_announced_once(make, plugin, monkeypatch, caplog):
    """`disconnect` waits for it, however long it takes."""
    module = importlib.import_module(f"{plugin.__name__}._control_thread")
    monkeypatch.setattr(module, "STOP_TIMEOUT", 0.1)
    caplog.set_level("INFO")
    robot = make(rest_q=LOW_POSE)
    robot.connect()
    arm = arm_of(robot)
    monkeypatch.setattr(robot._session.behavior, "step", lambda *_: 1 / 0)
    assert wait_for(lambda: "is being lowered" in caplog.text)
    robot.disconnect()
    assert not powered(arm)
    assert caplog.text.count("is being lowered") == 1


def test_a_program_that_ends_lowers_the_arm_after_the_loop(make, monkeypatch, caplog):
    """LeRobot's programs end without `disconnect` if that of the teleoperator fails."""
    callbacks = []
    monkeypatch.setattr(atexit, "register", callbacks.append)
    robot = make(rest_q=LOW_POSE)
    robot.connect()
    arm = arm_of(robot)
    for callback in reversed(callbacks):
        callback()
    assert not powered(arm)
    assert caplog.text.count("is being lowered") == 1


@pytest.fixture
def interruptible():
    """Make Ctrl-C raise KeyboardInterrupt; a test run in the background would ignore it."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, previous)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_reaches_the_program_and_disconnect_lowers(make):
    """The exception ends the loop; then `disconnect` is called, as in LeRobot's programs."""
    robot = make(rest_q=LOW_POSE)
    robot.connect()
    arm = arm_of(robot)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert powered(arm)
    assert robot.get_observation()
    robot.disconnect()
    assert not powered(arm)


class Camera:
    """Camera with LeRobot's interface; `fails`: it cannot be connected."""

    def __init__(self, fails=False, **options):
        self.is_connected, self._fails = False, fails
        self.height, self.width = 4, 6
        vars(self).update(options)

    def connect(self):
        if self._fails:
            raise ConnectionError("no such camera")
        self.is_connected = True

    def disconnect(self):
        self.is_connected = False

    def read_latest(self):
        if self._fails:
            raise TimeoutError("too old")
        return "colour"

    def read_latest_depth(self):
        return "depth"


def test_a_camera_that_fails_to_open_keeps_torque_off(make):
    robot = make()
    first = Camera()
    robot.cameras = {"top": first, "wrist": Camera(fails=True)}
    with pytest.raises(ConnectionError, match="no such camera"):
        robot.connect()
    assert not robot.is_connected
    assert not first.is_connected


def test_a_log_that_cannot_be_written_keeps_torque_off(make, monkeypatch, tmp_path):
    pytest.importorskip("mcap_ros2", reason="logs: pip install 'pliant[log]'")
    robot = make(log=tmp_path)
    monkeypatch.setattr(pliant.Arm, "enable", lambda _: pytest.fail("torque on"))
    with pytest.raises(pliant.ConfigError, match="it is a folder; name a file"):
        robot.connect()
    assert not robot.is_connected


def test_a_camera_that_fails_later_leaves_the_arm_connected(make):
    """`is_connected` stays True; otherwise LeRobot's programs would not lower the arm."""
    robot = make(on_exit="leave_enabled")
    camera, depth = Camera(), Camera(use_depth=True)
    robot.cameras = {"top": camera, "wrist": depth}
    assert robot.observation_features["wrist"] == (4, 6, 3)
    assert robot.observation_features["wrist_depth"] == (4, 6, 1)
    robot.connect()
    observation = robot.get_observation()
    assert list(observation) == list(robot.observation_features)
    assert (observation["wrist"], observation["wrist_depth"]) == ("colour", "depth")
    camera._fails, camera.is_connected = True, False
    with pytest.raises(TimeoutError, match="too old"):
        robot.get_observation()
    assert robot.is_connected
    robot.disconnect()
    assert not depth.is_connected


@pytest.fixture
def pair(plugin):
    options = {
        side: plugin.follower.PliantFollowerOptions(backend="sim", on_exit="leave_enabled")
        for side in ("left", "right")
    }
    config = plugin.BiPliantFollowerConfig(
        id="pair", left_arm_config=options["left"], right_arm_config=options["right"]
    )
    robot = plugin.BiPliantFollower(config)
    yield robot
    if robot.is_connected:
        robot.disconnect()


def test_two_arms_move_together_or_not_at_all(pair, errors):
    pair.connect()
    assert list(pair.get_observation()) == list(pair.observation_features)
    assert {arm.id for arm in pair._arms.values()} == {"pair_left", "pair_right"}
    pair.send_action(dict.fromkeys(pair.action_features, 0.0))
    targets = [arm._session.behavior.target for arm in pair._arms.values()]
    with pytest.raises(ValueError, match="nan"):
        pair.send_action({"left_shoulder_pan.pos": 5.0, "right_shoulder_pan.pos": float("nan")})
    assert [arm._session.behavior.target for arm in pair._arms.values()] == targets
    action = pair.send_action({"left_shoulder_pan.pos": 5.0})
    assert action == {"left_shoulder_pan.pos": pytest.approx(5.0)}
    wait(1.5)
    observation = pair.get_observation()
    assert observation["left_shoulder_pan.pos"] == pytest.approx(5.0, abs=1.5)
    assert observation["right_shoulder_pan.pos"] == pytest.approx(0.0, abs=1.5)
    pair.disconnect()
    with pytest.raises(errors.DeviceNotConnectedError):
        pair.disconnect()


def test_an_arm_that_fails_to_connect_disconnects_the_other(pair):
    left, right = pair._arms.values()
    right.cameras = {"wrist": Camera(fails=True)}
    with pytest.raises(ConnectionError, match="no such camera"):
        pair.connect()
    assert not pair.is_connected
    assert not left.is_connected


def test_one_dead_arm_ends_the_other_too(pair, errors, monkeypatch):
    pair.connect()
    left, right = pair._arms.values()
    arms = [arm_of(left), arm_of(right)]
    monkeypatch.setattr(left._session.behavior, "step", lambda *_: 1 / 0)
    assert wait_for(lambda: not arms[0].enabled)
    message = "control loop of pair_left PliantFollower ended: division by zero"
    with pytest.raises(errors.DeviceNotConnectedError, match=message):
        pair.get_observation()
    assert pair.is_connected
    assert arms[1].enabled
    pair.disconnect()
    assert not arms[1].enabled


def test_motors_have_the_units_of_lerobot(make):
    robot = make(use_degrees=False, on_exit="leave_enabled")
    robot.connect()
    values = positions(robot)
    assert set(values) == {f"{motor}.pos" for motor in MOTORS}
    robot.send_action({"shoulder_pan.pos": 100.0, "gripper.pos": 100.0})
    target = robot._session.behavior.target
    assert abs(target.q[0]) == pytest.approx(abs(arm_of(robot).model.upper[0]), abs=1e-3)
    assert target.extra["gripper"] == pytest.approx(arm_of(robot).gripper.opened, abs=1e-3)


def test_a_pulled_cable_ends_with_an_error_and_disconnect_returns(plugin, errors):
    """The emulated USB adapter is unplugged, so that no command can reach the servos."""
    robot = plugin.PliantFollower(plugin.PliantFollowerConfig(backend="emulator"))
    robot.connect()
    arm = arm_of(robot)
    arm.drive.emulator.call("pull")

    def has_failed():
        try:
            robot.get_observation()
        except errors.DeviceNotConnectedError:
            return True
        return False

    assert wait_for(has_failed)
    assert robot.is_connected
    begin = time.monotonic()
    robot.disconnect()
    assert time.monotonic() < begin + 10.0
    assert not robot.is_connected
    assert not arm.enabled


@pytest.mark.parametrize("name", ["PliantFollower", "PliantLeader", "BiPliantFollower"])
def test_a_device_without_an_id_is_named_by_its_class(plugin, name):
    options = {"backend": "sim"}
    if name == "BiPliantFollower":
        module = importlib.import_module(plugin.PliantFollower.__module__)
        side = module.PliantFollowerOptions(backend="sim")
        options = {"left_arm_config": side, "right_arm_config": side}
    for id_, expected in ((None, name), ("black", f"black {name}")):
        config = getattr(plugin, f"{name}Config")(id=id_, **options)
        assert str(getattr(plugin, name)(config)) == expected


def test_motors_with_other_names_are_told_before_torque(make, monkeypatch, caplog):
    robot = make()
    follower = importlib.import_module(type(robot).__module__)
    monkeypatch.setattr(follower, "STOCK_MOTORS", frozenset({"j1"}))

    def stop(*_, **__):
        raise pliant.ServoError("no port")

    monkeypatch.setattr(pliant, "connect", stop)
    with pytest.raises(pliant.ServoError, match="no port"):
        robot.connect()
    assert "has the motors shoulder_pan, shoulder_lift" in caplog.text
    assert "must use the same names" in caplog.text


def test_without_lerobot_the_plugin_gives_the_reason():
    folder = Path(__file__).resolve().parents[2] / "integrations" / "lerobot"
    code = (
        f"import sys; sys.path.insert(0, {str(folder)!r}); sys.modules['lerobot'] = None; "
        "import lerobot_robot_pliant"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    last = done.stderr.strip().splitlines()[-1]
    remedy = "Python >= 3.12" if sys.version_info < (3, 12) else "pip install lerobot"
    assert last.startswith("ImportError: lerobot_robot_pliant is a plugin of LeRobot")
    assert remedy in last
