"""Arm files: the files of the package, and mistakes in a user's file."""

import re
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from bare_arm import bare_arm

import pliant
from pliant import config
from pliant.config import factory
from pliant.config.factory import make_emulator
from pliant.config.loader import builtin_text
from pliant.config.schema import zeros
from pliant.emulator import ManualClock
from pliant.servo import ServoBus

ROBOTS = Path(__file__).parents[3] / "shared" / "robots"
READY_FILES = ("arm7", "koch", "so100", "so101")
SIM = 'backend = "sim"\nrobot.builtin = "so101"\n'
SERVO = SIM + '[servo.a]\nmodel = "MX-64"\nid = 1\n'


@pytest.mark.parametrize("name", config.list_arms())
def test_ready_files_are_valid_and_described(name):
    arm_config = config.load(name)
    assert len(config.describe_arm(name)) > 40
    assert arm_config.settings().rate == arm_config.loop.rate
    if name in READY_FILES:
        model = arm_config.model()
        assert list(arm_config.servo) == list(model.joint_names)
        pliant.Controller(model, arm_config.settings())


def test_a_users_urdf_takes_the_place_of_the_files():
    urdf = ROBOTS / "vx300s" / "vx300s.urdf"
    if not urdf.is_file():
        pytest.skip(f"no {urdf}")
    arm_config = config.load("vx300s", urdf=urdf)
    assert arm_config.model().joint_names == tuple(arm_config.servo)
    assert len(arm_config.life.rest_q) == arm_config.model().n


def test_a_missing_urdf_is_named():
    with pytest.raises(pliant.ConfigError, match=r"robot\.urdf.*vx300s\.urdf.*--urdf"):
        config.load("vx300s").model()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "robot.limits = { wrist_roll = [-110, 110] }",
            r"robot\.limits\.wrist_roll: -110 is beyond ±12\.57 rad.*-110° are -1\.92 rad",
        ),
        ("robot.limits = { elbow_flex = [0.0, 90.0] }", r"elbow_flex: 90 is .* 90° are 1\.571 rad"),
        (
            'gripper = { servo = { model = "STS3215-7.4V", id = 6 }, opened = 90.0, closed = 0.0 }',
            r"gripper\.opened: 90 is beyond",
        ),
    ],
)
def test_angles_that_can_only_be_degrees_are_refused(line, message):
    with pytest.raises(pliant.ConfigError, match=message):
        config.parse(SIM + line).model()


def test_a_rate_that_the_simulator_cannot_run_is_named_with_rates_that_it_can():
    arm_config = config.parse(SIM + "loop.rate = 30")
    with pytest.raises(pliant.ConfigError, match=r"loop\.rate = 30 Hz: .* fit: 25, 31\.25 Hz"):
        pliant.connect(arm_config)
    for rate in (25.0, 31.25):
        assert pliant.connect(arm_config, rate=rate).rate == rate


def test_a_software_limit_in_degrees_is_refused():
    text = builtin_text("so101").replace("id = 1,", "id = 1, lower = -90, upper = 90,")
    with pytest.raises(pliant.ConfigError, match=r"servo\.shoulder_pan\.lower: -90 is beyond"):
        config.parse(text).model()


@pytest.mark.parametrize(
    ("kind", "limits"), [("continuous", "[-12.5, 12.5]"), ("prismatic", "[0, 15]")]
)
def test_limits_of_two_turns_and_of_long_rails_are_accepted(tmp_path, kind, limits):
    link = '<link name="{0}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" \
izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="r">{link.format("base")}{link.format("tool")}<joint name="one" '
        f'type="{kind}"><parent link="base"/><child link="tool"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="2" velocity="3"/></joint></robot>'
    )
    file = tmp_path / "arm.toml"
    file.write_text(
        f'backend = "sim"\nrobot = {{ urdf = "arm.urdf", limits = {{ one = {limits} }} }}\n'
    )
    assert config.load(file).model().upper[0] in (12.5, 15.0)


