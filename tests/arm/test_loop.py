"""The loop: timing, missing readings, missing commands, and no jump of the goal after them."""

import logging
import os
import threading
import time
import warnings
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from bare_arm import bare_arm

import pliant
from experiments.lifecycle import FAULT_CASES, run_fault
from pliant.arm._messages import MESSAGES
from pliant.loop import LatenessHistogram


@pytest.fixture
def running(make, grasp):
    """Return an enabled arm in its grasp pose with a controller, and its present target."""
    arm = make(plant={"delay": (1, 1)})
    controller = pliant.Controller(arm.model, pliant.Settings.soft("y"), arm.servos)
    arm.enable()
    yield arm, controller, arm.model.forward_kinematics(grasp)
    arm.leave_enabled()


def test_a_tick_per_period_with_its_time_and_delay(running):
    arm, controller, target = running
    loop = pliant.Loop(arm, controller, rate=100.0, duration=1.0)
    times = []
    for tick in loop:
        tick.write(controller.step(tick.q, target, dt=tick.dt))
        times.append((tick.time, tick.dt, tick.index))
    tick_times, dt, index = np.array(times).T
    assert np.diff(tick_times) == pytest.approx(0.01)
    assert dt == pytest.approx(0.01)
    assert list(index) == list(range(100))
    assert loop.delay == pytest.approx(0.02)
    assert (loop.missed, loop.missing, loop.rejected, loop.restarts) == (0, 0, 0, 0)
    assert len(loop.lateness) == 100


def test_the_first_goal_carries_the_weight(running):
    arm, controller, target = running
    height = []
    for tick in pliant.Loop(arm, controller, duration=0.5):
        tick.write(controller.step(tick.q, target, dt=tick.dt))
        height.append(arm.drive.plant.tool[2, 3])
    assert np.ptp(height) < 1e-4


def test_deadlines_that_were_missed_are_skipped_not_caught_up(running):
    arm, controller, target = running
    loop = pliant.Loop(arm, controller, duration=0.5)
    tick_times = []
    for tick in loop:
        if tick.index == 10:
            arm.clock.wait_until(arm.clock.now() + 0.034)
        tick.write(controller.step(tick.q, target, dt=tick.dt))
        tick_times.append(tick.time)
    gaps = np.diff(tick_times)
    assert loop.missed == 3
    assert gaps.max() == pytest.approx(0.04)
    assert np.sort(gaps)[:-1] == pytest.approx(0.01)


def test_a_command_from_old_positions_is_not_sent(running):
    arm, controller, target = running
    loop = pliant.Loop(arm, controller, duration=0.5)
    for tick in loop:
        command = controller.step(tick.q, target, dt=tick.dt)
        if tick.index == 10:
            arm.clock.wait_until(arm.clock.now() + 0.3)
            count = len(arm.drive.diary)
            assert not tick.write(command)
            assert len(arm.drive.diary) == count
            tick.skip()
        else:
            assert tick.write(command)
    assert (loop.rejected, loop.restarts) == (1, 1)


def test_commands_that_are_not_finite_hold_for_a_while_then_end_the_loop(running):
    arm, controller, _ = running

    class Bad:
        goal = np.full(7, np.nan)
        torque_limit = np.ones(7)

    ticks = []

    def loop():
        for tick in pliant.Loop(arm, controller):
            tick.write(Bad)
            ticks.append(tick.time)

    with pytest.raises(pliant.ServoTimeoutError, match=r"no command could be sent for 0.5"):
        loop()
    assert ticks[-1] - ticks[0] == pytest.approx(0.5, abs=0.02)


def test_a_loop_needs_torque_and_a_rate_that_fits(make):
    arm = make()
    with pytest.raises(pliant.ServoError, match="torque is off"):
        next(iter(pliant.Loop(arm)))
    with pytest.raises(pliant.ConfigError, match="rate=150"):
        pliant.Loop(arm, rate=150.0)
    for low in (0.0, 0.5):
        with pytest.raises(pliant.ConfigError, match="rate must be 1 Hz or more, got"):
            pliant.Loop(arm, rate=low)


def test_a_loop_names_wrong_arguments(make):
    with pytest.raises(TypeError, match=r"arm must be an Arm, .*got None \(NoneType\)"):
        pliant.Loop(None, None, rate=0.0)
    for value, message in ((-1.0, "must be 0 s or more"), ("2", "must be a number, got '2'")):
        for name in ("duration", "max_step_time"):
            with pytest.raises(pliant.ConfigError, match=f"{name} {message}"):
                pliant.Loop(make(), **{name: value})


