"""Control tables (registers) of the three servo families, from the makers' manuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


Area = Literal["eeprom", "ram"]


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of a control table.

    Attributes:
        name: Snake-case name; common registers have the same name in every family.
        address: Address of the first byte.
        size: Number of bytes, little-endian.
        area: `eeprom` or `ram`.
        writable: True if the host may write the register.
        initial: Value in a new servo.
        low, high: Smallest and largest value that the servo accepts.
        sign: Coding of the sign. None: unsigned; 0: two's complement; else sign and magnitude, and
            this is the number of the sign bit.
    """

    name: str
    address: int
    size: int
    area: Area
    writable: bool
    initial: int
    low: int
    high: int
    sign: int | None

    def decode(self, data: bytes | bytearray) -> int:
        """Return the value that these bytes of the register encode, with its sign."""
        raw = int.from_bytes(data[: self.size], "little")
        if self.sign is None:
            return raw
        if self.sign == 0:
            return raw - (1 << 8 * self.size) if raw >> (8 * self.size - 1) else raw
        bit = 1 << self.sign
        return -(raw & (bit - 1)) if raw & bit else raw & (bit - 1)

    def encode(self, value: int) -> bytes:
        """Return the bytes that encode a value, clipped to what size and sign coding can hold."""
        if self.sign is None:
            raw = max(0, min(value, (1 << 8 * self.size) - 1))
        elif self.sign == 0:
            half = 1 << (8 * self.size - 1)
            raw = max(-half, min(value, half - 1)) % (2 * half)
        else:
            bit = 1 << self.sign
            raw = min(abs(value), bit - 1) | (bit if value < 0 else 0)
        return raw.to_bytes(self.size, "little")


class Table:
    """The control table of one servo model.

    Attributes:
        size: Number of bytes from address 0 to the end of the last register.
    """

    def __init__(self, registers: Iterable[Register]) -> None:
        """Store the registers by name; a later register replaces an earlier one of its name."""
        self._by_name = {register.name: register for register in registers}
        self._at = {
            register.address + k: register
            for register in self._by_name.values()
            for k in range(register.size)
        }
        self.size = max(self._at) + 1

    def __iter__(self) -> Iterator[Register]:
        return iter(self._by_name.values())

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> Register:
        """Return a register by name.

        Raises:
            ConfigError: No register has this name; the message lists the known names.
        """
        try:
            return self._by_name[name]
        except KeyError:
            known = ", ".join(self._by_name)
            raise ConfigError(f"no register {name!r} in this table; there are {known}") from None

    def at(self, address: int) -> Register | None:
        """Return the register that contains the byte at `address`; None between registers."""
        return self._at.get(address)

    def span(self, address: int, length: int) -> list[Register]:
        """Return the registers that overlap `length` bytes from `address` on, in order."""
        registers: list[Register] = []
        for byte in range(address, address + length):
            register = self._at.get(byte)
            if register is not None and (not registers or registers[-1] is not register):
                registers.append(register)
        return registers

    def changed(self, text: str = "", **initial: int) -> Table:
        """Return a copy of the table with registers added or replaced and new initial values.

        Args:
            text: Rows of registers to add or replace, in the format of `parse`.
            **initial: New initial values by register name.
        """
        rows = {**self._by_name, **{register.name: register for register in parse(text)}}
        for name, value in initial.items():
            rows[name] = replace(rows[name], initial=value)
        return Table(rows.values())

    def without(self, *names: str) -> Table:
        """Return a copy of the table without the registers of these names."""
        return Table(register for register in self if register.name not in names)


def parse(text: str) -> list[Register]:
    """Return the registers of rows `address size area access initial range coding name`.

    Area is E (EEPROM) or R (RAM); access is r or rw; range is `low..high`, or `-` for the full
    range of the coding; coding is `u` (unsigned), `t` (two's complement) or `sN` (sign and
    magnitude, sign in bit N).
    """
    return [_row(line.split()) for line in text.strip().splitlines() if line.strip()]


def _row(cells: list[str]) -> Register:
    address, size, area, access, initial, span, coding, name = cells
    bits = 8 * int(size)
    sign = {"u": None, "t": 0}[coding] if coding in {"u", "t"} else int(coding[1:])
    if span == "-":
        high = (1 << (bits if sign is None else bits - 1 if sign == 0 else sign)) - 1
        low = 0 if sign is None else -high - (1 if sign == 0 else 0)
    else:
        low, high = (int(end) for end in span.split(".."))
    return Register(
        name,
        int(address),
        int(size),
        "eeprom" if area == "E" else "ram",
        access == "rw",
        int(initial),
        low,
        high,
        sign,
    )


