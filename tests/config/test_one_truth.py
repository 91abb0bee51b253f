"""On every backend the arm assumes the servo parameters of its file."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arms run in the simulator: extra sim")

from mismatch import Mismatch, Parameters

import pliant
from pliant import config
from pliant._servo_tables import COLUMNS
from pliant.config import factory
from pliant.config.factory import make_emulator
from pliant.emulator import ManualClock
from pliant.servo import ServoBus

ROBOTS = Path(__file__).parents[3] / "shared" / "robots"
#: Robots that have a ready file.
READY_FILES = ("arm7", "koch", "so100", "so101")
KOCH = """
[robot]
urdf = "{urdf}"
[supply]
voltage = {volts}
[servo]
"Revolute 2" = {{ model = "STS3215-7.4V", id = 1, kp = 14.7, friction = 0.29 }}
"Revolute 3" = {{ model = "STS3215-7.4V", id = 2, kp = 9.0, damping = 0.3, sign = -1 }}
"Revolute 5" = {{ model = "STS3215-7.4V", id = 3, kp = 8.0, gear_ratio = 2.0, gain = 20 }}
"Revolute 6" = {{ model = "STS3215-7.4V", id = 4, kp = 7.0, stall = 1.5 }}
"Revolute 7" = {{ model = "STS3215-7.4V", id = 5, kp = 6.0, secondary = {{ id = 7 }} }}
"""


def read(name, tmp_path, backend):
    """Read a built-in configuration, or write and read the configuration of another robot."""
    if name in READY_FILES:
        return config.load(name, backend=backend)
    if name == "vx300s":
        urdf = ROBOTS / "vx300s" / "vx300s.urdf"
        if not urdf.is_file():
            pytest.skip(f"no {urdf}")
        return config.load("vx300s", backend=backend, urdf=urdf)
    urdf = ROBOTS / "koch_low_cost" / "low-cost-arm.urdf"
    if not urdf.is_file():
        pytest.skip(f"no {urdf}")
    file = tmp_path / "arm.toml"
    file.write_text(KOCH.format(urdf=urdf.as_posix(), volts=7.4), "utf-8")
    return config.load(file, backend=backend)


def on_bytes(arm_config, model):
    """Return servo parameters with emulated servos: the arm's, the true ones, the model's."""
    with make_emulator(arm_config, clock="steps") as bus:
        servo_bus = ServoBus(
            factory.servo_specs(arm_config, bus.ports),
            reply_timeout_min=0.5,
            clock=ManualClock(bus),
        )
        arm = pliant.Arm(
            model, servo_bus, grippers=factory.gripper_configs(arm_config), handle_signals=False
        )
        arm.open()
        try:
            return arm.servos, bus.plant.gains, arm.model.servos
        finally:
            arm.close()


@pytest.mark.pty
@pytest.mark.parametrize("name", [*READY_FILES, "vx300s", "koch by its URDF"])
def test_the_arm_assumes_the_same_servos_on_every_backend(name, tmp_path):
    simulated_config = read(name, tmp_path, "sim")
    model = simulated_config.model()
    arm = pliant.connect(simulated_config, handle_signals=False)
    simulated, truth = arm.servos, arm.drive.plant.gains
    bus_servos, _, _ = on_bytes(read(name, tmp_path, "emulator"), model)
    for table in (bus_servos, model.servos, arm.model.servos):
        for field in (*COLUMNS, "no_load_speed"):
            value, other = getattr(simulated, field), getattr(table, field)
            assert (value is None) == (other is None), field
            if value is not None:
                np.testing.assert_allclose(value, other, rtol=1e-9, err_msg=field)
        assert (simulated.limit_type, simulated.stiffness_known) == (
            table.limit_type,
            table.stiffness_known,
        )
    # By default, the simulated servos have the parameters that the arm assumes.
    np.testing.assert_array_equal(truth.kp, simulated.kp)
    np.testing.assert_array_equal(truth.torque, simulated.max_torque)
    np.testing.assert_array_equal(truth.friction, simulated.friction)
    np.testing.assert_array_equal(truth.armature, simulated.armature)
    assert simulated.stiffness_known == (name == "koch by its URDF")


SERVO = """
robot.builtin = "so101"
backend = "emulator"
supply.voltage = 7.0
[servo]
shoulder_pan = {{ {model}, id = 1, kp = 6.6, friction = 0.10, damping = 0.21, gain = 16 }}
shoulder_lift = {{ {model}, id = 2, kp = 6.2, friction = 0.12, sign = -1 }}
elbow_flex = {{ {model}, id = 3, kp = 9.0, damping = 0.3, gear_ratio = 2.0 }}
wrist_flex = {{ {model}, id = 4, kp = 5.5, friction = 0.0, secondary = {{ id = 7 }} }}
wrist_roll = {{ {model}, id = 5 }}
[gripper]
servo = {{ {model}, id = 6, kp = 4.0, friction = 0.05 }}
"""


def emulated_joints(arm_config, p_gain=None):
    """Return stiffness, friction and damping of the gears of the emulated joints, by joint name."""
    bus = make_emulator(arm_config, clock="steps")
    for servo in bus.servos:
        if p_gain is not None:
            servo.put(servo.gain_register, p_gain)
        servo.put("torque_enable", 1)
    bus.world.advance(0.01)
    model, out = bus.plant.mj_model, {}
    for mount in factory.make_mounts(arm_config):
        dof = int(model.joint(mount.joint).dofadr[0])
        slope = bus.servo(mount.id).model.motor.slope * mount.gear_ratio**2 * len(mount.ids)
        out[mount.joint] = (
            float(model.actuator(mount.joint).gainprm[0]),
            float(model.dof_frictionloss[dof]),
            float(model.dof_damping[dof]) - slope,
        )
    return out


@pytest.mark.parametrize("model", ["STS3215-7.4V", "XL430-W250", "XL330-M288", "EX-106+"])
def test_the_emulated_servos_have_the_parameters_of_the_file(model):
    text = SERVO.format(model=f'model = "{model}"')
    if model != "STS3215-7.4V":
        text = text.replace(", gain = 16", "").replace("supply.voltage = 7.0\n", "")
    has_current_limits = model == "XL330-M288"
    arm_config = config.parse(text)
    joints = emulated_joints(arm_config)
    kp = {"shoulder_pan": 6.6, "shoulder_lift": 6.2, "elbow_flex": 9.0, "wrist_flex": 5.5}
    for joint, value in (kp | {"gripper": 4.0}).items():
        assert joints[joint][0] == pytest.approx(value), joint
    friction = {"shoulder_pan": 0.10, "shoulder_lift": 0.12, "wrist_flex": 0.0, "gripper": 0.05}
    for joint, value in friction.items():
        assert joints[joint][1] == value, joint
    if not has_current_limits:  # whose back-EMF is part of the current loop
        assert joints["shoulder_pan"][2] == pytest.approx(0.21)
        assert joints["elbow_flex"][2] == pytest.approx(0.3)
    # A joint without values in the file has those of the emulated model.
    plain = emulated_joints(
        config.parse(f"""
