"""The whole stack: controller, arm, driver, rustypot, bytes, emulated servos and MuJoCo."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="an arm behind the emulator needs the extra sim")

import pliant
import pliant.robots
from pliant.arm import Arm
from pliant.emulator import Faults, ManualClock, Mount, emulate
from pliant.servo import ServoBus, ServoSpec

START = np.array([0.0, -0.5, 0.8, 0.3, 0.0])


def so101(bus, model, **options):
    ranges = zip(model.joint_names, model.lower, model.upper, strict=True)
    specs = [
        ServoSpec(
            name=name, model="STS3215-7.4V", id=i, port=bus.port, lower=low, upper=high, zero=2048
        )
        for i, (name, low, high) in enumerate(ranges, 1)
    ]
    return ServoBus(specs, reply_timeout_min=0.1, **options)


# The test without faults is in tests/config/test_arm.py.
@pytest.mark.parametrize(
    "shares",
    [pytest.param({}, marks=pytest.mark.full), {"lose": 0.01, "corrupt": 0.01, "late": 0.01}],
)
def test_an_arm_is_enabled_held_and_lowered(shares):
    model = pliant.robots.so101()
    mounts = [
        Mount(joint=name, model="STS3215", id=i) for i, name in enumerate(model.joint_names, 1)
    ]
    faults = Faults(seed=1, **shares)
    with emulate(model, mounts, q=START, clock="steps", faults=faults) as bus:
        servo_bus = so101(bus, model, clock=ManualClock(bus))
        with Arm(model, servo_bus, rate=50.0, handle_signals=False) as arm:
            controller = pliant.Controller(
                model, pliant.Settings(task=pliant.Task(axes="xyz"), rate=50.0), servo_bus.servos
            )
            target = model.forward_kinematics(arm.read().q)
            for k, tick in enumerate(pliant.Loop(arm, controller, rate=50.0)):
                if tick.state.fresh:
                    # Readings are up to date: transactions take no time on this clock.
                    assert tick.q == pytest.approx(bus.plant.q, abs=0.004)
                tick.write(controller.step(tick.q, target, dt=tick.dt))
                if k == 100:
                    break
            assert bus.plant.tool[:3, 3] == pytest.approx(target[:3, 3], abs=0.005)
        # After the descent, the torque is off, the arm rests, and no other register was written.
        assert [servo.get("torque_enable") for servo in bus.servos] == [0] * 5
        assert bus.log.eeprom_writes() == []
        assert not bus.log.writes(refused=True)
        assert servo_bus.counters["retries"] > 0 or not shares
