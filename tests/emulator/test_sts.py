"""Behaviour of the emulated STS3215, and the examples of its maker's protocol sheet."""

from __future__ import annotations

import pytest
from emulator.helpers import ask, le16, p1, pass_time, read1, single_servo, wire, write1

from pliant.emulator import Device

OVERLOAD, HEAT, VOLTAGE = 0x20, 0x04, 0x01
GOAL = (0x00, 0x08, 0, 0, 0xE8, 0x03)


def hex_text(data):
    return data.hex(" ").upper()


def test_sheet_ping_and_read():
    line, servo = single_servo("STS3215")
    assert hex_text(ask(line, bytes.fromhex("FF FF 01 02 01 FB"))) == "FF FF 01 02 00 FC"
    servo.shaft.angle = 1304 * servo.model.count
    answer = ask(line, bytes.fromhex("FF FF 01 04 02 38 02 BE"))
    assert hex_text(answer) == "FF FF 01 04 00 18 05 DD"


def test_sheet_broadcast_id_and_write():
    line, servo = single_servo("STS3215")
    servo.put("id", 9)
    assert ask(line, bytes.fromhex("FF FF FE 04 03 05 01 F4")) == b""
    assert servo.id == 1
    answer = ask(line, bytes.fromhex("FF FF 01 09 03 2A 00 08 00 00 E8 03 D5"))
    assert hex_text(answer) == "FF FF 01 02 00 FC"
    assert (servo.get("goal_position"), servo.get("goal_velocity")) == (2048, 1000)


def test_sheet_reg_write_and_action():
    line, servo = single_servo("STS3215")
    servo.put("goal_position", 100)
    answer = ask(line, bytes.fromhex("FF FF 01 09 04 2A 00 08 00 00 E8 03 D4"))
    assert hex_text(answer) == "FF FF 01 02 00 FC"
    assert servo.get("goal_position") == 100
    assert ask(line, bytes.fromhex("FF FF FE 02 05 FA")) == b""
    assert servo.get("goal_position") == 2048


def test_sheet_sync_write():
    line = wire(*(Device("STS3215", id) for id in (1, 2, 3, 4)))
    part = "00 08 00 00 E8 03"
    request = f"FF FF FE 20 83 2A 06 01 {part} 02 {part} 03 {part} 04 {part} 58"
    assert ask(line, bytes.fromhex(request)) == b""
    assert {(s.get("goal_position"), s.get("goal_velocity")) for s in line.servos} == {(2048, 1000)}


def test_sheet_sync_read():
    line = wire(Device("STS3215-12V", 1), Device("STS3215-12V", 2))
    for servo, count, volts, heat in zip(
        line.servos, (2048, 2047), (12.1, 11.9), (30.0, 35.0), strict=True
    ):
        servo.shaft.angle, servo.supply = count * servo.model.count, volts
        servo.temperature = heat
    answer = ask(line, bytes.fromhex("FF FF FE 06 82 38 08 01 02 36"))
    assert hex_text(answer) == (
        "FF FF 01 0A 00 00 08 00 00 00 00 79 1E 55 FF FF 02 0A 00 FF 07 00 00 00 00 77 23 53"
    )


def test_a_goal_switches_torque_on():
    line, servo = single_servo("STS3215")
    write1(line, "goal_position", *GOAL)
    assert servo.enabled


def test_goals_are_cut_to_the_position_limits():
    line, servo = single_servo("STS3215", min_position_limit=1000, max_position_limit=3000)
    write1(line, "goal_position", *le16(3500))
    assert servo.get("goal_position") == 3000


def test_refused_writes_are_ignored_without_an_error():
    line, servo = single_servo("STS3215")
    assert write1(line, "torque_limit", *le16(1001)) == 0
    assert write1(line, "present_position", *le16(5)) == 0
    assert servo.get("torque_limit") == 1000
    assert len(line.log.writes(refused=True)) == 2


def test_eeprom_is_kept_only_while_unlocked():
    line, servo = single_servo("STS3215")
    write1(line, "max_torque_limit", *le16(500))
    assert servo.get("max_torque_limit") == 500
    servo.power_up()
    servo.wake()
    assert servo.get("max_torque_limit") == 1000
    write1(line, "lock", 0)
    write1(line, "max_torque_limit", *le16(500))
    servo.power_up()
    assert (servo.get("max_torque_limit"), servo.get("torque_limit")) == (500, 500)


