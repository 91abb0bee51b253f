"""LeRobot's stock follower and pliant's: the same actions on the same emulated SO-101.

    python integrations/lerobot/compare.py            # all, about five minutes
    python integrations/lerobot/compare.py press      # or wall, gripper, lag

Every run has its own emulated arm, to which the follower connects over a serial port. Forces are
those of the simulation, not estimates.

Loop and emulator run in real time: start the program on an idle machine, or with `nice -n -10`,
because each wait for a processor adds to the lag.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import pliant
from pliant.config import Config, motor_units
from pliant.config.factory import make_emulator
from pliant.emulator.process import EmulatorProcess
from pliant.sim import Wall

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
START = np.array([0.0, -0.3, 0.3, 0.9, 0.0])
FPS = 30.0
#: Depth of the target in the table; distances of table and wall from the tool at the start [m].
DEPTH, CLEARANCE, WALL = 0.05, 0.03, 0.03
#: Stiffness of table and wall [N/m], and their damping [N·s/m].
STIFFNESS, DAMPING = 5000.0, 20.0
#: Wrong target of the pan, behind the wall [rad].
WRONG_PAN = math.radians(40.0)
#: Angle of the open jaw, and angle at which a hard object stops the closing jaw [rad].
OPEN, OBJECT = 1.2, 0.6
#: Calibrated range of the jaw [counts].
JAW_RANGE = {"range_min": 1024, "range_max": 3071}
#: Amplitude of the sines [rad] and their frequency [Hz].
SINE, FREQUENCY = math.radians(15.0), 0.5

Robot = Callable[[str, Path], Any]


def emulator(file: Config, wall: Wall | None, jaw_stop: float | None) -> Any:
    """Return an emulated arm with a wall, or with an object in its gripper.

    The emulator calls this function in its own process.
    """
    arm = make_emulator(file, q=START, plant={"scene": [] if wall is None else [wall]})
    plant, model = arm.plant, arm.plant.mj_model
    arm.force = lambda: float(np.linalg.norm(plant.hands[0].force))
    arm.peak_force = lambda: plant.hands[0].peak_force
    arm.jaw_torque = lambda: float(plant.mj_data.actuator("gripper").force[0])
    arm.joint_position = lambda joint: float(plant.q[joint])
    if jaw_stop is not None:
        jaw = model.joint("gripper")
        model.jnt_limited[jaw.id], model.jnt_range[jaw.id, 0] = True, jaw_stop
        plant.mj_data.joint("gripper").qpos[0] = OPEN
    return arm


def stock(gain: int) -> Robot:
    """Return a function that makes LeRobot's follower with a P gain."""
    from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig

    def make(port: str, folder: Path) -> Any:
        return SO101Follower(
            SO101FollowerConfig(
                port=port, id="arm", calibration_dir=folder, position_p_coefficient=gain
            )
        )

    return make


def soft(**options: Any) -> Robot:
    """Return a function that makes pliant's follower."""
    from lerobot_robot_pliant import PliantFollower, PliantFollowerConfig

    def make(port: str, folder: Path) -> Any:
        return PliantFollower(
            PliantFollowerConfig(
                port=port, id="arm", calibration_dir=folder, on_exit="leave_enabled", **options
            )
        )

    return make


