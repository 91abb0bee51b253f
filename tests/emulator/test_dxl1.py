"""Behaviour of emulated Dynamixel Protocol 1.0 servos, register by register."""

from __future__ import annotations

import math

import pytest
from emulator.helpers import ask, le16, p1, pass_time, read1, single_servo, wire, write1

from pliant.emulator import Device

ANGLE, RANGE, OVERLOAD, INSTRUCTION = 0x02, 0x08, 0x20, 0x40
FAMILY = ["EX-106+", "RX-64", "MX-28", "MX-64", "MX-106"]


@pytest.mark.parametrize(
    ("model", "number"), list(zip(FAMILY, [107, 64, 29, 310, 320], strict=True))
)
def test_model_number_and_factory_values(model, number):
    line, _ = single_servo(model)
    error, data = read1(line, "model_number", 24)
    assert error == 0
    assert int.from_bytes(data[:2], "little") == number
    assert (data[3], data[5], data[16], data[18]) == (1, 250, 2, 36)


@pytest.mark.parametrize("model", FAMILY)
def test_the_block_of_goal_speed_limit_is_one_write(model):
    line, servo = single_servo(model)
    assert write1(line, "goal_position", *le16(600), *le16(100), *le16(300)) == 0
    names = ("goal_position", "moving_speed", "torque_limit")
    assert [servo.get(name) for name in names] == [600, 100, 300]


@pytest.mark.parametrize("model", FAMILY)
def test_a_goal_switches_torque_on(model):
    line, servo = single_servo(model)
    assert not servo.enabled
    write1(line, "goal_position", *le16(600))
    assert servo.enabled


@pytest.mark.parametrize(
    ("register", "data"),
    [
        ("torque_limit", le16(1024)),
        ("max_torque", le16(1024)),
        ("present_position", le16(100)),
        ("id", (254,)),
        ("goal_position", (5,)),
        (200, (1,)),
    ],
    ids=["limit", "max torque", "read-only", "id", "half a register", "beyond"],
)
def test_what_is_out_of_range_is_refused_and_nothing_changes(register, data):
    line, servo = single_servo("MX-64")
    before = bytes(servo.memory)
    assert write1(line, register, *data) == RANGE
    assert bytes(servo.memory) == before


def test_a_goal_outside_the_angle_limits_is_refused():
    line, servo = single_servo("MX-28", cw_angle_limit=1000, ccw_angle_limit=3000)
    before = servo.get("goal_position")
    assert write1(line, "goal_position", *le16(500)) == ANGLE
    assert servo.get("goal_position") == before


def test_a_sync_write_out_of_range_is_refused_in_silence():
    line, servo = single_servo("MX-28")
    assert ask(line, p1(0xFE, 0x83, 34, 2, 1, *le16(1024))) == b""
    assert servo.get("torque_limit") == 1023
    assert line.log.writes(refused=True)[0].error == RANGE


def test_eeprom_is_closed_while_torque_is_on_and_after_lock_until_power_off():
    line, servo = single_servo("MX-28")
    assert write1(line, "max_torque", *le16(500)) == 0
    write1(line, "torque_enable", 1)
    assert write1(line, "max_torque", *le16(600)) == RANGE
    write1(line, "torque_enable", 0)
    write1(line, "lock", 1)
    assert write1(line, "max_torque", *le16(600)) == RANGE
    assert write1(line, "lock", 0) == RANGE
    servo.power_up()
    servo.wake()
    assert servo.get("lock") == 0
    assert write1(line, "max_torque", *le16(600)) == 0


def test_power_up_copies_max_torque_and_clears_ram():
    _, servo = single_servo("RX-64", max_torque=400)
    servo.put("torque_limit", 100)
    servo.put("torque_enable", 1)
    servo.power_up()
    assert (servo.get("torque_limit"), servo.enabled) == (400, False)
    assert servo.get("goal_position") == servo.position


@pytest.mark.parametrize(("level", "answers"), [(0, 1), (1, 2), (2, 3)])
def test_status_return_level(level, answers):
    line, _ = single_servo("MX-28", status_return_level=level)
    requests = [p1(1, 1), p1(1, 2, 36, 2), p1(1, 3, 25, 1)]
    assert sum(bool(ask(line, request)) for request in requests) == answers


def test_a_broken_checksum_is_answered_with_its_bit():
    line, servo = single_servo("MX-28")
    request = bytearray(p1(1, 3, 25, 1))
    request[-1] ^= 1
    assert ask(line, bytes(request))[4] == 0x10
    assert servo.get("led") == 0


