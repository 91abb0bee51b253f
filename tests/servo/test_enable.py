"""Torque on with one lost packet, registers that bound the torque, and their restoration."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from pliant import ServoError
from pliant.emulator import Emulator, ManualClock
from pliant.servo import ServoBus, ServoSpec, _enable
from pliant.servo import _device as driver
from tests.servo.conftest import JOINTS, devices

KINDS = ["sts", "xm", "xl430", "ex", "rx", "mx"]
#: Distance between old goals and present positions [counts], 44° with 4096 counts per turn.
GOAL_ERROR = 500


def servo_bus_on(bus, kind, n, patience=0.005):
    specs = [
        ServoSpec(
            name=f"joint{i}", model=JOINTS[kind][1], id=i + 1, port=bus.port, lower=-1.0, upper=1.0
        )
        for i in range(n)
    ]
    return ServoBus(specs, reply_timeout_min=patience, clock=ManualClock(bus))


def fault_request(bus, fault, index):
    """Apply `fault` to the request number `index`, counted from 1; return the request count.

    The count is a list of one number, which grows with each request.
    """
    line, count = bus.lines["main"], [0]

    def chance():
        count[0] += 1
        return fault if count[0] == index else None

    line.faults.chance = chance
    return count


def enable_with_old_goals(kind, fault, index):
    """Enable servos that have old goals; return their largest motion [rad] and request count.

    The motion is measured until one second after torque on.
    """
    with Emulator(devices(kind, 2), clock="steps") as bus, servo_bus_on(bus, kind, 2) as servo_bus:
        for servo in bus.servos:
            servo.put("goal_position", servo.position - GOAL_ERROR if kind != "rx" else 100)
            speeds = {"moving_speed", "profile_velocity", "goal_velocity"}
            for name in speeds & {register.name for register in servo.table}:
                servo.put(name, 0)
        start = np.array([servo.shaft.angle for servo in bus.servos])
        goal = servo_bus.read().position
        count = fault_request(bus, fault, index)
        distances = []
        try:
            servo_bus.enable(goal, 0.5 * servo_bus.servos.max_torque)
        except ServoError:
            assert not any(servo.enabled for servo in bus.servos)
        requests = count[0]
        for _ in range(10):
            bus.advance(0.02)
            distances.append(
                max(abs(servo.shaft.angle - start[i]) for i, servo in enumerate(bus.servos))
            )
        assert not bus.log.eeprom_writes()
        return max(distances), requests


@pytest.mark.parametrize("fault", ["deaf", pytest.param("lose", marks=pytest.mark.full)])
@pytest.mark.parametrize("kind", KINDS)
def test_no_single_lost_packet_switches_torque_on_with_an_old_goal(kind, fault):
    _, requests = enable_with_old_goals(kind, fault, 0)
    assert requests > 10
    for index in range(1, requests + 1):
        distance, _ = enable_with_old_goals(kind, fault, index)
        assert distance < 0.005, f"request {index} of {requests}"


@pytest.mark.parametrize("kind", ["sts", "xm", "mx"])
def test_torque_that_could_not_be_switched_off_again_is_reported(kind):
    """All packets are lost after the first servo has switched its torque on."""
    with Emulator(devices(kind, 2), clock="steps") as bus, servo_bus_on(bus, kind, 2) as servo_bus:
        goal, faults = servo_bus.read().position, bus.lines["main"].faults
        # Before that, no servo has torque, and silence gives another message.
        faults.chance = lambda: "deaf"
        with pytest.raises(ServoError, match=r"\A(?!.*may still be on)"):
            servo_bus.enable(goal, 0.5 * servo_bus.servos.max_torque)
        faults.chance = lambda: "deaf" if any(servo.enabled for servo in bus.servos) else None
        with pytest.raises(
            ServoError, match=r"(?s)torque may still be on: .*cut the supply"
        ) as error:
            servo_bus.enable(goal, 0.5 * servo_bus.servos.max_torque)
        assert bus.servos[0].enabled
        assert "joint0, joint1 did not confirm torque_enable = 0" in str(error.value)


@pytest.mark.parametrize("kind", ["sts", "xl430", "mx"])
def test_a_failure_before_torque_comes_on_names_no_fall(emulated, enabled, kind):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        bus.stick(1, "goal_pwm" if kind == "xl430" else "torque_limit", 7)
        with pytest.raises(ServoError, match=r"did not take the torque limit.*switched on\Z"):
            enabled(servo_bus)
        assert not servo_bus.enabled.any()
        assert {write.data for write in bus.log.writes("torque_enable")} == {b"\0"}


@pytest.mark.parametrize("had_torque", [False, True])
@pytest.mark.parametrize("kind", ["sts", "xm"])
def test_a_failure_while_torque_comes_on_says_what_falls(kind, had_torque, monkeypatch):
    """The line fails once a servo gets torque, until torque is switched off again.

    One of two servos may have torque already, and keeps it.
    """
    with Emulator(devices(kind, 2), clock="steps") as bus, servo_bus_on(bus, kind, 2) as servo_bus:
        goal, faults = servo_bus.read().position, bus.lines["main"].faults
        switched = bus.servos
        if had_torque:
            servo_bus.enable(goal, 0.5 * servo_bus.servos.max_torque)
            servo_bus.disable(["joint0"])
            bus.sync()
            bus.log.clear()
            switched = bus.servos[:1]
        faults.chance = lambda: "deaf" if any(servo.enabled for servo in switched) else None
        switch_off = _enable._try_off

        def mended(device, ports):
            faults.chance = lambda: None
            return switch_off(device, ports)

        monkeypatch.setattr(_enable, "_try_off", mended)
        where = "joint0" if had_torque else "all joints"
        with pytest.raises(ServoError, match=rf"\ntorque is OFF again in {where}: .*falls"):
            servo_bus.enable(goal, 0.5 * servo_bus.servos.max_torque)
        bus.sync()
        assert len(bus.log.writes("torque_enable")) >= len(switched)
        assert [servo.enabled for servo in bus.servos] == [False, had_torque]
        assert servo_bus.enabled.tolist() == [False, had_torque]
        assert not (servo_bus.torque_unknown | servo_bus.unrestored).any()


def test_a_register_that_does_not_take_its_value_is_named(emulated, enabled):
    with emulated("sts", 1, clock="steps") as (bus, servo_bus):
        bus.stick(1, "acceleration", 7)
        message = r"joint0 did not take acceleration_cap: it reads 7, written was 0; nothing"
        with pytest.raises(ServoError, match=message):
            enabled(servo_bus)


def test_registers_that_were_not_restored_after_a_failure_are_named(monkeypatch):
    def fails(device, ports):
        raise ServoError("no answer")

    monkeypatch.setattr(_enable, "_restore_registers", fails)
    with Emulator(devices("xm", 2), clock="steps") as bus, servo_bus_on(bus, "xm", 2) as servo_bus:
        bus.stick(2, "torque_enable", 0)
        with pytest.raises(ServoError, match=rf"\njoint0, joint1: {_enable.KEPT}\Z"):
            servo_bus.enable(servo_bus.read().position, 0.5 * servo_bus.servos.max_torque)
        assert servo_bus.unrestored.all()


def test_a_silent_servo_delays_no_watchdog_of_the_others():
    with Emulator(devices("xm", 3), clock="steps") as bus, servo_bus_on(bus, "xm", 3) as servo_bus:
        servo_bus.read()
        time.sleep(0.05)  # longer than the time budget of a cycle: the call must start a new one
        bus.unplug(1)
        before = servo_bus.counters
        with pytest.raises(ServoError, match=r"\Ajoint0 did not confirm"):
            servo_bus.watchdog(0.2)
        assert servo_bus.counters["retries"] == before["retries"]
        assert 1 <= servo_bus.counters["timeouts"] - before["timeouts"] <= 4
        assert [servo.get("bus_watchdog") for servo in bus.servos[1:]] == [10, 10]
        # If no servo at all replies, the requests are not repeated.
        bus.short()
        before = servo_bus.counters
        with pytest.raises(ServoError, match=r"\Ajoint0, joint1, joint2 did not confirm"):
            servo_bus.watchdog(0.1)
        assert servo_bus.counters["timeouts"] - before["timeouts"] <= 3


def test_a_watchdog_whose_packets_are_lost_is_set_again():
    with Emulator(devices("xm", 2), clock="steps") as bus, servo_bus_on(bus, "xm", 2) as servo_bus:
        servo_bus.read()
        lost = [*["deaf"] * 2, *[None] * 2, *["deaf"] * 2]
        bus.lines["main"].faults.chance = lambda: lost.pop(0) if lost else None
        servo_bus.watchdog(0.2)
        assert [servo.get("bus_watchdog") for servo in bus.servos] == [10, 10]
        assert not lost


@pytest.mark.parametrize("count", [1, 2])
def test_a_lost_reply_leaves_no_watchdog_unconfirmed(count):
    # A late reply would look like the next one, so a reading of another length comes in between.
    with Emulator(devices("xm", 2), clock="steps") as bus, servo_bus_on(bus, "xm", 2) as servo_bus:
        servo_bus.read()
        bus.faults.inject("lose", 2, count=count)
        servo_bus.watchdog(0.2)
        assert [servo.get("bus_watchdog") for servo in bus.servos] == [10, 10]


@pytest.mark.parametrize("kind", KINDS)
def test_first_goals_lead_by_what_carries_the_weight(kind):
    """A joint whose goal would be outside of the range of the servo leads up to its end."""
    with Emulator(devices(kind, 3), clock="steps") as bus:
        specs = [
            ServoSpec(
                name=f"joint{i}",
                model=JOINTS[kind][1],
                id=i + 1,
                port=bus.port,
                lower=-1.0,
                upper=1.0,
                sign=-1 if i == 1 else 1,
            )
            for i in range(3)
        ]
        with ServoBus(specs, reply_timeout_min=0.005, clock=ManualClock(bus)) as chain:
            count = bus.servos[0].model.count
            before = [servo.position for servo in bus.servos]
            writes = []
            for servo in bus.servos:
                servo.put("goal_position", 0)
            angles = chain.read().position
            chain.enable(angles, 0.2 * chain.servos.max_torque, lead=[0.05, 0.05, 5.0])
            bus.sync()
            goals = np.array([servo.get("goal_position") for servo in bus.servos])
            writes = np.array(goals - before) * count
            assert writes[0] == pytest.approx(0.05, abs=count)
            assert writes[1] == pytest.approx(-0.05, abs=count)
            # The limit of the joint is 1 rad.
            assert angles[2] + writes[2] == pytest.approx(1.0, abs=2.0 * count)


@pytest.mark.parametrize("kind", ["sts", "xm"])
def test_few_requests_while_an_arm_hangs_on_servos_without_feedback(kind):
    """An arm with a load falls until the first goal that reacts to its motion."""
    with Emulator(devices(kind, 6), clock="steps") as bus, servo_bus_on(bus, kind, 6) as chain:
        goal, requests, line = chain.read().position, [], bus.lines["main"].faults

        def chance():
            requests.append(all(servo.enabled for servo in bus.servos))

        line.chance = chance
        chain.enable(goal, 0.5 * chain.servos.max_torque)
        chain.read()
        assert all(servo.enabled for servo in bus.servos)
        # With a request per servo instead of one to all servos: 43 (sts) and 13 (xm).
        assert 0 < sum(requests) <= 10


def registers(servo):
    """Return the RAM registers that bound torque or motion, by name."""
    names = [
        "torque_limit", "goal_current", "goal_pwm", "moving_speed", "goal_velocity", "goal_time",
        "profile_velocity", "profile_acceleration", "acceleration", "goal_acceleration",
        "bus_watchdog", "cw_compliance_margin", "ccw_compliance_margin", "ccw_compliance_slope",
        "punch", "i_gain", "position_i_gain",
    ]  # fmt: skip
    available = {register.name for register in servo.table}
    return {name: servo.get(name) for name in names if name in available}


@pytest.mark.parametrize("kind", KINDS)
def test_registers_are_handed_back_as_they_were_found(emulated, enabled, kind):
    with emulated(kind, 2, clock="steps", is_open=False) as (bus, servo_bus):
        for servo in bus.servos:
            for name, value in registers(servo).items():
                servo.put(name, value - 7 if name in {"torque_limit", "goal_current"} else 3)
        before = [registers(servo) for servo in bus.servos]
        servo_bus.open()
        for _ in range(2):
            limit = enabled(servo_bus)
            servo_bus.watchdog(0.2)
            for k in range(5):
                servo_bus.read()
                servo_bus.write([0.01 * k, 0.0], 0.01 * limit, velocity=[0.1, 0.1])
                bus.advance(0.01)
            assert [registers(servo) for servo in bus.servos] != before
            servo_bus.disable()
            bus.sync()
            assert [registers(servo) for servo in bus.servos] == before
        assert not bus.log.eeprom_writes()


@pytest.mark.parametrize("kind", ["sts", "xm", "mx"])
def test_limits_that_a_killed_program_left_are_not_handed_back(emulated, enabled, kind):
    with emulated(kind, 1, clock="steps") as (bus, servo_bus):
        name = {"sts": "torque_limit", "xm": "goal_current", "mx": "torque_limit"}[kind]
        full = bus.servos[0].get(name)
        limit = enabled(servo_bus)
        servo_bus.write([0.0], 0.01 * limit, velocity=[0.1])
        servo_bus.close()  # the torque stays on, as after a killed program
        servo_bus.open()
        enabled(servo_bus)
        servo_bus.disable()
        bus.sync()
        assert bus.servos[0].get(name) == full


def test_a_limit_of_zero_after_an_overload_is_not_handed_back(emulated, enabled):
    for found, restored in ((0, 1000), (1, 1), (700, 700)):
        with emulated("sts", 1, clock="steps", is_open=False) as (bus, servo_bus):
            bus.servos[0].put("torque_limit", found)
            servo_bus.open()
            enabled(servo_bus)
            servo_bus.disable()
            bus.sync()
            assert bus.servos[0].get("torque_limit") == restored


def test_lerobot_moves_an_arm_after_pliant_as_before(emulated, enabled):
    """The registers that LeRobot does not write, such as limits and speeds, are restored."""

    def lerobot(bus, goal):
        for servo in bus.servos:
            servo.write(40, bytes([1]))
            servo.write(42, goal.to_bytes(2, "little"))
        bus.advance(1.5)
        positions = [servo.position for servo in bus.servos]
        for servo in bus.servos:
            servo.write(40, bytes([0]))
        return positions

    with emulated("sts", 2, clock="steps") as (bus, servo_bus):
        for servo in bus.servos:
            servo.load.torque = -0.5
        before = lerobot(bus, 2300)
        lerobot(bus, 2048)
        enabled(servo_bus)
        servo_bus.write([0.0, 0.0], [0.002, 0.002], velocity=[0.01, 0.01])
        servo_bus.read()
        servo_bus.disable()
        for servo in bus.servos:
            servo.shaft.angle = 2048 * servo.model.count
        assert lerobot(bus, 2300) == pytest.approx(before, abs=2)


def test_a_goal_pwm_that_was_left_low_does_not_weaken_a_current_limited_servo(emulated, enabled):
    with emulated("xm", 1, clock="steps", is_open=False) as (bus, servo_bus):
        bus.servos[0].put("goal_pwm", 150)
        servo_bus.open()
        enabled(servo_bus, share=1.0)
        bus.sync()
        assert bus.servos[0].drive().ceiling == pytest.approx(
            servo_bus.servos.max_torque[0], rel=0.01
        )
        servo_bus.disable()
        bus.sync()
        assert bus.servos[0].get("goal_pwm") == 150


@pytest.mark.parametrize("kind", ["xm", "xl430", "mx"])
def test_an_integral_gain_that_another_program_left_is_off_while_driven(emulated, enabled, kind):
    """With an integral gain, a servo's force against a hand would grow up to its torque limit."""
    name = "i_gain" if kind == "mx" else "position_i_gain"
    with emulated(kind, 1, clock="steps", is_open=False) as (bus, servo_bus):
        bus.servos[0].put(name, 200)
        servo_bus.open()
        enabled(servo_bus)
        bus.sync()
        assert bus.servos[0].get(name) == 0
        servo_bus.disable()
        bus.sync()
        assert bus.servos[0].get(name) == 200


