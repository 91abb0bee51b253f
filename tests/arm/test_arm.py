"""The life cycle of an arm: order of commands, exits, off-chain joints, errors."""

import copy
import logging
import os
import pickle
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from bare_arm import bare_arm
from mismatch import Mismatch, Parameters

import pliant
import pliant.arm.arm
from pliant._core import JointReadings
from pliant.arm import Arm, Budget, GripperConfig
from pliant.arm._guardian import _running
from pliant.arm._io import RESUME_READS, ArmIO, JointMap, LowTorqueWarning
from pliant.arm._messages import MESSAGES, Message
from pliant.arm._supervisor import Supervisor
from pliant.arm.gripper import Gripper
from pliant.drive import ServoStatus
from pliant.loop import Loop
from pliant.sim import Plant, SimDrive


def test_order_from_torque_on_to_torque_off(make, grasp):
    arm = make()
    with arm:
        assert arm.enabled
    assert arm.drive.verbs() == [
        *("enable", "write", "watchdog", "write", "watchdog", "disable", "write")
    ]
    _, goal, limit = arm.drive.diary[0]
    gravity, kp = arm.model.gravity(grasp), np.asarray(arm.servos.kp)
    # Goal and limit of the first command hold the arm's weight; the limit has a small margin.
    assert goal == pytest.approx(grasp + gravity / kp)
    assert limit == pytest.approx(1.1 * np.abs(gravity) + 2 * np.asarray(arm.servos.friction))
    assert not arm.enabled
    assert not arm.drive.enabled.any()


def test_an_arm_without_torque_gets_goals_where_its_joints_are(make, grasp):
    arm = make()
    arm.drive.disable(arm.drive.names)
    q = arm.read().q
    arm.enable()
    assert arm.drive.diary[-1][0] == "watchdog"
    _, goal, _ = next(entry for entry in arm.drive.diary if entry[0] == "enable")
    assert goal == pytest.approx(q)
    arm.disable_torque()


def test_a_watchdog_that_may_have_tripped_is_cleared_before_anything_is_sent(make):
    arm = make(watchdog=0.2)
    arm.enable()
    q = arm.read().q
    arm.clock.wait_until(arm.clock.now() + 1.0)
    before = len(arm.drive.diary)
    arm.write(q)
    assert arm.drive.diary[before][:2] == ("watchdog", 0.0)
    assert arm.drive.diary[before + 1][:2] == ("watchdog", 0.2)
    assert [verb for verb, *_ in arm.drive.diary[before + 2 :]] == ["write"]
    arm.leave_enabled()


def test_taking_over_does_not_let_the_tool_dip(make):
    arm = make(plant={"delay": (1, 1)})
    height = arm.drive.plant.tool[2, 3]
    arm.enable()
    assert abs(arm.drive.plant.tool[2, 3] - height) < 1e-3
    arm.leave_enabled()


def test_limits_rise_and_never_exceed_what_was_asked(make):
    arm = make()
    arm.enable()
    q, torque = arm.read().q, np.asarray(arm.servos.max_torque)
    arm.write(q, torque)
    first = arm.drive.diary[-1][2]
    assert np.all(first < 0.6 * torque)
    arm.clock.wait_until(arm.clock.now() + 0.6)
    arm.read()
    arm.write(q, torque)
    assert arm.drive.diary[-1][2] == pytest.approx(torque)
    arm.write(q, 0.0 * torque)
    assert arm.drive.diary[-1][2] == pytest.approx(0.0 * torque)
    arm.leave_enabled()


def test_goals_stay_within_position_limits_and_what_the_weight_needs(make):
    with make() as arm:
        arm.read()
        arm.write(arm.model.upper + 0.9, np.zeros(7))
        lead = np.abs(arm.model.gravity(arm.read().q)) / np.asarray(arm.servos.kp)
        assert np.all(arm.drive.diary[-1][1] <= arm.model.upper + lead + 1e-9)
        assert np.all(arm.drive.diary[-1][1] >= arm.model.upper - 1e-9)
        arm.leave_enabled()


def test_invalid_commands_are_not_sent(make, grasp):
    arm = make()
    with pytest.raises(pliant.ServoError, match="torque is off"):
        arm.write(grasp)
    with arm:
        before = len(arm.drive.diary)
        for goal, limit, error in (
            (np.full(7, np.nan), None, pliant.OutOfRangeError),
            (grasp[:3], None, pliant.ShapeError),
            (grasp, -np.ones(7), pliant.OutOfRangeError),
            (grasp, np.full(7, np.inf), pliant.OutOfRangeError),
        ):
            with pytest.raises(error):
                arm.write(goal, limit)
        with pytest.raises(pliant.ConfigError, match="no joint 'claw' off the chain"):
            arm.write(grasp, None, {"claw": (0.0, 1.0)})
        assert len(arm.drive.diary) == before
        arm.leave_enabled()


def test_an_exception_lowers_the_arm_and_is_raised_again(make):
    arm = make()
    with pytest.raises(ZeroDivisionError), arm:
        _ = 1 / 0
    assert not arm.enabled
    plant = arm.drive.plant
    assert plant.tool[2, 3] < -0.6
    # A joint that friction stopped before its rest position may still swing toward it.
    assert np.linalg.norm(plant.ground_truth.frame("tool").twist()[:3]) < 0.03
    for _ in range(100):
        plant.advance()
    assert np.abs(plant.dq).max() < 0.1


