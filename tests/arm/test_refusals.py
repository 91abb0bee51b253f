"""Commands of a program that are rejected, and those that cause a warning."""

from types import SimpleNamespace

import numpy as np
import pytest

import pliant
from pliant.arm._checks import check_same_robot, join_faults


def write_for(arm, limit, seconds=0.5):
    """Write the same torque limit at every tick, as a program without a controller does."""
    q = arm.read().q
    for tick in pliant.Loop(arm, duration=seconds):
        tick.write(SimpleNamespace(goal=q, torque_limit=limit))


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_limits_below_the_weight_are_sent_with_one_warning(make, grasp, share):
    arm = make()
    weight = np.abs(arm.model.gravity(grasp))
    with arm:
        write_for(arm, share * weight, 0.15)
        with pytest.warns(
            RuntimeWarning, match=r"may exert .* N·m, and this pose needs .*disable_torque"
        ):
            write_for(arm, share * weight, 0.4)
        assert arm.drive.diary[-1][2] == pytest.approx(share * weight)
        write_for(arm, share * weight)
        arm.disable_torque()


def test_limits_that_carry_the_weight_and_a_controllers_are_not_warned_of(make, grasp):
    with make() as arm:
        weight = np.abs(arm.model.gravity(grasp))
        write_for(arm, 0.6 * weight, 0.1)
        write_for(arm, 1.1 * weight)
        # This controller's torque limits lack gravity on purpose, so that the arm sags.
        controller = pliant.Controller(
            arm.model, pliant.Settings.soft("x y z", gravity=False), arm.servos
        )
        target = arm.model.forward_kinematics(arm.read().q)
        low = []
        for tick in pliant.Loop(arm, controller, duration=0.5):
            command = controller.step(tick.q, target, dt=tick.dt)
            tick.write(command)
            low.append((command.torque_limit < 0.5 * weight).any())
        assert any(low)
        arm.disable_torque()


def test_an_argument_of_another_kind_is_named(make, grasp):
    for value, error, message in (
        (lambda: make(power_budget=5), TypeError, r"power_budget must be a Budget.*got 5 \(int\)"),
        (lambda: make(power_budget=0), TypeError, r"power_budget must be a Budget.*got 0 \(int\)"),
        (lambda: make(grippers=5), TypeError, r"grippers must be a mapping, as .*got 5 \(int\)"),
        (
            lambda: make(grippers={"a": 5}),
            TypeError,
            r"grippers\['a'\] must be a GripperConfig, .*got 5",
        ),
        (lambda: pliant.Loop(make(), 5), TypeError, r"controller must be .*got 5 \(int\)"),
        (lambda: pliant.Loop(make(), recorder=5), TypeError, r"recorder must be .*got 5 \(int\)"),
    ):
        with pytest.raises(error, match=message):
            value()
    with make(q=None, robot="so101") as arm:
        q = arm.read().q
        for arguments, error, message in (
            ((q, None, 5), TypeError, r"extra must be a mapping, as \{'gripper': .*got 5 \(int\)"),
            ((q, None, 0), TypeError, r"extra must be a mapping, as \{'gripper': .*got 0 \(int\)"),
            (
                (q, None, {"gripper": 5}),
                pliant.ConfigError,
                "extra must be .*got 5 .int. for gripper",
            ),
            ((q, None, {"gripper": ("1", 1)}), pliant.ConfigError, "goal of gripper must be a num"),
            (
                (q, None, {"gripper": (0, True)}),
                pliant.ConfigError,
                "limit of gripper must be a num",
            ),
            ((q, None, {"gripper": (0, -1)}), pliant.OutOfRangeError, "limit >= 0, got 0 and -1"),
            (([True] * 5,), pliant.ShapeError, "goal must be 5 real numbers, got .*True"),
            ((q + 0j,), pliant.ShapeError, "goal must be 5 real numbers, got .*complex|j"),
            (([0j] * 5,), pliant.ShapeError, "goal must be 5 real numbers, got .*0j"),
            ((["1"] * 5,), pliant.ShapeError, "goal must be 5 real numbers, got .*'1'"),
            (([[1.0], 2.0],), pliant.ShapeError, "goal must be 5 real numbers"),
            ((q, q < 9.0), pliant.ShapeError, "limit must be 5 real numbers"),
        ):
            before = len(arm.drive.diary)
            with pytest.raises(error, match=message):
                arm.write(*arguments)
            assert len(arm.drive.diary) == before
        for tick in pliant.Loop(arm):
            with pytest.raises(TypeError, match=r"command must be a Command.*got 5 \(int\)"):
                tick.write(5)
            with pytest.raises(pliant.ShapeError, match="goal must be 5 real numbers"):
                tick.write(SimpleNamespace(goal=q < 9.0, torque_limit=q))
            break
        arm.disable_torque()


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("comm_timeout", np.inf, "comm_timeout must be above 0 s and at most 60 s, got inf"),
        ("comm_timeout", 1e9, "at most 60 s, got 1e[+]09"),
        ("comm_timeout", np.nan, "at most 60 s, got nan"),
        ("comm_timeout", True, "comm_timeout must be a number, got True"),
        ("rate", "100", "rate must be a number, got '100'"),
        ("rate", np.inf, "rate must be above 0 Hz and finite, got inf"),
        ("watchdog", np.inf, "watchdog must be 0 s .*got inf"),
    ],
)
def test_times_that_would_keep_an_arm_up_for_ever_are_refused(make, option, value, message):
    with pytest.raises(pliant.ConfigError, match=message):
        make(**{option: value})