def test_urdf_and_file_that_disagree_on_joints():
    text = 'robot.builtin = "koch"\n[servo]\n' + "\n".join(
        f'{joint} = {{ model = "XL330-M288", id = {i} }}'
        for i, joint in enumerate(("shoulder_pan", "shoulder_lift", "elbow", "wrist_flex"), 1)
    )
    with pytest.raises(pliant.ConfigError, match="no servo for elbow_flex, wrist_roll") as error:
        config.parse(text).model()
    assert "no joint for the servos elbow" in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x =", "is not TOML"),
        ("[servo]\nRevolute 2 = { id = 1 }", "is not TOML.*a name with spaces.* is in quotes"),
        (
            'robot.urdf = "C:\\Users\\arm.urdf"',
            "is not TOML.*a path with / or in single quotes",
        ),
        (SIM + "bakend = 1", "did you mean 'backend'"),
        ("backend = 'sim'\n[robot]\n", "robot: takes one of urdf and builtin"),
        (SIM + "[loop]\nrate = -1", r"loop\.rate = -1: input should be greater than 0"),
        (SIM + "[loop]\nrate = nan", r"loop\.rate = nan"),
        (SIM + "[life]\nrest_q = [inf]", r"life\.rest_q\[0\] = inf: .*finite"),
        (SIM + '[servo.a]\nmodel = "XM430"\nid = 1', "did you mean: XM430-W"),
        (SIM + '[servo.a]\nmodle = "x"\nid = 1', r"servo\.a\.modle .* did you mean 'model'"),
        (SIM + '[servo.a]\nmodel = "MX-64"\nid = 300', r"servo\.a\.id = 300"),
        (SIM + '[servo.a]\nmodel = "MX-64"\nid = 1\nport = "mian"', "did you mean 'main'"),
        (SIM + '[servo.a]\nmodel = "MX-64"\nid = 1\nsecondary = { id = 1 }', "same id 1"),
        (
            SIM + '[servo]\na = { model = "MX-64", id = 1 }\nb = { model = "MX-64", id = 1 }',
            "same id 1",
        ),
        (SIM + '[settings]\nlaw = "capp"', "did you mean 'cap'"),
        (SIM + "[settings.axes.y]\nsofft = 3", r"settings: axes\.y: .*did you mean 'soft'"),
        (SIM + "[settings.axes]\ny = 3", r"axes\.y is a table"),
        (SIM + "[settings.axes.y]\nsoft = -3", r"settings: axes\.y: soft = -3 is outside"),
        (SIM + "[settings]\nmax_tool_speed = -1", "settings: max_tool_speed .* = -1 is outside"),
        ('preset = "dor"\n' + SIM, "did you mean 'door'"),
        ('preset = "soft"\n' + SIM, "needs its axes"),
        ('preset = { name = "wipe", pres = 3 }\n' + SIM, "pres"),
        ("preset = { press = 3 }\n" + SIM, "without a name"),
        ("preset = 3\n" + SIM, r'preset: takes a name, as "door", or a table, .* got 3$'),
        (SIM + '[settings]\npreset = "door"', "settings: preset belongs at the top of the file"),
        (SIM + "[loop]\npreset = 'door'", r"loop\.preset is not a key here: preset belongs at the"),
        (SIM + '[port]\npath = "x"', r"port is a list of tables: \[\[port\]\] in double brackets"),
        ('robot.builtin = "so101"', "needs a servo for every joint"),
        (
            SIM + "[gripper]\nopened = 1\nclosed = 1\n[gripper.servo]\nmodel = 'MX-64'\nid = 1",
            "same angle",
        ),
        (SIM + "[[port]]\n[[port]]\n", "'main' is there twice"),
        (SIM + "[loop]\ncomm_timeout = inf", r"loop\.comm_timeout = inf: .* 60"),
        (SIM + "[loop]\ncomm_timeout = 61", r"loop\.comm_timeout = 61: .* 60"),
        (SERVO + "sign = true", r"servo\.a\.sign: must be 1 or -1, got true"),
        (SERVO + "secondary = { id = 2, sign = false }", r"secondary\.sign: must be 1 or -1"),
        (SERVO + "stall = 1e308", r"servo\.a\.stall = 1e\+308: .* 10000"),
        (SERVO + "kp = 1e308", r"servo\.a\.kp = 1e\+308: .* 1000000"),
        (SERVO + "gear_ratio = 1e308", r"servo\.a\.gear_ratio = 1e\+308: .* 1000"),
        (SIM + "robot.payload = 0.1", r"robot\.payload = 0\.1: .* table; its keys are com, mass"),
        (SIM + "robot.gravity = -9.81", r"robot\.gravity = -9\.81: must be a list of numbers"),
        (SIM + "robot.gravity = [0, 0, -9810]", r"robot\.gravity: 9810 m/s² is above 30"),
        (SIM + "servo.a = 1", r"servo\.a = 1: must be a table; its keys are damping, "),
        (SIM + "robot.table = 1e308", r"robot\.table = 1e\+308: .* 100"),
        (SIM + "[loop]\nreply_timeout_min = 1e9", r"loop\.reply_timeout_min = 1000000000\.0: .* 1"),
    ],
)
def test_mistakes_are_named_with_valid_values(text, message):
    with pytest.raises(pliant.ConfigError, match=message) as error:
        config.parse(text, source="arm.toml")
    assert str(error.value).startswith("arm.toml")
    assert "http" not in str(error.value)