@pytest.mark.parametrize(("kind", "punch"), [("ex", 0), ("rx", 32)])
def test_compliance_that_another_program_left_does_not_weaken_a_servo(
    emulated, enabled, kind, punch
):
    """With a compliance margin of 200 counts, a servo would let its joint sag."""
    registers_left = {
        "cw_compliance_margin": 200,
        "ccw_compliance_margin": 150,
        "ccw_compliance_slope": 254,
        "punch": 900,
    }
    with emulated(kind, 1, clock="steps", is_open=False) as (bus, servo_bus):
        (servo,) = bus.servos
        for name, value in registers_left.items():
            servo.put(name, value)
        servo_bus.open()
        enabled(servo_bus, share=1.0)
        bus.sync()
        assert servo.drive().dead == servo.model.count
        assert [servo.get(name) for name in registers_left] == [
            1,
            1,
            servo.get("cw_compliance_slope"),
            punch,
        ]
        servo_bus.disable()
        bus.sync()
        assert {name: servo.get(name) for name in registers_left} == registers_left


def test_a_pwm_limit_bounds_the_torque_that_is_reported():
    from pliant.emulator import Device

    part = Device("XM430-W350", 1, operating_mode=5, return_delay_time=0, pwm_limit=300)
    with (
        Emulator([part], clock="steps") as bus,
        servo_bus_on(bus, "xm", 1, patience=0.1) as servo_bus,
    ):
        assert servo_bus.servos.max_torque[0] == pytest.approx(4.1 * 300 / 885, rel=0.01)
        assert any("PWM Limit" in note and "34%" in note for note in servo_bus.found[0].notes)
        servo_bus.enable(servo_bus.read().position, servo_bus.servos.max_torque)
        bus.sync()
        ceiling = bus.servos[0].drive().ceiling
        assert ceiling == pytest.approx(servo_bus.servos.max_torque[0], rel=0.01)


