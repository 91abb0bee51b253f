"""`Units`: conversions in both directions, for all models, voltages, gears, signs and torques."""

import math
import random
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pliant import ConfigError
from pliant.servo import ServoSpec, Units, get_model, list_models
from pliant.servo.spec import at_voltage, servos_from_units

specs = st.builds(
    ServoSpec,
    name=st.just("joint"),
    model=st.sampled_from(list_models()),
    id=st.just(1),
    port=st.just("port"),
    sign=st.sampled_from([-1, 1]),
    zero=st.one_of(st.none(), st.floats(0, 1023)),
    gear_ratio=st.floats(0.2, 5.0),
    secondary=st.sampled_from([None, (2, 1), (2, -1)]),
    torque_offset=st.floats(0.0, 0.3),
)


@st.composite
def joints(draw):
    spec = draw(specs)
    low, high = spec.row.voltage
    return Units.of(spec, draw(st.floats(low, high)))


@given(joints(), st.floats(0.0, 40.0), st.integers(0, 2047))
def test_a_limit_is_never_more_than_asked_and_within_one_count(units, torque, ceiling):
    register = units.register(torque, ceiling)
    assert 0 <= register <= min(ceiling, units.full)
    given_torque = units.torque(register)
    assert given_torque <= torque * (1 + 1e-9) + 1e-9
    if register < min(ceiling, units.full) and torque > 0:
        assert torque - given_torque <= units.torque_per_unit * (1 + 1e-9) + 1e-9


@given(joints(), st.integers(0, 2047))
def test_registers_convert_to_joint_values_and_back(units, register):
    register = min(register, units.full)
    if units.torque(register) > 0.0:
        assert units.register(units.torque(register)) == register


@given(joints(), st.integers(0, 4095))
def test_counts_come_back_as_themselves(units, counts):
    assert units.counts(units.angle(counts)) == counts


@given(joints(), st.floats(-3.0, 3.0))
def test_an_angle_comes_back_within_half_a_count(units, angle):
    assert abs(units.angle(units.counts(angle)) - angle) <= 0.5 * units.count * (1 + 1e-9)


@given(joints())
def test_a_rising_angle_is_rising_counts_by_the_sign(units):
    step = units.counts(0.5) - units.counts(-0.5)
    assert math.copysign(1, step) == units.spec.sign


@given(joints(), st.integers(1, 254))
def test_stiffness_is_positive_and_goes_with_the_gain(units, gain):
    assert units.stiffness(gain) > 0
    ratio = units.stiffness(2 * gain) / units.stiffness(gain)
    assert ratio == pytest.approx(0.5 if units.row.gain == 0.0 else 2.0)


def joint(model, **options):
    return Units.of(ServoSpec(name="j", model=model, id=1, port="p", **options))


def test_a_gear_turns_slower_and_pushes_harder():
    direct, geared = joint("MX-64"), joint("MX-64", gear_ratio=2.0)
    assert geared.usable(1023) == pytest.approx(2 * direct.usable(1023))
    assert geared.count == pytest.approx(direct.count / 2)
    assert geared.no_load_speed == pytest.approx(direct.no_load_speed / 2)
    assert geared.stiffness(32) == pytest.approx(4 * direct.stiffness(32))


@pytest.mark.parametrize("name", ["RX-64", "EX-106+"])
def test_the_smallest_compliance_slope_is_one_count(name):
    servo = joint(name)
    assert servo.stiffness(0) == servo.stiffness(1) == pytest.approx(2 * servo.stiffness(2))


def test_two_servos_share_the_torque():
    single, secondaries = joint("XM540-W270"), joint("XM540-W270", secondary=(2, -1))
    assert secondaries.usable(2047) == pytest.approx(2 * single.usable(2047))
    assert secondaries.register(4.0) == single.register(2.0)