def test_leaving_the_loop_lowers(make):
    with make() as arm:
        for tick in pliant.Loop(arm):
            tick.skip()
            if tick.index == 3:
                break
    assert not arm.enabled
    assert arm.drive.plant.tool[2, 3] < -0.6


def test_a_loop_over_an_arm_that_the_program_lowered_says_that_torque_is_off(make):
    with make() as arm:
        ticks = iter(pliant.Loop(arm))
        tick = next(ticks)
        arm.lower()
        tick.skip()
        with pytest.raises(pliant.ServoError, match="torque is off"):
            next(ticks)


@pytest.mark.parametrize("is_same", [False, True])
def test_a_loop_within_a_loop_over_the_same_arm_is_refused(make, is_same):
    with make() as arm:
        outer = pliant.Loop(arm)
        inner = outer if is_same else pliant.Loop(arm, duration=0.1)
        ticks = iter(outer)
        for tick in (next(ticks), next(iter(inner))):
            tick.skip()
        with pytest.raises(pliant.ConfigError, match="another loop over this arm"):
            next(ticks)
        for tick in pliant.Loop(arm, duration=0.1):  # loops that follow each other are allowed
            tick.skip()


class SlowRecorder:
    """A recorder that takes to close until the torque of an arm is off, but at most 5 s."""

    def __init__(self, arm):
        self.arm, self.was_off, self.is_closed = arm, None, False

    def start(self, arm, controller, rate):
        return controller

    def add(self, tick, command):
        pass

    def close(self):
        end = time.monotonic() + 5.0
        while self.arm.enabled and time.monotonic() < end:
            time.sleep(0.005)
        self.was_off = not self.arm.enabled
        time.sleep(0.3)
        self.is_closed = True


@pytest.mark.parametrize("error", [None, KeyError], ids=["duration", "exception"])
def test_an_arm_in_real_time_does_not_wait_for_its_recorder(error):
    arm = bare_arm("koch", real_time=True, handle_signals=False, on_exit="leave_enabled")
    recorder = SlowRecorder(arm)
    with nullcontext() if error is None else pytest.raises(error), arm:
        for tick in pliant.Loop(arm, duration=0.05, recorder=recorder):
            tick.skip()
            if error is not None:
                raise error
    assert recorder.was_off
    assert recorder.is_closed


def test_other_threads_run_while_the_loop_waits():
    arm = bare_arm("koch", real_time=True, handle_signals=False)
    arm.enable()
    count, stop = [0], threading.Event()

    def work():
        while not stop.is_set():
            count[0] += 1
            time.sleep(1e-4)

    worker = threading.Thread(target=work)
    worker.start()
    ticks = sum(1 for tick in pliant.Loop(arm, duration=0.3) if not tick.skip())
    stop.set()
    worker.join()
    arm.leave_enabled()
    assert ticks > 0
    assert count[0] > ticks


def test_lateness_is_bounded_and_right_within_a_bin():
    histogram = LatenessHistogram()
    size = histogram.counts.nbytes
    for value in np.linspace(0.0, 1e-3, 10_001):
        histogram.add(value)
    histogram.add(100.0)
    histogram.add(-1.0)
    assert histogram.counts.nbytes == size
    assert histogram.percentile(50.0) == pytest.approx(0.5e-3, rel=0.13)
    assert histogram.percentile(99.0) == pytest.approx(0.99e-3, rel=0.13)
    assert histogram.percentile(100.0) == histogram.largest == 100.0
    assert LatenessHistogram().percentile(50.0) == 0.0
    other = LatenessHistogram()
    other.add(200.0)
    other.add_all(histogram)
    assert (len(other), len(histogram), other.largest) == (10_004, 10_003, 200.0)
    assert (other.counts - histogram.counts).tolist() == [0] * 141 + [1]


