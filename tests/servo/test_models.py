"""Register tables: complete, consistent, and equal to those of the emulator.

The tables of the emulator were written independently.
"""

from itertools import pairwise

import numpy as np
import pytest

from pliant import ConfigError, Servos
from pliant.emulator import MODELS as EMULATED
from pliant.servo import ServoSpec, Units, get_model, list_models
from pliant.servo.models import by_number
from pliant.servo.models.base import estimated_mechanics

ALL = list_models()
#: By register of the driver: names in the tables of the emulator, of which each table has the first
#: that it contains; empty if the emulator lacks the register.
NAMES = {
    "model": ("model_number",),
    "firmware": ("firmware_version", "firmware_major"),
    "id": ("id",),
    "baud": ("baud_rate",),
    "shadow_id": ("secondary_id",),
    "return_delay": ("return_delay_time",),
    "return_level": ("response_level", "status_return_level"),
    "position_min": ("cw_angle_limit", "min_position_limit"),
    "position_max": ("ccw_angle_limit", "max_position_limit"),
    "temperature_limit": ("temperature_limit",),
    "voltage_min": ("min_voltage_limit",),
    "voltage_max": ("max_voltage_limit",),
    "max_torque": ("max_torque_limit", "max_torque"),
    "shutdown": ("unloading_condition", "shutdown"),
    "goal": ("goal_position",),
    "goal_time": ("goal_time",),
    "speed_cap": ("moving_speed", "profile_velocity", "goal_velocity"),
    "acceleration_cap": ("goal_acceleration", "profile_acceleration", "acceleration"),
    "position": ("present_position",),
    "speed": ("present_speed", "present_velocity"),
    "voltage": ("present_input_voltage", "present_voltage"),
    "temperature": ("present_temperature",),
    "load": ("present_load",),
    "current": ("present_current",),
    "pwm": ("present_pwm",),
    "mode": ("operating_mode",),
    "gain": ("p_coefficient", "position_p_gain", "p_gain", "cw_compliance_slope"),
    "slope_ccw": ("ccw_compliance_slope",),
    "margin_cw": ("cw_compliance_margin",),
    "margin_ccw": ("ccw_compliance_margin",),
    "punch": ("punch",),
    "hardware_error": ("hardware_error_status",),
    "condition": ("status",),
    "watchdog": ("bus_watchdog",),
    "torque_enable": ("torque_enable",),
    "overload_torque": ("overload_torque",),
    "protective_torque": ("protective_torque",),
    "protection_time": ("protection_time",),
    "phase": ("phase",),
    "homing_offset": ("homing_offset",),
    "lock": ("lock",),
    "drive_mode": ("drive_mode",),
    "current_limit": ("current_limit",),
    "pwm_limit": ("pwm_limit",),
    "pwm_goal": ("goal_pwm",),
    "limit": ("torque_limit", "goal_current", "goal_pwm"),
    "goal_velocity": ("goal_velocity",),
}
#: Sign coding of the driver, by that of the emulator.
SIGNS = {None: "unsigned", 0: "twos", 10: "bit10", 11: "bit11", 15: "bit15"}
#: Registers whose sign driver and emulator may code differently: positions within a turn are never
#: negative, and a tripped watchdog is 255 for the driver, -1 for the emulator.
OTHER_SIGNS = {"position_min", "position_max", "goal", "position", "watchdog"}
#: Registers that the driver does not use in some families that have them.
NOT_USED = {"current", "goal_velocity", "lock", "punch", "pwm_goal"}
#: Largest scatter of no-load speed and stall torque over voltage, in data sheets with a larger one.
SCATTERS = {
    "XH540-W270": (1.05, 1.09),
    "XL330-M077": (1.03, 1.3),
    "XL330-M288": (1.03, 1.14),
    "XL430-W250": (1.03, 1.14),
}
TWINS = {"STS3215-7.4V-191": "STS3215-C044", "STS3215-7.4V-147": "STS3215-C046"}


def emulated(name):
    return EMULATED[TWINS.get(name, name)]


def test_the_supported_models_are_in_the_table():
    assert {"EX-106+", "RX-64", "MX-28", "MX-64", "MX-106", "STS3215-7.4V", "STS3215-12V"} <= {*ALL}
    assert set(map(emulated, ALL)) == set(EMULATED.values())