@pytest.mark.parametrize(
    ("rest_q", "message"),
    [([0.0, 0.0], r"life\.rest_q has shape \(2,\)"), ([0.0] * 4 + [90.0], "are these degrees")],
)
def test_a_rest_pose_of_another_arm_is_named_with_its_file(rest_q, message):
    arm_config = config.parse(f"{SIM}[life]\nrest_q = {rest_q}", source="arm.toml")
    with pytest.raises(pliant.ConfigError, match=message) as error:
        pliant.connect(arm_config)
    assert str(error.value).startswith("arm.toml")


def test_all_mistakes_are_reported_together():
    with pytest.raises(pliant.ConfigError) as error:
        config.parse("robto = 1\n[loop]\nrate = 0\n[port]\nx = 1")
    first, *lines = str(error.value).splitlines()
    assert first == "configuration has 4 mistakes:"
    assert [line.split()[0] for line in lines] == ["robot", "port", "loop.rate", "robto"]


def test_mistakes_in_settings_and_servos_are_reported_with_the_others():
    text = SIM.replace("backend", "bakend = 1\nbackend") + (
        '[loop]\nrate = -1\n[servo]\na = { model = "STS3512-7.4V", id = "4" }\n[settings]\n'
        'lw = "cap"\nmax_tool_speed = -1\ntask = "xyz"\n'
        "axes.y = { sofft = 3, adaptation = 4 }\naxes.z = { soft = -3 }\naxes.yaw = { soft = 3 }\n"
        "axes.roll = { soft = 3 }\n"
    )
    with pytest.raises(pliant.ConfigError) as error:
        config.parse(text)
    for message in (
        "bakend is not a key here",
        "loop.rate = -1",
        "servo.a.model: ",
        "servo.a.id = '4': input should be a valid integer",
        "settings: lw: Settings has no such field",
        "settings: max_tool_speed [m/s, rad/s] = -1 is outside",
        "settings: axes.y: sofft: Axis has no such field",
        "settings: axes.y: adaptation = 4 is outside",
        "settings: axes.z: soft = -3 is outside",
        "settings: axes.yaw: 'yaw' is not an axis of the task",
        "settings: axes.roll: 'roll' is not an axis of the task",
    ):
        assert str(error.value).count(message) == 1, message