def load_servo(share, **registers):
    line, servo = single_servo("STS3215", **registers)
    write1(line, "goal_position", *le16(3000), 0, 0, 0, 0, *le16(1000))
    servo.shaft.torque = share * servo.stall
    return line, servo


def test_overload_cuts_to_the_protective_torque_until_the_next_goal():
    line, servo = load_servo(0.85)
    pass_time(servo, 1.9)
    assert read1(line, "present_position", 2)[0] == 0
    pass_time(servo, 0.2)
    assert read1(line, "status", 1) == (OVERLOAD, bytes([OVERLOAD]))
    assert servo.drive().ceiling == pytest.approx(0.2 * servo.stall)
    assert write1(line, "goal_position", *le16(3000)) == 0, (
        "the write is done, and clears the protection"
    )
    assert servo.drive().ceiling == pytest.approx(0.97 * servo.stall)


def test_below_overload_torque_nothing_trips():
    line, servo = load_servo(0.75)
    pass_time(servo, 10.0)
    assert read1(line, "present_position", 2)[0] == 0


def test_lerobots_gripper_settings_trip_early():
    line, servo = load_servo(0.30, overload_torque=25)
    pass_time(servo, 2.1)
    assert read1(line, "present_position", 2)[0] == OVERLOAD
    assert servo.drive().ceiling == pytest.approx(0.2 * servo.stall)


def test_a_condition_does_not_refuse_torque_off():
    line, servo = load_servo(0.85)
    pass_time(servo, 2.1)
    assert write1(line, "torque_enable", 0) == 0
    assert not servo.enabled


def test_heat_unloads():
    line, servo = load_servo(0.1)
    servo.temperature = 75.0
    pass_time(servo, 0.01)
    assert not servo.enabled
    assert read1(line, "present_position", 2)[0] == HEAT


def test_a_servo_for_7_volts_on_12_reports_its_voltage():
    line, servo = single_servo("STS3215-7.4V")
    servo.supply = 12.0
    error, data = read1(line, "present_voltage", 1)
    assert (error, data[0]) == (VOLTAGE, 120)


def test_signs_are_sign_and_magnitude():
    line, servo = load_servo(-0.25)
    servo.shaft.speed = -1.0
    data = read1(line, "present_position", 15)[1]
    assert int.from_bytes(data[2:4], "little") == 0x8000 | 652
    load = int.from_bytes(data[4:6], "little")
    assert load & 0x400
    assert load & 0x3FF == round(1000 * (0.25 + 1.0 * servo.model.motor.slope / servo.stall))
    assert int.from_bytes(data[13:15], "little") & 0x8000


def test_homing_offset_and_middle():
    line, servo = single_servo("STS3215", homing_offset=-100)
    assert servo.position == 2148
    servo.shaft.angle = 700 * servo.model.count
    write1(line, "torque_enable", 128)
    assert servo.position == 2048


def test_position_wraps_at_the_seam():
    _, servo = single_servo("STS3215")
    servo.shaft.angle = -1 * servo.model.count
    assert servo.position == 4095


def test_broadcast_ping_is_answered_by_all_and_sync_read_skips_the_silent():
    line = wire(*(Device("STS3215", id) for id in (3, 1, 2)))
    assert ask(line, p1(0xFE, 1)) == b"".join(
        bytes([0xFF, 0xFF, id, 2, 0, ~(id + 2) & 0xFF]) for id in (1, 2, 3)
    )
    line.servos[1].plugged = False
    answer = ask(line, p1(0xFE, 0x82, 56, 2, 1, 2, 3))
    assert [answer[2], answer[10]] == [2, 3]


def test_a_broken_request_is_not_answered():
    line, _ = single_servo("STS3215")
    assert ask(line, b"\xff\xff\x01\x02\x01\x00") == b""


@pytest.mark.parametrize("id", [252, 253])
def test_a_servo_with_a_large_id_answers(id):
    # Packets to id 253 begin like those of Protocol 2.0, FF FF FD.
    line = wire(Device("STS3215", id))
    assert ask(line, p1(id, 1)) == p1(id, 0)
    assert ask(line, p1(id, 2, 5, 1)) == p1(id, 0, id)