def test_leave_enabled_leaves_torque_on(make, grasp):
    with make() as arm:
        arm.leave_enabled()
    assert arm.drive.enabled.all()
    assert "disable" not in arm.drive.verbs()
    arm.drive.clock.wait_until(arm.clock.now() + 2.0)
    assert np.abs(arm.drive.plant.q - grasp).max() < 0.01
    with make(on_exit="leave_enabled") as arm:
        pass
    assert arm.drive.enabled.all()


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
def test_an_arm_is_not_copied_but_its_parts_are(make, duplicate):
    arm = make()
    for part in (arm.model, arm.servos, pliant.Controller(arm.model, None, arm.servos)):
        duplicate(part)
    with pytest.raises(TypeError, match=r"cannot be copied.*can be pickled"):
        duplicate(arm)


def test_an_arm_that_was_left_on_is_lowered_only_after_enable(quick):
    def leave():
        quick.leave_enabled()

    def stop():
        quick.is_down = False
        quick.lower()
        quick.is_down = True

    for leave_on in (leave, stop):
        quick.enable()
        leave_on()
        count = len(quick.descents)
        quick.drive.calls.clear()
        for lower in (quick.lower, quick.park):
            with pytest.raises(pliant.ServoError, match=r"arm\.enable\(\).*then arm\.lower\(\)"):
                lower()
        assert quick.drive.calls == []
        quick.enable()
        quick.lower()
        assert len(quick.descents) == count + 1
        quick.lower()  # torque is off: nothing to do
    quick.enable()
    quick.leave_enabled()
    quick.disable_torque()
    quick.lower()
    assert len(quick.descents) == count + 1


def test_disable_torque_switches_off_at_once(make):
    with make() as arm:
        before = arm.clock.now()
        arm.disable_torque()
        assert arm.clock.now() == before
    assert not arm.drive.enabled.any()


def test_park_needs_a_rest_pose_and_moves_there(make):
    arm = make()
    with arm:
        with pytest.raises(pliant.ConfigError, match="no pose to park in"):
            arm.park()
        with pytest.raises(pliant.OutOfRangeError):
            arm.park(np.full(7, np.nan))
        assert arm.enabled
        pose = np.array((-0.3, -0.1, 0.0, -0.9, 0.0, 0.0, 0.0))
        nearest = []
        arm.drive.clock.on_tick = lambda: nearest.append(np.abs(arm.drive.plant.q - pose).max())
        arm.park(pose)
    assert min(nearest) < 0.1


def test_a_bus_that_is_gone_ends_the_descent_with_advice(make):
    arm = make()
    with pytest.raises(pliant.ServoError, match="support the arm"), arm:
        arm.drive.broken = True
    arm = make()

    def fail():
        with arm:
            arm.drive.broken = True
            raise KeyError("first")

    with pytest.raises(KeyError) as error:
        fail()
    assert "while the arm was being lowered" in error.value.__notes__[0]


def test_joints_that_do_not_answer_are_named_before_torque_goes_on(make):
    arm = make()
    arm.drive.silent = {"wrist_pitch"}
    before = arm.clock.now()
    with pytest.raises(pliant.ServoTimeoutError, match="no answer from wrist_pitch"):
        arm.enable()
    # Ten readings at 100 Hz.
    assert arm.clock.now() - before == pytest.approx(0.1)
    assert arm.drive.diary == []
    assert not arm.enabled


@pytest.mark.parametrize(("direction", "is_accepted"), [(0.05, True), (-0.05, True), (0.5, False)])
def test_a_joint_far_outside_its_limits_gets_no_torque(make, grasp, direction, is_accepted):
    arm = make()
    original, model = arm.drive.read, arm.model
    low, high = model.lower[3], model.upper[3]

    def misplaced():
        sample = original()
        sample.position[3] = high + direction if direction > 0.0 else low + direction
        return sample

    arm.drive.read = misplaced
    assert arm.drive.read().position[3] != pytest.approx(
        arm.drive.plant.q[3], abs=abs(direction) / 2
    )
    if is_accepted:  # the joint rests on its stop
        arm.enable()
        assert arm.read().q[3] == (high if direction > 0.0 else low) + direction
        arm.disable_torque()
        return
    message = (
        rf"elbow_pitch stands at {high + direction:.2f} rad, "
        rf"outside its {low:.2f} to {high:.2f}.*doctor"
    )
    with pytest.raises(pliant.ServoError, match=message):
        arm.enable()
    assert arm.drive.diary == []
    assert not arm.enabled


@pytest.mark.parametrize("robot", ["arm7", "so101", "koch"])
def test_an_arm_that_was_dropped_starts_from_its_present_position(make, robot):
    arm = make(q=None, robot=robot)
    upper = np.asarray(arm.model.upper)
    arm.drive.plant.reset(np.where(np.isfinite(upper), 0.9 * upper, 0.0))
    arm.enable()
    arm.disable_torque()
    arm.clock.wait_until(arm.clock.now() + 2.0)
    arm.enable()
    assert arm.enabled
    arm.disable_torque()


