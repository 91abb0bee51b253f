"""A hand that moves an emulated arm whose torque is off."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from emulator.helpers import p1
from emulator.test_arm import ask, counts

from pliant import config
from pliant.cli import main
from pliant.cli.servos.emulate import _motion
from pliant.config.factory import make_emulator
from pliant.emulator import JointHand
from pliant.emulator.hand import MIDDLE_TIME, RANGE_TIME
from pliant.teach import Motion

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@pytest.fixture
def so101():
    arm_config = config.load("so101", backend="emulator")
    return arm_config.model_copy(
        update={"robot": arm_config.robot.model_copy(update={"table": None})}
    )


def record_motion(arm_config, motion, seconds, interval=0.1):
    """Return joint positions (N, 6) [rad], and the positions that the servos report [counts]."""
    with make_emulator(
        arm_config, clock="steps", hand=JointHand(_motion(motion, arm_config))
    ) as bus:
        joints, reported = [], []
        for _ in range(round(seconds / interval)):
            bus.world.advance(interval)
            joints.append([float(bus.plant.mj_data.joint(name).qpos[0]) for name in NAMES])
            reported.append(counts(bus))
        return np.array(joints), np.array(reported)


@pytest.mark.slow
def test_a_wave_moves_every_joint_of_a_limp_arm_and_its_servos_report_it(so101):
    joints, reported = record_motion(so101, "wave", 12.0)
    assert np.ptp(joints, axis=0).min() > 0.4
    assert np.abs(joints[40:, :5]).max() < 0.35
    ranges = np.ptp(reported, axis=0) * 2.0 * np.pi / 4096
    np.testing.assert_allclose(ranges, np.ptp(joints, axis=0), atol=0.01)


@pytest.mark.slow
def test_ranges_begin_in_the_middle_and_lead_every_joint_from_end_to_end(so101):
    joints, _ = record_motion(so101, "ranges", MIDDLE_TIME + 6 * RANGE_TIME + 1.0)
    limits = {joint.name: (joint.lower, joint.upper) for joint in so101.model().joints}
    low, high = np.array([limits[name] for name in NAMES]).T
    np.testing.assert_allclose(joints[int(MIDDLE_TIME * 10) - 5], (low + high) / 2.0, atol=0.05)
    np.testing.assert_allclose(joints.min(axis=0), low, atol=0.05)
    np.testing.assert_allclose(joints.max(axis=0), high, atol=0.05)


@pytest.mark.slow
def test_a_taught_motion_is_led_forth_and_back(so101, tmp_path):
    time = np.linspace(0.0, 4.0, 41)
    q = np.zeros((41, 5))
    q[:, 1] = 0.5 * time / 4.0
    file = tmp_path / "led.json"
    Motion(joints=NAMES[:5], time=time, q=q).save(file)
    joints, _ = record_motion(so101, str(file), 8.0)
    assert joints[39, 1] == pytest.approx(0.5, abs=0.05)
    assert joints[-1, 1] == pytest.approx(0.0, abs=0.05)


def test_a_hand_with_times_takes_hold_after_torque_and_lets_go(so101):
    hand = JointHand(_motion("wave", so101), interval=(1.0, 4.0))
    with make_emulator(so101, clock="steps", hand=hand) as bus:

        def positions(seconds):
            bus.world.advance(seconds)
            return np.array([float(bus.plant.mj_data.joint(name).qpos[0]) for name in NAMES[:5]])

        held = positions(0.1)
        np.testing.assert_array_equal(positions(5.0), held)  # the arm waits for its torque
        for servo in range(1, 7):
            ask(bus, p1(servo, 3, 40, 1))
        before = positions(0.8)
        led = positions(2.5)
        released = positions(4.0)
        assert np.abs(led - before).max() > 0.02
        np.testing.assert_allclose(positions(2.0), released, atol=2e-3)


@pytest.mark.parametrize("times", [(3.0, 3.0), (-1.0, 2.0), (np.nan, 2.0), (0.0, np.inf)])
def test_a_hand_holds_between_two_times(times):
    with pytest.raises(config.factory.ConfigError, match="from a time >= 0 s to a later one"):
        JointHand(lambda _: {}, interval=times)


def test_times_without_a_hand_are_refused(capsys):
    assert main(["servos", "emulate", "so101", "--hand-during", "1", "2"]) == 2
    assert "add --hand wave" in capsys.readouterr().err


def test_a_motion_of_another_arm_is_refused(so101, tmp_path):
    file = tmp_path / "other.json"
    Motion(joints=("a", "b"), time=np.array([0.0, 1.0]), q=np.zeros((2, 2))).save(file)
    with pytest.raises(config.factory.ConfigError, match=r"joints \(a, b\).*choose wave or ranges"):
        _motion(str(file), so101)


@pytest.mark.slow
def test_a_servo_with_torque_resists_the_hand(so101):
    with make_emulator(so101, clock="steps", hand=JointHand(_motion("wave", so101))) as bus:
        ask(bus, p1(2, 3, 40, 1))  # switch on the torque of shoulder_lift
        bus.world.advance(0.1)
        start = float(bus.plant.mj_data.joint("shoulder_lift").qpos[0])
        largest = {"shoulder_lift": 0.0, "elbow_flex": 0.0}
        for _ in range(80):
            bus.world.advance(0.1)
            for name, largest_angle in largest.items():
                angle = float(bus.plant.mj_data.joint(name).qpos[0])
                largest[name] = max(largest_angle, abs(angle - start))
    assert largest["shoulder_lift"] < 0.7 * largest["elbow_flex"]
