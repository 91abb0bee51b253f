"""`ServoCodec` compared with the conversions of `Units`, and its check of positions."""

import math
from math import floor, pi

import numpy as np
import pytest

from pliant._core import OutOfRangeError, ServoCodec, ShapeError
from pliant.servo import ServoSpec, list_models
from pliant.servo._device import Device
from pliant.servo._transactions import Reply

MODELS = list_models()


def device(model="STS3215-12V", **options):
    servo = Device(ServoSpec(name="pan", model=model, id=1, port="a", **options), 0, 1, 1)
    servo.units = servo.units.of(servo.spec)
    servo.attach(ServoCodec(1, 1), 0)
    return servo


def encode(servo, goal, limit, speed, max_speed=math.inf):
    """Return the registers of a command, and its packets."""
    row = [column[0] for column in servo.codec.encode([0], [goal], [limit], [speed], max_speed)]
    return row[:3], tuple(row[3:])


def reply(servo, time, **values):
    block = servo.family.read[0]
    return Reply(block, servo.family.layout(block).encode(values), 0, time)


@pytest.mark.parametrize("model", MODELS)
def test_joint_values_are_those_of_the_units(model):
    servo = device(model, sign=-1, zero=300.0, gear_ratio=1.5, torque_offset=0.02)
    units, row = servo.units, servo.row
    measured = "current" if row.limit_type == "current" else "load"
    has_sign = servo.family.registers["speed"].sign != "unsigned"
    rng = np.random.default_rng(0)
    for time in range(50):
        position, speed, load = 200 + int(rng.integers(300)), *rng.integers(-90, 90, 2).tolist()
        if not has_sign:
            speed, load = abs(speed), abs(load)
        servo.accept_any_position()
        assert servo.accept(
            reply(servo, float(time), position=position, speed=speed, **{measured: load})
        )
        readings = servo.codec.joints([0])
        if measured == "current":
            torque = units.sign * units.torque(load)
            assert readings.current == pytest.approx([row.current_unit * abs(load)])
        else:
            torque = units.sign * units.load(load)
        expected = [units.angle(position), time, units.velocity(speed), torque]
        values = (readings.position, readings.time, readings.velocity, readings.load)
        assert np.ravel(values) == pytest.approx(expected, rel=1e-12, abs=1e-15)
        assert readings.ok.tolist() == [True]
        assert servo.codec.joints([]).ok.tolist() == [False]


@pytest.mark.parametrize("model", MODELS)
def test_registers_are_those_of_the_units(model):
    servo = device(model, zero=500.0, gear_ratio=1.5, torque_offset=0.02)
    servo.low, servo.high, servo.ceiling = 300, 800, servo.units.full // 2
    servo.configure()
    units, row = servo.units, servo.row
    rng = np.random.default_rng(0)
    for _ in range(200):
        goal, limit, speed = (
            rng.normal(0.0, 0.5),
            abs(rng.normal(0.0, 2.0)),
            abs(rng.normal(0.0, 4.0)),
        )
        goal_register = max(300, min(units.counts(goal), 800))
        limit_register = units.register(min(limit, units.usable(servo.ceiling)), servo.ceiling)
        unit = row.speed_unit * 2.0 * pi / 60.0 / 1.5
        speed_register = max(1, min(floor(speed / unit), servo.family.speed_max))
        expected = [goal_register, limit_register, speed_register]
        registers, packets = encode(servo, goal, limit, speed)
        assert registers == expected
        # A speed cap is never higher than the speed, but at least one unit: 0 means no limit.
        assert 0.0 < units.velocity(speed_register) <= max(speed, units.velocity(1)) * (1 + 1e-9)
        for names, packet in zip(servo.family.write, packets, strict=False):
            assert packet == servo.packet(names, *expected)
    assert encode(servo, 0.0, 0.0, 0.0)[0][1:] == [0, 1]
    for register in range(servo.ceiling):
        assert encode(servo, 0.0, units.torque(register), 1.0)[0][1] in {register, 0}
    no_load = encode(servo, 0.0, 0.0, units.no_load_speed)[0]
    assert encode(servo, 0.0, 0.0, math.inf, 0.0)[0] == no_load != encode(servo, 0.0, 0.0, 0.1)[0]


