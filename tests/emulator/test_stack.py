"""Controller, driver, serial bytes, emulated servos and simulated arm together."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arm needs the extra sim")
pytest.importorskip("rustypot", reason="the bus needs the extra servo")

import pliant
from pliant.emulator import Faults, ManualClock, Mount, emulate
from pliant.servo import ServoBus, ServoSpec

TICK = 0.01


def so101():
    """Return the setup of an SO-101: model, duty-limited servos, registers, pose, settings."""
    axes = {"y": pliant.Axis(soft=1.0, firm=3.0, soft_until=0.01, firm_from=0.1, adaptation=0.9)}
    return (
        pliant.robots.so101(),
        ["STS3215-7.4V"] * 5,
        {"p_coefficient": 16},
        np.array([0.1, 0.2, 0.4, 0.3, 0.1]),
        pliant.Settings(task=pliant.Task(axes="xyz"), axes=axes),
    )


def arm7():
    """Return the setup of an arm with seven current-limited servos and six axes."""
    axes = {"y": pliant.Axis(soft=4.0, firm=15.0, soft_until=0.01, firm_from=0.1, adaptation=0.9)}
    return (
        pliant.robots.arm7(),
        ["XM540-W270"] * 4 + ["XM430-W350"] * 3,
        {"operating_mode": 5, "return_delay_time": 0, "shutdown": 20},
        np.array([-0.13, -0.6, 0.72, -1.74, 0.93, 0.68, -0.17]),
        pliant.Settings(axes=axes),
    )


@pytest.mark.parametrize("build", [so101, arm7])
@pytest.mark.parametrize("share", [0.0, 0.01])
def test_limits_reach_the_motors_and_the_arm_stays(build, share):
    model, types, registers, pose, settings = build()
    names = list(model.joint_names)
    mounts = [
        Mount(joint=name, model=kind, id=id, registers=registers)
        for id, (name, kind) in enumerate(zip(names, types, strict=True), 1)
    ]
    with emulate(model, mounts, pose, clock="steps", faults=Faults(seed=5)) as bus:
        specs = [
            ServoSpec(
                name=mount.joint,
                model=mount.model,
                id=mount.id,
                port=bus.port,
                lower=float(low),
                upper=float(high),
            )
            for mount, low, high in zip(mounts, model.lower, model.upper, strict=True)
        ]
        servo_bus = ServoBus(specs, rate=1.0 / TICK, reply_timeout_min=0.3, clock=ManualClock(bus))
        try:
            run(bus, servo_bus, model, settings, share)
        finally:
            servo_bus.close()


def run(bus, servo_bus, model, settings, share):
    servo_bus.open()
    pose = bus.plant.q
    ceiling = np.asarray(servo_bus.servos.max_torque)
    servo_bus.enable(servo_bus.read().position, 0.9 * ceiling)
    controller = pliant.Controller(model, settings, servo_bus.servos)
    target = model.forward_kinematics(pose)
    controller.reset(servo_bus.read().position)
    bus.faults.by_chance(lose=share / 3, corrupt=share / 3, deaf=share / 3)
    bus.log.clear()
    q, missing = pose, 0
    for _ in range(200):
        sample = servo_bus.read()
        missing += not sample.ok.all()
        q = np.where(sample.ok, sample.position, q)
        command = controller.step(q, target)
        before = bus.log.count
        servo_bus.write(command.goal, command.torque_limit)
        bus.advance(TICK)
        has_faults = any(t.faults for t in list(bus.log)[-(bus.log.count - before) :])
        drives = [servo.drive() for servo in bus.servos]
        if not has_faults:
            # Tolerance: one count of the register, and 0.2 % difference of the two stall torques.
            room = 0.002 * ceiling + ceiling / 500.0
            assert np.all(np.abs([d.ceiling for d in drives] - command.torque_limit) <= room)
        assert np.all([d.ceiling for d in drives] <= ceiling * 1.001)
    error = np.linalg.norm(bus.plant.tool[:3, 3] - target[:3, 3])
    # Deviation that the dry friction of the gears can cause [rad].
    stiction = [servo.model.motor.friction for servo in bus.servos] / np.asarray(
        servo_bus.servos.kp
    )
    assert error < 1.5 * np.abs(model.jacobian(pose)[:3] @ np.diag(stiction)).sum(axis=1).max()
    assert missing <= 200 * share
    assert not bus.log.eeprom_writes()
    assert not bus.log.goals_while_disabled()
    assert (bus.log.faulty > 0) == (share > 0.0)
