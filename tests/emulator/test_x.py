"""Behaviour of emulated Dynamixel Protocol 2.0 servos, register by register."""

from __future__ import annotations

import pytest
from emulator.helpers import address_of, ask, le16, le32, pass_time, single_servo, wire

from pliant.emulator import MODELS, Device
from pliant.emulator.packets import packet_2
from pliant.servo.models import get_model, list_models

RANGE, LENGTH, LIMIT, ACCESS, ALERT = 4, 5, 6, 7, 0x80
CURRENT_POSITION = 5


def write(line, register, *data, id=1):
    """Write `data` by Protocol 2.0; return the error byte of the reply."""
    return ask(line, packet_2(id, 3, bytes([*le16(address_of(line, register)), *data])))[8]


def read(line, register, length, id=1):
    """Read `length` bytes by Protocol 2.0; return error byte and data of the reply."""
    parameters = bytes([*le16(address_of(line, register)), *le16(length)])
    answer = ask(line, packet_2(id, 2, parameters))
    return answer[8], answer[9:-2]


def number(data):
    return int.from_bytes(data, "little", signed=True)


def current_mode(model="XM430-W350", **registers):
    line, servo = single_servo(model, operating_mode=CURRENT_POSITION, **registers)
    assert write(line, "torque_enable", 1) == 0
    return line, servo


@pytest.mark.parametrize("name", [n for n, m in MODELS.items() if m.family == "x"])
def test_model_number_limits_and_present_block(name):
    line, servo = single_servo(name)
    assert number(read(line, "model_number", 2)[1]) == MODELS[name].number
    error, data = read(line, 126, 10)  # Present Current (or Load), Velocity and Position
    assert error == 0
    assert number(data[6:10]) == 2048
    assert ("current_limit" in servo.table) == (MODELS[name].current_unit > 0.0)


def test_eeprom_is_closed_while_torque_is_on():
    line, servo = single_servo("XM430-W350")
    assert write(line, "torque_enable", 1) == 0
    assert write(line, "operating_mode", 5) == ACCESS
    assert servo.get("operating_mode") == 3
    assert write(line, "torque_enable", 0) == 0
    assert write(line, "operating_mode", 5) == 0


@pytest.mark.parametrize(
    ("register", "data", "error"),
    [
        ("goal_current", le16(1194), RANGE),
        ("present_position", le32(0), ACCESS),
        (14, (1,), ACCESS),
        ("goal_position", le16(100), LENGTH),
        ("goal_pwm", le16(886), RANGE),
        ("operating_mode", (2,), RANGE),
        ("goal_position", le32(5000), LIMIT),
    ],
    ids=["current", "read-only", "gap", "half", "pwm", "mode", "position"],
)
def test_refusals(register, data, error):
    line, servo = single_servo("XM430-W350")
    before = bytes(servo.memory)
    assert write(line, register, *data) == error
    assert bytes(servo.memory) == before


def test_goal_current_above_current_limit_is_refused_in_silence_on_sync_write():
    line, servo = current_mode(current_limit=500)
    assert write(line, "goal_current", *le16(501)) == LIMIT
    servo.put("goal_current", 100)
    block = bytes([*le16(102), *le16(2), 1, *le16(501)])
    assert ask(line, packet_2(0xFE, 0x83, block)) == b""
    assert servo.get("goal_current") == 100
    assert line.log.writes("goal_current", refused=True)


def test_xl430_has_no_current_mode():
    line, _ = single_servo("XL430-W250")
    assert write(line, "operating_mode", 5) == RANGE
    assert write(line, 102, *le16(10)) == ACCESS  # Goal Current of other models


def test_mode_change_resets_gains_and_goals():
    line, servo = single_servo("XM430-W350")
    servo.put("goal_current", 3)
    servo.put("goal_pwm", 3)
    write(line, "position_p_gain", *le16(100))
    write(line, "profile_velocity", *le32(50))
    assert write(line, "operating_mode", 5) == 0
    names = ("goal_current", "goal_pwm", "position_p_gain", "profile_velocity")
    assert [servo.get(name) for name in names] == [1193, 885, 800, 0]


