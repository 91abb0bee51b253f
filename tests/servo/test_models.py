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
#: By register of the driver: names of the register in the emulator's tables. In each table, the
#: first name that it contains counts; empty if the emulator lacks the register.
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
    "integral_gain": ("i_coefficient", "position_i_gain", "i_gain"),
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
#: Sign coding of the driver, by sign coding of the emulator.
SIGNS = {None: "unsigned", 0: "twos", 10: "bit10", 11: "bit11", 15: "bit15"}
#: Registers whose sign driver and emulator may code differently: positions within a turn are never
#: negative, and a tripped watchdog is 255 for the driver, -1 for the emulator.
OTHER_SIGNS = {"position_min", "position_max", "goal", "position", "watchdog"}
#: Registers that the driver does not use in some families that have them.
NOT_USED = {"current", "goal_velocity", "lock", "punch", "pwm_goal"}
#: Allowed scatter of no-load speed and of stall torque over voltage, as a ratio, for data sheets
#: with a larger scatter than the others.
SCATTERS = {
    "XH540-W270": (1.05, 1.09),
    "XL330-M077": (1.03, 1.3),
    "XL330-M288": (1.03, 1.14),
    "XL430-W250": (1.03, 1.14),
}
TWINS = {"STS3215-7.4V-191": "STS3215-C044", "STS3215-7.4V-147": "STS3215-C046"}

#: Data sheets: name, number, current unit [A], largest current register, current at stall
#: [A], rated voltage and supply range [V]; then voltage [V], stall torque [N·m], speed [rpm].
DATA_SHEETS = """
STS3215-7.4V 777 0.0065 0 - 7.4 4.0 8.4 | 7.4 1.9123 52
STS3215-12V 777 0.0065 0 - 12 6.0 12.6 | 12 2.9420 45
EX-106+ 107 0 0 - 14.8 12 18.5 | 18.5 10.9 91
RX-64 64 0 0 - 14.8 12 18.5 | 18.5 5.3 64
MX-28 29 0 0 - 12 10 14.8 | 11.1 2.3 50 | 12 2.5 55 | 14.8 3.1 67
MX-64 310 0 0 - 12 10 14.8 | 11.1 5.5 58 | 12 6.0 63 | 14.8 7.3 78
MX-106 320 0 0 - 12 10 14.8 | 11.1 8.0 41 | 12 8.4 45 | 14.8 10.0 55
MX-64(2.0) 311 0.00336 1941 4.1 12 10 14.8 | 11.1 5.5 58 | 12 6.0 63 | 14.8 7.3 78
MX-106(2.0) 321 0.00336 2047 5.2 12 10 14.8 | 11.1 8.0 41 | 12 8.4 45 | 14.8 10.0 55
XL330-M077 1190 0.001 1750 1.47 5 3.7 6.0 | 3.7 0.18 278 | 5 0.215 383 | 6 0.228 456
XL330-M288 1200 0.001 1750 1.47 5 3.7 6.0 | 3.7 0.42 76 | 5 0.52 103 | 6 0.60 123
XC330-T181 1210 0.001 910 0.80 11.1 6.5 12 | 9 0.65 83 | 11.1 0.76 104 | 12 0.80 113
XC330-T288 1220 0.001 910 0.80 11.1 6.5 12 | 9 0.76 52 | 11.1 0.92 65 | 12 1.00 71
XM430-W210 1030 0.00269 1193 2.3 12 10 14.8 | 11.1 2.7 70 | 12 3.0 77 | 14.8 3.7 95
XM430-W350 1020 0.00269 1193 2.3 12 10 14.8 | 11.1 3.8 43 | 12 4.1 46 | 14.8 4.8 57
XM540-W150 1130 0.00269 2047 4.4 12 10 14.8 | 11.1 6.9 50 | 12 7.3 53 | 14.8 8.9 66
XM540-W270 1120 0.00269 2047 4.4 12 10 14.8 | 11.1 10.0 28 | 12 10.6 30 | 14.8 12.9 37
XH430-W210 1010 0.00269 648 1.3 12 10 14.8 | 11.1 2.2 46 | 12 2.5 50 | 14.8 3.1 62
XH430-W350 1000 0.00269 648 1.3 12 10 14.8 | 11.1 3.1 27 | 12 3.4 30 | 14.8 4.2 37
XH540-W150 1110 0.00269 2047 4.9 12 10 14.8 | 11.1 6.6 66 | 12 7.1 70 | 14.8 8.5 86
XH540-W270 1100 0.00269 2047 4.9 12 10 14.8 | 11.1 9.2 36 | 12 9.9 39 | 14.8 11.7 46
XL430-W250 1060 0 0 - 11.1 6.5 12 | 9 1.0 47 | 11.1 1.4 57 | 12 1.5 61
XC430-W150 1070 0 0 - 12 6.5 14.8 | 9 1.2 80 | 11.1 1.4 99 | 12 1.6 106
XC430-W240 1080 0 0 - 12 6.5 14.8 | 9 1.4 52 | 11.1 1.7 65 | 12 1.9 70
"""
#: Per family: coding of the status, True with sync read, register values of full duty, full load
#: and largest speed, register that bounds the torque limit; motor duty per radian and unit of the
#: gain, unit of speed [rpm], overload threshold as a share of the torque.
FAMILIES = {
    "STS3215": ("feetech", True, 1000, 1000, 3400, "max_torque", 0.166, 60 / 4096, 0.8),
    "EX-106+": ("p1", False, 1023, 1023, 1023, "max_torque", 0.0, 0.111, None),
    "RX-64": ("p1", False, 1023, 1023, 1023, "max_torque", 0.0, 0.111, None),
    "MX-28, MX-64": ("p1", False, 1023, 1023, 1023, "max_torque", 0.158, 0.114, None),
    "MX-106": ("p1", False, 1023, 1023, 1023, "max_torque", 0.158, 0.114, None),
    "X, current-limited": ("p2", True, 885, 1000, 32767, "current_limit", 0.005755, 0.229, None),
    "X, duty-limited": ("p2", True, 885, 1000, 32767, "pwm_limit", 0.005755, 0.229, None),
}
#: Identified friction [N·m], damping [N·m·s/rad] and inertia [kg·m²] of gears and rotor.
IDENTIFIED = {
    "STS3215-7.4V": (0.052, 0.059, 0.028),
    "STS3215-12V": (0.052, 0.059, 0.028),
    "MX-64(2.0)": (0.090, 0.012, 0.012),
    "MX-106(2.0)": (0.104, 0.035, 0.027),
    "XL330-M288": (0.013, 0.0037, 0.0018),
}