@pytest.mark.parametrize("make_controller", [pliant.Controller, pliant.HandGuiding])
def test_a_controller_of_another_robot_is_refused(make, make_controller):
    arm = make(q=None, robot="so101")
    settings = (pliant.Settings(task="xyz"),) if make_controller is pliant.Controller else ()
    stranger = pliant.robots.koch()
    assert stranger.joint_names == arm.model.joint_names
    for model, message in (
        (stranger, "made for koch_like, the arm is so101_like .joint shoulder_pan has another"),
        (pliant.robots.arm7(), "made for .*, the arm is so101_like .joints .*, not shoulder_pan"),
    ):
        controller = make_controller(model, *settings)
        with pytest.raises(pliant.ConfigError, match=message):
            pliant.Loop(arm, controller)


AXIS = np.array([0.0, 0.6, 0.8])


def turned(angle):
    """Return a rotation about x [rad] as a homogeneous matrix."""
    matrix = np.eye(4)
    matrix[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return matrix


def shifted(distance):
    matrix = np.eye(4)
    matrix[1, 3] = distance
    return matrix


@pytest.mark.parametrize(
    ("change", "is_same"),
    [
        ({}, True),
        ({"kind": "prismatic"}, False),
        ({"axis": turned(0.04)[:3, :3] @ AXIS}, True),
        ({"axis": turned(0.08)[:3, :3] @ AXIS}, False),
        ({"axis": -AXIS}, False),
        ({"matrix": turned(-0.04)}, True),
        ({"matrix": turned(-0.06)}, False),
        ({"matrix": shifted(-0.004)}, True),
        ({"matrix": shifted(-0.006)}, False),
    ],
)
def test_a_joint_with_another_place_axis_or_type_is_another_joint(change, is_same):
    plain = {"kind": "revolute", "axis": AXIS, "matrix": np.eye(4)}

    def robot(**lift):
        joints = [
            SimpleNamespace(
                name=name,
                kind=values["kind"],
                axis=values["axis"],
                origin=SimpleNamespace(matrix=values["matrix"]),
            )
            for name, values in (("pan", plain), ("lift", {**plain, **lift}))
        ]
        return SimpleNamespace(name="robot", joints=joints, joint_names=("pan", "lift"))

    if is_same:
        check_same_robot(robot(**change), robot())
        return
    with pytest.raises(pliant.ConfigError, match="joint lift has another place, axis or type"):
        check_same_robot(robot(**change), robot())


def test_a_controller_with_another_tip_mass_or_range_is_accepted(make):
    arm = make(q=None, robot="so101")
    text, options = arm.model.source
    low, high = arm.model.lower[0] + 0.1, arm.model.upper[0]
    for description, other in (
        (text, {"tip": arm.model.links[5].name}),
        (text, {"payload": pliant.Payload(0.05)}),
        (text, {"limits": {"shoulder_pan": (low, high)}}),
        (text.replace('<mass value="0.', '<mass value="0.1'), {}),
    ):
        model = pliant.Model.from_urdf_str(description, **{**options, **other})
        pliant.Loop(arm, pliant.Controller(model, pliant.Settings(task="xyz")))


@pytest.mark.parametrize("patience", [np.nan, -1.0, 0.0, "x"])
def test_an_invalid_timeout_is_refused(make, patience):
    with pytest.raises(pliant.ConfigError, match=r"patience must be .*, got"):
        make().supervised(patience)


def test_joints_with_the_same_fault_are_named_together():
    off, low = "its torque went off by itself: look at plug", "supply voltage outside its limits"
    faults = (f"a: {off}", f"b: {low}", f"c: {off}", f"d (id 4): {low}", "a fault of a drive")
    assert join_faults(faults) == f"a, c: {off}; b, d (id 4): {low}; a fault of a drive"