def test_implausible_readings_are_not_used(make):
    arm = make()
    arm.enable()
    first = arm.read()
    arm.drive.silent = {"elbow_pitch"}
    arm.clock.wait_until(arm.clock.now() + 0.1)
    state = arm.read()
    assert not state.fresh
    assert state.age[3] == pytest.approx(0.1)
    assert state.q[3] == first.q[3]
    arm.drive.silent = set()
    assert arm.read().fresh
    arm.drive.plant.mj_data.qpos[3] += 1.2
    arm.clock.wait_until(arm.clock.now() + 0.01)
    assert not arm.read().fresh
    assert arm.counters["jumps"] > 0
    arm.leave_enabled()


def test_voltage_and_temperature_are_those_of_the_servo_that_reported_them(make):
    arm = make()
    arm.enable()
    q, reports = arm.read().q, [(11.5, 41.0), (11.0, None), (None, 45.0)]
    arm.drive.poll_status = lambda: ServoStatus("elbow_pitch", *reports.pop(0), ())
    for voltage, temperature in ((11.5, 41.0), (11.0, 41.0), (11.0, 45.0)):
        arm.write(q)
        state = arm.read()
        assert (state.voltage[3], state.temperature[3]) == (voltage, temperature)
        assert np.isnan(np.delete([state.voltage, state.temperature], 3, axis=1)).all()
    arm.drive.poll_status = lambda: None
    arm.leave_enabled()


def test_a_gripper_holds_on_while_the_arm_comes_down(make):
    arm = make(q=None, robot="so101", grippers={"gripper": GripperConfig(lever=0.05)})
    with arm:
        gripper = arm.gripper
        assert gripper.limit == pytest.approx(0.3 * gripper.max_limit)
        gripper.open()
        arm.clock.wait_until(arm.clock.now() + 1.0)
        arm.read()
        assert gripper.width == pytest.approx(0.1 * np.sin(1.7 / 2), rel=0.1)
        gripper.close(force=2.0)
        assert arm.drive.diary[-1][2][5] == pytest.approx(0.1)  # [N·m] of 2 N at 50 mm
        with pytest.raises(pliant.ConfigError, match="force must be between 0 and"):
            gripper.close(force=1e3)
        with pytest.raises(pliant.ConfigError, match=r"gripper: force must be a number, got '1'"):
            gripper.close(force="1")
        with pytest.raises(pliant.ConfigError, match="not finite"):
            gripper.go(np.nan)
        arm.write(arm.read().q, None, {"gripper": (0.2, 0.05)})
        assert arm.drive.diary[-1][2][5] == pytest.approx(0.05)
    orders = [(goal[5], limit[5]) for verb, goal, limit in arm.drive.diary if verb == "write"]
    assert set(orders[-20:-1]) == {(0.2, 0.05)}


def test_limit_and_lever_of_a_gripper_are_checked():
    assert GripperConfig(limit=0.0, lever=1e-3).limit == 0.0
    for options, message in (
        ({"limit": -0.1}, "limit must be at least 0"),
        ({"limit": np.nan}, "limit must be at least 0"),
        ({"lever": 0.0}, "lever must be above 0"),
        ({"lever": np.nan}, "lever must be above 0"),
    ):
        with pytest.raises(pliant.ConfigError, match=message):
            GripperConfig(**options)


def gripper_of(robot="so101", *, overload=1.0, at=0.0, **options):
    """Return the gripper of a model without a drive, and the list of its orders."""
    orders, model = [], pliant.robots.load(robot)
    (name,) = {j.name for j in model.joints if j.kind != "fixed"} - set(model.joint_names)
    gripper = Gripper(
        name,
        GripperConfig(**options),
        model,
        max_limit=2.0,
        overload=overload,
        order=lambda *order: orders.append(order[1:]),
        measure=lambda _: at,
    )
    return gripper, orders


@pytest.mark.parametrize(
    ("options", "limit"),
    [
        ({}, 0.3 * 2.0),
        ({"overload": 0.2}, 0.9 * 0.2 * 2.0),
        ({"overload": 0.2, "limit": 1.5}, 1.5),
        ({"limit": 2.5}, 2.0),
    ],
)
def test_a_gripper_closes_with_its_default_limit(options, limit):
    gripper, orders = gripper_of(opened=1.5, closed=-0.1, **options)
    gripper.close()
    gripper.open()
    gripper.close(1.2)
    for position in (9.0, -9.0, 0.4):
        gripper.go(position)
    assert orders[:3] == [(-0.1, pytest.approx(limit)), (1.5, pytest.approx(limit)), (-0.1, 1.2)]
    assert [goal for goal, _ in orders[3:]] == [1.5, -0.1, 0.4]


@pytest.mark.parametrize("closed", [-0.1, 3.0])
def test_a_grip_force_acts_at_the_lever(closed):
    gripper, orders = gripper_of(opened=1.5, closed=closed, lever=0.5, at=1.1)
    gripper.close(4.0)
    assert orders == [(closed, 2.0)]  # [N·m]
    for force in (-0.1, 4.1, np.nan):
        with pytest.raises(pliant.ConfigError, match="force must be between 0 and 4, got"):
            gripper.close(force)
    assert len(orders) == 1
    assert gripper.width == pytest.approx(2.0 * 0.5 * np.sin(abs(1.1 - closed) / 2.0))
    gripper._measure = lambda _: closed + 4.0  # beyond half a turn
    assert gripper.width == pytest.approx(1.0)