def emulated(name):
    return EMULATED[TWINS.get(name, name)]


@pytest.mark.parametrize(
    "line", DATA_SHEETS.strip().splitlines(), ids=lambda line: line.partition(" ")[0]
)
def test_models_have_the_numbers_of_their_data_sheets(line):
    head, *points = line.split(" | ")
    name, *words = head.split()
    expected = [np.nan if word == "-" else float(word) for word in words]
    row = get_model(name)
    numbers = [row.model_number, row.current_unit, row.current_max, row.stall_current, row.rated]
    assert [*numbers, *row.voltage] == pytest.approx(expected, rel=1e-9, nan_ok=True)
    volts, stall, speed = np.array([point.split() for point in points], dtype=float).T
    for table, values in ((row.stall, stall), (row.no_load, speed)):
        assert table == pytest.approx(np.transpose([volts, values]), rel=1e-4)
    units = Units.of(ServoSpec(name="j", model=name, id=1, port="p"), volts[0])
    assert units.no_load_speed == pytest.approx(speed[0] * np.pi / 30.0)
    family = row.family
    *texts, gain, unit, overload = FAMILIES[family.name]
    sizes = (family.full_duty, family.full_load, family.speed_max)
    assert [family.status, family.sync_read, *sizes, family.ceiling] == texts
    assert (row.gain, row.speed_unit) == pytest.approx((gain, unit), rel=1e-3)
    assert row.overload == overload
    gears = [getattr(row.mechanics, field) for field in ("friction", "damping", "armature")]
    if name in IDENTIFIED or family.name == "X, current-limited":
        largest = float(np.interp(row.rated, volts, stall))
        estimate = [0.02 * largest, 0.005 * largest, 0.003 * largest]
        assert gears == pytest.approx(IDENTIFIED.get(name, estimate))


def test_a_zero_with_a_sign_is_zero():
    family = get_model("STS3215-7.4V").family
    block = family.block("goal")
    assert family.layout(block).decode(b"\x00\x80") == {"goal": 0}
    assert family.decode(block, b"\x00\x80", "goal") == 0


def test_registers_of_the_drive_and_blocks_of_readings():
    compliance = {"margin_cw": 1, "margin_ccw": 1, "slope_ccw": "gain"}
    for name, values, first, last in (
        ("STS3215", {"acceleration_cap": 0}, (56, 15), (0, 71)),
        ("EX-106+", {**compliance, "punch": 0}, (34, 10), (0, 50)),
        ("RX-64", {**compliance, "punch": 32}, (34, 10), (0, 50)),
        ("MX-64", {"acceleration_cap": 0, "integral_gain": 0}, (34, 10), (0, 50)),
        ("MX-106", {"acceleration_cap": 0, "integral_gain": 0}, (34, 10), (0, 50)),
        ("XM430-W350", {"pwm_goal": "pwm_limit", "integral_gain": 0}, (126, 10), (104, 43)),
        ("XL430-W250", {"acceleration_cap": 0, "integral_gain": 0}, (126, 10), (104, 43)),
    ):
        family = get_model(name).family
        assert family.drive_values == values
        assert (family.read[0], family.read[-1]) == (first, last)
        assert [block.size for block in family.read] == [*range(first[1], last[1] + 1)]
        assert all(block.address <= first[0] for block in family.read)
        assert all(sum(block) >= sum(first) for block in family.read)


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
    # Goal and limit are adjacent, so that one packet writes both, and they are in RAM.
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