robot.builtin = "so101"
backend = "emulator"
{"supply.voltage = 7.0" if model == "STS3215-7.4V" else ""}
[servo]
{chr(10).join(f'{n} = {{ model = "{model}", id = {k} }}' for k, n in enumerate(kp, 1))}
wrist_roll = {{ model = "{model}", id = 5 }}
""")
    )
    assert joints["wrist_roll"] == pytest.approx(plain["wrist_roll"])


def test_the_emulated_stiffness_follows_the_gain_register():
    arm_config = config.parse(SERVO.format(model='model = "STS3215-7.4V"'))
    joints = emulated_joints(arm_config, p_gain=8)
    # The file has k_p at gain 16, or at the maker's gain of 32.
    assert joints["shoulder_pan"][0] == pytest.approx(3.3)
    assert joints["shoulder_lift"][0] == pytest.approx(6.2 / 4.0)


def test_a_damping_that_includes_the_back_emf_is_emulated_once():
    """In a chain with current limits, the damping of PWM-limited joints includes the back-EMF."""
    arm_config = config.load("koch", backend="emulator")
    assert arm_config.servo["shoulder_pan"].model == "XL430-W250"
    assert arm_config.model().servos.limit_type == "current"
    servo = arm_config.servo["shoulder_pan"].model_copy(update={"damping": 1.0})
    changed = arm_config.model_copy(update={"servo": arm_config.servo | {"shoulder_pan": servo}})
    mounts = {mount.joint: mount for mount in factory.make_mounts(changed)}
    slope = make_emulator(changed, clock="steps").servo(1).model.motor.slope
    assert mounts["shoulder_pan"].damping == pytest.approx(1.0 - slope)


def test_options_of_the_plant_do_not_change_the_assumptions():
    table = config.load("so101").model().servos
    options = {"backend": "sim", "handle_signals": False}
    with Mismatch(plant=Parameters(kp=2.0, friction=0.5), assumed=Parameters()):
        arms = [pliant.connect("so101", kp_scale=2.0, friction_scale=0.5, **options)]
    with Mismatch(plant=Parameters(kp=2.0), assumed=Parameters()):
        arms += [pliant.connect("so101", servos=table.replace(kp=2.0 * table.kp), **options)]
    for arm in arms:
        np.testing.assert_allclose(arm.drive.plant.gains.kp, 2.0 * table.kp)
        np.testing.assert_array_equal(arm.servos.kp, table.kp)
        np.testing.assert_array_equal(arm.servos.friction, table.friction)
        assert not arm.servos.stiffness_known


def test_the_gripper_of_the_simulator_has_the_servo_of_the_file():
    arm_config = config.load("koch", backend="sim")
    arm = pliant.connect(arm_config, handle_signals=False)
    drive = arm.drive
    index = drive.names.index("gripper")
    servo = drive.plant.mj_model.actuator("gripper")
    assert drive.servos.kp[index] == pytest.approx(0.72, rel=0.01)
    assert servo.gainprm[0] == pytest.approx(drive.servos.kp[index])
    assert arm.gripper.max_limit == pytest.approx(drive.servos.max_torque[index])


@pytest.mark.pty
@pytest.mark.parametrize("kp", [True, False])
def test_k_p_is_known_where_the_file_has_it_for_the_whole_chain(kp):
    table = tomllib.loads((Path(config.__file__).parent / "arms" / "so101.toml").read_text("utf-8"))
    lines = [
        f'{joint} = {{ model = "STS3215-7.4V", id = {servo["id"]}'
        + (", kp = 5.0 }" if kp or joint != "wrist_roll" else " }")
        for joint, servo in table["servo"].items()
    ]
    text = (
        'backend = "{}"\nrobot.builtin = "so101"\n[servo]\n' + "\n".join(lines) + "\n[gripper]\n"
        'servo = {{ model = "STS3215-7.4V", id = 6 }}\n'
    )
    simulated = config.parse(text.replace("{{", "{").replace("}}", "}").replace("{}", "sim"))
    assert pliant.connect(simulated, handle_signals=False).servos.stiffness_known is kp
    wired = config.parse(text.replace("{{", "{").replace("}}", "}").replace("{}", "emulator"))
    bus_servos, _, _ = on_bytes(wired, wired.model())
    assert bus_servos.stiffness_known is kp


def test_a_finger_without_limits_and_servo_is_fixed(tmp_path):
    """A finger without limits in the URDF and without a servo in the file is a fixed joint."""
    link = '<link name="{0}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" \
izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    joint = '<joint name="{2}" type="{3}"><parent link="{0}"/><child link="{1}"/><origin \
xyz="0 0 0.1"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="2" velocity="3"/></joint>'
    parts = [link.format(name) for name in ("base", "arm", "tool", "finger")]
    parts.append(joint.format("base", "arm", "one", "revolute"))
    parts.append(joint.format("arm", "tool", "two", "revolute"))
    parts.append(joint.format("tool", "finger", "jaw", "continuous"))
    (tmp_path / "arm.urdf").write_text(f'<robot name="r">{"".join(parts)}</robot>')
    file = tmp_path / "arm.toml"
    file.write_text(
        'robot = { urdf = "arm.urdf", base = "base", tip = "tool" }\n'
        'servo.one = { model = "XL430-W250", id = 1 }\n'
        'servo.two = { model = "XL430-W250", id = 2 }\n'
    )
    with pliant.connect(file, backend="sim", handle_signals=False) as arm:
        assert arm.gripper.opened == arm.gripper.closed
        arm.disable_torque()