def test_readings_of_a_group_are_those_of_single_servos():
    rng = np.random.default_rng(0)
    codec = ServoCodec(3, 3)
    group = [
        Device(ServoSpec(name="pan", model="STS3215", id=i, port="a"), i, i, 1) for i in range(3)
    ]
    single = [device() for _ in range(3)]
    for i, servo in enumerate(group):
        servo.attach(codec, i)
    block = group[0].family.read[0]
    results = set()
    for cycle in range(200):
        time = 0.01 * cycle + (0.5 if cycle > 100 else 0.0)
        positions = 2000 + rng.integers(5, size=3) + (rng.random(3) < 0.1) * 1000
        rows = [
            reply(single[0], time, position=int(p), voltage=70 + cycle // 50) for p in positions
        ]
        answers = [(row.data, int(rng.random() < 0.05)) for row in rows]
        ages = [time - servo.time for servo in single]
        expected = []
        for i, (servo, (data, status)) in enumerate(zip(single, answers, strict=True)):
            reading = None
            if ages[i] <= 0.1:
                rows = servo.codec.decode([0], [(data, status)], block.address, time, math.inf)
                if not rows:
                    continue
                reading = rows[0][1]
            expected.append((i, reading))
        assert codec.decode([0, 1, 2], answers, block.address, time, 0.1) == expected
        results.update(reading for _, reading in expected)
        for i, reading in expected:
            if reading is None:
                for servo in (single[i], group[i]):
                    servo.accept(Reply(block, *answers[i], time))
        assert [servo.position for servo in group] == [servo.position for servo in single]
    assert results == {None, False, True}


def test_implausible_positions_do_not_extend_the_accepted_change():
    servo = device()
    reach = (2.0 * servo.units.no_load_speed * 0.01 + 0.1) / servo.units.count
    assert servo.accept(reply(servo, 1.0, position=2000))
    assert servo.accept(reply(servo, 1.01, position=2000 + floor(reach)))
    last = servo.position
    for i in range(20):
        assert not servo.accept(reply(servo, 1.02 + 0.01 * i, position=int(last + reach + 2)))
    assert "jumped" in " ".join(servo.faults)
    assert servo.position == last
    assert servo.accept(reply(servo, 1.5, position=int(last + 1)))


def test_arguments_that_do_not_fit():
    servo = device()
    with pytest.raises(ShapeError, match="numbers"):
        servo.codec.configure(0, 0, [1.0])
    with pytest.raises(OutOfRangeError, match="servo = 1"):
        servo.codec.encode([1], [0.0], [0.0], None, 0.0)
    with pytest.raises(ShapeError, match="limit has shape"):
        servo.codec.encode([0], [0.0], [0.0, 0.0], None, 0.0)
    for command in ((math.nan, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, math.nan)):
        with pytest.raises(OutOfRangeError, match="command"):
            encode(servo, *command)
    with pytest.raises(ShapeError, match="position"):
        servo.codec.decode([0], [(b"\0" * 15, 0)], 200, 0.0, math.inf)
    with pytest.raises(ShapeError, match="packet"):
        servo.codec.record_sent(0, 1, 1, b"\0" * 33)
    for call in (servo.codec.sent, lambda i: servo.codec.record_sent(i, 1, 1, b"")):
        with pytest.raises(OutOfRangeError, match="servo = 1"):
            call(1)


@pytest.mark.parametrize("model", ["STS3215-12V", "MX-64", "XL430-W250"])
def test_a_block_shows_whether_the_registers_hold_the_last_command(model):
    servo = device(model)
    family, codec = servo.family, servo.codec
    (address, size), packet = family.write_blocks[0], encode(servo, 0.2, 0.5, 1.0)[1][0]
    torque_enable = family.registers["torque_enable"].address
    first = min(address, torque_enable)
    data = bytearray(max(address + size, torque_enable + 1) - first)
    data[torque_enable - first] = 1
    data[address - first : address - first + size] = packet
    assert not codec.has_command(0, bytes(data), first), "no command was sent"
    servo.record_sent(*encode(servo, 0.2, 0.5, 1.0)[0][:2], packet)
    assert codec.has_command(0, bytes(data), first)
    for i in {torque_enable - first, *range(address - first, address - first + size)}:
        changed = bytearray(data)
        changed[i] ^= 2
        assert not codec.has_command(0, bytes(changed), first)
    # Without the register Torque Enable there is nothing to compare.
    assert codec.has_command(0, b"", first)
    assert not codec.has_command(0, bytes(data[torque_enable - first :][:1]), torque_enable)
    with pytest.raises(OutOfRangeError, match="servo"):
        codec.has_command(1, bytes(data), first)
