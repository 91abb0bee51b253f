"""Emulated servos that drive the joints of a simulated arm."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arm needs the extra sim")

from emulator.helpers import BAUD, le16, le32, p1

import pliant.robots
from pliant import ConfigError
from pliant.emulator import Mount, emulate
from pliant.emulator.packets import packet_2

POSE = np.array([0.2, 0.3, 0.4, 0.1, 0.0])
NAMES = list(pliant.robots.so101().joint_names)


def mounts(**changes):
    """Return STS3215 on every joint of the SO-101, and on its gripper; `changes` by joint."""
    result = [Mount(joint=name, model="STS3215", id=k + 1) for k, name in enumerate(NAMES)]
    result.append(Mount(joint="gripper", model="STS3215", id=6))
    return [changes.get(mount.joint, mount) for mount in result]


def so101(mounted=None, q=POSE, **options):
    mounted = mounts() if mounted is None else mounted
    return emulate(pliant.robots.so101(), mounted, q, clock="steps", **options)


def ask(emulator, request):
    answers = emulator.lines["main"].feed(request, BAUD, emulator.time)
    return b"".join(delivery.data for delivery in answers)


def counts(emulator, count=6):
    answer = ask(emulator, p1(0xFE, 0x82, 56, 2, *range(1, count + 1)))
    return np.array(
        [int.from_bytes(answer[k + 5 : k + 7], "little") for k in range(0, 8 * count, 8)]
    )


def hold(emulator, share, goals=None):
    goals = counts(emulator) if goals is None else goals
    blocks = [
        byte
        for id, goal in enumerate(goals, 1)
        for byte in (id, *le16(int(goal)), 0, 0, 0, 0, *le16(share))
    ]
    ask(emulator, p1(0xFE, 0x83, 42, 8, *blocks))


def test_positions_come_from_the_plant():
    emulator = so101()
    expected = 2048 + np.append(POSE, 0.0) / (2 * np.pi) * 4096
    assert np.abs(counts(emulator) - expected).max() <= 0.5


def test_sign_zero_and_gear_turn_the_counts():
    options_by_joint = {
        NAMES[0]: Mount(joint=NAMES[0], model="STS3215", id=1, sign=-1),
        NAMES[1]: Mount(joint=NAMES[1], model="STS3215", id=2, zero=1000),
        NAMES[2]: Mount(joint=NAMES[2], model="STS3215", id=3, gear_ratio=2.0),
        NAMES[3]: Mount(
            joint=NAMES[3], model="STS3215", id=4, registers={"homing_offset": 300}, zero=1500
        ),
    }
    per_rad = 4096 / (2 * np.pi)
    result = counts(so101(mounts(**options_by_joint)))[:4]
    expected = [
        2048 - 0.2 * per_rad,
        1000 + 0.3 * per_rad,
        2048 + 0.8 * per_rad,
        1500 + 0.1 * per_rad,
    ]
    assert np.abs(result - expected).max() <= 0.5


def test_without_torque_the_arm_falls_and_with_it_stays():
    emulator = so101()
    plant = emulator.plant
    hold(emulator, 1000)
    emulator.world.advance(1.0)
    assert np.abs(plant.q - POSE).max() < 0.06, "the error that carries gravity"
    ask(emulator, p1(0xFE, 3, 40, 0))
    emulator.world.advance(0.5)
    assert np.abs(plant.q - POSE).max() > 0.3


def test_a_held_arm_is_let_go_when_all_its_joints_have_torque():
    emulator = so101(held=True)
    ids = range(1, 6)
    for id in ids:
        emulator.world.advance(0.2)
        assert np.array_equal(emulator.plant.q, POSE)
        ask(emulator, p1(id, 3, 40, 1))
    emulator.world.advance(0.5)
    assert 0.0 < np.abs(emulator.plant.q - POSE).max() < 0.06
    ask(emulator, p1(0xFE, 3, 40, 0))
    emulator.world.advance(0.5)
    assert np.abs(emulator.plant.q - POSE).max() > 0.3, "nobody catches it a second time"


def test_the_limit_in_the_register_is_the_limit_in_the_plant():
    emulator = so101()
    stall = emulator.servo(1).stall
    goal = counts(emulator) + 500
    hold(emulator, 200, goal)
    largest = np.zeros(5)
    for _ in range(50):
        emulator.world.advance(0.01)
        largest = np.maximum(largest, np.abs(emulator.plant.torque))
    assert largest.max() <= 0.2 * stall + 1e-9
    assert largest.max() == pytest.approx(0.2 * stall), "a far goal uses all of it"


def test_load_and_current_come_from_the_plant():
    emulator = so101()
    hold(emulator, 1000)
    emulator.world.advance(1.0)
    shoulder = emulator.servo(2)
    shoulder.refresh()
    expected = emulator.plant.torque[1] / shoulder.stall * 1000.0
    assert shoulder.get("present_load") == pytest.approx(expected, abs=2)
    assert np.sign(shoulder.get("present_current")) == np.sign(expected)


def test_gripper_off_the_chain_moves():
    emulator = so101()
    goals = counts(emulator)
    goals[5] += 200
    hold(emulator, 800, goals)
    emulator.world.advance(1.0)
    assert counts(emulator)[5] == pytest.approx(goals[5], abs=15)
    assert emulator.plant.read().extra["gripper"] > 0.2


def test_two_servos_share_a_joint_and_its_torque():
    pair = Mount(joint=NAMES[1], model="STS3215", id=2, secondary=(7, -1))
    emulator = so101(mounts(**{NAMES[1]: pair}))
    first, second = emulator.servo(2), emulator.servo(7)
    assert first.position - 2048 == 2048 - second.position
    for servo in (first, second):
        servo.put("torque_enable", 1)
    emulator.world.advance(0.5)
    assert emulator.plant.q[1] == pytest.approx(POSE[1], abs=0.06)
    assert first.shaft.torque == pytest.approx(-second.shaft.torque)
    limit = emulator.plant.mj_model.actuator(NAMES[1]).forcerange[1]
    assert limit == pytest.approx(2 * 0.97 * first.stall)
    second.power_up()
    emulator.world.advance(0.05)
    limit = emulator.plant.mj_model.actuator(NAMES[1]).forcerange[1]
    assert limit == pytest.approx(0.97 * first.stall)


def test_an_arm_of_current_limited_servos_holds_and_its_watchdog_stops_it():
    arm = pliant.robots.arm7()
    mounted = [
        Mount(
            joint=name,
            model="XM540-W270" if k < 4 else "XM430-W350",
            id=k + 1,
            registers={"operating_mode": 5},
        )
        for k, name in enumerate(arm.joint_names)
    ]
    pose = np.array([-0.13, -0.6, 0.72, -1.74, 0.93, 0.68, -0.17])
    emulator = emulate(arm, mounted, pose, clock="steps")
    ids = range(1, 8)
    assert ask(emulator, packet_2(0xFE, 3, bytes([*le16(64), 1]))) == b""
    emulator.world.advance(1.0)
    assert np.abs(emulator.plant.q - pose).max() < 0.25
    assert np.abs(emulator.plant.dq).max() < 0.02
    ask(emulator, packet_2(0xFE, 3, bytes([*le16(98), 5])))
    block = b"".join(bytes([id, *le32(emulator.servo(id).position + 600)]) for id in ids)
    ask(emulator, packet_2(0xFE, 0x83, bytes([*le16(116), *le16(4)]) + block))
    emulator.world.advance(0.12)
    assert {emulator.servo(id).get("bus_watchdog") for id in ids} == {-1}
    final_q = emulator.plant.q
    emulator.world.advance(2.0)
    assert np.abs(emulator.plant.q - final_q).max() < 0.3, "it stays about where it was"
    assert np.abs(emulator.plant.dq).max() < 0.02


def test_a_run_repeats_bit_for_bit():
    def run():
        emulator = so101(q=POSE)
        hold(emulator, 500)
        for _ in range(20):
            emulator.world.advance(0.01)
        return emulator.plant.q

    assert np.array_equal(run(), run())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: so101(mounts()[1:]), "no servo is mounted on shoulder_pan"),
        (lambda: so101([*mounts(), Mount(joint="nose", model="MX-28", id=9)]), "no such joint"),
        (lambda: so101([*mounts(), Mount(joint=NAMES[0], model="MX-28", id=9)]), "twice"),
        (lambda: so101(plant={"delay": (1, 1)}), "'delay'"),
        (lambda: so101(plant={"encoder_step": 0.1}), "'encoder_step'"),
        (lambda: so101(plant={"noise": 0.1}), "'noise'"),
        (lambda: so101(plant={"bus_outage": (0.0, 1.0)}), "'bus_outage'"),
        (lambda: Mount(joint="x", model="MX-28", id=1, sign=0), "sign"),
        (lambda: Mount(joint="x", model="MX-28", id=1, gear_ratio=0.0), "gear_ratio"),
    ],
)
def test_errors(make, message):
    with pytest.raises(ConfigError, match=message):
        make()