class Bench:
    """A robot and its emulated arm, at `START`.

    Args:
        make: Function that makes the robot.
        wall: Obstacle; None: no obstacle.
        jaw_stop: Angle at which an object stops the gripper [rad]; None: no object.
    """

    def __init__(
        self, make: Robot, *, wall: Wall | None = None, jaw_stop: float | None = None
    ) -> None:
        """Start the emulator and connect the robot."""
        self._folder = tempfile.TemporaryDirectory()
        folder = Path(self._folder.name)
        table = {
            name: {"id": i, "drive_mode": 0, "homing_offset": 0}
            # The joints need a wide range, because the arm falls when the supply is switched off.
            | ({"range_min": 347, "range_max": 3748} if name in JOINTS else JAW_RANGE)
            for i, name in enumerate((*JOINTS, "gripper"), 1)
        }
        (folder / "arm.json").write_text(json.dumps(table), "utf-8")
        file = pliant.config.load("so101", calibration=folder / "arm.json")
        robot = file.robot.model_copy(update={"table": None})
        file = file.model_copy(update={"robot": robot})
        self.units = motor_units(file, file.model())
        self.emulator = EmulatorProcess(emulator, file, wall, jaw_stop)
        self.robot = make(self.emulator.port, folder)

    def power_cycle(self) -> None:
        """Connect once and switch the supply off and on.

        LeRobot writes the gripper's largest torque to EEPROM, which servos read when they start.
        """
        self.robot.connect()
        self.robot.disconnect()
        self.emulator.call("brown_out")
        time.sleep(0.5)

    def __enter__(self) -> Bench:
        """Connect, and wait at the start."""
        self.robot.connect()
        self.run(lambda _: START, 2.5)
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect and end the emulator."""
        self.robot.disconnect()
        self.emulator.stop()
        self._folder.cleanup()

    def run(
        self,
        target: Callable[[float], np.ndarray],
        seconds: float,
        *,
        gripper: Callable[[float], float] | None = None,
        measure: Callable[[], Any] | None = None,
    ) -> list[tuple[float, Any]]:
        """Send joint targets [rad] as a policy does; return time [s] and measured values."""
        begin, out = time.perf_counter(), []
        for k in range(round(seconds * FPS)):
            time.sleep(max(begin + k / FPS - time.perf_counter(), 0.0))
            now = time.perf_counter() - begin
            positions = dict(zip(JOINTS, target(now).tolist(), strict=True))
            positions["gripper"] = OPEN if gripper is None else gripper(now)
            self.robot.send_action(self._action(positions))
            if measure is not None:
                out.append((time.perf_counter() - begin, measure()))
        return out

    def _action(self, positions: Mapping[str, float]) -> dict[str, float]:
        return {f"{name}.pos": self.units[name].value(q) for name, q in positions.items()}


def contact(make: Robot, wall: Wall, goal: np.ndarray, ramp: float) -> tuple[str, ...]:
    """Move to a goal behind a wall within `ramp` [s]; return peak and final force [N]."""
    with Bench(make, wall=wall) as bench:
        forces = bench.run(
            lambda t: START + (goal - START) * min(t / ramp, 1.0),
            6.0,
            measure=lambda: bench.emulator.call("force"),
        )
        peak, final = bench.emulator.call("peak_force"), np.median([f for _, f in forces[-60:]])
        return f"{peak:.1f}", f"{final:.1f}"


def press(make: Robot) -> tuple[str, ...]:
    """Press the tool onto a table, with a target below its surface; return lines of results."""
    model, goal = pliant.config.load("so101").model(), START.copy()
    height = np.asarray(model.forward_kinematics(START))[2, 3] - CLEARANCE - DEPTH
    for _ in range(400):
        position = np.asarray(model.forward_kinematics(goal))[:3, 3]
        rows = np.asarray(model.jacobian(goal))[:3]
        error = np.array([0.0, 0.0, height - position[2]])
        goal += 0.2 * rows.T @ np.linalg.solve(rows @ rows.T + 1e-4 * np.eye(3), error)
    table = Wall(into=(0.0, 0.0, -1.0), distance=CLEARANCE, stiffness=STIFFNESS, damping=DAMPING)
    return contact(make, table, goal, ramp=1.5)


def wall(make: Robot) -> tuple[str, ...]:
    """Turn the pan to a target behind a wall, to which the target moves within 0.1 s."""
    obstacle = Wall(into=(0.0, 1.0, 0.0), distance=WALL, stiffness=STIFFNESS, damping=DAMPING)
    model, goal = pliant.config.load("so101").model(), START.copy()
    goal[0] = WRONG_PAN * np.sign(np.asarray(model.jacobian(START))[1, 0])
    return contact(make, obstacle, goal, ramp=0.1)


def gripper(make: Robot) -> tuple[str, ...]:
    """Close the gripper on a hard object; return the jaw torque [N·m] after 1.5, 3 and 10 s."""
    bench = Bench(make, jaw_stop=OBJECT)
    bench.power_cycle()
    with bench:
        torques = bench.run(
            lambda _: START,
            11.0,
            gripper=lambda t: max(OPEN * (1.0 - t), 0.0),
            measure=lambda: abs(bench.emulator.call("jaw_torque")),
        )
    times = (1.5, 3.0, 10.0)
    return tuple(f"{min(torques, key=lambda row: abs(row[0] - t))[1]:.2f}" for t in times)


def lag(make: Robot) -> tuple[str, ...]:
    """Follow sines, joint by joint; return the ranges of lag [ms] and gain [1]."""
    lags, gains = [], []
    omega = 2.0 * math.pi * FREQUENCY
    with Bench(make) as bench:
        for joint in range(len(JOINTS)):
            unit = np.eye(len(JOINTS))[joint]
            samples = bench.run(
                lambda t, unit=unit: START + unit * SINE * math.sin(omega * t),
                6.0,
                measure=lambda joint=joint: bench.emulator.call("joint_position", joint),
            )
            t, q = np.array([sample for sample in samples if sample[0] > 2.0]).T
            waves = np.stack([np.sin(omega * t), np.cos(omega * t), np.ones(t.size)], axis=1)
            (sine, cosine, _), *_ = np.linalg.lstsq(waves, q, rcond=None)
            lags.append(-math.atan2(cosine, sine) / omega)
            gains.append(math.hypot(sine, cosine) / SINE)
    return (
        f"{1e3 * min(lags):.0f} to {1e3 * max(lags):.0f}",
        f"{min(gains):.2f} to {max(gains):.2f}",
    )


TESTS: dict[str, tuple[Callable[[Robot], tuple[str, ...]], str]] = {
    "press": (press, "5 cm into the table: peak, held [N]"),
    "wall": (wall, "wrong target behind a wall: peak, held [N]"),
    "gripper": (gripper, "jaw on a hard object: torque after 1.5, 3, 10 s [N·m]"),
    "lag": (lag, "0.5 Hz sines: lag [ms], gain"),
}


def main(names: list[str]) -> None:
    """Print one row per test."""
    from lerobot.motors.feetech import feetech

    # LeRobot waits 50 ms for a Feetech servo; an emulator on a busy machine may need more.
    stock_timeout = feetech.patch_setPacketTimeout

    def set_timeout(port: Any, length: int) -> None:
        stock_timeout(port, length)
        port.packet_timeout = 1000.0

    feetech.patch_setPacketTimeout = set_timeout
    robots = {
        "LeRobot, P 16": stock(16),
        "LeRobot, P 32": stock(32),
        "pliant, 4 N": soft(),
        "pliant, 2 N": soft(soft="x=2 y=2 z=2", grip=3.0),
    }
    print("| | " + " | ".join(robots) + " |")
    print("|---" * (len(robots) + 1) + "|")
    for name in names or TESTS:
        test, title = TESTS[name]
        cells = [", ".join(test(make)) for make in robots.values()]
        print(f"| {title} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
