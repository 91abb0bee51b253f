"""Life cycle of an arm over serial bytes: emulated servos that drive a simulated arm."""

import pickle
import re
from contextlib import contextmanager

import numpy as np
import pytest
from mismatch import Mismatch, Parameters

pytest.importorskip("rustypot", reason="servo buses need the extra servo")
pytest.importorskip("mujoco", reason="the arm behind the bytes needs the extra sim")

import pliant
from experiments import bus_lower
from experiments.lifecycle import LOAD
from pliant.arm import Arm
from pliant.arm._messages import MESSAGES
from pliant.emulator import ManualClock, Mount, Timing, emulate
from pliant.servo import ServoBus, ServoSpec
from pliant.sim import ForceProfile, Push, Tabletop

#: Units of the speed registers [rad/s]: one encoder step per second, and 0.229 rpm.
STEP, RPM = 2.0 * np.pi / 4096, 0.229 * np.pi / 30.0
#: Robot and servo of each family.
FAMILIES = {"sts": ("so101", "STS3215", "STS3215-7.4V", {}), "x": ("koch", "XL430-W250", None, {})}
MORE_FAMILIES = {
    "mx": ("so101", "MX-64", None, {"return_delay_time": 0}),
    "xm": ("koch", "XM430-W350", None, {"operating_mode": 5, "return_delay_time": 0}),
}


@contextmanager
def arm_over_bytes(
    family,
    q,
    clock="steps",
    plant=None,
    *,
    zero=None,
    wrong_sign=None,
    wrong_ids=None,
    patience=0.1,
    timing=None,
    **options,
):
    robot, device, model, registers = (FAMILIES | MORE_FAMILIES)[family]
    chain_model = pliant.robots.load(robot)
    names = [*chain_model.joint_names, "gripper"]
    mounts = [
        Mount(joint=n, model=device, id=k, registers=registers) for k, n in enumerate(names, 1)
    ]
    is_held = plant is not None
    timing = timing or Timing()
    with emulate(
        chain_model, mounts, q=np.array(q), clock=clock, plant=plant, held=is_held, timing=timing
    ) as bus:
        specs = [
            ServoSpec(
                name=n,
                model=model or device,
                id=(wrong_ids or {}).get(n, k),
                port=bus.port,
                zero=(zero or {}).get(n),
                sign=-1 if n == wrong_sign else 1,
            )
            for k, n in enumerate(names, 1)
        ]
        servo_bus = ServoBus(
            specs,
            rate=options.get("rate", 100.0),
            reply_timeout_min=patience,
            clock=ManualClock(bus) if clock == "steps" else None,
        )
        yield bus, Arm(chain_model, servo_bus, handle_signals=False, **options)


def switches(bus, id):
    """Return the writes to a servo's Torque Enable register, in order."""
    return [step for step in bus.log.order(id) if step.startswith("torque")]


def unknown_load(load):
    """Return the `Mismatch` of an arm whose model lacks a load [kg]."""
    return Mismatch(plant=Parameters(payload=load), assumed=Parameters(), compared=("payload",))


@pytest.mark.parametrize(("counts", "starts"), [(1500, False), (40, True)])
def test_a_joint_whose_zero_is_far_off_gets_no_torque(counts, starts):
    zero = {"elbow_flex": 2048 + counts}
    with arm_over_bytes("sts", [0.0] * 5, zero=zero) as (bus, arm):
        if starts:
            arm.enable()
            error = arm.read().q[2] - bus.plant.q[2]
            assert error == pytest.approx(-counts * STEP, abs=2 * STEP)
            arm.disable_torque()
        else:
            with pytest.raises(pliant.ServoError, match=r"elbow_flex stands at -2\.3.*by hand"):
                arm.enable()
            assert not any(bus.log.order(k) for k in range(1, 7))
        arm.close()


@pytest.mark.parametrize(
    "payload", [(300.0, [0.0, 0.0, 0.0]), (0.3, [0.0, 0.0, 20.0])], ids=["grams", "millimetres"]
)
def test_an_arm_far_too_heavy_for_its_servos_gets_no_torque(payload):
    with arm_over_bytes("sts", [0.0, -0.5, 0.5, 0.8, 0.0]) as (bus, arm):
        model = pliant.robots.load("so101", payload=payload)
        heavy = Arm(model, arm.drive, handle_signals=False)
        with pytest.raises(pliant.ServoError, match=r"shoulder_lift needs .*com.*payload"):
            heavy.enable()
        assert not any(bus.log.order(k) for k in range(1, 7))
        heavy.close()