def test_the_ends_of_a_gripper_come_from_the_model_or_the_configuration():
    joint = next(j for j in pliant.robots.so101().joints if j.name == "gripper")
    gripper, _ = gripper_of(at=joint.lower + 0.3)
    assert (gripper.closed, gripper.opened) == (joint.lower, joint.upper)
    assert gripper.width == pytest.approx(0.3)  # [rad]
    for ends, missing in (({"closed": 0.0}, "opened"), ({"opened": 0.0}, "closed")):
        given = {"opened": np.inf, "closed": np.inf} | ends
        with pytest.raises(pliant.ConfigError, match=rf"GripperConfig\({missing}="):
            gripper_of(**given)


def test_arguments_of_an_arm_that_do_not_match_are_named(make):
    model = pliant.robots.arm7()
    drive = SimDrive(Plant(pliant.robots.so101()))
    with pytest.raises(pliant.ConfigError, match="no servo is named shoulder_pitch"):
        Arm(model, drive)
    for robot, known in (("arm7", "none"), ("so101", "gripper")):
        with pytest.raises(pliant.ConfigError, match=f"no joint 'claw' off the chain.*: {known}$"):
            make(q=None, robot=robot, grippers={"claw": GripperConfig()})
    with pytest.raises(pliant.ConfigError, match="exit must be"):
        make(on_exit="disable_torque")
    with pytest.raises(pliant.ConfigError, match="needs one joint off the chain"):
        _ = make().gripper


def test_connect_by_name_and_by_parts():
    arm = bare_arm("so101", rate=200.0, rest_q=np.zeros(5))
    assert (arm.model.n, arm.rate, arm.clock.period) == (5, 200.0, 0.005)
    assert pliant.connect("so101", backend="sim", rate=50.0).rate == 50.0
    assert pliant.Arm(arm.model, arm.drive).drive is arm.drive
    for arguments, message in (
        (lambda: pliant.connect({"kind": "bus"}), "cannot connect to"),
        (lambda: pliant.connect("arm.toml"), "no file arm.toml"),
        (lambda: pliant.connect("so102"), "did you mean 'so101'"),
        (lambda: pliant.connect(arm.model), r"use pliant\.Arm\(model, drive\)"),
        (
            lambda: pliant.connect(pliant.config.load("so101"), backend="sim"),
            r"pliant\.config\.load\(\.\.\., backend=",
        ),
    ):
        with pytest.raises(pliant.ConfigError, match=message):
            arguments()


def test_a_misspelt_option_is_named_before_a_port_is_looked_for():
    for option, suggestion in (
        (lambda: pliant.connect("so101", backned="sim"), "'backned' here; did you mean 'backend'"),
        (lambda: pliant.connect("so101", on_exti="leave_enabled"), "did you mean 'on_exit'"),
        (
            lambda: pliant.connect(pliant.config.load("so101"), on_exti="leave_enabled"),
            "did you mean 'on_exit'",
        ),
        (lambda: pliant.connect("so101", q=[0.0] * 5), "'q' is an option of a simulated arm"),
    ):
        with pytest.raises(pliant.ConfigError, match=suggestion):
            option()


def test_degrees_are_refused_before_anything_is_sent():
    with pytest.raises(pliant.OutOfRangeError, match=r"rest_q: .*degrees"):
        bare_arm("so101", rest_q=[0, -90, 90, 40, 0])
    with bare_arm("so101", handle_signals=False) as arm:
        goal = arm.read().q.copy()
        goal[1] = -90.0
        with pytest.raises(pliant.OutOfRangeError, match=r"goal of shoulder_lift .*degrees"):
            arm.write(goal, np.ones(5))
        with pytest.raises(pliant.OutOfRangeError, match="pose: "):
            arm.park(goal)
        arm.disable_torque()


def test_controllers_made_from_the_model_assume_the_arms_servos():
    model = pliant.robots.so101()
    plant = pliant.sim.Plant(model)
    arm = pliant.Arm(model, SimDrive(plant, servos=plant.table.replace(kp=[9.0] * 5)))
    assert arm.model.servos.kp.tolist() == arm.servos.kp.tolist()
    assert arm.model.servos.kp.tolist() != pliant.robots.so101().servos.kp.tolist()
    # The true servo parameters of the simulation are unknown to the arm.
    with Mismatch(plant=Parameters(kp=2.0), assumed=Parameters()):
        arm = bare_arm("so101", kp_scale=2.0)
    assert arm.servos.kp.tolist()[:5] == model.servos.kp.tolist()


def test_connect_names_an_invalid_arm():
    for nothing in (42, None):
        with pytest.raises(pliant.ConfigError, match="cannot connect to"):
            pliant.connect(nothing)