@pytest.mark.parametrize("first", ['task = "xyzq"', 'law = "capp"'])
def test_fields_that_depend_on_an_invalid_one_are_not_checked(first):
    with pytest.raises(pliant.ConfigError) as error:
        config.parse(SIM + f"[settings]\n{first}\ntracking.gain = [1.0, 1.0, 1.0]\n")
    assert str(error.value).count("settings: ") == 1
    assert "gain" not in str(error.value).splitlines()[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[servo.a]\nmodel = "MX-64"\nid = 1\nkp = "4.7"', r"servo\.a\.kp = '4\.7'"),
        ("[servo.a]\nmodel = 'MX-64'\nid = true", r"servo\.a\.id = True"),
        ("[loop]\nrate = '100'", r"loop\.rate = '100'"),
        ("[[port]]\nbaud = '57600'", r"port\[0\]\.baud = '57600'"),
        ("[life]\nrest_q = ['0', 0, 0, 0, 0]", r"life\.rest_q\[0\] = '0'"),
    ],
)
def test_a_number_in_quotes_is_refused(text, message):
    with pytest.raises(pliant.ConfigError, match=message):
        config.parse(SIM + text)


def test_settings_go_through_the_same_code_as_in_python():
    arm_config = config.parse(
        'backend = "sim"\npreset = { name = "soft", axes = "y" }\nrobot.builtin = "arm7"\n'
        "[loop]\nrate = 200\n"
        "[settings]\nlaw = 'cap'\n[settings.axes.x]\nhold = 30.0\nfirm = [5.0, 9.0]\n"
    )
    by_hand = pliant.Settings.soft(
        "y", law="cap", rate=200.0, axes={"x": pliant.Axis(hold=30.0, firm=(5.0, 9.0))}
    )
    assert arm_config.settings() == by_hand


def test_the_command_line_replaces_port_and_backend(tmp_path):
    assert config.load("so101", port="/dev/ttyX").port[0].path == "/dev/ttyX"
    assert config.load("so101", backend="emulator").backend == "emulator"
    file = tmp_path / "two.toml"
    file.write_text("robot.builtin = 'so101'\n[[port]]\nname = 'a'\n[[port]]\nname = 'b'\n")
    with pytest.raises(pliant.ConfigError, match="just one port"):
        config.load(file, port="/dev/ttyX")


@pytest.mark.parametrize("backend", ["sim", "emulator"])
def test_a_port_for_a_backend_that_opens_none_is_refused(backend):
    message = (
        rf"port /dev/ttyX is for servos on a bus, and backend '{backend}' opens no serial port"
    )
    with pytest.raises(pliant.ConfigError, match=message):
        config.load("so101", port="/dev/ttyX", backend=backend)


def test_a_urdf_is_not_taken_for_a_configuration(tmp_path):
    (tmp_path / "vx300s.urdf").write_text('<?xml version="1.0"?>\n<robot name="x"/>')
    with pytest.raises(
        pliant.ConfigError, match=r"vx300s\.urdf is not TOML but XML.*\[robot\] urdf"
    ):
        config.load(tmp_path / "vx300s.urdf")


def test_a_gain_that_a_servo_does_not_keep_is_rejected():
    with pytest.raises(pliant.ConfigError, match=r"servo\.a: gain: XM430-W350 starts with"):
        config.parse(SIM + '[servo.a]\nmodel = "XM430-W350"\nid = 1\ngain = 800')
    with pytest.raises(pliant.ConfigError, match=r"gain: STS3215-7\.4V takes 1 to 254, got 5000"):
        config.parse(SIM + '[servo.a]\nmodel = "STS3215-7.4V"\nid = 1\ngain = 5000')