def test_a_simulated_arm_far_too_heavy_for_its_servos_is_not_enabled():
    config = pliant.config.parse(
        'backend = "sim"\n[robot]\nbuiltin = "so101"\npayload = { mass = 100 }'
    )
    arm = pliant.connect(config, q=[0.0, -0.5, 0.5, 0.8, 0.0])
    with pytest.raises(pliant.ServoError, match=r"shoulder_lift needs .*as it is.*payload"):
        arm.enable()
    assert not arm.drive.counters["writes"]


@pytest.mark.parametrize("family", FAMILIES)
def test_enabled_in_order_controlled_and_held(family):
    with arm_over_bytes(family, [0.1, 0.2, 0.2, 0.1, 0.0]) as (bus, arm):
        arm.enable()
        controller = pliant.Controller(
            arm.model, pliant.Settings(task=pliant.Task(axes="xyz")), arm.servos
        )
        start = arm.model.forward_kinematics(arm.read().q)[:3, 3]
        loop = pliant.Loop(arm, controller, duration=0.5)
        for tick in loop:
            command = controller.step(tick.q, start, dt=tick.dt)
            tick.write(command)
        # Speed registers have the speed limits of the command, rounded down.
        bus.sync()
        register, unit = {"sts": ("goal_velocity", STEP), "x": ("profile_velocity", RPM)}[family]
        speeds = unit * np.array([bus.servo(k).get(register) for k in range(1, 6)])
        assert np.all(speeds <= command.speed_limit)
        assert speeds == pytest.approx(command.speed_limit, abs=unit)
        arm.gripper.open()
        arm.leave_enabled()
        arm.close()
        for k in range(1, 7):
            order = bus.log.order(k)
            assert order[:3] == ["limit", "goal", "torque on"]
            assert "torque off" not in order
        assert not bus.log.eeprom_writes()
        assert (loop.missed, loop.missing, loop.rejected) == (0, 0, 0)
        assert np.linalg.norm(bus.plant.tool[:3, 3] - start) < 0.01


#: An FTDI adapter whose latency timer has its factory value.
SLOW_ADAPTER = Timing(wire=True, usb_latency=0.016)
#: An adapter whose latency timer has the recommended value.
TIMED = Timing(wire=True, usb_latency=0.001)
#: Poses in which the tool is 32 cm and 3 cm above the end of its descent [rad].
HIGH, LOW = [0.0, 0.2, 0.0, 0.2, 0.0], [0.0, 1.5, 0.0, 0.0, 0.0]
#: A pose with large torques of all joints that lift the arm [rad].
STRETCHED = [0.1, 0.4, 0.2, 0.1, 0.0]


def hold(arm, rate, pause=0.0):
    """Hold the arm where it is for 1 s, in a loop at `rate` [Hz]; return the loop.

    The program pauses in each tick for `pause` [s].
    """
    controller = pliant.Controller(arm.model, pliant.Settings(task="xyz"), arm.servos)
    target = arm.model.forward_kinematics(arm.read().q)
    loop = pliant.Loop(arm, controller, rate=rate, duration=1.0)
    for tick in loop:
        arm.clock.wait_until(arm.clock.now() + pause)
        tick.step(target)
    return loop


@pytest.mark.parametrize("family", FAMILIES)
def test_a_slow_adapter_makes_the_loop_slow_but_no_command_too_old(family):
    # If each servo had a request of its own after the silence of `enable`, every command would be
    # too old.
    with arm_over_bytes(family, LOW, timing=SLOW_ADAPTER, watchdog=0.2) as (bus, arm):
        arm.enable()
        loop = hold(arm, rate=100.0)
        assert loop.rejected == 0
        assert loop.missed > 10
        arm.close()
        assert not any(bus.servo(k).get("torque_enable") for k in range(1, 7))


def test_an_arm_that_is_read_too_slowly_for_its_loop_gets_no_torque():
    with arm_over_bytes("mx", LOW, timing=SLOW_ADAPTER) as (bus, arm):
        with pytest.raises(pliant.ServoError, match=r"takes 9\d ms, .* 70 ms .* 100 Hz: torque st"):
            arm.enable()
        assert not any(switches(bus, k) for k in range(1, 7))
        arm.close()
    with arm_over_bytes("mx", LOW, timing=SLOW_ADAPTER, rate=5.0) as (_, arm):
        arm.enable()
        assert hold(arm, rate=5.0).rejected == 0
        arm.close()


def test_commands_that_come_too_late_are_named_as_the_cause():
    with arm_over_bytes("sts", LOW) as (_, arm):
        arm.enable()
        with pytest.raises(pliant.ServoTimeoutError, match=r"0\.15 s after the start of its tick"):
            hold(arm, rate=100.0, pause=0.15)
        arm.close()