class Drive:
    """Drive of an SO-101 in simulated time whose replies and registers a test sets.

    Attributes:
        silent: Indices of the joints that do not answer.
        calls: Watchdog times and the word `write`, in order.
    """

    latency = 0.004

    def __init__(self):
        model = pliant.robots.so101()
        self.model, self.names = model, (*model.joint_names, "gripper")
        self.servos = SimDrive(Plant(model)).servos
        self.position, self.silent, self.reads = np.full(6, 0.1), set(), 0
        self.enabled, self.goals, self.limits = np.ones(6, dtype=bool), np.zeros(6), np.zeros(6)
        self.time, self.calls, self.clock = 100.0, [], self

    def now(self):
        return self.time

    def wait_until(self, deadline):
        self.time = deadline

    def read(self):
        self.reads += 1
        is_silent = np.isin(np.arange(6), list(self.silent))
        return JointReadings(np.where(is_silent, np.nan, self.position), ~is_silent, self.time)

    def reopen(self):
        unknown = np.isin(np.arange(6), list(self.silent))
        return np.where(unknown, np.nan, self.goals), np.where(unknown, np.nan, self.limits)

    def watchdog(self, seconds):
        self.calls.append(seconds)

    def poll_status(self):
        return None

    def __getattr__(self, name):
        """Return a method that only records its call."""
        if name not in {"open", "close", "enable", "disable", "write"}:
            raise AttributeError(name)
        return lambda *_, **__: self.calls.append(name)


@pytest.fixture
def io():
    drive = Drive()
    return ArmIO(drive.model, drive, Budget())


def test_an_arm_is_resumed_with_the_commands_in_its_registers(io):
    drive = io.drive
    drive.goals, drive.limits = np.linspace(0.2, 0.7, 6), np.linspace(1.0, 1.5, 6)
    drive.silent, drive.enabled = {1}, np.array([True, True, False, True, True, True])
    drive.goals[2] = drive.limits[2] = np.nan  # registers of a joint without torque
    assert io.resume(100.0)
    # `resume` reads until all joints answer, but at most `RESUME_READS` times more.
    assert drive.reads == RESUME_READS + 1
    assert drive.time == pytest.approx(100.0 + 0.01 * RESUME_READS)
    assert io.unknown_joints() == ["shoulder_lift"]
    assert io.goal == pytest.approx([0.2, np.nan, 0.1, 0.5, 0.6], nan_ok=True)
    assert io.limit == pytest.approx([1.0, 0.0, 0.0, 1.3, 1.4])
    assert io.orders == {"gripper": (pytest.approx(0.7), pytest.approx(1.5))}
    assert io.resume_silent() is None
    assert io.outdated().tolist() == [False, True, False, False, False]
    drive.silent = set()
    io.sample()
    drive.goals[0] = 9.0  # must not replace the goal of a joint that had answered
    assert io.resume_silent().tolist() == [False, True, False, False, False]
    assert not io.outdated().any()
    assert not io.unknown_joints()
    assert (io.goal[:2], io.limit[:2]) == (pytest.approx([0.2, 0.3]), pytest.approx([1.0, 1.1]))
    assert io.resume_silent() is None


class Watching:
    """Guardian of an arm of this program, without a process of its own."""

    def __init__(self, supervisor):
        self._supervisor = supervisor
        _running.add(self)


@pytest.fixture
def quick(monkeypatch, io):
    """Return an arm whose torque-on and descent take no time; record its messages."""
    io.drive.enabled[:] = False
    arm = Arm(io.model, io.drive, watchdog=0.3, rest_q=np.zeros(5), comm_timeout=0.7)
    arm.texts, arm.descents, arm.is_down, arm.error = [], [], True, None

    def descend(io, rest, rate, is_aborted, *, on_tick, **_):
        arm.descents.append(rest)
        arm._supervisor.heartbeat[0] = 0.0
        other = Watching(Supervisor(lambda: None))
        on_tick(SimpleNamespace(phase="down"))
        assert arm._supervisor.heartbeat[0] > 0.0  # read by the guardian
        assert other._supervisor.heartbeat[0] > 0.0  # read by the guardian of another arm
        assert arm._supervisor.heartbeat[1] == 0.7
        if arm.error is not None:
            raise arm.error
        return arm.is_down

    def post(text, level=logging.INFO, **_):
        arm.texts.append((text, level))
        return Message(text, level)

    monkeypatch.setattr(pliant.arm.arm, "descend", descend)
    monkeypatch.setattr(pliant.arm.arm, "transfer_weight", lambda *_: np.zeros(5))
    monkeypatch.setattr(MESSAGES, "post", post)
    return arm


def test_an_arm_goes_through_its_life(quick):
    handler = signal.getsignal(signal.SIGINT)
    assert "not enabled" in repr(quick)
    with quick:
        assert "joints, enabled" in repr(quick)
        assert quick.drive.calls == ["open", "enable", 0.3]
        assert quick._supervisor.heartbeat[1] == 0.0
        assert signal.getsignal(signal.SIGINT) != handler
        quick.enable()  # changes nothing
        quick.open()
        quick.drive.calls.clear()
    assert quick.drive.calls == [0.0, "disable", "close"]
    assert quick.descents[0].tolist() == [0.0] * 5
    assert [level for _, level in quick.texts] == [logging.DEBUG] * 2
    assert signal.getsignal(signal.SIGINT) == handler
    assert not quick.enabled
    assert "not enabled" in repr(quick)


