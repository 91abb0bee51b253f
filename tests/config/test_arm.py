"""Configuration files become servo specifications, and arms that work on simulator and emulator."""

import numpy as np
import pytest

import pliant
from pliant import config
from pliant.config import factory
from pliant.config.factory import make_emulator
from pliant.emulator import ManualClock
from pliant.servo import ServoBus
from pliant.servo.spec import Units


def test_specs_are_what_the_file_says(tmp_path):
    arm_config = config.parse(
        'robot.builtin = "so101"\n[[port]]\nname = "main"\npath = "/dev/ttyX"\nbaud = 500_000\n'
        "[servo]\n"
        "shoulder_pan = { model = 'STS3215-12V', id = 7, sign = -1, zero = 9, kp = 8.0 }\n"
        "shoulder_lift = { model = 'XM540-W270', id = 2, secondary = { id = 3 }, lower = -1 }\n"
    )
    pan, lift = factory.servo_specs(arm_config, factory.port_paths(arm_config))
    assert (pan.name, pan.port, pan.sign, pan.zero, pan.kp) == (
        "shoulder_pan",
        "/dev/ttyX",
        -1,
        9,
        8,
    )
    assert (lift.secondary, lift.lower, lift.upper) == ((3, -1), -1.0, None)


def test_an_automatic_port_is_the_only_one(monkeypatch):
    arm_config = config.load("so101")
    monkeypatch.setattr(factory, "serial_ports", lambda: ("/dev/a",))
    assert factory.port_paths(arm_config) == {"main": "/dev/a"}
    monkeypatch.setattr(factory, "serial_ports", lambda: ("/dev/a", "/dev/b"))
    with pytest.raises(pliant.ServoError, match=r"there are 2: /dev/a, /dev/b.*--port"):
        factory.port_paths(arm_config)
    monkeypatch.setattr(factory, "serial_ports", tuple)
    with pytest.raises(pliant.ServoError, match="no serial port on this machine"):
        pliant.connect("so101")


def test_a_file_on_the_simulator_becomes_an_arm():
    with pliant.connect("koch", backend="sim", handle_signals=False) as arm:
        assert arm.enabled
        assert list(arm.grippers) == ["gripper"]
        assert np.isfinite(arm.read().q).all()
    assert not arm.enabled


def move(arm, name):
    """Move every joint by 0.1 rad; return target and final position of the tool (3,) [m]."""
    controller = pliant.Controller(arm.model, config.load(name).settings(), arm.servos)
    state = arm.read()
    target = arm.model.forward_kinematics(state.q + 0.1)
    for tick in pliant.Loop(arm, controller, rate=arm.rate):
        tick.write(controller.step(tick.q, target, dt=tick.dt))
        if tick.state.time - state.time > 1.5:
            break
    return target[:3, 3], arm.model.forward_kinematics(tick.q)[:3, 3]


@pytest.mark.pty
@pytest.mark.parametrize("name", ["so101", "koch", "arm7"])
def test_a_packaged_arm_moves_over_a_pseudo_terminal(name):
    arm_config = config.load(name)
    with make_emulator(arm_config, clock="steps") as bus:
        servo_bus = ServoBus(
            factory.servo_specs(arm_config, bus.ports),
            reply_timeout_min=0.2,
            clock=ManualClock(bus),
        )
        options = {
            "rate": 50.0,
            "grippers": factory.gripper_configs(arm_config),
            "handle_signals": False,
        }
        with pliant.Arm(arm_config.model(), servo_bus, **options) as arm:
            target, final = move(arm, name)
            arm.disable_torque()
        order = bus.log.order(servo_bus.specs[0].id)
        assert not bus.log.eeprom_writes()
    # Emulated supply voltage and gains differ from those that the servo table assumes.
    assert np.linalg.norm(final - target) < 0.015
    assert order[:3] == ["limit", "goal", "torque on"]


@pytest.mark.pty
def test_emulated_servos_have_the_baud_rate_of_their_port():
    fast = config.load("so101")
    port = fast.port[0].model_copy(update={"baud": 115_200})
    arm_config = fast.model_copy(update={"port": [port]})
    with make_emulator(arm_config, clock="steps") as bus:
        specs = factory.servo_specs(arm_config, bus.ports)
        servo_bus = ServoBus(specs, baudrate=115_200, reply_timeout_min=0.2, clock=ManualClock(bus))
        servo_bus.open()
        assert len(servo_bus.found) == 6
        servo_bus.close()


@pytest.mark.pty
def test_a_packaged_arm_moves_with_an_emulator_process():
    options = {"rate": 20.0, "comm_timeout": 20.0, "handle_signals": False}
    with pliant.connect("arm7", backend="emulator", **options) as arm:
        servo_bus = arm.drive
        assert servo_bus._cycle == pytest.approx(0.05)  # its timeouts depend on the rate too
        move(arm, "arm7")
        order = servo_bus.emulator.call("log.order", servo_bus.specs[0].id)
        assert not servo_bus.emulator.call("log.eeprom_writes")
        assert [servo.voltage for servo in servo_bus.found] == [18.5] * 7
        arm.disable_torque()
    assert order[:3] == ["limit", "goal", "torque on"]


def test_joint_ranges_of_packaged_arms_fit_their_servos():
    for name in ("so101", "so100", "koch", "arm7"):
        arm_config = config.load(name)
        model = arm_config.model()
        ranges = dict(
            zip(model.joint_names, zip(model.lower, model.upper, strict=True), strict=True)
        )
        for spec in factory.servo_specs(arm_config, {"main": "/dev/none"}):
            if spec.name in ranges:
                units = Units.of(spec)
                counts = [units.counts(bound) for bound in ranges[spec.name]]
                assert min(counts) >= 0, (name, spec.name, counts)
                assert max(counts) <= spec.row.max_position, (name, spec.name, counts)