def test_a_silent_elbow_does_not_lift_the_arm_on_its_way_down():
    # On the straight way to this rest pose the elbow must move; if it stood still, the other joints
    # would lift the tool by 17 cm.
    rest_q = [0.0, -1.74, 1.57, 0.85, 0.0]
    with arm_over_bytes("sts", HIGH, patience=0.03, rest_q=rest_q) as (bus, arm):
        arm.enable()
        start, heights, step = bus.plant.tool[2, 3], [], bus.world.physics.step

        def watch(count):
            step(count)
            heights.append(bus.plant.tool[2, 3])

        bus.world.physics.step = watch
        bus.faults.inject("lose", 3, count=100)
        arm.clock.wait_until(arm.clock.now() + 0.3)
        arm.lower()
        assert arm.detour == "elbow_flex (no answer for 0.2 s) may not follow to the rest pose"
        assert max(heights) < start + 0.02
        arm.close()


@pytest.mark.parametrize("servo", [2, 3])
def test_a_silent_joint_descends_by_the_model(servo):
    """A Feetech servo gets goals too: with its limit only, the elbow fell at 0.47 m/s."""
    q, heights = [-0.14, -1.02, -0.26, -0.78, -1.05], []
    with arm_over_bytes("sts", q, patience=0.03) as (bus, arm):
        arm.enable()
        arm.clock.wait_until(arm.clock.now() + 0.2)
        wait = arm.clock.wait_until

        def watch(deadline):
            wait(deadline)
            speeds.append(np.linalg.norm(bus.plant.ground_truth.frame("tool").twist()[:3]))
            heights.append(bus.plant.tool[2, 3])

        speeds = []
        bus.faults.inject("lose", id=servo, count=10**6)
        wait(arm.clock.now() + 0.1)
        arm.clock.wait_until = watch
        with pytest.raises(pliant.ServoError, match="did not confirm torque_enable = 0"):
            arm.lower()
        for _ in range(100):
            watch(arm.clock.now() + 0.01)
        arm.clock.wait_until = wait
    assert heights[-1] < heights[0] - 0.1
    assert max(speeds) < 0.2  # [m/s], measured 0.10
    assert max(heights) < heights[0] + 0.005


@pytest.mark.parametrize(
    ("family", "q"),
    [("x", LOW), *(pytest.param(name, HIGH, marks=pytest.mark.full) for name in FAMILIES)],
)
def test_lowered_after_the_program_stalled(family, q):
    speeds = []
    with arm_over_bytes(family, q, watchdog=0.2) as (bus, arm):
        arm.enable()
        arm.clock.wait_until(arm.clock.now() + 1.0)  # longer than the time of any watchdog
        stalled = bus.time
        height = bus.plant.tool[2, 3]
        wait = arm.clock.wait_until

        def watch(deadline):
            wait(deadline)
            speeds.append(np.linalg.norm(bus.plant.ground_truth.frame("tool").twist()[:3]))

        arm.clock.wait_until = watch
        arm.lower()
        assert not arm.enabled
        assert not [w for w in bus.log.writes(refused=True) if w.time > stalled]
        assert not arm.drive.enabled.any()
        assert all(switches(bus, k)[-1] == "torque off" for k in range(1, 7))
        wait(arm.clock.now() + 0.5)
        assert bus.plant.tool[2, 3] < height - 0.02
        arm.close()
    assert max(speeds) < 0.18


def enabled_with_old_goals(family, lost_request=0):
    """Enable an arm whose servos have old goals; request number `lost_request` is lost.

    Returns:
        Distance moved by the tool [m], and the numbers of the requests that contained goals.
    """
    q = [0.1, 0.4, 0.2, 0.1, 0.0]
    with arm_over_bytes(family, q, plant={}, patience=0.01) as (bus, arm):
        for servo in bus.servos:
            servo.put("goal_position", servo.position - 500)
        count, start, distances = 0, bus.plant.tool[:3, 3].copy(), []

        def chance():
            nonlocal count
            count += 1
            return "deaf" if count == lost_request else None

        def watch(_):
            distances.append(np.linalg.norm(bus.plant.tool[:3, 3] - start))

        bus.lines["main"].faults.chance = chance
        bus.world.watchers.append(watch)
        arm.enable()
        arm.disable_torque()
        arm.close()
        goals = [
            number
            for number, transaction in enumerate(bus.log, 1)
            if any("goal_position" in write.values for write in transaction.writes)
        ]
        return max(distances), goals


@pytest.mark.parametrize("family", [*FAMILIES, *MORE_FAMILIES])
def test_a_lost_packet_of_goals_does_not_let_an_old_goal_move_the_arm(family):
    distance, goals = enabled_with_old_goals(family)
    assert distance < 0.005
    # If `enable` did not read goals back, the tool would move by up to 40 mm.
    distance_with_loss, _ = enabled_with_old_goals(family, goals[0])
    assert distance_with_loss < min(distance + 0.0005, 0.005)


