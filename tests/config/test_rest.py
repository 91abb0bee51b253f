"""Ready arms stand on a table and have a rest pose on it."""

import re
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arms run in the simulator: extra sim")

from bare_arm import bare_arm
from mismatch import Mismatch, Parameters

import pliant
from pliant import config
from pliant._core import ArmPoints
from pliant.arm._checks import STEPS, path_obstacle
from pliant.config import factory
from pliant.config.factory import ARM_OPTIONS, PLANT_OPTIONS
from pliant.sim import Plant, Tabletop

ROBOTS = Path(__file__).parents[3] / "shared" / "robots"
READY_FILES = ("arm7", "koch", "so100", "so101")


def load(name, **options):
    if name != "vx300s":
        return config.load(name, **options)
    urdf = ROBOTS / "vx300s" / "vx300s.urdf"
    if not urdf.is_file():
        pytest.skip(f"no {urdf}")
    return config.load(name, urdf=urdf, **options)


def test_ready_files_have_rest_pose_and_table_or_neither():
    for name in config.list_arms():
        arm_config = config.load(name)
        assert arm_config.life.rest_q is not None, name
        assert (arm_config.robot.table is None) == (name == "arm7"), name


@pytest.mark.parametrize("name", [*READY_FILES, "vx300s"])
def test_a_rest_pose_lies_within_limits_above_the_table_and_presses_on_nothing(name):
    arm_config = load(name)
    model, rest_q = arm_config.model(), np.array(arm_config.life.rest_q)
    assert np.all(rest_q >= model.lower)
    assert np.all(rest_q <= model.upper)
    if arm_config.robot.table is None:
        weight = np.abs(model.gravity(rest_q))
        assert np.all(weight < model.servos.friction), "gears hold it where it hangs"
        return
    table = Tabletop(height=arm_config.robot.table)
    plant = Plant(model, scene=[table])
    plant.reset(rest_q)
    assert table.clearance() >= 0.0
    gripper_command = dict.fromkeys(plant.read().extra, (0.0, 0.0))
    for _ in range(300):
        plant.write(plant.q, np.zeros(plant.n), gripper_command)
        plant.advance()
    # Without torque the arm sinks onto the table or its stops; the tool does not enter the table.
    assert table.clearance() > -1e-3
    assert plant.tool[2, 3] > arm_config.robot.table
    assert np.abs(plant.dq).max() < 0.05


@pytest.mark.parametrize("name", ["koch", "so101", "vx300s"])
def test_an_arm_of_a_ready_file_is_parked_and_lies_on_its_table(name):
    arm_config = load(name, backend="sim")
    arm = pliant.connect(arm_config, handle_signals=False)
    plant = arm.drive.plant
    (table,) = plant.fixtures
    rest_q = np.array(arm_config.life.rest_q)
    lowest, states = np.inf, []

    def look():
        nonlocal lowest
        lowest = min(lowest, table.clearance())
        states.append(np.abs(plant.q - rest_q).max())

    with arm:
        assert np.abs(plant.q).max() < 0.05, "it starts in a pose to work from"
        arm.clock.on_tick = look
    assert arm.detour is None
    assert min(states) < 0.15, "it went by its rest pose"
    assert lowest > -2e-3
    assert np.abs(plant.dq).max() < 0.05
    assert not arm.enabled


#: Posture bent forward [rad]: half-way on the straight path to the rest pose, the tool would be
#: 5 cm below the table.
BLOCKED_POSE = [0.0, 1.24, 1.23, 1.24, 0.0]


def test_a_path_through_the_table_is_detected():
    model = pliant.robots.so101()
    points, rest_q = ArmPoints(model), np.array(config.load("so101").life.rest_q)

    def lowest(share):
        return points.position(np.array(BLOCKED_POSE) + share * (rest_q - BLOCKED_POSE))[:, 2].min()

    heights = [lowest(share) for share in np.linspace(0.0, 1.0, STEPS)]
    assert min(heights[0], heights[-1]) > 0.0 > -0.008 > min(heights)
    obstacle = path_obstacle(model, points, np.array(BLOCKED_POSE), rest_q, 0.0)
    assert (
        obstacle == f"the way to the rest pose leads the tool {-min(heights):.3f} m into the table"
    )
    for free, table in (
        (np.zeros(5), 0.0),
        (np.array(BLOCKED_POSE), None),
        (np.array(BLOCKED_POSE), -0.1),
    ):
        assert path_obstacle(model, points, free, rest_q, table) is None
    # A point that starts below the table may move up, but not down.
    start, goal = np.array([0.0, 1.3, 0.9, 0.0, 0.0]), np.array([0.0, 1.3, 1.7, 0.0, 0.0])
    assert points.position(start)[:, 2].min() < -0.09
    assert path_obstacle(model, points, start, goal, 0.0) is None
    assert "the tool 0.1" in path_obstacle(
        model, points, start, np.array([0.0, 1.3, 0.3, 0, 0]), 0.0
    )


