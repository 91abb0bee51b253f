"""LeRobot's own arms drive emulated servos before, beside and after the arms of the plugin."""

import json
import subprocess
import sys
import time

import pytest
from conftest import MOTORS, calibration, emulated
from emulated_leader import swinging
from lerobot.robots.koch_follower import KochFollower, KochFollowerConfig
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig
from lerobot.teleoperators.so_leader import SO101Leader, SO101LeaderConfig
from lerobot_robot_pliant import PliantFollower, PliantFollowerConfig

import pliant
from pliant.emulator.process import EmulatorProcess

STOCK = {
    "so101": (SO101Follower, SO101FollowerConfig),
    "koch": (KochFollower, KochFollowerConfig),
}
#: Prefixes of the names of registers that may differ afterwards: those that a servo changes by
#: itself, and the goals.
CHANGING = ("Present", "Moving", "Realtime", "Trajectory", "Goal_Position", "Status", "Goal_PWM")
HOME = {f"{motor}.pos": 0.0 for motor in MOTORS[:5]}
AWAY = {"shoulder_pan.pos": 20.0, "elbow_flex.pos": -25.0, "wrist_flex.pos": 15.0}


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Give LeRobot's drivers time for an emulator on a busy machine."""
    import dynamixel_sdk
    from lerobot.motors.feetech import feetech

    monkeypatch.setattr(dynamixel_sdk.port_handler, "LATENCY_TIMER", 500.0)
    # LeRobot sets its own timeout for Feetech servos: 50 ms.
    stock_timeout = feetech.patch_setPacketTimeout

    def set_timeout(port, length):
        stock_timeout(port, length)
        port.packet_timeout = 1000.0

    monkeypatch.setattr(feetech, "patch_setPacketTimeout", set_timeout)


def registers(robot):
    """Return the values of all servo registers in LeRobot's table, except the changing ones."""
    bus = robot.bus
    return {
        (motor, name): bus.read(name, motor, normalize=False, num_retry=5)
        for motor in bus.motors
        for name in bus.model_ctrl_table[bus.motors[motor].model]
        if not any(part in name for part in CHANGING)
    }


def course(robot):
    """Move the arm to `HOME`, then toward `AWAY`; return 30 observations of the second motion."""
    robot.send_action(HOME | {"gripper.pos": 20.0})
    time.sleep(3.0)
    robot.send_action(AWAY)
    begin, observations = time.perf_counter(), []
    for k in range(1, 31):
        time.sleep(max(begin + 0.05 * k - time.perf_counter(), 0.0))
        observations.append(robot.get_observation())
    return observations


def setup(name, port, folder, *undo):
    """Run `pliant servos setup`: LeRobot sets small Koch servos to a mode without torque limit."""
    run = subprocess.run(
        [
            *(sys.executable, "-m", "pliant.cli", "servos", "setup", name, "--yes"),
            *("--port", port, "--calibration", folder / "stock.json"),
            *(undo or ("--backup", folder / "setup.json")),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.parametrize("name", ["so101", "koch"])
def test_the_stock_arm_moves_after_ours_as_before(name, tmp_path):
    robot_class, config_class = STOCK[name]
    with emulated(name, tmp_path) as (emulator, file):
        folder = tmp_path / "calibration"
        folder.mkdir()
        (folder / "stock.json").write_text(file.read_text("utf-8"), "utf-8")
        options = {"id": "stock", "calibration_dir": folder, "use_degrees": True}

        def stock():
            return robot_class(config_class(port=emulator.port, **options))

        with stock() as robot:
            assert robot.is_calibrated
            before, first = registers(robot), course(robot)
        if name == "koch":
            setup(name, emulator.port, folder)
        ours = PliantFollower(
            PliantFollowerConfig(arm=name, port=emulator.port, id="stock", calibration_dir=folder)
        )
        with ours:
            ours.send_action(HOME | {"gripper.pos": 20.0})
            time.sleep(2.0)
            ours.send_action(AWAY)
            time.sleep(2.0)
            observation = ours.get_observation()
            for motor, value in AWAY.items():
                assert observation[motor] == pytest.approx(value, abs=4.0)
        if name == "koch":
            setup(name, emulator.port, folder, "--undo", folder / "setup.json")
        with stock() as robot:
            after, second = registers(robot), course(robot)
    assert {k: (v, after[k]) for k, v in before.items() if after[k] != v} == {}
    for motor in HOME:
        for one, other in zip(first, second, strict=True):
            assert other[motor] == pytest.approx(one[motor], abs=3.0)
        assert second[-1][motor] == pytest.approx(first[-1][motor], abs=0.5)


def test_lerobots_leader_moves_our_follower(tmp_path):
    folder = tmp_path / "calibration"
    folder.mkdir()
    (folder / "lead.json").write_text(json.dumps(calibration()), "utf-8")
    file = pliant.config.load("so101", calibration=folder / "lead.json")
    with EmulatorProcess(swinging, file) as lead, emulated("so101", tmp_path) as (arm, path):
        leader = SO101Leader(
            SO101LeaderConfig(port=lead.port, id="lead", calibration_dir=folder, use_degrees=True)
        )
        follower = PliantFollower(PliantFollowerConfig(port=arm.port, calibration=path))
        errors, positions = [], []
        with leader, follower:
            assert leader.is_calibrated
            begin = time.perf_counter()
            while time.perf_counter() < begin + 12.0:
                action, actual = leader.get_action(), follower.get_observation()
                follower.send_action(action)
                if time.perf_counter() > begin + 5.0:
                    pairs = ((action[f"{m}.pos"], actual[f"{m}.pos"]) for m in MOTORS[:5])
                    errors.append(max(abs(a - b) for a, b in pairs))
                    positions.append(action["shoulder_pan.pos"])
                time.sleep(1 / 30)
    assert max(positions) - min(positions) > 15.0
    assert sorted(errors)[len(errors) // 2] < 5.0
    assert max(errors) < 12.0