def test_a_fault_that_comes_during_the_descent_is_told_once(quick, monkeypatch):
    def descend(*_, on_tick, **__):
        for _ in range(3):
            on_tick(SimpleNamespace(phase="down"))
        return True

    monkeypatch.setattr(pliant.arm.arm, "descend", descend)
    off, hot = "its torque went off by itself", "b is at {} °C and its limit is 68 °C: let it cool"
    found = [("a: old",), ("a: old", f"c: {off}", hot.format(68)), (f"d: {off}", hot.format(69.5))]
    with quick:
        monkeypatch.setattr(ArmIO, "faults", lambda _: found.pop(0))
    texts = [text for text, level in quick.texts if level == logging.WARNING]
    assert texts == [f"so101_like, while it was lowered: c, d: {off}; {hot.format(68)}"]


@pytest.mark.parametrize(
    ("step", "error", "stays"),
    [
        ("_start_guardian", pliant.ServoError("not started"), False),
        ("_start_guardian", KeyboardInterrupt(), False),
        ("enable", pliant.ServoError("a joint moved"), False),
        ("enable", KeyboardInterrupt(), True),  # torque may be on: the arm is lowered next
    ],
)
def test_a_failure_at_torque_on_ends_the_control_of_the_arm(quick, monkeypatch, step, error, stays):
    def fail(*_, **__):
        raise error

    handler = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(quick.drive if step == "enable" else quick, step, fail, raising=False)
    with pytest.raises(type(error)):
        quick.enable()
    assert quick.enabled is stays
    assert (signal.getsignal(signal.SIGINT) == handler) is not stays
    quick.disable_torque()


def test_a_slow_bus_and_a_wrong_stiffness_are_warned_of_at_torque_on(quick, monkeypatch):
    monkeypatch.setattr(pliant.arm.arm, "stiffness_mismatch", lambda *_, **__: "elbow: too soft")
    read = quick.drive.read
    quick.drive.read = lambda: (read(), quick.drive.wait_until(quick.drive.time + 0.02))[0]
    quick.enable()
    assert [text.partition(":")[0] for text, _ in quick.texts] == [
        "reading all joints takes 20 ms, a period at 100 Hz 10 ms",
        "elbow",
    ]
    assert {level for _, level in quick.texts} == {logging.WARNING}
    for word in ("sink", "later", "latency timer", "baud rate"):
        assert word in quick.texts[0][0]
    quick.disable_torque()


@pytest.mark.parametrize(
    ("lowest", "expected"),
    [(6.4, "elbow: too soft"), (6.2, "shoulder_lift was between 6.2 and 7.4 V")],
)
def test_a_supply_that_sags_at_torque_on_is_not_taken_for_soft_servos(
    quick, monkeypatch, lowest, expected
):
    def transfer(io, *_):
        for voltage in (7.4, lowest, 7.3):
            io._update_status(ServoStatus("shoulder_lift", voltage, 30.0, ()))
        io._update_status(ServoStatus("elbow_flex", 7.2, 30.0, ()))
        return np.zeros(5)

    monkeypatch.setattr(pliant.arm.arm, "transfer_weight", transfer)
    monkeypatch.setattr(pliant.arm.arm, "stiffness_mismatch", lambda *_, **__: "elbow: too soft")
    quick.enable()
    quick.disable_torque()
    ((text, level),) = quick.texts
    assert expected in text
    assert level == logging.WARNING
    quick.texts.clear()
    monkeypatch.setattr(pliant.arm.arm, "transfer_weight", lambda *_: np.zeros(5))
    quick.enable()  # voltages that were read before torque on do not count
    quick.disable_torque()
    assert [text for text, _ in quick.texts] == ["elbow: too soft"]


def test_messages_of_a_real_arm_name_its_ports(quick):
    quick.drive.outlives_program = True
    quick.drive.specs = [SimpleNamespace(port=port) for port in ("left", "left", "right")]
    with quick:
        pass
    assert quick.texts[0][0].startswith("so101_like (left, right) is being lowered")
    assert quick.texts[-1][0].startswith("so101_like (left, right) was lowered: torque OFF")


def test_an_aborted_descent_holds_the_arm_and_says_so(quick):
    quick.is_down = False
    quick.enable()
    quick.drive.calls.clear()
    quick.lower()
    assert quick.drive.calls == ["write", 0.0]
    assert "torque ON" in quick.texts[-1][0]
    assert quick.texts[-1][1] == logging.WARNING


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (pliant.ServoError("gone"), "the bus is gone"),
        (pliant.ServoFaultError("rejected"), "(ServoFaultError: rejected): torque is ON in elbow"),
        (ZeroDivisionError("a bug"), "(ZeroDivisionError: a bug): torque is ON in elbow"),
    ],
)
def test_a_failed_descent_holds_the_arm_and_names_its_joints(quick, error, text):
    quick.enable()
    quick.error = error
    quick.drive.enabled[2] = True
    quick.drive.calls.clear()
    with pytest.raises(type(error)):
        quick.lower()
    assert quick.drive.calls == ["write", 0.0]
    assert text in quick.texts[-1][0]
    assert not quick.enabled
    state = r"failed; at the last replies torque was ON in elbow_flex: arm\.enable\(\)"
    for use in (quick.lower, lambda: quick.write(np.zeros(5)), lambda: next(iter(Loop(quick)))):
        with pytest.raises(pliant.ServoError, match=state):
            use()
    quick.error = None
    quick.enable()
    quick.lower()