def test_an_arm_with_a_blocked_path_to_rest_is_lowered_straight_down():
    arm = pliant.connect("so101", backend="sim", q=BLOCKED_POSE, handle_signals=False)
    plant = arm.drive.plant
    (table,) = plant.fixtures
    with arm:
        lift = plant.q[1]
    assert arm.detour.startswith("the way to the rest pose leads the tool 0.0")
    assert plant.q[1] > lift - 0.1, "it did not lean back"
    assert table.clearance() > -2e-3
    assert table.touching


# In brackets: smallest distance from the rest pose if the other joints turned back.
@pytest.mark.parametrize(
    "q",
    [
        [1.047, -1.731, -1.074, 0.59, -0.255],  # (1.6 rad)
        [-0.344, -1.735, 0.172, -0.772, 1.195],  # (0.9 rad)
    ],
)
def test_a_joint_at_its_rest_position_that_its_load_pulls_off_does_not_turn_the_others_back(q):
    arm = pliant.connect("so101", backend="sim", q=q, handle_signals=False)
    distances = []
    with arm:
        arm.clock.on_tick = lambda: distances.append(np.abs(arm.drive.plant.q - arm.rest_q).max())
        arm.park()
    assert min(distances) < 0.03
    on_way = np.array(distances[: int(np.argmin(distances))])
    assert (on_way - np.minimum.accumulate(on_way)).max() < 0.05
    assert arm.detour is None


def test_an_arm_that_is_too_weak_for_the_way_to_its_rest_pose_says_so():
    q = [1.58, -1.06, -0.41, 0.52, -1.89]
    arm = pliant.connect("so101", backend="sim", q=q, kp_scale=0.22, handle_signals=False)
    with arm:
        arm.park()
    assert re.fullmatch(
        r"the arm gets no closer to the rest pose, \w+ is [12]\.\d\d rad away", arm.detour
    )


def test_a_rest_pose_inside_the_table_is_refused():
    with pytest.raises(
        pliant.OutOfRangeError, match=r"rest_q: the tool would be 0\.\d+ m inside the tab"
    ):
        pliant.connect("so101", backend="sim", rest_q=[0.0, 1.5, 1.2, 0.0, 0.0])
    arm = pliant.connect("so101", backend="sim", handle_signals=False)
    with arm:
        with pytest.raises(pliant.OutOfRangeError, match=r"pose: the tool .* inside the table"):
            arm.park([0.0, 1.5, 1.2, 0.0, 0.0])
        arm.disable_torque()


def test_the_table_can_be_taken_away_moved_and_added_to():
    options = {"backend": "sim", "handle_signals": False}
    assert pliant.connect("so101", table=False, **options).drive.plant.fixtures == ()
    (lower,) = pliant.connect("so101", table=-0.3, **options).drive.plant.fixtures
    assert lower.height == -0.3
    push = pliant.sim.Push(force_vector=(1.0, 0.0, 0.0))
    arm = pliant.connect("so101", scene=[push], **options)
    assert len(arm.drive.plant.fixtures) == 1
    assert [hand.hand for hand in arm.drive.plant.hands] == [push]
    assert pliant.connect("arm7", **options).drive.plant.fixtures == ()
    assert bare_arm("so101", handle_signals=False).drive.plant.fixtures == ()
    arm_config = config.load("so101", backend="sim")
    assert pliant.connect(arm_config, table=False, handle_signals=False).drive.plant.fixtures == ()
    assert pliant.connect(arm_config, table=-0.3, handle_signals=False).table == -0.3
    assert arm_config.robot.table == 0.0
    with pytest.raises(pliant.ConfigError, match=r"table is a height \[m\], or False"):
        pliant.connect("so101", table=True, **options)


@pytest.mark.parametrize("backend", ["sim", "emulator"])
def test_an_arm_that_would_start_inside_its_table_is_refused(backend):
    with pytest.raises(pliant.ConfigError, match=r"start 0\.\d+ m inside its table.*table=False"):
        pliant.connect("so101", backend=backend, q=[0.0, 1.5, 1.2, 0.0, 0.0])


def test_an_emulated_arm_stands_on_the_table_of_its_file():
    from pliant.config.factory import make_emulator

    bus = make_emulator(config.load("koch", backend="emulator"), clock="steps")
    assert [fixture.height for fixture in bus.plant.fixtures] == [0.0]
    bus = make_emulator(config.load("koch", backend="emulator", table=False), clock="steps")
    assert bus.plant.fixtures == ()