@pytest.mark.full
@pytest.mark.parametrize("family", [*FAMILIES, *MORE_FAMILIES])
def test_no_lost_packet_of_enabling_lets_an_old_goal_move_the_arm(family):
    _, goals = enabled_with_old_goals(family)
    for request in range(goals[0] - 60, goals[1]):
        distance, _ = enabled_with_old_goals(family, request)
        assert distance < 0.005, request


@pytest.mark.parametrize("is_cleared", [True, False])
def test_torque_does_not_go_off_where_servos_refuse_the_way_down(
    is_cleared, monkeypatch, capsys, caplog
):
    """The bus is short-circuited for longer than the watchdog time; then the arm is lowered."""
    if not is_cleared:
        # Simulate that the servos' watchdogs cannot be cleared.
        monkeypatch.setattr("pliant.servo._port.Port.clear_watchdogs", lambda *_: None)
        monkeypatch.setattr("pliant.servo._port.Port.set_watchdog", lambda *_: [])
    with arm_over_bytes("x", LOW, watchdog=0.1) as (bus, arm):
        arm.enable()
        if not is_cleared:
            for servo in bus.servos:
                servo.put("bus_watchdog", 5)
        start = bus.plant.tool[2, 3]
        bus.short()
        for _ in range(5):
            arm.read()
            arm.clock.wait_until(arm.clock.now() + 0.05)
        assert all(servo.get("bus_watchdog") == -1 for servo in bus.servos)
        bus.short(False)
        if is_cleared:
            arm.lower()
            assert all(switches(bus, k)[-1] == "torque off" for k in range(1, 7))
            writes = [w for w in bus.log.writes("torque_enable") if w.values["torque_enable"] == 0]
            goals = [w for w in bus.log.writes("goal_position", refused=False)]
            assert goals[-1].time < writes[0].time
            arm.clock.wait_until(arm.clock.now() + 0.5)
            assert bus.plant.tool[2, 3] < start - 0.02
        else:
            with pytest.raises(pliant.ServoFaultError, match="do not take the goals"):
                arm.lower()
            stderr = " ".join(capsys.readouterr().err.split()) + caplog.text
            assert "torque is ON in" in stderr
            assert "the bus is gone" not in stderr
            assert all(switches(bus, k)[-1] == "torque on" for k in range(1, 7))
        arm.close()


@pytest.mark.full
def test_lowered_in_place_of_a_program_that_never_returns():
    with arm_over_bytes("x", HIGH, clock="real", comm_timeout=0.3) as (
        bus,
        arm,
    ):
        height, rounds = bus.plant.tool[2, 3], 0

        def run():
            nonlocal rounds
            for tick in pliant.Loop(arm):
                tick.skip()
                while tick.index == 5 and arm.enabled:
                    rounds += 1

        arm.enable()
        with pytest.raises(pliant.ServoTimeoutError, match="did not come back"):
            run()
        assert rounds > 0
        assert not arm.drive.enabled.any()
        assert all(switches(bus, k)[-1] == "torque off" for k in range(1, 7))
        assert bus.plant.tool[2, 3] < height - 0.02
        arm.close()


def test_an_unknown_load_sinks_and_is_brought_back_slowly():
    q, tools = [0.0, 0.5, 0.2, 0.2, 0.0], []
    with (
        unknown_load(0.3),
        arm_over_bytes("sts", q, plant={"payload": (0.3, (0.0, 0.0, 0.0))}) as (bus, arm),
    ):

        def watch(_):
            tools.append((bus.plant.tool[2, 3], bus.plant.ground_truth.frame("tool").twist()[2]))

        bus.world.watchers.append(watch)
        arm.enable()
        arm.disable_torque()
    height, speed = np.array(tools).T
    # Without the balance the tool would sink by more than 10 mm even with 0.2 kg.
    assert 0.005 < height[0] - height.min() < 0.010
    assert speed.max() < 0.08
    assert height[-1] == pytest.approx(height[0], abs=0.003)


@pytest.mark.parametrize(
    ("family", "pose"), [("sts", 2), pytest.param("x", 5, marks=pytest.mark.full)]
)
def test_what_is_in_the_way_of_a_descent_feels_no_more_than_15_newtons(family, pose):
    # Without the bound on the speed of heavy points, these arms would press with 17.8 and 19.2 N.
    q = bus_lower.poses(family, 6)[pose]
    with unknown_load(LOAD):
        run = bus_lower.lower(family, q, load=LOAD, over_table=True)
    assert run.force < 15.0
    assert run.speed < 0.18