#: By case: reaction of the arm, and largest tool speed before and during the descent [m/s].
EXPECTED = {
    "Ctrl-C, or any exception": ("is lowered", 0.01, 0.18),
    "the program stalls for 1 s": ("is lowered", 0.01, 0.18),
    "the same, `Loop(max_step_time=2.0)`": ("goes on", 0.01, 0.18),
    "target NaN for 1 s, caught: `tick.skip()`": ("goes on", 0.01, 0.18),
    "no command for 1 s": ("is lowered", 0.01, 0.18),
    "no positions for 0.3 s": ("goes on", 0.01, 0.18),
    "no positions for 1 s": ("is lowered", 0.01, 0.18),
    "no more positions": ("is lowered", 0.01, 0.18),
    "elbow no longer answers": ("is lowered", 0.01, 0.20),
}


#: Cases that always run; the others are marked `full`.
SHORT = {
    "the same, `Loop(max_step_time=2.0)`",
    "no positions for 1 s",
    "elbow no longer answers",
}


@pytest.mark.parametrize(
    "title", [pytest.param(t, marks=() if t in SHORT else pytest.mark.full) for t in EXPECTED]
)
def test_nothing_that_goes_wrong_drops_the_arm(title):
    case = next(m for m in FAULT_CASES if m.title == title)
    outcome, meanwhile, descent = EXPECTED[title]
    result = run_fault(case)
    assert result.outcome == outcome, result.reason
    assert result.speed < meanwhile
    assert result.drop < 1e-3
    assert result.descent < descent


def test_a_target_that_jumps_pushes_a_hand_with_what_its_axes_may(grasp):
    model = pliant.robots.arm7()
    controller = pliant.Controller(model, pliant.Settings.soft("y"), model.servos)
    controller.step(grasp, model.forward_kinematics(grasp))
    lever = np.linalg.pinv(model.jacobian(grasp))[:, :3]
    gears = np.abs(lever).T @ np.asarray(model.servos.friction)
    outcome = run_fault(
        next(m for m in FAULT_CASES if m.title.startswith("target jumps")), held=True
    )
    # x and z are stiff (cap `hold`), y is soft; the force along each stays below 1.15 times its cap
    # plus the friction of the gears.
    largest = 1.15 * np.asarray(controller.diagnostics.axis_strength[:3]) + gears
    assert outcome.along[0] > 0.9 * controller.diagnostics.axis_strength[0]
    assert np.all(outcome.along < largest), (outcome.along, largest)


def test_lost_readings_do_not_excuse_missing_commands():
    with bare_arm("arm7", read_loss=0.1, seed=1, handle_signals=False) as arm:
        loop = pliant.Loop(arm, rate=100.0, duration=5.0)
        with pytest.raises(pliant.ServoTimeoutError, match="no command could be sent"):
            list(loop)
        assert loop.missing > 0


def test_a_controllers_goals_may_lead_beyond_the_limits(make):
    arm = make()
    upper = arm.model.upper
    with arm:
        for tick in pliant.Loop(arm, rate=100.0, duration=0.03):
            goal = np.where(np.isfinite(upper), upper + 0.05, tick.q)
            arm.write(goal, np.ones(arm.model.n))
            gravity = arm.model.gravity(tick.q) / np.asarray(arm.servos.kp)
            assert np.all(arm.drive.diary[-1][1] <= upper + np.maximum(gravity, 0.0) + 1e-9)
            arm.write(goal, np.ones(arm.model.n), lead=True)
            assert arm.drive.diary[-1][1] == pytest.approx(goal)
            # Numbers that only NumPy converts.
            arm.write([np.array(q) for q in goal.tolist()], np.ones(arm.model.n), lead=True)
            assert arm.drive.diary[-1][1] == pytest.approx(goal)
            arm.write(goal.astype(object), np.ones(arm.model.n), lead=True)
            assert arm.drive.diary[-1][1] == pytest.approx(goal)
            tick.skip()


@pytest.mark.skipif(not hasattr(os, "SCHED_FIFO"), reason="SCHED_FIFO needs Linux")
def test_a_real_time_priority_lasts_as_long_as_the_loop(monkeypatch):
    def policies():
        return {
            thread.name: os.sched_getscheduler(thread.native_id) for thread in threading.enumerate()
        }

    name = threading.current_thread().name
    before = policies()[name]
    with bare_arm(real_time=True, handle_signals=False) as arm:
        loop = pliant.Loop(arm, duration=0.05, realtime_priority=5)
        try:
            for tick in loop:
                threads = policies()
                assert threads[name] == os.SCHED_FIFO
                assert threads["pliant-supervisor"] == os.SCHED_FIFO, "it must interrupt a stall"
                tick.skip()
        except pliant.ConfigError as error:
            pytest.skip(f"not permitted here: {error}")
        assert policies()[name] == before

        def refuse(*_):
            raise PermissionError(1, "Operation not permitted")

        monkeypatch.setattr(os, "sched_setscheduler", refuse)
        with pytest.raises(pliant.ConfigError, match=r"rtprio 5.*leave realtime_priority out"):
            next(iter(loop))
        for priority in (0, 100, 5.0, True):
            with pytest.raises(pliant.ConfigError, match=r"from 1 to 99, or None, got"):
                pliant.Loop(arm, realtime_priority=priority)
        arm.disable_torque()