def test_position_limits_bind_mode_3_only():
    line, servo = current_mode(max_position_limit=3000)
    assert write(line, "goal_position", *le32(9000)) == 0
    assert servo.drive().goal == pytest.approx(9000 * servo.model.count)
    assert servo.position == 2048


def test_goal_current_limits_torque_in_mode_5_and_not_in_mode_3():
    line, servo = current_mode()
    write(line, "goal_current", *le16(100))
    assert servo.drive().ceiling == pytest.approx(100 * 0.00269 * 4.1 / 2.3)
    line, servo = single_servo("XM430-W350")
    write(line, "torque_enable", 1)
    write(line, "goal_current", *le16(100))
    assert servo.drive().ceiling == pytest.approx(4.1)
    write(line, "goal_pwm", *le16(200))
    assert servo.drive().ceiling == pytest.approx(4.1 * 200 / 885)


@pytest.mark.parametrize("name", [name for name in list_models() if name in MODELS])
def test_factory_gains_of_driver_and_emulator_agree(name):
    # Both tables were copied from the e-Manuals, independently of each other.
    row, table = get_model(name), MODELS[name].table
    registers = ("position_p_gain", "p_gain", "p_coefficient", "cw_compliance_slope")
    (gain,) = (register for register in registers if register in table)
    _, servo = single_servo(name)
    assert servo.get(gain) == row.gain_default


def test_stiffness_of_factory_gains():
    line, servo = single_servo("XM430-W350")
    write(line, "torque_enable", 1)
    assert servo.drive().stiffness == pytest.approx(18.9, rel=0.01)
    line, servo = current_mode()
    assert servo.drive().stiffness == pytest.approx(19.5, rel=0.01)


def hold_at_limit(servo, seconds):
    servo.shaft.torque = servo.drive().ceiling
    pass_time(servo, seconds)


def test_overload_cuts_torque_until_reboot():
    line, servo = current_mode()
    write(line, "goal_current", *le16(100))
    hold_at_limit(servo, 3.2)
    assert not servo.enabled
    assert read(line, "hardware_error_status", 1) == (ALERT, bytes([0x20]))
    assert write(line, "torque_enable", 1) == ALERT
    assert not servo.enabled, "torque cannot be switched on again"
    ask(line, packet_2(1, 8))
    pass_time(servo, 0.4)
    assert read(line, "hardware_error_status", 1) == (0, b"\0")
    write(line, "torque_enable", 1)
    assert servo.enabled
    assert servo.get("goal_current") == 1193, "RAM starts anew: limits must be written again"


def test_overload_cleared_from_shutdown_only_alerts():
    line, servo = current_mode(shutdown=52 & ~0x20)
    write(line, "goal_current", *le16(100))
    hold_at_limit(servo, 3.2)
    assert servo.enabled
    assert read(line, "present_position", 4)[0] == ALERT


def test_bus_watchdog_stops_and_refuses_goals_until_cleared():
    line, servo = current_mode()
    assert write(line, "bus_watchdog", 5) == 0
    pass_time(servo, 0.05)
    write(line, "goal_position", *le32(3000))
    pass_time(servo, 0.09)
    assert servo.get("bus_watchdog") == 5
    pass_time(servo, 0.02)
    assert read(line, "bus_watchdog", 1)[1] == b"\xff"
    assert servo.enabled
    assert servo.get("goal_position") == servo.position, "it stops where it is"
    assert write(line, "goal_position", *le32(3000)) == RANGE
    assert write(line, "goal_current", *le16(10)) == RANGE
    assert write(line, "bus_watchdog", 0) == 0
    assert write(line, "goal_position", *le32(3000)) == 0