@pytest.mark.parametrize("answers", [True, pytest.param(False, marks=pytest.mark.full)])
def test_an_arm_taken_over_keeps_its_torque_while_servos_are_silent(answers, monkeypatch, caplog):
    """Servos with torque are silent; they may answer after the descent has begun."""
    monkeypatch.setattr("pliant.servo._enable.RESUME_TIME", 0.05)
    monkeypatch.setattr("pliant.arm._shutdown.UNKNOWN_TIME", 0.5)
    with arm_over_bytes("sts", HIGH, patience=0.03) as (bus, program):
        program.enable()
        copy = pickle.loads(pickle.dumps(program.drive.closed_copy()))
        program.leave_enabled()
        program.close()
        start = bus.plant.tool[2, 3]
        copy.clock = clock = ManualClock(bus)
        arm = Arm(program.model, copy, guardian=False, handle_signals=False)
        for k in range(1, 6) if answers else [2]:
            bus.faults.inject("lose", id=k, count=10**6)
        begin, wait = clock.now(), clock.wait_until

        def watch(deadline):
            wait(deadline)
            if answers and clock.now() > begin + 1.0:
                bus.faults.clear()
            if bus.plant.tool[2, 3] > 0.05:
                assert all(servo.enabled for servo in bus.servos)

        monkeypatch.setattr(clock, "wait_until", watch)
        with caplog.at_level("INFO", logger="pliant.arm"):
            if answers:
                arm._resume("the program has ended")
            else:
                with pytest.raises(pliant.ServoFaultError, match=r"shoulder_lift, .* hold the arm"):
                    arm._resume("the program has ended")
            MESSAGES.flush(5.0)
        assert any(servo.enabled for servo in bus.servos) is not answers
        if answers:
            assert bus.plant.tool[2, 3] < start - 0.25
            assert "was lowered: torque OFF" in caplog.text
        else:
            assert "and torque is not known in shoulder_lift." in caplog.text
            assert "was lowered" not in caplog.text
        copy.close()


@pytest.mark.parametrize("family", ["sts", pytest.param("x", marks=pytest.mark.full)])
def test_a_line_dead_for_a_time_makes_no_joint_of_an_arm_taken_over_jump(family, monkeypatch):
    """One servo is silent from the start; all of them answer together after 2.5 s."""
    monkeypatch.setattr("pliant.servo._enable.RESUME_TIME", 0.05)
    # Ask the silent servo in each cycle, so that it answers in the same cycle as the others.
    monkeypatch.setattr("pliant.servo._port.PROBE_CYCLES", 1)
    rest = [0.0, -1.74, 1.57, 0.85, 0.0] if family == "sts" else None
    with arm_over_bytes(family, HIGH, patience=0.01, timing=TIMED) as (bus, program):
        program.enable()
        copy = pickle.loads(pickle.dumps(program.drive.closed_copy()))
        program.leave_enabled()
        program.close()
        copy.clock = clock = ManualClock(bus)
        arm = Arm(program.model, copy, guardian=False, handle_signals=False, rest_q=rest)
        line, begin, speeds, wait = bus.lines["main"], clock.now(), [], clock.wait_until
        silent = 3 if family == "sts" else 5
        for kind in ("deaf", "lose"):
            bus.faults.inject(kind, id=silent, count=10**6)

        def watch(deadline):
            wait(deadline)
            line.dead = 0.3 < clock.now() - begin < 2.8
            if clock.now() - begin > 2.8:
                bus.faults.clear()
            speeds.append(np.linalg.norm(bus.plant.ground_truth.frame("tool").twist()[:3]))

        monkeypatch.setattr(clock, "wait_until", watch)
        arm._resume("the program has ended")
        assert not any(servo.enabled for servo in bus.servos)
        # 1.2 (so101) and 0.6 m/s (koch) if the descent restarted from the goals sent meanwhile.
        assert max(speeds) < 0.15
        copy.close()


def test_a_descent_without_replies_that_is_aborted_does_not_lift_the_arm(monkeypatch):
    """The servos hear the goals of the descent, and the program does not hear the servos."""
    with arm_over_bytes("sts", HIGH, patience=0.01) as (bus, arm):
        arm.enable()
        begin, wait = arm.clock.now(), arm.clock.wait_until
        bus.faults.by_chance(lose=1.0)

        def watch(deadline):
            wait(deadline)
            if arm.clock.now() > begin + 3.0:
                arm._supervisor.abort.set()

        monkeypatch.setattr(arm.clock, "wait_until", watch)
        start = bus.plant.tool[2, 3]
        arm.lower()
        low = bus.plant.tool[2, 3]
        assert low < start - 0.04
        bus.faults.clear()
        wait(arm.clock.now() + 1.0)
        # If the arm were held where its positions were last known, it would rise by 56 mm at 0.3
        # m/s.
        assert bus.plant.tool[2, 3] < low + 0.005
        arm.close()