def test_missing_files(tmp_path):
    with pytest.raises(pliant.ConfigError, match="so101"):
        config.load("so-101")
    with pytest.raises(pliant.ConfigError, match=r"no file .*arm\.toml"):
        config.load(tmp_path / "arm.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(pliant.ConfigError, match="cannot be read"):
        config.load(tmp_path / "bytes.toml")


def test_directions_of_the_ready_so101_match_the_makers_model():
    urdf = ROBOTS / "so101" / "so101_new_calib.urdf"
    if not urdf.is_file():
        pytest.skip(f"no {urdf}")
    arm_config = config.load("so101")
    model, makers_model = arm_config.model(), pliant.Model.from_urdf(urdf, tip="gripper_frame_link")
    signs = np.array([arm_config.servo[joint].sign for joint in model.joint_names])
    for joint in range(model.n):
        counts = np.eye(model.n)[joint] * 0.4
        rotation = [
            np.asarray(
                m.forward_kinematics(q)[:3, :3] @ m.forward_kinematics(np.zeros(5))[:3, :3].T
            )
            for m, q in ((model, signs * counts), (makers_model, counts))
        ]
        np.testing.assert_allclose(rotation[0], rotation[1], atol=0.06)


@pytest.mark.parametrize("name", READY_FILES)
def test_a_file_for_a_built_in_model_takes_no_other_urdf(name):
    message = r"model '\w+': its signs and zeros are wrong for my\.urdf.*docs/robots/so101\.md"
    with pytest.raises(pliant.ConfigError, match=message):
        config.load(name, urdf="my.urdf")


@contextmanager
def makers_arm(arm_config):
    """Yield the arm of a configuration: simulated, or on emulated servos in emulated time."""
    if arm_config.backend == "sim":
        with pliant.connect(arm_config, handle_signals=False) as arm:
            yield arm
        return
    with make_emulator(arm_config, clock="steps") as bus:
        specs = factory.servo_specs(arm_config, bus.ports)
        drive = ServoBus(specs, reply_timeout_min=0.5, clock=ManualClock(bus))
        grippers = factory.gripper_configs(arm_config)
        with pliant.Arm(arm_config.model(), drive, grippers=grippers, handle_signals=False) as arm:
            yield arm


@pytest.mark.parametrize("backend", ["sim", pytest.param("emulator", marks=pytest.mark.pty)])
def test_the_file_for_the_makers_so101_runs_as_printed(backend, tmp_path):
    page = Path(__file__).parents[2] / "docs" / "robots" / "so101.md"
    (text,) = re.findall(r"^```toml\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    file = tmp_path / "my_so101.toml"
    file.write_text(text, "utf-8")
    assert {servo.sign for servo in config.load(file).servo.values()} == {1}
    urdf = ROBOTS / "so101" / "so101_new_calib.urdf"
    if not urdf.is_file():
        pytest.skip(f"no {urdf}")
    arm_config = config.load(file, backend=backend, urdf=urdf)
    with makers_arm(arm_config) as arm:
        controller = pliant.Controller(arm.model, arm_config.settings(), arm.servos)
        start = arm.read().q
        target = arm.model.forward_kinematics(start)
        for tick in pliant.Loop(arm, controller, duration=0.3):
            tick.write(controller.step(tick.q, target, dt=tick.dt))
        assert np.abs(arm.read().q - start).max() < 0.05
        arm.lower()
        assert not arm.enabled


def test_zero_comes_from_the_file_then_from_the_calibration(tmp_path):
    (tmp_path / "cal.json").write_text(
        '{"shoulder_pan": {"id": 1, "drive_mode": 0, "homing_offset": 5, "range_min": 1000, '
        '"range_max": 3001}}'
    )
    text = SIM + (
        'calibration = "cal.json"\n[servo]\nshoulder_pan = { model = "STS3215-7.4V", id = 1 }\n'
        'elbow_flex = { model = "STS3215-7.4V", id = 3, zero = 7 }\n'
    ).replace('calibration = "cal.json"\n', "")
    arm_config = config.parse('calibration = "cal.json"\n' + text, folder=tmp_path)
    assert zeros(arm_config) == {"shoulder_pan": 2000.5, "elbow_flex": 7.0}
    other = config.parse(
        'calibration = "cal.json"\n' + text.replace("id = 1", "id = 2"), folder=tmp_path
    )
    with pytest.raises(pliant.ConfigError, match="has id 1, the configuration says 2"):
        zeros(other)


def test_a_bound_on_a_dead_host_reaches_the_servos_from_the_file():
    """Run loops with the arm of a file, with and without `max_host_loss_force`."""
    pytest.importorskip("mujoco", reason="runs in the simulator: extra sim")
    work = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])
    text = 'backend = "sim"\nrobot.builtin = "arm7"\n[settings]\naxes.y = { soft = 4.0 }\n'
    residuals, commands = [], []
    for bound in ("", "torque_limits.max_host_loss_force = 44.0\n"):
        arm_config = config.parse(text + bound)
        connected = pliant.connect(arm_config)
        connected.drive.plant.reset(work)
        with connected as arm:
            controller = pliant.Controller(arm.model, arm_config.settings(), arm.servos)
            for tick in pliant.Loop(arm, controller, duration=0.5):
                command = controller.step_joints(tick.q, work, dt=tick.dt)
                tick.write(command)
            assert np.abs(arm.read().q - work).max() < 1e-3, "it stands"
            axes = controller.report().axes
            residuals.append(max(max(axes[axis].host_loss_force) for axis in "xyz"))
            commands.append(command.torque_limit)
    assert residuals[0] > 46.0
    assert residuals[1] <= 44.0
    assert np.all(commands[1] <= commands[0] + 1e-9)
    with pytest.raises(pliant.ConfigError, match="did you mean 'max_host_loss_force'"):
        config.parse(text + "torque_limits.max_host_loss_forc = 44.0\n").settings()