def test_the_error_of_an_arm_without_control_says_what_its_torque_is(quick):
    with quick:
        quick.leave_enabled()
        with pytest.raises(pliant.ServoError, match=r"^torque was left ON: arm\.enable\(\)"):
            quick.write(np.zeros(5))
    quick.enable()
    quick.lower()
    with pytest.raises(pliant.ServoError, match=r"^torque is off: use"):
        quick.write(np.zeros(5))
    quick.enable()
    quick.error = pliant.ServoFaultError("rejected")
    quick._guardian = SimpleNamespace(close=lambda hand_over: None, rest=lambda: None)
    with pytest.raises(pliant.ServoFaultError):
        quick.close()
    with pytest.raises(pliant.ServoError, match=r"and the arm.s guardian lowers it: "):
        quick.write(np.zeros(5))
    quick.error = None
    quick.enable()
    quick.lower()


def test_an_error_of_the_program_carries_how_the_arm_was_left(quick):
    with pytest.raises(KeyError) as caught, quick:
        raise KeyError("policy")
    (note,) = caught.value.__notes__
    assert "was lowered: torque OFF" in note
    quick.error = pliant.ServoError("gone")
    with pytest.raises(KeyError) as caught, quick:
        raise KeyError("policy")
    assert caught.value.__notes__ == ["while the arm was being lowered: gone"]
    with pytest.raises(pliant.ServoError, match="gone"), quick:
        pass


@pytest.mark.parametrize("has_torque", [False, True])
@pytest.mark.parametrize("on_exit", ["lower", "leave_enabled"])
def test_the_guardian_ends_a_program_with_torque_as_configured(quick, has_torque, on_exit):
    quick._on_exit = on_exit
    quick.drive.goals[:] = 0.1 if has_torque else np.nan
    quick.drive.enabled[:] = has_torque
    quick._resume("the program has ended")
    assert len(quick.descents) == (has_torque and on_exit == "lower")
    assert ("disable" in quick.drive.calls) is (not has_torque or on_exit == "lower")
    assert (quick.drive.calls == ["write", 0.0]) is (has_torque and on_exit == "leave_enabled")
    first = quick.texts[0][0] if has_torque else ""
    if has_torque and on_exit == "lower":
        assert f"lowered (the program has ended). `kill -9 {os.getpid()}` leaves" in first
    assert not quick.enabled


def test_an_arm_is_lowered_at_the_end_of_the_interpreter(quick):
    quick.enable()
    quick._at_exit()
    assert "lowered (the program ends)" in quick.texts[0][0]
    assert quick.drive.calls[-1] == "close"
    quick._at_exit()
    assert len(quick.descents) == 1


@pytest.mark.parametrize("is_enabled", [False, True])
def test_a_signal_before_signals_are_held_back_lowers_the_arm_too(quick, is_enabled):
    if is_enabled:
        quick.enable()
    hold = quick._signals.hold

    def interrupted():
        quick._signals.hold = hold
        raise KeyboardInterrupt

    quick._signals.hold = interrupted
    with pytest.raises(KeyboardInterrupt):
        quick.close()
    assert len(quick.descents) == is_enabled


@pytest.mark.parametrize(("enabled", "has_torque"), [(False, False), (True, True)])
def test_an_arm_without_torque_is_not_resumed(io, enabled, has_torque):
    io.drive.goals[:] = io.drive.limits[:] = np.nan
    io.drive.enabled[:] = False
    io.drive.enabled[5] = enabled
    assert io.resume(100.0) is has_torque
    assert io.drive.reads == 1


@pytest.mark.parametrize("access", ["read", "write"])
def test_a_watchdog_is_armed_again_after_half_its_time(io, access):
    """The table has the time between two accesses [s], and the drive calls of the second one."""
    io.orders = {"gripper": (0.0, 0.1)}
    io.read()

    def act():
        io.read() if access == "read" else io.send(np.zeros(5), np.ones(5))

    own = ["write"] if access == "write" else []
    for seconds, expected in ((0.1, []), (0.12, [0.0, 0.2])):
        io.set_watchdog(0.2)
        io.drive.calls.clear()
        io.drive.time += seconds
        act()
        assert io.drive.calls == expected + own
    io.set_watchdog(0.0)
    io.drive.calls.clear()
    io.drive.time += 9.0
    act()
    assert io.drive.calls == own


def test_a_watchdog_is_armed_again_after_a_silence_of_the_servos(io):
    io.set_watchdog(0.2)
    io.drive.calls.clear()
    for silent in ({*range(6)}, {*range(6)}, {0}, set()):
        io.drive.silent = silent
        io.drive.time += 0.06
        io.read()
    assert io.drive.calls == [0.0, 0.2]