@pytest.mark.parametrize("family", FAMILIES)
def test_an_error_before_torque_names_the_servo_that_keeps_a_torque_limit(family):
    with arm_over_bytes(family, LOW, patience=0.01) as (bus, arm):
        arm.open()
        register = {"sts": "torque_limit", "x": "goal_pwm"}[family]
        factory = bus.servo(3).get(register)

        def watch(transaction):
            if any(write.id == 3 and register in write.values for write in transaction.writes):
                for kind in ("deaf", "lose"):
                    bus.faults.inject(kind, id=3, count=10**6)

        bus.log.watch = watch
        with pytest.raises(pliant.ServoError, match=r"elbow_flex: torque limits and speeds are"):
            arm.enable()
        assert bus.servo(3).get(register) < factory
        assert not any(servo.enabled for servo in bus.servos)
        arm.close()


def test_a_servo_that_hears_only_while_torque_comes_on_does_not_lift_the_arm():
    """The servo gets limits, but no goals, and still has the large lead of the first goals.

    With a slow adapter, the servo counts as silent before it gets the goals that hold the arm.
    """
    with arm_over_bytes("sts", STRETCHED, plant={}, timing=SLOW_ADAPTER) as (bus, arm):
        heights = []

        def watch(_):
            if all(servo.enabled for servo in bus.servos):
                if not heights:
                    bus.faults.inject("lose", id=2, count=10**6, skip=20)
                heights.append(bus.plant.tool[2, 3])

        bus.world.watchers.append(watch)
        with pytest.raises(pliant.ServoTimeoutError, match="no position of shoulder_lift"):
            arm.enable()
        # If its limit rose, the arm would rise by 19 mm.
        assert max(heights) - heights[0] < 0.005
        bus.faults.clear()
        arm.close()


@pytest.mark.parametrize("family", FAMILIES)
def test_a_servo_that_restarts_while_torque_comes_on_is_named(family, monkeypatch):
    with arm_over_bytes(family, LOW, patience=0.01) as (bus, arm):
        enable = arm.drive.enable

        def enable_and_restart(*arguments, **options):
            enable(*arguments, **options)
            bus.reboot(4)

        monkeypatch.setattr(arm.drive, "enable", enable_and_restart)
        with pytest.raises(pliant.ServoFaultError, match=r"torque of wrist_flex went off again"):
            arm.enable()
        # Other joints still hold the arm.
        assert [servo.id for servo in bus.servos if not servo.enabled] == [4]
        arm.close()
        assert not any(servo.enabled for servo in bus.servos)


@pytest.mark.parametrize("is_same", [True, False])
def test_a_gripper_with_torque_does_not_let_go_as_the_arm_is_taken_over(is_same):
    """An arm that was left on is enabled by the same program or by another one."""
    with arm_over_bytes("sts", LOW) as (bus, first):
        arm = first
        arm.enable()
        gripper = bus.servos[-1]
        bus.plant.mj_model.joint("gripper").range[0] = arm.gripper.position  # an object
        arm.gripper.close(force=0.5)
        arm.leave_enabled()
        arm.clock.wait_until(arm.clock.now() + 0.3)
        names = ("goal_position", "torque_limit")
        before = [gripper.get(name) for name in names]
        drive = arm.drive
        if not is_same:
            arm.close()
            drive = ServoBus(drive.specs, clock=ManualClock(bus))
            arm = Arm(arm.model, drive, handle_signals=False)
        arm.enable()
        arm.write(arm.read().q)
        arm.clock.wait_until(arm.clock.now() + 0.1)
        assert [gripper.get(name) for name in names] == before
        # With the measured position as goal, the torque would be 0.03 N·m.
        assert abs(bus.plant.mj_data.actuator("gripper").force[0]) == pytest.approx(0.5, rel=0.05)
        arm.disable_torque()
        arm.enable()  # without torque, the gripper stays where it is
        assert gripper.get("goal_position") == pytest.approx(gripper.position, abs=2)
        arm.close()


@pytest.mark.parametrize("seconds", [0.3, 1.0])
def test_a_line_dead_for_a_time_as_watchdogs_are_set(seconds, monkeypatch):
    with arm_over_bytes("x", LOW, patience=0.01) as (bus, arm):
        line, set_watchdog, since = bus.lines["main"], arm.drive.watchdog, None

        def begin(value):
            nonlocal since
            since = arm.clock.now() if since is None else since
            line.dead = arm.clock.now() < since + seconds
            set_watchdog(value)

        monkeypatch.setattr(arm.drive, "watchdog", begin)
        if seconds < arm.comm_timeout:
            arm.enable()
        else:
            with pytest.raises(pliant.ServoError, match="did not confirm the bus watchdog"):
                arm.enable()
        line.dead = False
        assert arm.enabled
        arm.close()