@pytest.mark.parametrize("disturbance", ["hum", "echo"])
@pytest.mark.parametrize("kind", ["sts", "xm", "mx"])
def test_torque_goes_off_on_a_line_that_is_never_silent(enabled, kind, disturbance):
    with (
        Emulator(devices(kind, 3), clock="steps") as bus,
        servo_bus_on(bus, kind, 3, 0.01) as servo_bus,
    ):
        enabled(servo_bus)
        getattr(bus, disturbance)()
        # With noise, `disable` fails because torque off is not confirmed; with an echo it may pass.
        failed = False
        try:
            servo_bus.disable()
        except ServoError:
            failed = True
        bus.sync()
        assert not any(servo.enabled for servo in bus.servos)
        # Torque counts as on until torque off is confirmed.
        assert servo_bus.torque_unknown.any() is np.bool_(failed)
        assert np.array_equal(servo_bus.enabled, servo_bus.torque_unknown)
        assert (servo_bus.unrestored | ~servo_bus.torque_unknown).all()
        getattr(bus, disturbance)(False)
        servo_bus.disable()
        assert not (servo_bus.enabled | servo_bus.torque_unknown | servo_bus.unrestored).any()


@pytest.mark.parametrize("disturbance", ["hum", "echo"])
@pytest.mark.parametrize("kind", ["sts", "xm", "mx"])
def test_a_line_that_is_never_silent_is_reported_at_open(kind, disturbance):
    # Noise arrives every 5 ms; only 10 ms without data, a fifth of the reply timeout, are silence.
    with (
        Emulator(devices(kind, 3), clock="steps") as bus,
        servo_bus_on(bus, kind, 3, 0.05) as servo_bus,
    ):
        servo_bus.close()
        getattr(bus, disturbance)()
        with pytest.raises(ServoError, match=r"never silent|echo") as error:
            servo_bus.open()
        assert "id of its own" not in str(error.value)
        assert "Two servos on one id" not in str(error.value)
        getattr(bus, disturbance)(False)
        servo_bus.open()
        assert servo_bus.read().ok.all()