_P1_COMMON = """
 0 2 E r  0    -        u model_number
 2 1 E r  36   -        u firmware_version
 3 1 E rw 1    0..253   u id
 4 1 E rw 34   0..254   u baud_rate
 5 1 E rw 250  0..254   u return_delay_time
 6 2 E rw 0    0..4095  u cw_angle_limit
 8 2 E rw 4095 0..4095  u ccw_angle_limit
11 1 E rw 80   0..150   u temperature_limit
12 1 E rw 60   50..250  u min_voltage_limit
13 1 E rw 160  50..250  u max_voltage_limit
14 2 E rw 1023 0..1023  u max_torque
16 1 E rw 2    0..2     u status_return_level
17 1 E rw 36   0..127   u alarm_led
18 1 E rw 36   0..127   u shutdown
24 1 R rw 0    0..1     u torque_enable
25 1 R rw 0    0..1     u led
30 2 R rw 0    0..4095  u goal_position
32 2 R rw 0    0..2047  u moving_speed
34 2 R rw 1023 0..1023  u torque_limit
36 2 R r  0    -        u present_position
38 2 R r  0    -        s10 present_speed
40 2 R r  0    -        s10 present_load
42 1 R r  120  -        u present_voltage
43 1 R r  25   -        u present_temperature
44 1 R r  0    -        u registered
46 1 R r  0    -        u moving
47 1 R rw 0    0..1     u lock
48 2 R rw 0    0..1023  u punch
"""

_COMPLIANCE = """
26 1 R rw 1    0..255   u cw_compliance_margin
27 1 R rw 1    0..255   u ccw_compliance_margin
28 1 R rw 32   0..254   u cw_compliance_slope
29 1 R rw 32   0..254   u ccw_compliance_slope
"""

_GAINS = """
20 2 E rw 0    -24576..24576 t multi_turn_offset
22 1 E rw 1    1..4     u resolution_divider
26 1 R rw 0    0..254   u d_gain
27 1 R rw 0    0..254   u i_gain
28 1 R rw 32   0..254   u p_gain
30 2 R rw 0    -28672..28672 t goal_position
36 2 R r  0    -        t present_position
50 2 R r  0    -        u realtime_tick
73 1 R rw 0    0..254   u goal_acceleration
"""

_DRIVE_MODE = "10 1 E rw 0 0..3 u drive_mode\n"

_TORQUE_MODE = """
68 2 R r  2048 -        u present_current
70 1 R rw 0    0..1     u torque_control_mode
71 2 R rw 0    0..2047  u goal_torque
"""

_P1 = Table(parse(_P1_COMMON))

RX64 = _P1.changed(
    _COMPLIANCE
    + """
 6 2 E rw 0    0..1023  u cw_angle_limit
 8 2 E rw 1023 0..1023  u ccw_angle_limit
30 2 R rw 0    0..1023  u goal_position
""",
    max_voltage_limit=190,
    punch=32,
)
EX106 = _P1.changed(
    _COMPLIANCE + _DRIVE_MODE + "56 2 R r 512 - u sensed_current\n", max_voltage_limit=240
)
MX28 = _P1.changed(_GAINS)
MX64 = _P1.changed(_GAINS + _TORQUE_MODE)
MX106 = _P1.changed(_GAINS + _TORQUE_MODE + _DRIVE_MODE)


def _indirect(data: int, count: int, low: int, high: int) -> str:
    """Return the rows of `count` indirect addresses and their data bytes, in the format of `parse`.

    The registers of the addresses start at 168, the data bytes at `data`. The addresses may refer
    to bytes from `low` to `high`.
    """
    rows = [
        f"{168 + 2 * k} 2 R rw {data + k} {low}..{high} u indirect_address_{k + 1}"
        for k in range(count)
    ]
    rows += [f"{data + k} 1 R rw 0 - u indirect_data_{k + 1}" for k in range(count)]
    return "\n".join(rows) + "\n"


