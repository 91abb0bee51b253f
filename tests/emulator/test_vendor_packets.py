"""Packet examples of the makers' manuals, byte for byte."""

from __future__ import annotations

import pytest

from pliant.emulator import Device, SerialLine
from pliant.emulator.packets import crc16, stuff, unstuff


def line(*devices, **values):
    """Return a serial line with servos; `values` are registers of the first servo."""
    servos = [device.build(1_000_000) for device in devices]
    serial_line = SerialLine(servos)
    for name, value in values.items():
        servos[0].put(name, value)
    return serial_line


def exchange(serial_line, request):
    return (
        b"".join(d.data for d in serial_line.feed(bytes.fromhex(request), 1_000_000))
        .hex(" ")
        .upper()
    )


def test_p1_ping():
    assert exchange(line(Device("RX-64", 1)), "FF FF 01 02 01 FB") == "FF FF 01 02 00 FC"


def test_p1_read_temperature():
    serial_line = line(Device("RX-64", 1))
    serial_line.servos[0].temperature = 32.0
    assert exchange(serial_line, "FF FF 01 04 02 2B 01 CC") == "FF FF 01 03 00 20 DB"


def test_p1_broadcast_write_sets_the_id_without_an_answer():
    serial_line = line(Device("RX-64", 7))
    assert exchange(serial_line, "FF FF FE 04 03 03 01 F6") == ""
    assert serial_line.servos[0].id == 1


def test_p1_checksum_example_is_understood():
    # Write 100 and 170 to addresses 12 and 13 of servo 1: both voltage limits.
    serial_line = line(Device("RX-64", 1))
    assert exchange(serial_line, "FF FF 01 05 03 0C 64 AA DC") == "FF FF 01 02 00 FC"
    assert (
        serial_line.servos[0].get("min_voltage_limit"),
        serial_line.servos[0].get("max_voltage_limit"),
    ) == (
        100,
        170,
    )


def test_p1_reg_write_and_action():
    serial_line = line(Device("RX-64", 1))
    assert exchange(serial_line, "FF FF 01 05 04 1E F4 01 E2") == "FF FF 01 02 00 FC"
    servo = serial_line.servos[0]
    assert servo.get("goal_position") != 500
    assert exchange(serial_line, "FF FF FE 02 05 FA") == ""
    assert servo.get("goal_position") == 500


def test_p1_factory_reset_is_refused():
    serial_line = line(Device("RX-64", 0))
    assert exchange(serial_line, "FF FF 00 02 06 F7") == "FF FF 00 02 40 BD"
    assert serial_line.servos[0].id == 0


def test_p1_sync_write():
    serial_line = line(Device("RX-64", 0), Device("RX-64", 1))
    request = "FF FF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67"
    assert exchange(serial_line, request) == ""
    goals = [(s.get("goal_position"), s.get("moving_speed")) for s in serial_line.servos]
    assert goals == [(0x010, 0x150), (0x220, 0x360)]


def test_p1_bulk_read():
    # The manual's example has RX-64 servos, which lack the instruction; MX servos have it.
    serial_line = line(Device("MX-28", 1), Device("MX-28", 2))
    serial_line.servos[0].put("goal_position", -0x8000)
    serial_line.servos[1].stuck["present_position"] = -0x8000
    answer = exchange(serial_line, "FF FF FE 09 92 00 02 01 1E 02 02 24 1D")
    assert answer == "FF FF 01 04 00 00 80 7A FF FF 02 04 00 00 80 79"


def test_p1_error_bits_of_the_status_example():
    serial_line = line(Device("RX-64", 1))
    serial_line.servos[0].temperature = 90.0
    serial_line.servos[0].trip(0x20)
    assert exchange(serial_line, "FF FF 01 02 01 FB") == "FF FF 01 02 24 D8"


PING = "FF FF FD 00 01 03 00 01 19 4E"
PONG_1 = "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"
PONG_2 = "FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D"
STATUS_OK = "FF FF FD 00 01 04 00 55 00 A1 0C"


def pair(**values):
    serial_line = line(Device("XM430-W210", 1), Device("XM430-W210", 2), **values)
    for servo in serial_line.servos:
        servo.put("firmware_version", 38)
    return serial_line


def test_p2_ping():
    assert exchange(pair(), PING) == PONG_1