@pytest.mark.parametrize(
    ("kind", "number", "expected"),
    [
        ("xm", 1, [True, False]),
        ("xm", 2, [True, True]),
        ("xm", 3, [True, True]),
        ("sts", 1, [True, True]),  # the goal has switched on the second servo
    ],
)
def test_a_signal_while_torque_comes_on_does_not_drop_the_arm(kind, number, expected, monkeypatch):
    """The signal comes after joint `number` got torque; number 3: while motion is checked."""
    original, count = _enable._set, 0

    def interrupted(device, ports, name, value):
        nonlocal count
        original(device, ports, name, value)
        if (name, value) == ("torque_enable", 1):
            count += 1
            if count == number:
                raise KeyboardInterrupt

    def check(*_):
        raise SystemExit(143)

    monkeypatch.setattr(_enable, "_set", interrupted)
    monkeypatch.setattr(_enable, "_check_still", check)
    with Emulator(devices(kind, 2), clock="steps") as bus, servo_bus_on(bus, kind, 2) as servo_bus:
        with pytest.raises((KeyboardInterrupt, SystemExit)):
            servo_bus.enable(servo_bus.read().position, 0.5 * servo_bus.servos.max_torque)
        assert [servo.enabled for servo in bus.servos] == expected
        servo_bus.disable()
        assert not any(servo.enabled for servo in bus.servos)