def test_a_pause_before_the_loop_is_not_a_silence(make):
    with make() as arm:
        arm.clock.wait_until(arm.clock.now() + 3.0)
        silent_until = arm.clock.now() + 0.2
        read = arm.drive.read

        def silent():
            arm.drive.silent = set(arm.drive.names) if arm.clock.now() < silent_until else set()
            return read()

        arm.drive.read = silent

        def skip_ticks():
            loop = pliant.Loop(arm, duration=1.0)
            for tick in loop:
                tick.skip()
            return loop

        assert skip_ticks().missing > 10
        silent_until = arm.clock.now() + 1.0
        with pytest.raises(pliant.ServoTimeoutError, match=r"any joint for 0\.5.*supply.*adapter"):
            skip_ticks()


def test_a_silent_joint_off_the_chain_is_reported_once(make, monkeypatch):
    texts = []
    monkeypatch.setattr(MESSAGES, "post", lambda text, level=0, **_: texts.append((text, level)))
    with make([0.0, -0.6, 0.6, 0.6, 0.0], "so101") as arm:
        arm.drive.silent = {"gripper"}
        loop = pliant.Loop(arm, duration=2.0)
        for tick in loop:
            if tick.time < 0.9:
                assert not texts
            tick.write(SimpleNamespace(goal=tick.q, torque_limit=arm.servos.max_torque))
        assert loop.missing == 0
        assert texts == [("no answer from gripper: look at its plug and cable", logging.WARNING)]


def test_a_controller_steps_one_arm_at_a_time(make):
    arms = [make(), make()]
    controller = pliant.Controller(arms[0].model, pliant.Settings.soft("y"), arms[0].servos)
    for arm in arms:
        arm.enable()
    first = iter(pliant.Loop(arms[0], controller))
    next(first).skip()
    with pytest.raises(pliant.ConfigError, match="make a Controller for each arm"):
        next(iter(pliant.Loop(arms[1], controller)))
    next(first).skip()
    # A loop that has ended, or whose arm has no torque, does not keep the controller.
    arms[0].disable_torque()
    for tick in pliant.Loop(arms[1], controller, duration=0.05):
        tick.skip()
    arms[0].enable()
    for tick in pliant.Loop(arms[0], controller, duration=0.05):
        tick.skip()
    for arm in arms:
        arm.disable_torque()


@pytest.mark.parametrize("starts", ["new every tick", "reset every tick", "new once", "never"])
def test_a_controller_that_starts_anew_in_every_tick_is_reported_once(starts):
    """The goals stay near the positions, so that the arm sinks by 0.1 m or more."""
    settings = pliant.Settings.firm(task="xyz")
    with pliant.connect("so101", backend="sim", q=(0.0, -0.3, 0.3, 0.9, 0.0), table=False) as arm:
        controller = pliant.Controller(arm.model, settings, arm.servos)
        target = arm.model.forward_kinematics(arm.read().q)
        with warnings.catch_warnings(record=True) as reported:
            warnings.simplefilter("always")
            for tick in pliant.Loop(arm, controller, rate=100.0, duration=0.5):
                if starts == "new every tick" or (starts == "new once" and tick.index == 20):
                    controller = pliant.Controller(arm.model, settings, arm.servos)
                if starts == "reset every tick":
                    controller.reset(tick.q)
                tick.write(controller.step(tick.q, target, dt=tick.dt))
    said = [str(warning.message) for warning in reported]
    assert len(said) == starts.endswith("every tick"), said
    assert all("first step of a controller" in text for text in said)
    assert {warning.filename for warning in reported} <= {__file__}