_X_COMMON = """
  0 2 E r  0    -        u model_number
  2 4 E r  0    -        u model_information
  6 1 E r  46   -        u firmware_version
  7 1 E rw 1    0..252   u id
  8 1 E rw 1    0..7     u baud_rate
  9 1 E rw 250  0..254   u return_delay_time
 10 1 E rw 0    0..13    u drive_mode
 11 1 E rw 3    0..16    u operating_mode
 12 1 E rw 255  0..255   u secondary_id
 13 1 E rw 2    1..2     u protocol_type
 20 4 E rw 0    -1044479..1044479 t homing_offset
 24 4 E rw 10   0..1023  u moving_threshold
 31 1 E rw 80   0..100   u temperature_limit
 32 2 E rw 160  95..160  u max_voltage_limit
 34 2 E rw 95   95..160  u min_voltage_limit
 36 2 E rw 885  0..885   u pwm_limit
 44 4 E rw 350  0..1023  u velocity_limit
 48 4 E rw 4095 0..4095  u max_position_limit
 52 4 E rw 0    0..4095  u min_position_limit
 60 1 E rw 0    0..3     u startup_configuration
 63 1 E rw 52   0..63    u shutdown
 64 1 R rw 0    0..1     u torque_enable
 65 1 R rw 0    0..1     u led
 68 1 R rw 2    0..2     u status_return_level
 69 1 R r  0    -        u registered
 70 1 R r  0    -        u hardware_error_status
 76 2 R rw 1920 0..16383 u velocity_i_gain
 78 2 R rw 100  0..16383 u velocity_p_gain
 80 2 R rw 0    0..16383 u position_d_gain
 82 2 R rw 0    0..16383 u position_i_gain
 84 2 R rw 800  0..16383 u position_p_gain
 88 2 R rw 0    0..16383 u feedforward_2nd_gain
 90 2 R rw 0    0..16383 u feedforward_1st_gain
 98 1 R rw 0    -1..127  t bus_watchdog
100 2 R rw 885  -885..885 t goal_pwm
104 4 R rw 0    -1023..1023 t goal_velocity
108 4 R rw 0    0..32767 u profile_acceleration
112 4 R rw 0    0..32767 u profile_velocity
116 4 R rw 0    -1048575..1048575 t goal_position
120 2 R r  0    -        u realtime_tick
122 1 R r  0    -        u moving
123 1 R r  0    -        u moving_status
124 2 R r  0    -        t present_pwm
126 2 R r  0    -        t present_current
128 4 R r  0    -        t present_velocity
132 4 R r  0    -        t present_position
136 4 R r  0    -        t velocity_trajectory
140 4 R r  0    -        t position_trajectory
144 2 R r  120  -        u present_input_voltage
146 1 R r  25   -        u present_temperature
"""

_X = Table(parse(_X_COMMON + _indirect(224, 28, 64, 661)))


def _with_current(table: Table, top: int) -> Table:
    """Return a copy of `table` with Current Limit and Goal Current, both at most `top` [counts]."""
    return table.changed(
        f"38 2 E rw {top} 0..{top} u current_limit\n102 2 R rw {top} -{top}..{top} t goal_current\n"
    )


XM430 = _with_current(_X, 1193)
XM540 = _with_current(_X.changed(velocity_limit=128), 2047)
XH430 = _with_current(_X.changed(position_p_gain=900), 648)
XH540 = _with_current(_X.changed(velocity_limit=167), 2047)
MX64_2 = _with_current(_X.changed(position_p_gain=850, velocity_limit=285), 1941)
MX106_2 = _with_current(_X.changed(position_p_gain=850, velocity_limit=210), 2047)

_PRESENT_LOAD = "126 2 R r 0 -1000..1000 t present_load\n"
_NO_CURRENT = _X.without("present_current").changed(_PRESENT_LOAD)
XL430 = _NO_CURRENT.changed(
    "32 2 E rw 140 60..140 u max_voltage_limit\n34 2 E rw 60 60..140 u min_voltage_limit\n",
    temperature_limit=72, velocity_limit=265, position_p_gain=640,
    position_d_gain=4000, velocity_i_gain=1000,
)  # fmt: skip
_XC430 = _NO_CURRENT.changed(
    "32 2 E rw 160 60..160 u max_voltage_limit\n34 2 E rw 60 60..160 u min_voltage_limit\n"
)
XC430_W150 = _XC430.changed(position_p_gain=460, velocity_limit=460)
XC430_W240 = _XC430.changed(position_p_gain=700, velocity_limit=306)
MX28_2 = _NO_CURRENT.changed(position_p_gain=850, velocity_limit=230)