@pytest.mark.parametrize(("counts", "is_told"), [(-1024, True), (0, False)])
def test_joints_that_servos_do_not_carry_are_named(counts, is_told, monkeypatch):
    """The horn of the shoulder is mounted 90° off, so that the weight of the model is wrong."""
    texts = []
    monkeypatch.setattr(MESSAGES, "post", lambda text, *_, **__: texts.append(text))
    zero = {"shoulder_lift": 2048 + counts}
    table = {"scene": [Tabletop(height=0.0)]}
    with arm_over_bytes("sts", [0.0, -0.6, 0.6, 0.6, 0.0], plant=table, zero=zero) as (_, arm):
        arm.enable()
        told = [text for text in texts if "torque did not hold elbow_flex by +0." in text]
        assert bool(told) is is_told
        arm.disable_torque()
        arm.close()


def test_a_push_as_torque_comes_on_is_named_as_a_cause(monkeypatch):
    texts = []
    monkeypatch.setattr(MESSAGES, "post", lambda text, *_, **__: texts.append(text))
    push = Push(force_vector=(0.0, 3.0, 0.0), course=ForceProfile(start=0.5, end=2.5))
    arm = pliant.connect("so101", backend="sim", q=[0.0, -0.3, 0.3, 0.9, 0.0], scene=[push])
    arm.enable()
    (text,) = (text for text in texts if "torque did not hold shoulder_pan" in text)
    assert text.endswith("or a hand pushed the arm")
    arm.disable_torque()
    arm.close()


@pytest.mark.parametrize("joint", ["shoulder_lift", "elbow_flex"])
def test_a_wrong_sign_is_found_as_torque_comes_on(joint):
    """The arm of the test has the sign +1; with the model's weight it pushes where it should hold.

    Without the check, the arm falls onto the table and swings over its base to the rest pose.
    """
    start, heights = [0.0, -0.6, 0.6, 0.6, 0.0], []
    table = {"scene": [Tabletop(height=0.0)]}
    rest = {"rest_q": [0.0, -1.74, 1.57, 0.85, 0.0], "table": 0.0}
    with arm_over_bytes("sts", start, plant=table, wrong_sign=joint, **rest) as (bus, arm):
        step = bus.world.physics.step

        def watch(count):
            step(count)
            heights.append(bus.plant.tool[2, 3])

        bus.world.physics.step = watch
        with pytest.raises(pliant.ServoError, match=f"{joint} by 0.1. rad went against the weight"):
            arm.enable()
        assert arm.enabled
        arm.clock.wait_until(arm.clock.now() + 0.5)
        assert heights[0] - heights[-1] < 0.07  # [m], measured 0.06; 0.1 is the table
        height = heights[-1]
        arm.lower()
        arm.close()
        bus.world.physics.step = step
    assert arm.detour.startswith(f"torque did not hold {joint} by -0.1")
    assert max(heights) < heights[0] + 0.002
    assert heights[-1] < height


def test_a_joint_with_the_id_of_another_servo_is_named_and_not_swung_to_the_rest_pose(monkeypatch):
    """The elbow and the gripper have each other's ids in the file."""
    start, heights, texts = [0.0, -0.6, 0.6, 0.6, 0.0], [], []
    options = {
        "plant": {"scene": [Tabletop(height=0.0)]},
        "wrong_ids": {"elbow_flex": 6, "gripper": 3},
        "rest_q": [0.0, -1.74, 1.57, 0.85, 0.0],
        "table": 0.0,
    }
    monkeypatch.setattr(MESSAGES, "post", lambda text, *_, **__: texts.append(text))
    with arm_over_bytes("sts", start, **options) as (bus, arm):
        step = bus.world.physics.step

        def watch(count):
            step(count)
            heights.append(bus.plant.tool[2, 3])

        bus.world.physics.step = watch
        arm.enable()
        arm.lower()
        arm.close()
        bus.world.physics.step = step
    assert any("elbow_flex: no weight on the servo" in text for text in texts)
    assert arm.detour.startswith("elbow_flex: no weight on the servo")
    assert max(heights) < heights[0] + 0.005  # 0.017 m on the way to the rest pose