def test_gears_and_second_servos_scale_what_a_controller_gets():
    plain = [joint(name) for name in ("XL430-W250", "XM540-W270")]
    geared = [
        joint(units.spec.model, gear_ratio=3.0, secondary=(2, 1), kp=kp)
        for units, kp in zip(plain, (50.0, None), strict=True)
    ]
    one, both = (servos_from_units(units, [800, 900], [885, 2047]) for units in (plain, geared))
    for name, factor in (("friction", 6.0), ("damping", 18.0), ("armature", 18.0)):
        assert getattr(both, name) == pytest.approx(factor * np.asarray(getattr(one, name))), name
    assert both.encoder_step == pytest.approx(np.asarray(one.encoder_step) / 3.0)
    assert both.max_torque == pytest.approx(6.0 * np.asarray(one.max_torque))
    assert both.kp == pytest.approx([50.0, 18.0 * one.kp[1]])
    assert not both.stiffness_known
    assert both.limit_type == one.limit_type == "current"
    # Back-EMF of the servo without current limit: stall torque over no-load speed.
    mechanics = [units.row.mechanics.damping for units in plain]
    back_emf = plain[0].usable(885) / plain[0].no_load_speed
    assert one.damping == pytest.approx([mechanics[0] + back_emf, mechanics[1]])


@pytest.mark.parametrize(
    "values",
    [
        {"id": 0},
        {"id": 253, "secondary": (252, -1)},
        {"model": "XL430-W250", "id": 252},
        {"sign": -1, "gear_ratio": 1e-3, "kp": 1e-3, "stall": 1e-3, "no_load": 1e-3},
        {"friction": 0.0, "damping": 0.0, "torque_offset": 0.0},
        {"lower": 0.5},
        {"voltage": (0.5, 0.6)},
    ],
)
def test_the_smallest_and_largest_values_are_valid(values):
    spec = ServoSpec(**{"name": "j", "model": "MX-64", "id": 1, "port": "p", **values})
    assert all(getattr(spec, name) == value for name, value in values.items())


def test_a_duty_follows_the_voltage_and_a_current_does_not():
    for model, ratio in (("RX-64", 0.8), ("XM430-W350", 1.0)):
        spec = ServoSpec(name="j", model=model, id=1, port="p")
        high = spec.row.rated
        at_high, at_low = Units.of(spec, high), Units.of(spec, 0.8 * high)
        assert at_low.torque_per_unit == pytest.approx(ratio * at_high.torque_per_unit, rel=0.02)


@pytest.mark.parametrize("name", list_models())
def test_a_table_holds_at_its_voltages_and_is_proportional_outside(name):
    for table in (get_model(name).stall, get_model(name).no_load):
        for voltage, value in table:
            assert at_voltage(table, voltage) == pytest.approx(value)
        for (low, at_low), (high, at_high) in pairwise(table):
            middle = at_voltage(table, 0.5 * (low + high))
            assert middle == pytest.approx(0.5 * (at_low + at_high))
        (low, at_low), (high, at_high) = table[0], table[-1]
        assert at_voltage(table, 0.5 * low) == pytest.approx(0.5 * at_low)
        assert at_voltage(table, 2.0 * high) == pytest.approx(2.0 * at_high)


def test_numbers_per_count_of_the_makers_data():
    spec = ServoSpec(name="j", model="EX-106+", id=1, port="p")
    assert Units.of(spec, 18.5).torque_per_unit == pytest.approx(0.0107, rel=0.01)
    assert Units.of(spec, 14.8).torque_per_unit == pytest.approx(0.0085, rel=0.01)
    assert joint("XM430-W350").torque_per_unit == pytest.approx(0.0048, rel=0.01)
    assert joint("XM540-W270").torque_per_unit == pytest.approx(0.0065, rel=0.01)
    assert joint("STS3215-12V").torque_per_unit == pytest.approx(2.94 / 1000, rel=0.01)
    assert joint("XL430-W250").torque_per_unit == pytest.approx(0.0016, rel=0.02)


