import numpy as np
import pytest

import pliant
from pliant import config
from pliant.config import assemble


def test_specs_are_what_the_file_says(tmp_path):
    read = config.parse(
        'robot.builtin = "so101"\n[[port]]\nname = "main"\npath = "/dev/ttyX"\nbaud = 500_000\n'
        "[servo]\n"
        "shoulder_pan = { model = 'STS3215-12V', id = 7, sign = -1, zero = 9, kp = 8.0 }\n"
        "shoulder_lift = { model = 'XM540-W270', id = 2, twin = { id = 3 }, lower = -1 }\n"
    )
    pan, lift = assemble.specs(read, assemble.paths(read))
    assert (pan.name, pan.port, pan.sign, pan.zero, pan.kp) == (
        "shoulder_pan",
        "/dev/ttyX",
        -1,
        9,
        8,
    )
    assert (lift.twin, lift.lower, lift.upper) == ((3, -1), -1.0, None)


def test_an_automatic_port_is_the_only_one(monkeypatch):
    read = config.load("so101")
    monkeypatch.setattr(assemble, "serial_ports", lambda: ("/dev/a",))
    assert assemble.paths(read) == {"main": "/dev/a"}
    monkeypatch.setattr(assemble, "serial_ports", lambda: ("/dev/a", "/dev/b"))
    with pytest.raises(pliant.ServoError, match=r"there are 2: /dev/a, /dev/b.*--port"):
        assemble.paths(read)
    monkeypatch.setattr(assemble, "serial_ports", tuple)
    with pytest.raises(pliant.ServoError, match="no serial port on this machine"):
        pliant.connect("so101")


def test_a_file_on_the_simulator_becomes_an_arm():
    with pliant.connect("koch", backend="sim", signals=False) as arm:
        assert arm.enabled
        assert list(arm.grippers) == ["gripper"]
        assert np.isfinite(arm.read().q).all()
    assert not arm.enabled


@pytest.mark.parametrize("name", ["so101", "koch", "arm7"])
def test_a_ready_arm_moves_over_real_bytes(name):
    rate = 50.0
    options = {"rate": rate, "hold_for": 5.0, "signals": False}
    with pliant.connect(name, backend="emulator", **options) as arm:
        controller = pliant.Controller(arm.model, config.load(name).settings(), arm.servos)
        state = arm.read()
        target = arm.model.forward_kinematics(state.q + 0.1)
        for tick in pliant.Loop(arm, controller, rate=rate):
            tick.write(controller.step(tick.q, target, dt=tick.dt))
            if tick.state.time - state.time > 1.5:
                break
        reached = arm.model.forward_kinematics(tick.q)[:3, 3]
        order = arm.drive.emulator.call("log.order", arm.drive.specs[0].id)
        assert not arm.drive.emulator.call("log.eeprom_writes")
        arm.limp()
    # The supply's voltage and the gain registers, not the ideal servos of the built-in table.
    assert np.linalg.norm(reached - target[:3, 3]) < 0.015
    assert order[:3] == ["limit", "goal", "torque on"]