def test_action_without_reg_write_is_an_instruction_error():
    line, _ = single_servo("MX-28")
    assert ask(line, p1(1, 5))[4] == INSTRUCTION


def saturate(model, seconds, **registers):
    """Hold a servo at its torque limit for `seconds`; return its serial line and the servo."""
    line, servo = single_servo(model, **registers)
    write1(line, "torque_limit", *le16(200))
    write1(line, "goal_position", *le16(0))
    servo.shaft.torque = -servo.drive().ceiling
    pass_time(servo, seconds)
    return line, servo


def test_overload_sets_the_torque_limit_to_zero_and_a_new_limit_revives():
    line, servo = saturate("RX-64", 3.2)
    assert servo.get("torque_limit") == 0
    assert servo.drive().goal is None
    error, data = read1(line, "torque_limit", 2)
    assert (error, data) == (OVERLOAD, b"\0\0")
    servo.shaft.torque = 0.0
    assert write1(line, "torque_limit", *le16(100)) == 0
    assert servo.drive().goal is not None


def test_overload_without_its_bit_in_shutdown_only_reports():
    line, servo = saturate("RX-64", 3.2, shutdown=4)
    assert servo.get("torque_limit") == 200
    assert read1(line, "torque_limit", 2)[0] == OVERLOAD


def test_no_overload_before_its_time():
    assert saturate("RX-64", 2.5)[1].get("torque_limit") == 200


def test_heat_and_voltage_are_conditions_that_go_away():
    line, servo = single_servo("MX-28", shutdown=0)
    servo.temperature, servo.supply = 90.0, 20.0
    assert read1(line, "present_position", 2)[0] == 0x05
    servo.temperature, servo.supply = 30.0, 12.0
    assert read1(line, "present_position", 2)[0] == 0


def test_torque_limit_is_a_share_of_stall_at_the_present_voltage():
    line, servo = single_servo("MX-64")
    write1(line, "goal_position", *le16(3000), *le16(0), *le16(511))
    assert servo.drive().ceiling == pytest.approx(6.0 * 511 / 1023)
    servo.supply = 14.8
    assert servo.drive().ceiling == pytest.approx(7.4 * 511 / 1023)


def test_stiffness_comes_from_gain_or_slope():
    line, servo = single_servo("MX-64")
    write1(line, "goal_position", *le16(2048))
    assert servo.drive().stiffness == pytest.approx(30.3, rel=0.01)
    line, servo = single_servo("RX-64")
    servo.supply = 18.5
    write1(line, "goal_position", *le16(512))
    assert servo.drive().stiffness == pytest.approx(32.4, rel=0.01)


def test_present_values_have_the_makers_units_and_signs():
    line, servo = single_servo("MX-64")
    servo.put("torque_enable", 1)
    servo.shaft.speed = -2.0
    servo.shaft.torque = -1.5
    _, data = read1(line, "present_position", 8)
    speed = int.from_bytes(data[2:4], "little")
    assert speed == 1024 + round(2.0 / (0.114 * 2 * math.pi / 60))
    assert int.from_bytes(data[4:6], "little") >> 10 == 1
    assert (data[6], data[7]) == (120, 25)
    current = int.from_bytes(read1(line, "present_current", 2)[1], "little")
    assert current == 2048 - round(1.5 / (6.0 / 4.1) / 0.0045)


def test_ex106_counts_span_251_degrees():
    line, servo = single_servo("EX-106+")
    servo.shaft.angle = math.radians(125.5)
    assert abs(int.from_bytes(read1(line, "present_position", 2)[1], "little") - 2048) <= 1
    servo.shaft.angle = math.radians(300.0)
    assert int.from_bytes(read1(line, "present_position", 2)[1], "little") == 4095


def test_bulk_read_stops_at_the_first_silent_servo():
    line = wire(*(Device("MX-28", id) for id in (1, 2, 3)))
    request = p1(0xFE, 0x92, 0, 2, 1, 36, 2, 2, 36, 2, 3, 36)
    assert len(ask(line, request)) == 3 * 8
    line.servos[1].plugged = False
    assert len(ask(line, request)) == 8


def test_sync_read_is_not_for_this_family():
    line, _ = single_servo("MX-28")
    assert ask(line, p1(0xFE, 0x82, 36, 2, 1)) == b""