def motion(robot, q, settings, pauses, duration):
    """Return the tool's displacements (m, 3) [m] in a loop that holds its pose, and the loop.

    `pauses` are the index of a tick and the pause after it [s].
    """
    with pliant.connect(robot, backend="sim", q=q, table=False) as arm:
        controller = pliant.Controller(arm.model, settings, arm.servos)
        target = arm.model.forward_kinematics(arm.read().q)
        plant, clock = arm.drive.plant, arm.clock
        positions = [plant.tool[:3, 3].copy()]
        clock.on_tick = lambda: positions.append(plant.tool[:3, 3].copy())
        loop = pliant.Loop(arm, controller, rate=100.0, duration=duration)
        for tick in loop:
            tick.step(target)
            if tick.index in pauses:
                clock.wait_until(clock.now() + pauses[tick.index])
        clock.on_tick = None
    return np.array(positions) - positions[0], loop


@pytest.mark.parametrize(
    ("q", "every"), [((0.3, 0.2, 0.2, 0.5, 0.2), 5), ((-0.5, 0.5, -0.3, 0.4, 0.5), 10)]
)
def test_repeated_pauses_do_not_swing_an_arm_at_rest(q, every):
    """A reset in each pause would swing the tool by more than 20 mm, at more than 0.15 m/s."""
    pauses = dict.fromkeys(range(100, 1000, every), 0.3)
    moved, loop = motion("so101", q, pliant.Settings.firm(task="xyz"), pauses, 4.0)
    assert loop.restarts >= 7
    assert np.linalg.norm(moved, axis=1).max() < 0.005


@pytest.mark.parametrize(("robot", "goal_slew"), [("koch", 1.0), ("koch", 0.2), ("so101", 0.2)])
def test_goals_carry_the_arm_from_the_first_tick_on(robot, goal_slew):
    """The goals may move only slowly, and the program pauses after the first tick."""
    settings = pliant.Settings.firm(task="xyz", tracking=pliant.Tracking(goal_slew=goal_slew))
    moved, _ = motion(robot, (-0.5, 0.6, -0.4, 0.3, 0.5), settings, {0: 0.45}, 1.0)
    assert np.linalg.norm(moved, axis=1).max() < 0.006


@pytest.mark.parametrize("angle", [0.2, 0.0])
def test_an_arm_that_moved_in_a_gap_returns_to_its_target_slowly(angle):
    """The reference pose starts at the tool if the arm moved; otherwise it stays at the target."""
    settings = pliant.Settings.firm(task="xyz")
    with pliant.connect("so101", backend="sim", q=(0.0, -0.3, 0.3, 0.9, 0.0), table=False) as arm:
        controller = pliant.Controller(arm.model, settings, arm.servos)
        target = arm.model.forward_kinematics(arm.read().q)
        for tick in pliant.Loop(arm, controller, rate=100.0, duration=1.0):
            tick.step(target)
            if tick.index == 50:
                arm.clock.wait_until(arm.clock.now() + 0.3)
                arm.drive.plant.mj_data.qpos[0] += angle
                arm.clock.wait_until(arm.clock.now() + 0.05)
            elif tick.index == 51:
                reference = controller.diagnostics.reference
                tool = arm.model.forward_kinematics(tick.q)
                from_target, from_tool = (
                    np.linalg.norm((reference - pose)[:3, 3]) for pose in (target, tool)
                )
                assert from_tool < 0.001
                assert (from_target > 0.02) == (angle > 0.0)
                break


def test_a_controller_of_the_users_own_needs_only_the_arguments_of_tick_step():
    settings = pliant.Settings.firm(task="xyz", tracking=pliant.Tracking(goal_slew=0.2))
    with pliant.connect("so101", backend="sim", q=(0.0, -0.3, 0.3, 0.9, 0.0), table=False) as arm:
        inner = pliant.Controller(arm.model, settings, arm.servos)

        class Own:
            model = arm.model

            def reset(self, q):
                inner.reset(q)

            def step(self, q, target, dt):
                return inner.step(q, target, dt=dt)

        target = arm.model.forward_kinematics(arm.read().q)
        loop = pliant.Loop(arm, Own(), rate=100.0, duration=0.5)
        for tick in loop:
            tick.step(target)
            if tick.index == 10:
                arm.clock.wait_until(arm.clock.now() + 0.3)
    assert loop.restarts == 1


