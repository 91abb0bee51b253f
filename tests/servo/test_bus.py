"""`ServoBus` over a pseudo-terminal: all families, torque on and off, units, order of writes."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from pliant import ConfigError, ServoError, ShapeError
from pliant._core import BusStatus, ServoCodec
from pliant.emulator import Device, Emulator, ManualClock
from pliant.servo import BusError, ServoBus, ServoSpec
from pliant.servo import _device as driver
from pliant.servo._port import RESTART_SPEED, Port, StatusPoller, latency_timer
from pliant.servo._transactions import TransactionGuard
from pliant.servo.bus import check_agreement

KINDS = ["sts", "xm", "xl430", "ex", "rx", "mx"]
#: Name of the emulator's register of the supply voltage, for each kind.
VOLTAGE = dict.fromkeys(KINDS, "present_voltage") | dict.fromkeys(
    ("xm", "xl430"), "present_input_voltage"
)


def settle(bus, servo_bus, goal, limit, seconds=1.0):
    for _ in range(10):
        servo_bus.read()
        servo_bus.write(goal, limit)
        bus.advance(seconds / 10)
    return servo_bus.read()


@pytest.mark.parametrize("kind", KINDS)
def test_goals_arrive_in_radians(emulated, enabled, kind):
    with emulated(kind, 3, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        goal = np.array([0.3, -0.2, 0.1])
        sample = settle(bus, servo_bus, goal, limit)
        middle = 512 if kind == "rx" else 2048
        for i, servo in enumerate(bus.servos):
            truth = servo.shaft.angle - middle * servo.model.count
            assert sample.position[i] == pytest.approx(truth, abs=1.5 * servo.model.count)
        # Gear friction stops a servo short of its goal by no more than friction / k_p.
        assert sample.position == pytest.approx(goal, abs=0.06)
        assert sample.ok.all()


@pytest.mark.parametrize("kind", KINDS)
def test_supply_and_temperature_are_known_from_open_on(emulated, kind):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        status = servo_bus.poll_status()
        assert status.name == "joint0"
        assert status.voltage == pytest.approx(bus.servos[0].get(VOLTAGE[kind]) / 10.0)
        assert status.temperature == bus.servos[0].get("present_temperature")


@pytest.mark.parametrize("kind", KINDS)
def test_limits_on_the_wire_are_what_was_asked(emulated, enabled, kind):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        largest = servo_bus.servos.max_torque
        for share in (0.0, 0.013, 0.37, 1.0, 7.0):
            servo_bus.write([0.0, 0.0], share * largest)
            servo_bus.read()
            bus.sync()
            for i, servo in enumerate(bus.servos):
                expected = min(share, 1.0) * largest[i]
                name = {"sts": "torque_limit", "xm": "goal_current", "xl430": "goal_pwm"}
                register = servo.get(name.get(kind, "torque_limit"))
                full = {"sts": 1000, "xm": 1193, "xl430": 885}.get(kind, 1023)
                unit = 4.1 / 2.3 * 0.00269 if kind == "xm" else largest[i] / full
                assert register <= full
                assert expected - 1.001 * unit <= register * unit <= expected * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_negative_values_are_named_with_their_joint(emulated, enabled, kind):
    with emulated(kind, 2, clock="steps") as (_, servo_bus):
        enabled(servo_bus)
        name = servo_bus.names[1]
        for call in (servo_bus.enable, servo_bus.write):
            with pytest.raises(ConfigError, match=f"limit of {name} is -0.1 N·m, at least 0"):
                call([0.0, 0.0], [0.5, -0.1])
        with pytest.raises(ConfigError, match=f"velocity of {name} is -2 rad/s, at least 0"):
            servo_bus.write([0.0, 0.0], [0.5, 0.5], [1.0, -2.0])


@pytest.mark.parametrize("kind", KINDS)
def test_order_on_the_wire_is_limit_goal_torque(emulated, enabled, kind):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        servo_bus.read()
        for number in (1, 2):
            assert bus.log.order(number)[:3] == ["limit", "goal", "torque on"]
        assert bus.log.eeprom_writes() == []
        assert not bus.log.writes(refused=True)


@pytest.mark.parametrize("kind", KINDS)
def test_no_goal_while_disabled(emulated, enabled, kind):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        servo_bus.write([0.5, 0.5], [1.0, 1.0])
        servo_bus.read()
        assert bus.log.writes() == []
        enabled(servo_bus)
        servo_bus.disable(["joint0"])
        servo_bus.read()
        bus.log.clear()
        servo_bus.write([0.2, 0.2], [0.5, 0.5])
        servo_bus.read()
        assert {write.id for write in bus.log.writes()} == {2}
        assert servo_bus.enabled.tolist() == [False, True]


def test_a_single_servo_without_torque_gets_no_goal(emulated):
    with emulated("sts", 1, clock="steps") as (bus, servo_bus):
        servo_bus.write([0.5], [1.0])
        servo_bus.read()
        assert bus.log.writes() == []


@pytest.mark.parametrize("kind", ["sts", "xm"])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (([np.nan, 0.0], [0.5, 0.5]), "goal of joint0 is not finite"),
        (([0.0, 0.0], [np.inf, 0.5]), "limit of joint0 is not finite"),
        (([0.0, 0.0], [-0.1, 0.5]), "limit of joint0 is -0.1 N·m, at least 0"),
        (([0.0, 0.0], [0.5, 0.5], [np.nan, 1.0]), "velocity of joint0 is not a number"),
    ],
)
def test_numbers_of_a_disabled_joint_are_validated_too(emulated, enabled, kind, value, message):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        for names in (servo_bus.names, ["joint0"]):
            enabled(servo_bus)
            servo_bus.disable(names)
            servo_bus.read()
            before = bus.log.count
            with pytest.raises(ConfigError, match=message):
                servo_bus.write(*value)
            assert bus.log.count == before


@pytest.mark.parametrize("kind", KINDS)
def test_goal_and_limit_travel_in_one_packet(emulated, enabled, kind):
    with emulated(kind, 3, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        servo_bus.read()
        bus.log.clear()
        servo_bus.write(np.full(3, 0.1), limit)
        servo_bus.read()
        writing = [t for t in bus.log if t.writes]
        assert len(writing) == (2 if kind == "xl430" else 1)
        assert all(len(t.writes) == 3 for t in writing)
        assert "goal_position" not in (writing[0].writes[0].values if len(writing) > 1 else ())


def test_a_torque_that_is_on_already_is_taken_over(emulated, enabled):
    with emulated("sts", 1, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        settle(bus, servo_bus, [0.4], limit)
        servo_bus.close()
        bus.log.clear()
        servo_bus.open()
        assert servo_bus.found[0].torque_on
        assert servo_bus.enabled.all()
        servo_bus.enable([0.4], limit)
        servo_bus.read()
        assert "torque off" not in bus.log.order(1)
        assert servo_bus.read().position[0] == pytest.approx(0.4, abs=0.05)


def test_limits_of_the_joint_bound_its_goals(emulated, enabled):
    for kind in ("sts", "xm"):
        with emulated(kind, 1, clock="steps", spec={"lower": -0.3, "upper": 0.2}) as (
            bus,
            servo_bus,
        ):
            limit = enabled(servo_bus)
            assert settle(bus, servo_bus, [5.0], limit).position[0] < 0.25
            assert settle(bus, servo_bus, [-5.0], limit).position[0] > -0.35


def test_sign_gear_and_zero(emulated, enabled):
    spec = {"sign": -1, "gear_ratio": 2.0, "zero": 1500.0}
    with emulated("sts", 1, clock="steps", spec=spec) as (bus, servo_bus):
        servo = bus.servos[0]
        raw = servo.shaft.angle / servo.model.count
        expected = -(raw - 1500.0) * servo.model.count / 2.0
        assert servo_bus.read().position[0] == pytest.approx(expected, abs=2e-3)
        limit = enabled(servo_bus)
        motion = settle(bus, servo_bus, [expected + 0.2], limit)
        assert servo.shaft.angle / servo.model.count < raw - 200
        assert motion.position[0] == pytest.approx(expected + 0.2, abs=0.05)


@pytest.mark.parametrize("bad", [[np.nan], [np.inf], [0.1, 0.2], [-1.0]])
def test_bad_input_sends_nothing(emulated, enabled, bad):
    with emulated("sts", 1, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        servo_bus.read()
        before = bus.log.count
        with pytest.raises((ConfigError, ShapeError)):
            servo_bus.write([0.0], bad)
        with pytest.raises((ConfigError, ShapeError)):
            servo_bus.enable([0.0], bad)
        assert bus.log.count == before


def test_torque_and_speed_are_reported(emulated, enabled):
    with emulated("xm", 1, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        bus.servos[0].load.torque = -1.0
        sample = settle(bus, servo_bus, [0.0], limit, seconds=2.0)
        assert sample.load[0] == pytest.approx(1.0, abs=0.25)
        assert sample.current[0] == pytest.approx(sample.load[0] / 1.78, rel=0.02)
        servo_bus.write([0.8], limit)
        bus.advance(0.15)
        assert servo_bus.read().velocity[0] > 0.3


def test_a_speed_cap_slows_the_joint(emulated, enabled):
    with emulated("sts", 1, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        servo_bus.write([0.8], limit, velocity=[0.2])
        bus.advance(1.0)
        assert servo_bus.read().position[0] == pytest.approx(0.2, abs=0.06)


def test_families_share_a_port_and_ports_an_arm(enabled):
    parts = [
        Device("MX-64", id=1, return_delay_time=0),
        Device("STS3215", id=2),
        Device("XM540-W270", id=1, port="b", operating_mode=5, return_delay_time=0),
        Device("XM540-W270", id=2, port="b", operating_mode=5, return_delay_time=0),
    ]
    with Emulator(parts, clock="steps") as bus:
        main_port, second_port = bus.ports["main"], bus.ports["b"]
        bounds = {"lower": -1.0, "upper": 1.0}
        specs = [
            ServoSpec(name="pan", model="MX-64", id=1, port=main_port, **bounds),
            ServoSpec(
                name="lift", model="XM540-W270", id=1, port=second_port, secondary=(2, -1), **bounds
            ),
            ServoSpec(name="wrist", model="STS3215-7.4V", id=2, port=main_port, **bounds),
        ]
        with ServoBus(specs, reply_timeout_min=0.1, clock=ManualClock(bus)) as servo_bus:
            limit = enabled(servo_bus)
            goal = np.array([0.2, 0.3, -0.1])
            sample = settle(bus, servo_bus, goal, limit)
            assert sample.position == pytest.approx(goal, abs=0.05)
            first, second = bus.servos[2], bus.servos[3]
            assert first.shaft.angle + second.shaft.angle == pytest.approx(2 * np.pi, abs=0.02)
            assert servo_bus.servos.limit_type == "current"
            assert servo_bus.servos.max_torque[1] == pytest.approx(21.2)


def test_protocols_1_and_2_on_one_port_are_refused():
    specs = [
        ServoSpec(name="pan", model="MX-64", id=1, port="/dev/ttyUSB0"),
        ServoSpec(name="lift", model="XM430-W350", id=2, port="/dev/ttyUSB0"),
    ]
    with pytest.raises(ConfigError, match=r"pan on Protocol 1\.0 and lift on Protocol 2\.0"):
        ServoBus(specs)


def test_names_and_ids_are_unique():
    spec = ServoSpec(name="pan", model="MX-64", id=1, port="p")
    with pytest.raises(ConfigError, match="two joints are named 'pan'"):
        ServoBus([spec, spec])
    other = ServoSpec(name="lift", model="MX-64", id=2, port="p", secondary=(1, 1))
    with pytest.raises(ConfigError, match="pan and lift both have id 1"):
        ServoBus([spec, other])
    with pytest.raises(ConfigError, match="no baud rate for p"):
        ServoBus([spec], baudrate={"q": 57_600})
    with pytest.raises(ConfigError, match="rate must be above 0"):
        ServoBus([spec], rate=0.0)
    with pytest.raises(ConfigError, match="at least one"):
        ServoBus([])


@pytest.mark.parametrize("patience", [0.0, 1.5, np.inf, np.nan])
def test_a_patience_that_a_silent_bus_would_outlast_is_refused(patience):
    spec = ServoSpec(name="pan", model="MX-64", id=1, port="/dev/null")
    with pytest.raises(ConfigError, match=f"reply_timeout_min must .* 1 s, got {patience:g}"):
        ServoBus([spec], reply_timeout_min=patience)


def test_two_servos_of_a_joint_disagree_only_about_angles_that_were_read():
    spec = ServoSpec(name="lift", model="XM540-W270", id=1, port="p", secondary=(2, -1))
    joint = [driver.Device(spec, 0, 1, 1), driver.Device(spec, 0, 2, -1)]
    for q, second_q, is_wrong in (
        (math.nan, math.nan, False),
        (0.3, math.nan, False),
        (0.3, 0.39, False),
        (0.3, 0.41, True),
        (0.3, 0.19, True),
        (0.3, 0.21, False),
    ):
        for device, angle in zip(joint, (q, second_q), strict=True):
            device._last_reading[0] = device.units.zero + device.units.sign * (
                angle / device.units.count
            )
        check_agreement(joint)
        assert ("secondaries" in joint[0].other_faults) is is_wrong
        assert not joint[1].other_faults


@pytest.mark.parametrize("is_wrong", [False, True])
def test_the_last_reading_of_a_silent_servo_is_not_compared(is_wrong):
    """The joint moves on while one servo is silent, so that its servos would disagree."""
    spec = ServoSpec(name="lift", model="XM540-W270", id=1, port="p", secondary=(2, 1))
    joint = [driver.Device(spec, 0, 1, 1), driver.Device(spec, 0, 2, 1)]
    zero, count = joint[0].units.zero, joint[0].units.count

    def read(number, angle, time):
        joint[number]._last_reading[:] = zero + angle / count, 0.0, time

    read(0, 0.3, 1.0)
    read(1, 0.45 if is_wrong else 0.3, 1.002)
    check_agreement(joint)
    read(0, 0.3 if is_wrong else 0.6, 1.5)
    check_agreement(joint)
    assert ("secondaries" in joint[0].other_faults) is is_wrong
    read(1, 0.3 if is_wrong else 0.45, 1.502)
    check_agreement(joint)
    assert ("secondaries" in joint[0].other_faults) is not is_wrong


def test_a_port_and_its_requests_have_the_settings_of_the_bus(fake_bus):
    spec = ServoSpec(name="pan", model="MX-64", id=253, port="p")
    assert ServoBus([spec])._cycle == 0.01
    assert ServoBus([spec], rate=0.5)._cycle == 2.0
    for rate in (0.0, math.nan):
        with pytest.raises(ConfigError, match="rate must be above 0 Hz"):
            ServoBus([spec], rate=rate)
    device, opened = driver.Device(spec, 0, 253, 1), []
    device.attach(ServoCodec(1, 1), 0)

    def open_transport(*arguments):
        opened.append(arguments)
        return fake_bus([253])

    port = Port(
        "p",
        [device],
        baudrate=57_600,
        cycle=0.02,
        reply_timeout_min=0.07,
        open_transport=open_transport,
        clock=lambda: 42.0,
    )
    guard = port.guard
    assert opened == [("p", 57_600, "p1")]
    assert (guard._baudrate, guard._cycle, guard._reply_timeout_min) == (57_600, 0.02, 0.07)
    assert (guard.unused_id, guard.latency, guard.sample_clock()) == (252, 0.001, 42.0)


def test_every_port_is_dropped(monkeypatch):
    dropped = []
    monkeypatch.setattr("pliant.servo.bus.drop_port", dropped.append)
    servo_bus = ServoBus([ServoSpec(name="pan", model="MX-64", id=1, port="p")])
    servo_bus._ports = [SimpleNamespace(path=path) for path in ("p", "q")]
    servo_bus.drop_ports()
    assert dropped == ["p", "q"]


def test_a_closed_copy_has_the_settings_of_its_bus():
    spec = ServoSpec(name="pan", model="MX-64", id=1, port="p")
    servo_bus = ServoBus(
        [spec], baudrate={"p": 57_600}, rate=40.0, reply_timeout_min=0.04, speed=1.5
    )
    names = ("specs", "names", "_baudrate", "_cycle", "_reply_timeout_min", "_budget", "_speed")
    copy = servo_bus.closed_copy()
    assert [getattr(copy, name) for name in names] == [getattr(servo_bus, name) for name in names]
    assert (copy._cycle, copy._reply_timeout_min, copy._speed) == (0.025, 0.04, 1.5)


def test_a_reading_and_the_first_ones_of_a_closed_copy_take_a_limited_time(
    emulated, enabled, monkeypatch
):
    """The servos still turn to the last goals of the program that has ended."""
    budgets, start_cycle = [], TransactionGuard.start_cycle

    def recorded(guard, budget=math.inf):
        budgets.append((budget, guard.transactions))
        start_cycle(guard, budget)

    with emulated("sts", 2, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        copy = servo_bus.closed_copy()
        # A reading in which nothing needs attention starts its cycle in the core.
        guard = servo_bus._ports[0].guard
        for _ in range(2):
            guard.deadline, guard.is_relaxed = math.inf, True
            start = guard.clock()
            servo_bus.read()
            assert start <= guard.deadline - servo_bus._budget <= guard.clock()
            assert not guard.is_relaxed
            servo_bus.write(np.zeros(2), [0.1, 0.1])
            servo_bus.poll_status()
        monkeypatch.setattr(TransactionGuard, "start_cycle", recorded)
        servo_bus.close()
        copy.reopen()
        copy.close()
        assert {budget for budget, _ in budgets} == {copy._budget}
        assert budgets[0][1] == 0
        # After a failed request, an infinite budget gives `reopen` time to discard late replies.
        budgets.clear()
        monkeypatch.setattr("pliant.servo._enable.RESUME_TIME", 0.02)
        bus.unplug(2)
        copy.reopen()
        copy.close()
        assert [budget for budget, _ in budgets[:3]] == [copy._budget, math.inf, math.inf]


def test_a_bus_that_is_not_open_raises():
    servo_bus = ServoBus([ServoSpec(name="pan", model="MX-64", id=1, port="p")])
    for call in (servo_bus.read, servo_bus.poll_status, servo_bus.identify, servo_bus.disable):
        with pytest.raises(ServoError, match="not open"):
            call()
    with pytest.raises(ConfigError, match="no joint 'lift'; there are: pan"):
        servo_bus._select(["lift"])


class Chain:
    """Three servos on a port in memory, with torque on; servos in `dead` do not answer."""

    def __init__(self, fake_bus, model, protocol, **options):
        self.dead, self.bus = set(), fake_bus([1, 2, 3])
        request, status = self.bus._request, BusStatus([0.0] * 3)

        def answered(name, ids, *arguments):
            numbers = ids if isinstance(ids, tuple) else (ids,)
            silent = set() if name == "sync_write" else self.dead.intersection(numbers)
            self.bus.plan = [BusError("no answer", "timeout", min(silent))] if silent else []
            return request(name, ids, *arguments)

        self.bus._request = answered
        specs = [ServoSpec(name=f"joint{i}", model=model, id=i, port="p") for i in (1, 2, 3)]
        self.devices = [driver.Device(s, i, s.id, 1, status) for i, s in enumerate(specs)]
        self.registers, codec = self.devices[0].family.registers, ServoCodec(3, 3)
        for i, device in enumerate(self.devices):
            device.attach(codec, i)
            device.enabled = True
            self.put(device.id, torque_enable=1, position=2048, voltage=120)
        self.port = Port(
            "p",
            self.devices,
            **{"baudrate": 1_000_000, "cycle": 0.01, "reply_timeout_min": 0.01} | options,
            open_transport=lambda *_: self.bus,
            clock=self.bus.clock,
        )
        self.port.guard.clock = self.bus.clock
        self.port.guard.start_cycle()

    def put(self, id, **values):
        for name, value in values.items():
            register = self.registers[name]
            data = register.encode(value)
            self.bus.memory[id][register.address : register.address + len(data)] = data

    def get(self, id, name):
        register = self.registers[name]
        return register.decode(
            bytes(self.bus.memory[id][register.address : register.address + register.size])
        )

    def cycle(self, seconds=0.01, budget=math.inf):
        """Read in a cycle; return the indices of accepted readings and the ids in requests."""
        self.bus.now += seconds
        self.bus.calls.clear()
        accepted = self.port.read(budget)
        asked = [call[1] for call in self.bus.calls if call[0] in {"read", "sync_read"}]
        return accepted, asked


SYNC_READ = ["XM430-W350", "STS3215-7.4V"]


@pytest.mark.parametrize("model", SYNC_READ)
def test_a_dead_servo_is_asked_every_eighth_cycle(fake_bus, model):
    chain = Chain(fake_bus, model, "p2")
    assert sorted(chain.cycle()[0]) == [0, 1, 2]
    chain.dead = {2}
    for _ in range(3):
        accepted, asked = chain.cycle()
        assert sorted(accepted) == [0, 2]
        assert {2} <= {*asked}
        assert chain.port.guard.counters.timeouts
    counts = [2 in chain.cycle()[1] for _ in range(18)]
    assert counts == [i % 8 == 6 for i in range(18)]
    chain.dead = set()
    accepted = [chain.cycle()[0] for _ in range(8)]
    assert sorted(accepted[-1]) == [0, 1, 2]
    first = next(i for i, found in enumerate(accepted) if len(found) == 3)
    assert first == 4
    # One reply ends the count of consecutive silences.
    chain.dead = {2}
    for _ in range(2):
        chain.cycle()
    chain.dead = set()
    chain.cycle()
    chain.dead = {2}
    for _ in range(2):
        chain.cycle()
    assert len(chain.port.responsive) == 3


def test_a_line_on_which_no_servo_answers_has_no_dead_servo(fake_bus):
    chain = Chain(fake_bus, "MX-64", "p1")
    chain.cycle()
    chain.dead = {1, 2, 3}
    for _ in range(9):
        assert not chain.cycle()[0]
    assert len(chain.port.responsive) == 3


@pytest.mark.parametrize("model", [*SYNC_READ, "MX-64"])
@pytest.mark.parametrize("silence", [0.05, 0.2])
def test_a_servo_that_restarted_gets_no_more_goals(fake_bus, model, silence):
    chain = Chain(fake_bus, model, "p2")
    chain.cycle()
    chain.put(2, torque_enable=0)
    chain.cycle(silence)
    assert [device.enabled for device in chain.devices] == [True, silence < 0.1, True]
    assert [bool(device.faults) for device in chain.devices] == [False, silence > 0.1, False]


@pytest.mark.parametrize("model", [*SYNC_READ, "MX-64"])
@pytest.mark.parametrize("has_torque", [True, False])
def test_a_servo_that_is_silent_gets_no_goal_before_its_torque_is_known(
    fake_bus, model, has_torque
):
    chain = Chain(fake_bus, model, "p2")
    command = ([0.1] * 3, [0.2] * 3, None, 0.0)

    def goals_and_limits():
        chain.cycle()
        for i in (1, 2, 3):
            chain.put(i, goal=0, limit=0)
        chain.port.write(command)
        return [[chain.get(i, name) > 0 for i in (1, 2, 3)] for name in ("goal", "limit")]

    chain.cycle()
    chain.dead, chain.port._restart = {2}, math.inf
    assert goals_and_limits() == [[True] * 3] * 2
    chain.port._restart = 0.1
    # A servo that may have restarted, and that a goal switches on, gets no goal until it was read.
    gets_goals = chain.devices[1].family.protocol == "p2"
    assert goals_and_limits() == [[True, gets_goals, True], [True] * 3]
    chain.put(2, torque_enable=has_torque)
    assert goals_and_limits() == [[True, gets_goals, True], [True] * 3]
    chain.dead = set()
    for _ in range(8):  # skipped servos are asked in every eighth cycle
        found = goals_and_limits()
    assert found == [[True, has_torque, True]] * 2
    assert chain.devices[1].enabled is has_torque


@pytest.mark.parametrize("model", ["STS3215", "RX-64"])
def test_a_silent_servo_gets_a_goal_only_with_a_speed_cap_in_the_same_packet(fake_bus, model):
    """The servo may have restarted: a goal then switches torque on, and the cap prevents a jump."""
    chain = Chain(fake_bus, model, "p2")
    assert len(chain.devices[1].family.write) == 1
    chain.cycle()
    chain.dead, chain.port._restart = {2}, 0.1
    for _ in range(3):
        chain.cycle(0.2)

    def gets_goal(speed):
        chain.put(2, goal=0)
        chain.port.write(([0.1] * 3, [0.2] * 3, speed, 0.0))
        return chain.get(2, "goal") > 0

    slow, fast = RESTART_SPEED, 1.01 * RESTART_SPEED
    assert not gets_goal(None)
    assert not gets_goal([math.inf, fast, math.inf])
    assert gets_goal([math.inf, slow, math.inf])
    chain.devices[1].caps_speed = False
    assert not gets_goal([math.inf, slow, math.inf])
    with pytest.raises(ShapeError):
        chain.port.write(([0.1] * 3, [0.2] * 3, [slow], 0.0))


def test_an_armed_watchdog_that_tripped_in_a_silence_is_armed_again(fake_bus):
    chain = Chain(fake_bus, "XM430-W350", "p2")
    chain.cycle()
    assert chain.port.set_watchdog(0.5, 1.0) == []
    assert [chain.get(i, "watchdog") for i in (1, 2, 3)] == [25] * 3
    chain.put(2, watchdog=driver.TRIPPED)
    assert sorted(chain.cycle(0.2)[0]) == [0, 1, 2]
    assert chain.devices[1].trips == 1
    assert [chain.get(i, "watchdog") for i in (1, 2, 3)] == [25] * 3
    assert not chain.devices[1].tripped
    # Once watchdogs are off, their registers are no longer read.
    assert chain.port.set_watchdog(0.0, 1.0) == []
    chain.put(2, watchdog=driver.TRIPPED)
    chain.cycle(0.2)
    assert chain.devices[1].trips == 1


@pytest.mark.parametrize(
    ("seconds", "units"), [(0.0, 0), (0.001, 1), (0.02, 1), (0.021, 2), (9.0, 127)]
)
def test_a_watchdog_is_rounded_up_to_its_unit(fake_bus, seconds, units):
    chain = Chain(fake_bus, "XM430-W350", "p2")
    chain.dead = {2}
    assert chain.port.set_watchdog(seconds, 1.0) == ["joint2"]
    assert [chain.get(i, "watchdog") for i in (1, 3)] == [units] * 2
    assert chain.port.watchdog == units


@pytest.mark.parametrize("model", [*SYNC_READ, "MX-64", "RX-64"])
def test_only_servos_with_torque_get_commands(fake_bus, model):
    chain = Chain(fake_bus, model, "p2")
    command = ([0.1] * 3, [0.2] * 3, None, 0.0)
    for enabled in ([True] * 3, [True, False, True], [False] * 3, [False, True, True]):
        for device, is_enabled in zip(chain.devices, enabled, strict=True):
            device.enabled = is_enabled
            chain.put(device.id, goal=0, limit=0)
        chain.port.write(command)
        for device, is_enabled in zip(chain.devices, enabled, strict=True):
            goal, limit = (chain.get(device.id, name) for name in ("goal", "limit"))
            assert bool(goal) is bool(limit) is is_enabled
            assert not is_enabled or (device.goal, device.limit) == (goal, limit)
    with pytest.raises(ShapeError):
        chain.port.write(([0.1] * 2, [0.2] * 3, None, 0.0))


@pytest.mark.parametrize("model", [*SYNC_READ, "MX-64"])
def test_status_is_read_in_turn_and_first_of_a_servo_with_a_fault(fake_bus, model):
    chain = Chain(fake_bus, model, "p2")
    poller = StatusPoller([[device] for device in chain.devices])
    for device in chain.devices:
        chain.put(device.id, temperature=30 + device.id)

    def names(count):
        found = []
        for _ in range(count):
            chain.port.guard.start_cycle()
            status = poller.step({id(device): chain.port for device in chain.devices})
            if status is not None:
                found.append(status.name)
                assert status.temperature in {30.0 + int(status.name[-1]), None}
        return found

    family = chain.devices[0].family
    turn = [f"joint{i}" for i in (1, 2, 3) for _ in family.status_blocks]
    # With Protocol 2.0, every third step reads the torque of all servos.
    steps = 3 if family.status == "p2" else 2
    assert names(len(turn) * steps) == turn * 2
    chain.devices[2].fault("jump", True, "jumped")
    assert names(steps)[0] == "joint3"


def test_torque_of_all_servos_is_read_in_every_third_step(fake_bus):
    chain = Chain(fake_bus, "XM430-W350", "p2")
    poller = StatusPoller([[device] for device in chain.devices])
    ports, seen = {id(device): chain.port for device in chain.devices}, []
    chain.devices[0].enabled = False
    for _ in range(6):
        chain.bus.calls.clear()
        poller.step(ports)
        seen += [call[1] for call in chain.bus.calls if call[0] == "sync_read"]
    assert seen == [(2, 3)] * 2
    chain.put(3, torque_enable=0)
    statuses = [poller.step(ports) for _ in range(3)]
    assert statuses[-1].name == "joint3"
    assert "torque went off" in statuses[-1].faults[0]
    assert not chain.devices[2].enabled


@pytest.mark.parametrize(("text", "seconds"), [("16\n", 0.016), ("?", None), (None, None)])
def test_the_latency_timer_of_an_adapter(monkeypatch, tmp_path, text, seconds):
    folder = tmp_path / "sys/bus/usb-serial/devices/ttyUSB0"
    folder.mkdir(parents=True)
    if text is not None:
        (folder / "latency_timer").write_text(text)
    monkeypatch.setattr("pliant.servo._port.Path", lambda path: tmp_path / path.lstrip("/"))
    assert latency_timer("/dev/ttyUSB0") == seconds


def test_a_reopened_bus_has_the_commands_of_the_servos_that_answer(emulated, enabled, monkeypatch):
    monkeypatch.setattr("pliant.servo._enable.RESUME_TIME", 0.02)
    with emulated("sts", 2, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        servo_bus.write([0.2, -0.3], limit)
        servo_bus.read()
        copy = servo_bus.closed_copy()
        servo_bus.close()
        bus.faults.inject("lose", 2, count=10**6)
        goals, limits = copy.reopen()
        assert goals == pytest.approx([0.2, np.nan], abs=0.002, nan_ok=True)
        assert limits == pytest.approx([limit[0], np.nan], rel=0.01, nan_ok=True)
        assert copy.torque_unknown.tolist() == [False, True]
        assert copy.enabled.tolist() == [True, True]
        copy.write([0.1, 0.1], limit)
        copy.read()
        goal = [copy._joints[i][0].angle(bus.servos[i].get("goal_position")) for i in range(2)]
        assert goal == pytest.approx([0.1, -0.3], abs=0.002)
        bus.faults.clear()
        for _ in range(50):  # the line must be silent first
            if not copy.torque_unknown.any():
                break
            copy.read()
            goals, limits = copy.reopen()
        assert goals == pytest.approx([0.1, -0.3], abs=0.002)
        assert limits == pytest.approx(limit, rel=0.01)
        assert not copy.torque_unknown.any()
        copy.close()
        bus.faults.inject("lose", count=10**6)
        with pytest.raises(ServoError, match=r"no answer from joint0, joint1: torque may be on$"):
            copy.reopen()
        bus.faults.clear()
        bus.servos[0].put("torque_enable", 0)
        bus.faults.inject("lose", 2, count=10**6)
        with pytest.raises(ServoError, match="joint1: torque may be on there, it is off in all"):
            copy.reopen()


def test_commands_of_servos_that_have_torque_at_open_are_known(emulated, enabled):
    with emulated("sts", 3, clock="steps", is_open=False) as (bus, servo_bus):
        for name, value in (("torque_enable", 1), ("goal_position", 2148), ("torque_limit", 300)):
            bus.servos[1].put(name, value)
        servo_bus.open()
        goals, limits = servo_bus.orders
        units = servo_bus._joints[1][0].units
        expected = [np.nan, units.angle(2148), np.nan]
        assert goals == pytest.approx(expected, nan_ok=True)
        assert limits == pytest.approx([np.nan, units.torque(300), np.nan], nan_ok=True)
        assert servo_bus.enabled.tolist() == [False, True, False]
        enabled(servo_bus)
        assert np.isnan(servo_bus.orders).all()