@pytest.mark.parametrize("name", ALL)
def test_two_independent_tables_agree(name):
    servo_model, emulated_model = get_model(name), emulated(name)
    table = {register.name: register for register in emulated_model.table}
    for field, register in servo_model.family.registers.items():
        twin = next((table[alias] for alias in NAMES[field] if alias in table), None)
        assert twin is not None, field
        # The driver reads the major and minor firmware version of Feetech servos as one number.
        twin_size = 2 if name.startswith("STS") and field == "firmware" else twin.size
        assert (register.address, register.size) == (twin.address, twin_size), field
        if field not in OTHER_SIGNS:
            assert register.sign == SIGNS[twin.sign], field
    available = {name for name, aliases in NAMES.items() if not table.keys().isdisjoint(aliases)}
    assert available - servo_model.family.registers.keys() <= NOT_USED
    gain = next(table[alias] for alias in NAMES["gain"] if alias in table)
    # The tables disagree about the factory gains of the XC models, which are read at open.
    assert servo_model.gain_default == gain.initial or name.startswith("XC")
    if "current_limit" in table:
        assert servo_model.current_max == table["current_limit"].initial
    assert servo_model.model_number == emulated_model.number
    assert 2 * np.pi / servo_model.counts_per_turn == pytest.approx(emulated_model.count, rel=1e-3)
    assert servo_model.max_position == emulated_model.max_position
    # The emulator has the data of EX and RX at their highest voltage.
    highest = name.startswith(("EX", "RX"))
    assert (servo_model.voltage[1] if highest else servo_model.rated) == emulated_model.motor.volts
    assert (
        servo_model.current_unit == pytest.approx(emulated_model.current_unit)
        or servo_model.limit_type == "pwm"
    )
    units = Units.of(ServoSpec(name="j", model=name, id=1, port="p"), emulated_model.motor.volts)
    assert units.usable(units.full) == pytest.approx(emulated_model.motor.stall, rel=0.01)
    assert units.no_load_speed == pytest.approx(emulated_model.motor.speed, rel=0.01)


@pytest.mark.parametrize("name", ALL)
def test_blocks_hold_what_the_cycle_needs(name):
    family = get_model(name).family
    for block in family.read:
        end = block.address + block.size
        load = "load" if "load" in family.registers else "current"
        for field in ("position", "speed", load):
            register = family.registers[field]
            assert block.address <= register.address
            assert register.address + register.size <= end
    assert family.read[0].size != family.read[1].size
    # Goal and limit are adjacent, so that one packet writes both, and not in EEPROM.
    fields = [field for packet in family.write for field in packet]
    assert {"goal", "limit", "speed_cap"} <= {*fields}
    assert all(
        family.registers[f].address > family.registers["torque_enable"].address for f in fields
    )
    for packet in family.write:
        spans = [family.registers[field] for field in packet]
        for before, after in pairwise(spans):
            assert before.address + before.size == after.address
    assert "limit" in family.write[0]


@pytest.mark.parametrize("name", ALL)
def test_every_row_gives_servos(name):
    servos = Servos.of([name])
    assert servos.max_torque[0] > 0
    assert servos.kp[0] > 0
    assert servos.friction[0] < 0.1 * servos.max_torque[0]
    assert servos.limit_type == get_model(name).limit_type
    assert servos.encoder_step[0] == pytest.approx(2 * np.pi / get_model(name).counts_per_turn)
    assert servos.armature[0] == pytest.approx(get_model(name).mechanics.armature)


@pytest.mark.parametrize("name", ALL)
def test_data_of_the_maker_go_together(name):
    """The no-load speed is proportional to the voltage, the stall torque nearly so."""
    servo_model = get_model(name)
    low, high = servo_model.voltage
    assert low <= servo_model.rated <= high
    scatters = SCATTERS.get(name, (1.03, 1.09))
    for table, scatter in zip((servo_model.no_load, servo_model.stall), scatters, strict=True):
        voltages, values = np.array(table).T
        assert low <= voltages[0]
        assert voltages[-1] <= high
        assert np.all(np.diff(voltages) > 0.0)
        assert np.all(np.diff(values) > 0.0)
        assert np.max(values / voltages) < scatter * np.min(values / voltages)