def test_an_invalid_task_is_reported_once():
    with pytest.raises(pliant.ConfigError) as error:
        config.parse(SIM + "[settings]\ntask = { axes = 3 }\naxes.y = { frim = 1.0 }\n")
    assert str(error.value).count("settings: task.") == 1
    assert "frim" in str(error.value)


def test_a_wrong_loop_does_not_hide_a_wrong_preset():
    with pytest.raises(pliant.ConfigError) as error:
        config.parse('preset = "soft"\n' + SIM + "[loop]\nrate = -1\n")
    assert "loop.rate = -1" in str(error.value)
    assert 'preset "soft" needs its axes' in str(error.value)


@pytest.mark.parametrize("backend", ["sim", "bus"])
def test_software_limits_of_a_servo_narrow_those_of_the_model(backend):
    text = config.loader.builtin_text("so101")
    line = next(row for row in text.splitlines() if row.startswith("elbow_flex"))

    def model(bounds, more=""):
        changed = text.replace(line, line.rstrip(" }") + f", {bounds} }}") + more
        return config.parse(changed, source="arm.toml", backend=backend).model()

    ends = config.parse(text, source="arm.toml").model()
    narrow = model("lower = -0.2, upper = 0.1")
    assert (narrow.lower[2], narrow.upper[2]) == (-0.2, 0.1)
    np.testing.assert_array_equal(np.delete(narrow.lower, 2), np.delete(ends.lower, 2))
    assert np.array_equal(narrow.servos.kp, ends.servos.kp)
    wide = model("lower = -9.0, upper = 9.0")
    assert (wide.lower[2], wide.upper[2]) == (ends.lower[2], ends.upper[2])
    one = model("upper = 0.1")
    assert (one.lower[2], one.upper[2]) == (ends.lower[2], 0.1)
    for bounds in ("lower = 0.3, upper = -0.3", "upper = -9.0"):
        with pytest.raises(pliant.ConfigError, match=r"servo\.elbow_flex: .* leave no range"):
            model(bounds)


def test_a_byte_order_mark_is_ignored(tmp_path):
    file = tmp_path / "arm.toml"
    file.write_text(SIM, encoding="utf-8-sig")
    assert config.load(file).robot.builtin == "so101"


@pytest.mark.parametrize("key", ["base", "tip"])
def test_a_link_that_does_not_exist_is_reported_with_its_key(key):
    text = builtin_text("so101").replace("[robot]", f'[robot]\n{key} = "lower_amr"')
    message = rf"^robot\.{key}: there is no link 'lower_amr'; did you mean 'lower_arm'\? there "
    with pytest.raises(pliant.ConfigError, match=message + "are: base, gripper, jaw, lower_arm, "):
        config.parse(text, source="arm.toml").model()


@pytest.mark.parametrize("height", [1e308, float("nan"), -101.0])
def test_a_table_far_from_the_arm_is_refused(height):
    with pytest.raises(pliant.OutOfRangeError, match=r"^table \[m\] must be in \[-100, 100\]"):
        pliant.connect("so101", backend="sim", table=height)
    with pytest.raises(pliant.OutOfRangeError, match=r"^table \[m\] must be in \[-100, 100\]"):
        bare_arm("koch", table=height)