@pytest.mark.parametrize("robot", ["so101", "koch"])
@pytest.mark.parametrize("guided", [False, True], ids=["controller", "hand guiding"])
def test_an_assigned_controller_holds_the_arm_as_it_takes_over(robot, guided):
    """A controller that the program steps itself would let it sink by 14 mm (so101) or more."""
    with pliant.connect(robot, backend="sim", q=(-0.5, 0.5, -0.3, 0.4, 0.5), table=False) as arm:
        settings = pliant.Settings.firm(task="xyz")
        first, second = (pliant.Controller(arm.model, settings, arm.servos) for _ in range(2))
        first = pliant.HandGuiding(arm.model, arm.servos) if guided else first
        targets = () if guided else (arm.model.forward_kinematics(arm.read().q),)
        plant, clock, positions = arm.drive.plant, arm.clock, []
        loop = pliant.Loop(arm, first, rate=100.0, duration=2.0)
        for tick in loop:
            if tick.index == 100:
                clock.on_tick = lambda: positions.append(plant.tool[:3, 3].copy())
                loop.controller = second
                targets = (arm.model.forward_kinematics(tick.q),)
            tick.step(*targets)
        clock.on_tick = None
    moved = np.array(positions) - positions[0]
    assert moved[:, 2].min() > -0.003
    assert np.linalg.norm(moved, axis=1).max() < 0.006


def test_an_assigned_controller_belongs_to_its_loop():
    class Recorder:
        def start(self, _arm, controller, _rate):
            return controller

        def add(self, _tick, _command):
            pass

        def close(self):
            pass

    with (
        pliant.connect("so101", backend="sim") as arm,
        pliant.connect("so101", backend="sim") as other,
    ):
        first, second, third = (
            pliant.Controller(arm.model, pliant.Settings.soft("y", task="xyz"), arm.servos)
            for _ in range(3)
        )
        target = arm.model.forward_kinematics(arm.read().q)
        loop, elsewhere = pliant.Loop(arm, first, duration=0.1), pliant.Loop(other, second)
        recorded = pliant.Loop(arm, third, recorder=Recorder())
        with pytest.raises(pliant.ConfigError, match="a recorder records one controller"):
            recorded.controller = first
        with pytest.raises(TypeError, match="controller must be a Controller, or have reset"):
            loop.controller = target
        ticks = iter(elsewhere)
        next(ticks).step(target)
        for tick in loop:
            if tick.index == 1:
                with pytest.raises(pliant.ConfigError, match="make a Controller for each arm"):
                    loop.controller = second
                assert loop.controller is first
                loop.controller = third
                with pytest.raises(pliant.ConfigError, match="make a Controller for each arm"):
                    elsewhere.controller = third
                elsewhere.controller = first
            tick.step(target)
        assert third.commands_made
        ticks.close()


@pytest.mark.parametrize("robot", ["so101", "koch"])
@pytest.mark.parametrize("is_new", [False, True], ids=["same controller", "new controller"])
def test_a_second_loop_holds_an_arm_that_has_moved_since_torque_on(robot, is_new):
    """With the weight measured at torque on, so101 would sink by 34 mm in the new pose."""
    q, away = (0.0, -1.2, 1.2, 0.4, 0.0), (0.0, 0.9, -0.3, 0.4, 0.0)
    settings = pliant.Settings.firm(task="xyz")
    with pliant.connect(robot, backend="sim", q=q, table=False) as arm:
        controller = pliant.Controller(arm.model, settings, arm.servos)
        before, target = arm.read().q, arm.model.forward_kinematics(np.array(away))
        for tick in pliant.Loop(arm, controller, rate=100.0, duration=6.0):
            tick.step(target)
        q, gravity = arm.read().q, arm.model.gravity
        assert abs(gravity(q)[1]) > 0.2 > abs(gravity(before)[1]), "another weight on the shoulder"
        if is_new:
            controller = pliant.Controller(arm.model, settings, arm.servos)
        target, plant, positions = arm.model.forward_kinematics(q), arm.drive.plant, []
        arm.clock.on_tick = lambda: positions.append(plant.tool[:3, 3].copy())
        for tick in pliant.Loop(arm, controller, rate=100.0, duration=2.0):
            tick.step(target)
        arm.clock.on_tick = None
    assert np.linalg.norm(np.array(positions) - positions[0], axis=1).max() < 0.002