_XL330_ROWS = """
  8 1 E rw 1    0..6     u baud_rate
 13 1 E rw 2    2..22    u protocol_type
 31 1 E rw 70   0..100   u temperature_limit
 32 2 E rw 70   31..70   u max_voltage_limit
 34 2 E rw 35   31..70   u min_voltage_limit
 44 4 E rw 445  0..2047  u velocity_limit
 62 1 E rw 140  1..255   u pwm_slope
104 4 R rw 0    -2047..2047 t goal_velocity
"""
_XL330_BASE = Table(parse(_X_COMMON + _indirect(208, 20, 64, 227) + _XL330_ROWS))
XL330 = _with_current(_XL330_BASE, 1750).changed(
    shutdown=53, position_p_gain=400, velocity_i_gain=1600, velocity_p_gain=180
)
_XC330 = _with_current(_XL330_BASE, 910).changed(
    "32 2 E rw 140 55..140 u max_voltage_limit\n34 2 E rw 55 55..140 u min_voltage_limit\n"
    "62 1 E rw 255 1..255 u pwm_slope\n",
    shutdown=52, position_p_gain=900, velocity_i_gain=1200, velocity_p_gain=40,
)  # fmt: skip
XC330_T181 = _XC330.changed(velocity_limit=510)
XC330_T288 = _XC330.changed(velocity_limit=320)

STS = Table(
    parse("""
 0 1 E r  3    -        u firmware_major
 1 1 E r  10   -        u firmware_minor
 3 2 E r  777  -        u model_number
 5 1 E rw 1    0..253   u id
 6 1 E rw 0    0..7     u baud_rate
 7 1 E rw 0    0..254   u return_delay_time
 8 1 E rw 1    0..1     u response_level
 9 2 E rw 0    0..4095  u min_position_limit
11 2 E rw 4095 0..4095  u max_position_limit
13 1 E rw 70   0..100   u temperature_limit
14 1 E rw 80   0..254   u max_voltage_limit
15 1 E rw 40   0..254   u min_voltage_limit
16 2 E rw 1000 0..1000  u max_torque_limit
18 1 E rw 12   0..254   u phase
19 1 E rw 44   0..254   u unloading_condition
20 1 E rw 47   0..254   u led_alarm_condition
21 1 E rw 32   0..254   u p_coefficient
22 1 E rw 32   0..254   u d_coefficient
23 1 E rw 0    0..254   u i_coefficient
24 2 E rw 16   0..1000  u minimum_startup_force
26 1 E rw 1    0..32    u cw_dead_zone
27 1 E rw 1    0..32    u ccw_dead_zone
28 2 E rw 500  0..511   u protection_current
30 1 E rw 1    1..3     u angular_resolution
31 2 E rw 0    -2047..2047 s11 homing_offset
33 1 E rw 0    0..3     u operating_mode
34 1 E rw 20   0..100   u protective_torque
35 1 E rw 200  0..254   u protection_time
36 1 E rw 80   0..100   u overload_torque
37 1 E rw 10   0..100   u velocity_p_coefficient
38 1 E rw 200  0..254   u over_current_protection_time
39 1 E rw 10   0..254   u velocity_i_coefficient
40 1 R rw 0    0..128   u torque_enable
41 1 R rw 0    0..254   u acceleration
42 2 R rw 0    -32766..32766 s15 goal_position
44 2 R rw 0    0..9999  u goal_time
46 2 R rw 0    -32766..32766 s15 goal_velocity
48 2 R rw 1000 0..1000  u torque_limit
55 1 R rw 1    0..1     u lock
56 2 R r  0    -        s15 present_position
58 2 R r  0    -        s15 present_velocity
60 2 R r  0    -        s10 present_load
62 1 R r  74   -        u present_voltage
63 1 R r  25   -        u present_temperature
64 1 R r  0    -        u registered
65 1 R r  0    -        u status
66 1 R r  0    -        u moving
69 2 R r  0    -        s15 present_current
80 1 R rw 1    -        u moving_threshold
84 1 R rw 80   -        u maximum_velocity
85 1 R rw 254  -        u maximum_acceleration
""")
)
