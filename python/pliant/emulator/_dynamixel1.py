"""Emulation of Dynamixel Protocol 1.0 servos: EX-106+, RX-64, MX-28, MX-64, MX-106."""

from __future__ import annotations

import math

from pliant._core import ConfigError
from pliant.emulator import control_tables as tables
from pliant.emulator.servo import BIT_OVERLOAD, OFF, Drive, Servo

BIT_ANGLE, BIT_RANGE, BIT_INSTRUCTION = 0x02, 0x08, 0x40
#: Motor duty [1] per radian of position error and per unit of the register P Gain, for MX servos;
#: from published oscilloscope measurements.
DUTY_PER_P = 0.158
#: Baud rates that do not follow the formula 2 000 000 / (register + 1), by register value [bit/s].
FAST_BAUDS = {250: 2_250_000, 251: 2_500_000, 252: 3_000_000}


class Dxl1Servo(Servo):
    """Emulated Protocol 1.0 servo; the register Torque Limit bounds the motor duty.

    A shutdown sets Torque Limit to 0; the register Shutdown selects the conditions that cause it.

    Assumptions: writing a goal switches torque on; the EEPROM is locked while torque is on; three
    seconds at the torque limit without motion count as an overload.
    """

    protocol = 1

    def on_power(self) -> None:
        """At power-up, set Torque Limit to Max Torque, and the goal to the present position."""
        self._latched = 0
        self._mx = "p_gain" in self.table
        self._rpm = (0.114 if self._mx else 0.111) * 2.0 * math.pi / 60.0
        self.put("torque_limit", self.get("max_torque"))
        self.put("goal_position", self.position)

    @property
    def position(self) -> int:
        """Return the present position [counts] as the servo reports it.

        Outside multi-turn mode, an MX wraps around after a turn; other models stop at the ends.
        """
        top = self.model.max_position
        raw = round(self.shaft.angle / self.model.count)
        if self._multi_turn:
            return raw
        raw = raw % 4096 if self._mx else max(0, min(raw, top))
        return top - raw if self._reverse else raw

    @property
    def direction(self) -> int:
        """Return -1 in reverse mode, in which reported counts fall as the shaft turns; else 1."""
        return -1 if self._reverse else 1

    def raw_of(self, count: float) -> float:
        """Return the encoder count at which `count` is reported; reverse mode counts downward."""
        return self.model.max_position - count if self._reverse else count

    @property
    def gain_register(self) -> str:
        """Return the register with the P gain, or with the compliance slope of models before MX."""
        return "p_gain" if "p_gain" in self.table else "cw_compliance_slope"

    def model_stiffness(self, gain: int, volts: float) -> float:
        """Return the stiffness [N·m/rad]; a compliance slope is the error at full torque."""
        if "p_gain" in self.table:
            return DUTY_PER_P * gain * self.stall_at(volts)
        return self.stall_at(volts) / (max(gain, 1) * self.model.count)

    @property
    def _reverse(self) -> bool:
        return "drive_mode" in self.table and bool(self.get("drive_mode") & 1)

    @property
    def _multi_turn(self) -> bool:
        return self._mx and self.get("cw_angle_limit") == 4095 == self.get("ccw_angle_limit")

    @property
    def _wheel(self) -> bool:
        return self.get("cw_angle_limit") == 0 == self.get("ccw_angle_limit")

    @property
    def baud(self) -> int:
        """Return the baud rate [bit/s]: 2 000 000 / (register + 1), or one of `FAST_BAUDS`."""
        value = self.get("baud_rate")
        return FAST_BAUDS.get(value, round(2_000_000 / (value + 1)))

    def set_baud(self, baud: int) -> None:
        """Store the value of the register Baud Rate for `baud` [bit/s] in EEPROM.

        Raises:
            ConfigError: No register value gives a rate within 3 %.
        """
        fast = {rate: value for value, rate in FAST_BAUDS.items() if self._mx}
        value = fast.get(baud, round(2_000_000 / baud) - 1)
        self.put("baud_rate", value)
        if not 0 <= value <= 254 or abs(self.baud / baud - 1.0) > 0.03:
            raise ConfigError(f"{self.model.name} cannot do {baud} bit/s")
        self.keep(self.table["baud_rate"].address, 1)

    def status(self) -> int:
        """Return the error bits of the present conditions: voltage, temperature, overload."""
        return self.faults() | self._latched

    def check_read(self, address: int, length: int) -> int:
        """Return 0 if the control table contains all bytes to read, else the range error bit."""
        return 0 if length and address + length <= self.table.size else BIT_RANGE

    def check_write(self, address: int, data: bytes) -> int:
        """Return the error bit of a write, 0 if it is accepted.

        It checks address, access rights, EEPROM lock and range, and for goals the angle limits.
        """
        end = address + len(data)
        if not data or end > self.table.size:
            return BIT_RANGE
        for register in self.table.span(address, len(data)):
            locked = self.get("lock") == 1 or self.enabled
            if not register.writable or (register.area == "eeprom" and locked):
                return BIT_RANGE
            if register.address < address or register.address + register.size > end:
                return BIT_RANGE
            start = register.address - address
            value = register.decode(data[start : start + register.size])
            if not register.low <= value <= register.high:
                return BIT_RANGE
            if register.name == "lock" and value == 0 and self.get("lock") == 1:
                return BIT_RANGE
            if register.name == "goal_position" and not (self._multi_turn or self._wheel):
                low, high = self.get("cw_angle_limit"), self.get("ccw_angle_limit")
                if not low <= value <= high:
                    return BIT_ANGLE
        return 0

    def on_write(self, address: int, data: bytes) -> None:
        """Apply side effects of a write: EEPROM is stored, a goal switches torque on.

        A Torque Limit above 0 ends a shutdown.
        """
        for register in self.table.span(address, len(data)):
            if register.area == "eeprom":
                self.keep(register.address, register.size)
            elif register.name == "torque_limit" and self.get("torque_limit") > 0:
                self._latched, self._overload_time = 0, 0.0
            elif register.name == "goal_position":
                self.put("torque_enable", 1)

    def drive(self) -> Drive:
        """Return the motor request: duty proportional to position error, within Torque Limit."""
        limit = self.get("torque_limit")
        slave = "drive_mode" in self.table and self.get("drive_mode") & 2
        if not self.enabled or not limit or self._wheel or slave or not self.plugged:
            return OFF
        count, stall, speed = self.model.count, self.stall, self.get("moving_speed") & 0x3FF
        dead = 0.0 if self._mx else self.get("cw_compliance_margin") * count
        return Drive(
            goal=self._goal_angle(),
            stiffness=self.stiffness,
            ceiling=stall * limit / 1023.0,
            speed=speed * self._rpm if speed else math.inf,
            dead=dead,
            slope=self.model.motor.slope,
        )

    def _goal_angle(self) -> float:
        goal: float = self.get("goal_position")
        if self._multi_turn:
            return goal * self.model.count
        goal = self.raw_of(goal)
        if self._mx:
            goal += 4096 * (round(self.shaft.angle / self.model.count) // 4096)
        return goal * self.model.count

    def protect(self, seconds: float) -> None:
        """Latch the bit of an overload; conditions that Shutdown enables set Torque Limit to 0.

        `seconds` is the time since the last call [s].
        """
        ceiling = self.stall * self.get("torque_limit") / 1023.0
        if self.is_overloaded(seconds, 0.98 * ceiling):
            self._latched |= BIT_OVERLOAD
        if self.status() & self.get("shutdown"):
            self.put("torque_limit", 0)
        self.put("led", 1 if self.status() & self.get("alarm_led") else self.get("led"))

    def trip(self, bit: int) -> None:
        """Set the error bit `bit`, as if its condition was detected.

        It stays set until Torque Limit is written.
        """
        self._latched |= bit
        self.protect(0.0)

    def refresh(self) -> None:
        """Update the registers of position, speed, load, voltage, temperature and current."""
        self.put("present_position", self.position)
        sign = self.direction
        self.put("present_speed", sign * self.shaft.speed / self._rpm)
        # Bit 10 of the registers load and speed is the sign: it is set in the direction of falling
        # counts.
        self.put("present_load", sign * 1023.0 * self.duty)
        self.put("present_voltage", self.supply * 10.0)
        self.put("present_temperature", self.temperature)
        self.put("registered", self.registered is not None)
        self.put("moving", abs(self.shaft.speed) > MOVING_SPEED)
        amps = sign * self.current
        if self.table is tables.EX106:
            self.put("sensed_current", 512 + amps / self.model.current_unit)
        elif "present_current" in self.table:
            self.put("present_current", 2048 + amps / self.model.current_unit)


#: Speed below which the register Moving reads 0 [rad/s].
MOVING_SPEED = 0.05