def test_stall_torque_can_be_the_users():
    quoted = joint("EX-106+", stall=10.0)
    assert quoted.usable(1023) == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"id": 254}, "id 254 is outside 0..253"),
        ({"model": "XM430-W350", "id": 253}, r"outside 0\.\.252"),
        ({"sign": 0}, "sign is"),
        ({"gear_ratio": 0.0}, "gear_ratio must be above 0"),
        ({"zero": math.nan}, "zero is a count"),
        ({"lower": 1.0, "upper": -1.0}, "lower must be below upper"),
        ({"secondary": (1, 1)}, "the secondary has the id"),
        ({"stall": 0.0}, "stall must be above 0"),
        ({"no_load": 0.0}, "no_load must be above 0"),
        ({"kp": 0.0}, "kp must be above 0"),
        ({"friction": -0.1}, "friction is at least 0"),
        ({"lower": 1.0, "upper": 1.0}, "lower must be below upper"),
        ({"voltage": (12.0, 12.0)}, "voltage is lowest and highest"),
        ({"torque_offset": -1.0}, "torque_offset"),
        ({"model": "MX-65"}, "did you mean"),
    ],
)
def test_errors_of_a_spec_name_the_cause(change, match):
    with pytest.raises(ConfigError, match=match):
        ServoSpec(**{"name": "j", "model": "MX-64", "id": 1, "port": "p", **change})


@pytest.mark.parametrize(
    "change", [{"no_load": 50.0}, {"voltage": (9.0, 13.0)}, {"model_number": 310}]
)
def test_a_spec_replaces_no_other_value_of_its_model(change):
    row, plain = joint("MX-64", **change).row, get_model("MX-64")
    (field,) = change
    assert replace(row, **{field: getattr(plain, field)}) == plain
    expected = ((plain.rated, 50.0),) if field == "no_load" else change[field]
    assert getattr(row, field) == expected


@pytest.mark.parametrize("name", ["STS3215-7.4V", "MX-64", "XM430-W350", "XL430-W250"])
def test_a_block_holds_its_registers(name):
    family, rng = get_model(name).family, random.Random(0)
    for block in (*family.read, *family.write_blocks, *family.status_blocks) * 3:
        layout, values = family.layout(block), {}
        for register in layout.decode(bytes(block.size)):
            size, sign = family.registers[register].size, family.registers[register].sign
            bits = {"unsigned": 8 * size, "twos": 8 * size - 1}.get(sign) or int(sign[3:])
            low, high = 0 if sign == "unsigned" else 1 - 2**bits, 2**bits - 1
            values[register] = rng.choice([low, rng.randint(low, high), high])
        data = layout.encode(values)
        assert len(data) == block.size
        assert layout.decode(data) == values
        assert {name: family.decode(block, data, name) for name in values} == values


def test_signs_of_registers():
    register = get_model("MX-64").family.registers["speed"]
    assert register.decode(register.encode(-5)) == -5
    assert register.encode(-5) == (1024 + 5).to_bytes(2, "little")
    twos = get_model("XM430-W350").family.registers["position"]
    assert twos.decode(twos.encode(-4096)) == -4096
    sts = get_model("STS3215-7.4V").family.registers["goal"]
    assert sts.encode(-1) == b"\x01\x80"


@pytest.mark.parametrize(
    ("zero", "gear_ratio", "is_valid"),
    [
        (-4096, 1.0, True),
        (8191, 1.0, True),
        (8192, 1.0, False),
        (99999, 1.0, False),
        (8192, 2.0, True),
        (math.nan, 1.0, False),
    ],
)
def test_a_zero_lies_within_a_turn_of_the_encoder(zero, gear_ratio, is_valid):
    options = {"name": "j", "model": "STS3215-7.4V", "id": 1, "port": ""}
    if is_valid:
        assert ServoSpec(**options, zero=zero, gear_ratio=gear_ratio).zero == zero
        return
    with pytest.raises(ConfigError, match=r"j: zero is a count of STS3215.* -4096 to 8191"):
        ServoSpec(**options, zero=zero, gear_ratio=gear_ratio)