def test_any_packet_on_the_bus_feeds_the_watchdog():
    line = wire(Device("XM430-W350", 1), Device("XM430-W350", 2))
    servo = line.servos[0]
    write(line, "torque_enable", 1)
    write(line, "bus_watchdog", 2)
    for _ in range(10):
        pass_time(servo, 0.03)
        read(line, "present_position", 4, id=2)
    assert servo.get("bus_watchdog") == 2


def test_indirect_block_carries_limit_and_goal():
    line, servo = current_mode()
    # The two bytes of Goal Current and the four of Goal Position.
    for k, target in enumerate([102, 103, 116, 117, 118, 119]):
        assert write(line, f"indirect_address_{k + 1}", *le16(target)) == 0
    assert write(line, "indirect_data_1", *le16(77), *le32(2100)) == 0
    assert (servo.get("goal_current"), servo.get("goal_position")) == (77, 2100)
    assert read(line, "indirect_data_1", 6)[1] == bytes([*le16(77), *le32(2100)])
    assert line.log.writes("goal_current")[-1].values == {"goal_current": 77}
    servo.power_up()
    assert servo.get("indirect_address_1") == 224, "volatile"


def test_xl330_has_its_indirect_data_at_208():
    line, servo = single_servo("XL330-M288")
    write(line, "indirect_address_1", *le16(65))
    assert write(line, 208, 1) == 0
    assert servo.get("led") == 1


def test_homing_offset_and_reverse_mode():
    _, servo = single_servo("XM430-W350", homing_offset=-500)
    assert servo.position == 1548
    _, servo = single_servo("XM430-W350", drive_mode=1, homing_offset=10)
    servo.shaft.angle = 1000 * servo.model.count
    assert servo.position == 4096 - 1000 + 10
    assert servo.angle_of(servo.position) == pytest.approx(servo.shaft.angle)


def test_position_counts_on_beyond_a_turn_and_starts_within_one():
    _, servo = single_servo("XM430-W350")
    servo.shaft.angle = 5000 * servo.model.count
    assert servo.position == 5000
    servo.power_up()
    assert servo.position == 904


def test_position_mode_counts_from_within_a_turn_at_torque_on():
    line, servo = single_servo("XC430-W150", homing_offset=100)
    servo.shaft.angle = 4300 * servo.model.count
    assert servo.position == 4400
    write(line, "torque_enable", 1)
    assert servo.position == 304
    line, servo = current_mode()
    servo.shaft.angle = 4300 * servo.model.count
    write(line, "torque_enable", 0)
    write(line, "torque_enable", 1)
    assert servo.position == 4300, "mode 5 counts on"


def test_a_silent_servo_ends_the_chain_of_a_sync_read():
    line = wire(*(Device("XL430-W250", id) for id in (1, 2, 3)))
    request = packet_2(0xFE, 0x82, bytes([*le16(132), *le16(4), 1, 2, 3]))
    assert len(ask(line, request)) == 3 * 15
    line.servos[1].plugged = False
    assert len(ask(line, request)) == 15


def test_mx_does_not_know_fast_sync_read():
    line = wire(Device("MX-64(2.0)", 1))
    assert ask(line, packet_2(0xFE, 0x8A, bytes([*le16(132), *le16(4), 1]))) == b""


def test_stuffed_data_arrives_whole():
    line, servo = current_mode()
    assert write(line, "goal_position", 0xFF, 0xFF, 0xFD, 0xFF) == 0
    assert servo.get("goal_position") == 0xFFFDFFFF - (1 << 32)
    # The helper `read` does not remove byte stuffing: these are the bytes on the line.
    assert read(line, "goal_position", 4)[1] == bytes([0xFF, 0xFF, 0xFD, 0xFD, 0xFF])


def test_present_current_and_velocity_are_signed():
    line, servo = current_mode()
    servo.shaft.torque, servo.shaft.speed = -1.0, -1.0
    data = read(line, "present_current", 10)[1]
    assert number(data[:2]) == -round(1.0 / (4.1 / 2.3) / 0.00269)
    assert number(data[2:6]) == -42
