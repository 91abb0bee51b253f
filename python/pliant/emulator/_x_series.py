"""Emulation of the Dynamixel X series and of MX(2.0) servos, Protocol 2.0."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

from pliant.emulator.servo import BIT_OVERLOAD, OFF, Drive, Servo

if TYPE_CHECKING:
    from pliant.emulator.control_tables import Table

FAIL, INSTRUCTION, CRC, RANGE, LENGTH, LIMIT, ACCESS = range(1, 8)
ALERT = 0x80
_BAUDS = (9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
#: Motor output [counts of PWM or current] per radian of position error and per unit of the register
#: Position P Gain, which the servo divides by 128.
OUTPUT_PER_P = 4096 / (2.0 * math.pi) / 128.0
#: Value of the PWM registers at full duty.
FULL_PWM = 885
_RPM = 0.229 * 2.0 * math.pi / 60.0
_GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
_GAINS = ("position_p_gain", "position_i_gain", "position_d_gain", "velocity_p_gain",
          "velocity_i_gain", "feedforward_1st_gain", "feedforward_2nd_gain")  # fmt: skip


@cache
def indirections(table: Table) -> dict[int, str]:
    """Return the register with the address that an indirect data byte refers to, by its address."""
    return {
        byte: f"indirect_address_{register.name[14:]}"
        for register in table
        if register.name.startswith("indirect_data_")
        for byte in range(register.address, register.address + register.size)
    }


class XServo(Servo):
    """Emulated X-series servo; it limits current (operating mode 5) or duty (other modes).

    A shutdown lasts until reboot; the register Shutdown selects the conditions that cause it.

    Velocity, current and PWM modes accept their registers but do not drive the motor. Assumptions:
    a goal written with torque off is kept, and the servo moves to it at torque-on; three seconds at
    standstill with the torque at its limit count as an overload.
    """

    protocol = 2
    bauds = _BAUDS

    def on_power(self) -> None:
        """At power-up, set Goal Position to the present position, other goals to their limits."""
        self._shut_down = False
        self._last_instruction = self.now
        self._reset_turns()
        self._reset_mode()
        if self.get("startup_configuration") & 1:
            self.put("torque_enable", 1)

    def _reset_turns(self) -> None:
        """Reset the turn counter, so that the position count is within one turn.

        Called at power-up, and in position mode when the mode or torque enable is written.
        """
        self._turns = -math.floor(self.shaft.angle / self.model.count / 4096 + 1e-9)

    def _reset_mode(self) -> None:
        for name in (*_GAINS, "profile_acceleration", "profile_velocity"):
            self.put(name, self.table[name].initial)
        self.put("goal_pwm", self.get("pwm_limit"))
        if self._has_current_sensor:
            self.put("goal_current", self.get("current_limit"))
        self.put("goal_position", self.position)

    @property
    def _has_current_sensor(self) -> bool:
        return "goal_current" in self.table

    @property
    def direction(self) -> int:
        """Return -1 in reverse mode, in which reported counts fall as the shaft turns; else 1."""
        return -1 if self.get("drive_mode") & 1 else 1

    def raw_of(self, count: float) -> float:
        """Return the encoder count at which `count` is reported.

        The servo reports the encoder count, inverted in reverse mode, plus Homing Offset.
        """
        raw = count - self.get("homing_offset")
        return raw if self.direction > 0 else 4096 - raw

    @property
    def gain_register(self) -> str:
        """Return the name of the register with the P gain of the position loop."""
        return "position_p_gain"

    def model_stiffness(self, gain: int, volts: float) -> float:
        """Return the stiffness [N·m/rad]: mode 5 sets the current, other modes set the duty."""
        output = OUTPUT_PER_P * gain
        if self.get("operating_mode") == CURRENT_POSITION:
            return output * self._torque_per_count
        return output * self.stall_at(volts) / FULL_PWM

    @property
    def _torque_per_count(self) -> float:
        """Torque of one count of the current registers [N·m]."""
        return self.model.current_unit * self.model.motor.torque_per_amp

    @property
    def position(self) -> int:
        """Return the reported present position [counts], multi-turn, including Homing Offset."""
        raw = round(self.shaft.angle / self.model.count) + 4096 * self._turns
        return (raw if self.direction > 0 else 4096 - raw) + self.get("homing_offset")

    def on_instruction(self) -> None:
        """Restart the time of the bus watchdog, because an instruction packet is on the bus."""
        self._last_instruction = self.now

    def status(self) -> int:
        """Return the alert bit if the register Hardware Error Status is not 0, else 0."""
        return ALERT if self.get("hardware_error_status") else 0

    def resolve(self, address: int, length: int) -> list[int]:
        """Return the address of each byte; for an indirect data byte, the address it refers to."""
        addresses, last = range(address, address + length), self.table.size - 1
        pointers = indirections(self.table)
        if not pointers.keys().isdisjoint(addresses):
            targets = [self.get(pointers[b]) if b in pointers else b for b in addresses]
            pairs = zip(targets, addresses, strict=True)
            return [min(to if self.table.at(to) else byte, last) for to, byte in pairs]
        return [min(byte, last) for byte in addresses]

    def check_read(self, address: int, length: int) -> int:
        """Return 0, or the access error for bytes beyond the table; gaps in it read as 0."""
        return 0 if length and address + length <= self.table.size else ACCESS

    def check_write(self, address: int, data: bytes) -> int:
        """Return the first error of a write, 0 if it is accepted.

        For each register, the checks are access, length, range and limits, in this order.
        """
        end = address + len(data)
        if any(self.table.at(byte) is None for byte in range(address, end)):
            return ACCESS
        for register in self.table.span(address, len(data)):
            if not register.writable or (register.area == "eeprom" and self.enabled):
                return ACCESS
            if register.address < address or register.address + register.size > end:
                return LENGTH
            start = register.address - address
            value = register.decode(data[start : start + register.size])
            if not register.low <= value <= register.high or not self._allowed(
                register.name, value
            ):
                return RANGE
            if not self._within_limits(register.name, value):
                return LIMIT
        return 0

    def _allowed(self, name: str, value: int) -> bool:
        if name == "operating_mode":
            modes = {VELOCITY, POSITION, EXTENDED, PWM}
            return value in (
                modes | {CURRENT, CURRENT_POSITION} if self._has_current_sensor else modes
            )
        if name == "bus_watchdog":
            return value >= 0
        return not (name in _GOALS and self.get("bus_watchdog") == -1)

    def _within_limits(self, name: str, value: int) -> bool:
        if name == "goal_pwm":
            return abs(value) <= self.get("pwm_limit")
        if name == "goal_current":
            return abs(value) <= self.get("current_limit")
        if name == "goal_velocity":
            return abs(value) <= self.get("velocity_limit")
        if name == "goal_position" and self.get("operating_mode") == POSITION:
            return self.get("min_position_limit") <= value <= self.get("max_position_limit")
        return True

    def on_write(self, address: int, data: bytes) -> None:
        """Apply side effects of a write: EEPROM is stored, a new mode resets goals and gains.

        A write of Torque Enable has no effect after a shutdown.
        """
        for register in self.table.span(address, len(data)):
            if register.area == "eeprom":
                self.keep(register.address, register.size)
            switched = register.name in {"operating_mode", "torque_enable"}
            if switched and self.get("operating_mode") == POSITION:
                self._reset_turns()
            if register.name == "operating_mode":
                self._reset_mode()
            elif register.name == "torque_enable" and self._shut_down:
                self.put("torque_enable", 0)
            elif (
                register.name == "goal_position"
                and self.get("drive_mode") & 8
                and not self._shut_down
            ):
                self.put("torque_enable", 1)

    def drive(self) -> Drive:
        """Return the motor request: current (mode 5) or duty proportional to the position error.

        Goal PWM, and in mode 5 also Goal Current, limit the torque.
        """
        mode = self.get("operating_mode")
        if not self.enabled or not self.plugged or mode not in {POSITION, EXTENDED,
                                                                CURRENT_POSITION}:  # fmt: skip
            return OFF
        motor, stiffness = self.model.motor, self.stiffness
        ceiling = self.stall * abs(self.get("goal_pwm")) / FULL_PWM
        profile = self.get("profile_velocity")
        speed = profile * _RPM if profile and not self.get("drive_mode") & 4 else math.inf
        goal = self.raw_of(self.get("goal_position")) - 4096 * self._turns
        angle = goal * self.model.count
        if mode != CURRENT_POSITION:
            return Drive(angle, stiffness, ceiling, speed, slope=motor.slope)
        limit = abs(self.get("goal_current")) * self._torque_per_count
        inertia = motor.inertia + self.load.inertia
        # ROBOTIS does not publish the damping of the current loop: assume a damping ratio of 0.7,
        # which avoids oscillation.
        kv = 1.4 * math.sqrt(stiffness * inertia)
        return Drive(angle, stiffness, min(limit, ceiling), speed, kv=kv)

    def protect(self, seconds: float) -> None:
        """Stop at the present position if the bus watchdog expired; pass errors to `trip`.

        `seconds` is the time since the last call [s].
        """
        watchdog = self.get("bus_watchdog")
        if watchdog > 0 and self.enabled and self.now - self._last_instruction > watchdog * 0.020:
            self.put("bus_watchdog", -1)
            self.put("goal_position", self.position)
        bits = self.faults()
        if self.is_overloaded(seconds, 0.98 * self.drive().ceiling):
            bits |= BIT_OVERLOAD
        if bits:
            self.trip(bits)

    def trip(self, bit: int) -> None:
        """Set bits of Hardware Error Status; bits enabled in Shutdown end torque until reboot."""
        self.put("hardware_error_status", self.get("hardware_error_status") | bit)
        if self.get("hardware_error_status") & self.get("shutdown"):
            self._shut_down = True
            self.put("torque_enable", 0)
            self.put("led", 1)

    def refresh(self) -> None:
        """Write the state of shaft, supply and temperature to the registers of present values."""
        sign = self.direction
        self.put("present_position", self.position)
        self.put("position_trajectory", self.position)
        self.put("present_velocity", sign * self.shaft.speed / _RPM)
        self.put("present_pwm", sign * self.duty * FULL_PWM)
        if self._has_current_sensor:
            self.put("present_current", sign * self.current / self.model.current_unit)
        else:
            self.put("present_load", sign * self.duty * 1000.0)
        self.put("present_input_voltage", self.supply * 10.0)
        self.put("present_temperature", self.temperature)
        self.put("registered", self.registered is not None)
        self.put("moving", abs(self.shaft.speed) > self.get("moving_threshold") * _RPM)
        self.put("realtime_tick", self.now * 1000.0 % 32768)