class Image(dict):
    """Registers of a servo by name, 0 if absent, with the time of their reading [s]."""

    def __missing__(self, name):
        return 0


@pytest.mark.parametrize(
    ("counts", "speed", "seconds", "limit", "is_still"),
    [
        (32, 0, 0.0, 0, True),  # 0.05 rad
        (33, 0, 0.0, 0, False),
        (-33, 0, 0.0, 0, False),
        (-50, -100, 0.1, 0, True),  # falling: twice 100 steps/s for 0.1 s is allowed
        (-53, 10, 0.1, 0, False),
        (90, 0, 0.0, 1000, True),  # sagging is allowed until the servo exerts its limit
        (600, 0, 0.0, 1000, False),
    ],
)
def test_a_joint_may_fall_and_sag_but_not_jump_as_torque_comes_on(
    counts, speed, seconds, limit, is_still
):
    device = driver.Device(ServoSpec(name="pan", model="STS3215-7.4V", id=1, port=""), 0, 1, 1)
    device._last_sent = (2000, limit, 1, b"")
    before, after = Image(position=2000, speed=speed), Image(position=2000 + counts)
    before.time, after.time = 5.0, 5.0 + seconds
    with pytest.raises(ServoError, match="did not switch its torque on"):
        _enable._check_still(device, before, after)
    after["torque_enable"] = 1
    if is_still:
        _enable._check_still(device, before, after)
        return
    moved = abs(counts) * device.units.count
    with pytest.raises(ServoError, match=f"pan moved by {moved:.2f} rad"):
        _enable._check_still(device, before, after)