@pytest.mark.parametrize("name", ALL)
def test_identified_gears_resemble_the_estimated_ones(name):
    servo_model = get_model(name)
    voltages, stalls = zip(*servo_model.stall, strict=True)
    estimate = estimated_mechanics(float(np.interp(servo_model.rated, voltages, stalls)))
    # The gears of the STS3215 have more damping and inertia than those of Dynamixel servos.
    largest = 7.0 if name.startswith("STS") else 1.5
    for field in ("friction", "damping", "armature"):
        ratio = getattr(servo_model.mechanics, field) / getattr(estimate, field)
        assert 0.35 < ratio < (1.5 if field == "friction" else largest), field


@pytest.mark.parametrize("name", ["MX-28", "MX-64", "MX-106"])
def test_both_protocols_of_a_servo_have_one_motor(name):
    first, second = get_model(name), get_model(f"{name}(2.0)")
    for field in ("stall", "no_load", "mechanics", "rated", "voltage", "counts_per_turn"):
        assert getattr(first, field) == getattr(second, field), field


def test_variants_of_a_servo_differ_by_their_gear_ratio():
    full = get_model("STS3215-7.4V")
    for name in ("STS3215-7.4V-191", "STS3215-7.4V-147"):
        variant = get_model(name)
        ratio = variant.stall[0][1] / full.stall[0][1]
        assert ratio == pytest.approx(int(name[-3:]) / 345)
        assert variant.no_load[0][1] == pytest.approx(full.no_load[0][1] / ratio)
        gears, plain = variant.mechanics, full.mechanics
        assert gears.friction == pytest.approx(ratio * plain.friction)
        assert gears.damping == pytest.approx(ratio**2 * plain.damping)
        assert gears.armature == pytest.approx(ratio**2 * plain.armature)


def test_unknown_models_are_answered_with_near_ones():
    with pytest.raises(ConfigError, match="did you mean: XM430-W350"):
        get_model("XM430W350")
    with pytest.raises(ConfigError, match=r"STS3215-7\.4V"):
        get_model("STS3212")
    with pytest.raises(ConfigError, match="there are: STS3215"):
        get_model("?")
    assert get_model("sts3215-c018") is get_model("STS3215-12V")


def test_variants_share_a_model_number():
    assert len(by_number(777)) == 4
    assert by_number(12345) == ()


def test_servos_of_names_the_voltage_and_counts_the_gains():
    with pytest.raises(ConfigError, match=r"XL430-W250 takes 6\.5 to 12 V, got 24 V"):
        Servos.of(["XL430-W250"], voltage=24.0)
    for voltage in get_model("XL430-W250").voltage:
        assert Servos.of(["XL430-W250"], voltage=voltage).max_torque[0] > 0.0
    with pytest.raises(ConfigError, match="1 gains for 2 servos"):
        Servos.of(["RX-64", "RX-64"], gains=[32])
    with pytest.raises(ConfigError, match="a list"):
        Servos.of("RX-64")


def test_stiffness_follows_the_gain_register():
    soft, stiff = Servos.of(["STS3215-7.4V"] * 2, gains=[16, 32]).kp
    assert soft == pytest.approx(5.1, rel=0.01)
    assert stiff == pytest.approx(2 * soft)
    # The stiffness is inversely proportional to the compliance slope; 32 N·m/rad at slope 32.
    assert Servos.of(["RX-64"], voltage=18.5).kp[0] == pytest.approx(32, rel=0.02)
    assert Servos.of(["RX-64"], voltage=18.5, gains=[64]).kp[0] == pytest.approx(16, rel=0.02)
    assert Servos.of(["XM430-W350"], voltage=12.0).kp[0] == pytest.approx(19.5, rel=0.01)


def test_a_mixed_chain_counts_back_emf_as_damping():
    single = Servos.of(["XL430-W250"])
    both = Servos.of(["XL430-W250", "XL330-M288"])
    assert single.limit_type == "pwm"
    assert both.limit_type == "current"
    back_emf = single.max_torque[0] / single.no_load_speed[0]
    assert both.damping[0] == pytest.approx(single.damping[0] + back_emf)