def test_the_age_of_positions_is_that_of_the_newest_and_of_the_drive(io):
    io.read()
    io.drive.silent, io.drive.time = {0}, 100.03
    io.read()
    assert io.delay(100.05) == pytest.approx(0.02 + 0.004)
    assert io.delay(100.0) == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("names", "chain", "is_view"),
    [
        ("a b c d", [1, 2], True),
        ("b c a d", [0, 1], True),
        ("c b a d", [1, 0], False),
        ("b a c d", [0, 2], False),
    ],
)
def test_joints_are_matched_by_name(names, chain, is_view):
    model = SimpleNamespace(joint_names=["b", "c"], velocity_limit=[3.0, np.inf])
    joints = JointMap(model, SimpleNamespace(names=names.split()))
    values = np.arange(4.0)
    assert joints.chain.tolist() == chain == values[joints.select].tolist()
    assert np.shares_memory(values[joints.select], values) is is_view
    assert sorted(joints.extra) == ["a", "d"]
    speeds = dict(zip(names.split(), joints.max_speeds(model), strict=True))
    assert speeds == {"a": 10.0, "b": 3.0, "c": 10.0, "d": 10.0}
    both = joints.join(np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    assert (both[joints.chain].tolist(), both[joints.off_chain].tolist()) == ([1, 2], [3, 4])


def test_a_drive_whose_joints_do_not_match_is_named():
    model = SimpleNamespace(joint_names=["b", "c"], name="robot", base="base", tip="tip")
    for names, message in (
        ("b c b", "two servos have one joint name: b, c, b"),
        ("c d", "named b"),
    ):
        with pytest.raises(pliant.ConfigError, match=message):
            JointMap(model, SimpleNamespace(names=names.split()))


def test_a_joint_that_jumps_or_overheats_is_a_fault(io):
    io.read()
    for seconds in range(1, 4):
        assert not io.faults()
        io.drive.time += 0.01
        io.drive.position = np.full(6, 0.1) + np.array([0.0, 2.0 + seconds, 0.0, 0.0, 0.0, 0.0])
        io.read()
    (fault,) = io.faults()
    assert fault.startswith("shoulder_lift: its position jumped by")
    io._store_supply(4, None, 99.0)
    assert io.faults()[1].startswith("wrist_roll is at 99 °C")
    io._update_status(ServoStatus("elbow_flex", 12.0, 40.0, ("elbow_flex: overload",)))
    assert "elbow_flex: overload" in io.faults()
    assert (io.read().voltage[2], io.read().temperature[2]) == (12.0, 40.0)
    io._update_status(ServoStatus("elbow_flex", 11.0, 41.0, ()))
    assert "elbow_flex: overload" not in io.faults()
    assert (io.read().voltage[2], io.read().temperature[2]) == (11.0, 41.0)


def test_joints_that_may_not_follow_are_silent_alone_hot_or_faulty(io):
    io.read()
    io.drive.silent, io.drive.time = {1, 5}, 100.3
    io.read()
    assert io.unfit_joints(100.3) == {"shoulder_lift": "no answer for 0.2 s"}
    assert io.unfit_joints(100.1) == {}
    io.drive.silent = set(range(6))  # a dead line: no single joint is at fault
    assert io.unfit_joints(200.0) == {}
    io._store_supply(3, None, 68.0)
    for name in ("elbow_flex", "gripper"):
        io._update_status(ServoStatus(name, 12.0, 40.0, (f"{name}: overload",)))
    assert io.unfit_joints(100.3) == {
        "shoulder_lift": "no answer for 0.2 s",
        "elbow_flex": "overload",
        "wrist_flex": "at 68 °C it gets no torque",
    }


def test_the_limit_of_a_servo_counts_where_it_is_below_that_of_the_budget(io):
    io.drive.temperature_limit = np.array([70.0, 80.0, 55.0, np.inf, 70.0, 70.0])
    io = ArmIO(io.model, io.drive, Budget())
    for index, degrees in ((1, 67.0), (2, 52.0), (3, 67.0)):
        io._store_supply(index, None, degrees)
    assert not io.faults()
    ceiling = io.thermal.torque_ceiling() / io._usable
    assert ceiling == pytest.approx([1.0, 1 / 8, 1 / 8, 1 / 8, 1.0, 1.0])
    io._store_supply(2, None, 53.0)
    assert io.faults() == ("elbow_flex is at 53 °C and its limit is 53 °C: let it cool",)


def test_the_joint_that_lacks_most_torque_is_warned_of_once():
    servos = SimpleNamespace(friction=[0.1, 0.1, 2.0])
    low = LowTorqueWarning(SimpleNamespace(joint_names=["a", "b", "c"]), servos)
    limit, gravity = np.array([0.4, 0.1, 0.4]), np.array([-1.0, 1.0, 1.5])
    for begin in (0.0, 1.0, 2.0):  # each time the limit is too low for less than 0.2 s
        low.check(limit, gravity, begin)
        low.check(limit, gravity, begin + 0.19)
        low.reset() if begin == 0.0 else low.check(np.ones(3), gravity, begin + 0.3)
    low.check(limit, gravity, 3.0)
    with pytest.warns(RuntimeWarning, match=r"^b may exert 0\.1 N·m, and this pose needs 1:"):
        low.check(limit, gravity, 3.21)
    low.check(limit, gravity, 9.0)
    low.check(limit, gravity, 9.9)


def test_a_gripper_that_a_program_keeps_measures_the_open_arm():
    arm = pliant.connect("so101", backend="sim")
    gripper = arm.gripper
    with arm:
        gripper.go(1.0)
        for tick in pliant.Loop(arm, duration=1.5):
            tick.skip()
        assert gripper.position == arm.gripper.position == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("name", ["opened", "closed", "limit", "lever"])
def test_a_gripper_configuration_takes_numbers(name):
    with pytest.raises(pliant.ConfigError, match=rf"GripperConfig.{name} must be a number, got"):
        GripperConfig(**{name: "1"})