@pytest.mark.parametrize(("pings", "returns"), [(1, True), (30, True), (10**6, False)])
def test_a_servo_has_a_limited_time_to_restart(monkeypatch, pings, returns):
    device = driver.Device(ServoSpec(name="pan", model="XM430-W350", id=7, port=""), 0, 7, 1)
    device.enabled, device.hardware, time, calls = True, ("overload",), [0.0], []

    def ping(id):
        time[0] += 0.02
        calls.append(id)
        return len(calls) >= pings

    guard = SimpleNamespace(start_cycle=lambda: None, reboot=calls.append, ping=ping)
    monkeypatch.setattr(_enable.time, "monotonic", lambda: time[0])
    monkeypatch.setattr(_enable, "_image", lambda *arguments: calls.append(arguments[2:]))
    ports = {id(device): SimpleNamespace(guard=guard)}
    if returns:
        _enable.reboot([device], ports)
        assert not device.faults
        assert calls[-1] == ("hardware_error", "torque_enable")
    else:
        with pytest.raises(ServoError, match="pan did not come back within"):
            _enable.reboot([device], ports)
        assert time[0] == pytest.approx(_enable.REBOOT, abs=0.041)
        assert device.hardware
    assert not device.enabled
    assert calls[0] == 7


@pytest.mark.parametrize("is_enabled_again", [False, True])
def test_close_repeats_a_torque_off_only_if_it_was_the_last_request(enabled, is_enabled_again):
    with Emulator(devices("sts", 2), clock="steps") as bus:
        servo_bus = servo_bus_on(bus, "sts", 2, 0.01)
        servo_bus.open()
        enabled(servo_bus)
        for kind in ("deaf", "lose"):
            bus.faults.inject(kind, id=2, count=10**6)
        with pytest.raises(ServoError, match="joint1 did not confirm torque_enable"):
            servo_bus.disable()
        bus.sync()  # the last packets get lost too
        bus.faults.clear()
        if is_enabled_again:
            goal = servo_bus.read().position + np.array([1.0, 0.0])
            with pytest.raises(ServoError, match="enable it with its present position"):
                servo_bus.enable(goal, 0.5 * servo_bus.servos.max_torque)
            assert bus.servo(2).enabled
        servo_bus.close()
        assert [servo.enabled for servo in bus.servos] == [False, is_enabled_again]