def test_a_simulated_arm_begins_at_its_rest_pose_where_zero_is_in_the_table():
    arm_config = config.parse(
        'backend = "sim"\nrobot = { builtin = "so101", table = 0.3 }\n[life]\n'
        "rest_q = [0.0, -0.3, -1.0, 0.0, 0.0]\n"
    )
    np.testing.assert_array_equal(
        factory.start_pose(arm_config, arm_config.model()), arm_config.life.rest_q
    )


def test_backend_sim_takes_the_options_of_the_simulator():
    q = [0.1, -0.3, 0.3, 0.9, 0.0]
    options = {"q": q, "kp_scale": 1.2, "seed": 3, "payload": (0.1, (0.0, 0.0, 0.0))}
    with Mismatch(plant=Parameters(kp=1.2, payload=0.1), assumed=Parameters()):
        arm = pliant.connect("so101", backend="sim", rate=50.0, handle_signals=False, **options)
    np.testing.assert_allclose(arm.drive.plant.q, q)
    assert (arm.rate, arm.drive.plant.rate) == (50.0, 50.0)
    simulated = {"backend": "sim", "handle_signals": False}
    assert pliant.connect("so101", real_time=True, **simulated).clock.real_time
    with pytest.raises(pliant.ConfigError, match=r"'scen'.*did you mean 'scene'"):
        pliant.connect("so101", scen=[], **simulated)
    for backend in ("bus", "emulator"):
        with pytest.raises(pliant.ConfigError, match=rf"'scene' is an option.*{backend}.*\"sim\""):
            pliant.connect("so101", backend=backend, scene=[])
    with pytest.raises(pliant.ShapeError, match="q has shape"):
        pliant.connect("so101", backend="sim", q=[0.0])


def test_an_arm_has_the_name_that_the_user_gave(tmp_path):
    file = tmp_path / "left.toml"
    file.write_text(config.loader.builtin_text("so101"))
    simulated = {"backend": "sim", "handle_signals": False}
    for source, options, name in (
        ("so101", {}, "so101"),
        (file, {}, "left"),
        (file, {"name": "right"}, "right"),
        (config.load(file, backend="sim"), {}, "left"),
    ):
        kind = simulated if isinstance(source, str | type(file)) else {"handle_signals": False}
        arm = pliant.connect(source, **kind, **options)
        assert arm.name == name
        assert repr(arm).startswith(f"<Arm {name}, ")
    text = config.loader.parse(config.loader.builtin_text("so101"), backend="sim")
    assert pliant.connect(text).name == "so101_like"
    with pytest.raises(TypeError, match=r"name must be a str, got 5 \(int\)"):
        pliant.connect("so101", name=5, **simulated)


def test_the_kind_of_a_simulated_arms_servos_is_an_option_of_the_plant():
    table = pliant.config.load("so101").model().servos.replace(limit_type="current")
    arm = pliant.connect("so101", backend="sim", servos=table, handle_signals=False)
    assert arm.drive.plant.table.limit_type == "current"


def test_the_typed_options_of_connect_are_those_of_arm_and_plant():
    def keywords(arm):
        return frozenset(signature(arm).parameters)

    assert keywords(pliant.Arm) - {"model", "drive"} == ARM_OPTIONS
    assert keywords(pliant.sim.Plant) - {"model", "rate"} == PLANT_OPTIONS


@pytest.mark.parametrize("soft", ["", "x y"])
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_joint_targets_lead_an_arm_out_of_its_rest_pose(name, soft):
    target = np.array([0.0, -0.3, 0.3, 0.9, 0.0])
    with pliant.connect(name, backend="sim", q=config.load(name).life.rest_q) as arm:
        controller = pliant.Controller(
            arm.model,
            pliant.Settings.soft(soft, task="xyz") if soft else pliant.Settings(task="xyz"),
            arm.servos,
        )
        for tick in pliant.Loop(arm, controller, duration=5.0):
            tick.write(controller.step_joints(tick.q, target, dt=tick.dt))
        arm.leave_enabled()
    # Joints may miss the target, because friction stops the null-space motion early: the largest
    # measured distance is 0.01 to 0.22 rad, and 1.4 rad if the arm gets stuck.
    np.testing.assert_allclose(tick.q, target, atol=0.3)
    tool, target_tool = (arm.model.forward_kinematics(q)[:3, 3] for q in (tick.q, target))
    # On a soft axis, friction larger than the cap keeps the tool from reaching its target.
    assert np.linalg.norm(tool - target_tool) < (
        0.04 if soft else 0.02
    )  # [m], measured 0.027, 0.014