def test_p2_broadcast_ping():
    assert exchange(pair(), "FF FF FD 00 FE 03 00 01 31 42") == f"{PONG_1} {PONG_2}"


def test_p2_read():
    serial_line = pair()
    serial_line.servos[0].stuck["present_position"] = 166
    answer = "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"
    assert exchange(serial_line, "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15") == answer


def test_p2_write():
    serial_line = pair()
    assert exchange(serial_line, "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89") == STATUS_OK
    assert serial_line.servos[0].get("goal_position") == 512


def test_p2_reg_write_and_action():
    serial_line = pair()
    serial_line.servos[0].put("operating_mode", 1)
    assert exchange(serial_line, "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E") == STATUS_OK
    assert serial_line.servos[0].get("goal_velocity") == 0
    assert exchange(serial_line, "FF FF FD 00 01 03 00 05 02 CE") == STATUS_OK
    assert serial_line.servos[0].get("goal_velocity") == 200


def test_p2_factory_reset_is_refused():
    serial_line = pair()
    answer = exchange(serial_line, "FF FF FD 00 01 04 00 06 01 A1 E6")
    assert answer.startswith("FF FF FD 00 01 04 00 55 02")


def test_p2_reboot():
    serial_line = pair()
    serial_line.servos[0].put("torque_enable", 1)
    assert exchange(serial_line, "FF FF FD 00 01 03 00 08 2F 4E") == STATUS_OK
    assert not serial_line.servos[0].enabled
    assert exchange(serial_line, PING) == "", "deaf while it boots"


def test_p2_sync_read():
    serial_line = pair()
    serial_line.servos[0].stuck["present_position"] = 166
    serial_line.servos[1].stuck["present_position"] = 2079
    answer = (
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0 FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"
    )
    assert exchange(serial_line, "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA") == answer


def test_p2_sync_write():
    serial_line = pair()
    request = "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"
    assert exchange(serial_line, request) == ""
    assert [s.get("goal_position") for s in serial_line.servos] == [150, 170]


def test_p2_bulk_read():
    serial_line = pair()
    serial_line.servos[0].supply = 11.9
    serial_line.servos[1].temperature = 36.0
    answer = "FF FF FD 00 01 06 00 55 00 77 00 C3 69 FF FF FD 00 02 05 00 55 00 24 8B A9"
    request = "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05"
    assert exchange(serial_line, request) == answer


def test_p2_bulk_write():
    serial_line = pair()
    request = "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68"
    assert exchange(serial_line, request) == ""
    assert serial_line.servos[0].get("max_voltage_limit") == 160
    assert serial_line.servos[1].get("temperature_limit") == 80


def trio(number=3):
    return line(*(Device("XC330-T288", id) for id in (3, 7, 4)[:number]))


def test_p2_fast_sync_read():
    serial_line = trio()
    for servo, count in zip(serial_line.servos, (166, 2079, 1023), strict=True):
        servo.stuck["present_position"] = count
    answer = (
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 "
        "00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
    )
    assert exchange(serial_line, "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2") == answer


def test_p2_fast_bulk_read():
    serial_line = trio()
    serial_line.servos[0].stuck["present_position"] = 166
    serial_line.servos[1].stuck["present_pwm"] = 421
    serial_line.servos[2].temperature = 31.0
    body = bytes.fromhex("FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00")
    # The manual repeats the CRC of its previous example here; compute the correct one.
    request = (body + crc16(body).to_bytes(2, "little")).hex()
    answer = "FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4 00 07 A5 01 24 74 00 04 1F D9 C1"
    assert exchange(serial_line, request) == answer


def test_p2_clear_is_not_known():
    serial_line = pair()
    answer = exchange(serial_line, "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC")
    assert answer.startswith("FF FF FD 00 01 04 00 55 02")


@pytest.mark.parametrize(
    "body", [b"\xff\xff\xfd", b"\xff\xff\xfd\xfd", b"a\xff\xff\xfdb\xff\xff\xff\xfd", b"\xff\xff"]
)
def test_stuffing_keeps_the_header_out_and_is_undone(body):
    assert b"\xff\xff\xfd" not in stuff(body).replace(b"\xff\xff\xfd\xfd", b"")
    assert unstuff(stuff(body)) == body