@pytest.mark.parametrize("answers", [True, False])
def test_a_servo_silent_during_torque_off_is_asked_again_at_close(answers, monkeypatch, caplog):
    with arm_over_bytes("sts", LOW, patience=0.01, guardian=False) as (bus, arm):
        arm.open()
        servo, names = bus.servo(3), ("torque_limit", "goal_velocity", "torque_enable")
        before = [servo.get(name) for name in names]
        arm.enable()
        disable = arm.drive.disable

        def disable_silently(*arguments):
            for kind in ("deaf", "lose"):
                bus.faults.inject(kind, id=3, count=10**6)
            disable(*arguments)

        monkeypatch.setattr(arm.drive, "disable", disable_silently)
        with (
            caplog.at_level("WARNING", logger="pliant.arm"),
            pytest.raises(pliant.ServoError, match="elbow_flex did not confirm torque_enable"),
        ):
            arm.lower()
        bus.sync()
        assert servo.enabled
        if answers:
            bus.faults.clear()
        requests = len(bus.log)
        with caplog.at_level("WARNING", logger="pliant.arm"):
            arm.close()
            MESSAGES.flush(5.0)
        is_told = "speeds of elbow_flex could not be restored" in caplog.text
        assert is_told is not answers
        if answers:
            assert [servo.get(name) for name in names] == before
            assert not (arm.drive.torque_unknown | arm.drive.unrestored).any()
        else:
            # One read, and its retries within a few periods.
            assert 0 < len(bus.log) - requests < 10


def test_a_supply_that_falls_in_a_loop_is_told_once(monkeypatch):
    texts = []
    monkeypatch.setattr(MESSAGES, "post", lambda text, *_, **__: texts.append(text))
    with arm_over_bytes("sts", LOW) as (bus, arm):
        arm.enable()
        assert not texts
        hold(arm, rate=50.0)
        assert not texts
        bus.supply(4.0)  # the lowest voltage at which these servos can be driven: no fault
        hold(arm, rate=50.0)
        (text,) = texts
        assert " was between 4.0 and 7.4 V since torque came on: " in text
        arm.disable_torque()
        arm.close()


@pytest.mark.parametrize("family", ["sts", "mx"])
def test_a_trip_that_the_next_command_ends_is_told_once(family, monkeypatch):
    texts = []
    monkeypatch.setattr(MESSAGES, "post", lambda text, *_, **__: texts.append(text))
    with arm_over_bytes(family, LOW) as (bus, arm):
        arm.enable()
        controller = pliant.Controller(arm.model, pliant.Settings(task="xyz"), arm.servos)
        target = arm.model.forward_kinematics(arm.read().q)
        for tick in pliant.Loop(arm, controller, duration=2.0):
            tick.step(target)
            if tick.index in {50, 100}:  # the next reading shows it; the goal of that tick ends it
                bus.trip(3, "overload")
        told = [text for text in texts if "tripped" in text]
        assert len(told) == 1, texts
        assert told[0].startswith("elbow_flex (id 3): overload: the servo's protection tripped")
        assert "Lower the load" in told[0]
        arm.disable_torque()
        arm.close()


def test_the_summary_counts_the_fall_after_a_brown_out(monkeypatch):
    texts = []
    monkeypatch.setattr(MESSAGES, "post", lambda text, *_, **__: texts.append(text))
    with arm_over_bytes("sts", HIGH) as (bus, arm):
        arm.enable()
        height = bus.plant.tool[2, 3]
        controller = pliant.Controller(arm.model, pliant.Settings(task="xyz"), arm.servos)
        target = arm.model.forward_kinematics(arm.read().q)

        def run():
            for tick in pliant.Loop(arm, controller, duration=3.0):
                if tick.index == 50:
                    bus.brown_out()
                tick.step(target)

        with pytest.raises(pliant.ServoError):
            run()
        fallen = height - bus.plant.tool[2, 3]
        assert fallen > 0.1
        arm.close()
        total = height - bus.plant.tool[2, 3]
    (told,) = re.findall(r"tool (\d+) cm lower", texts[-1])
    assert int(told) == pytest.approx(100.0 * total, abs=2.0)


def test_an_arm_that_has_ended_takes_no_command():
    with arm_over_bytes("sts", LOW) as (_, arm):
        with arm:
            controller = pliant.Controller(arm.model, pliant.Settings(task="xyz"), arm.servos)
            target = arm.model.forward_kinematics(arm.read().q)
            gripper = arm.gripper
            for tick in pliant.Loop(arm, controller, duration=0.1):
                tick.step(target)
        assert arm.clock.now() - tick.began > 0.2  # the tick is too old for a command
        commands = (
            lambda: arm.write(tick.q),
            lambda: tick.step(target),
            lambda: tick.write(tick.command),
            gripper.open,
            arm.gripper.close,
        )
        for command in commands:
            with pytest.raises(pliant.ServoError, match="torque is off: use"):
                command()
