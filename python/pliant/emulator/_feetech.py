"""Emulation of the Feetech STS3215: packets of Protocol 1.0, Feetech's control table and rules."""

from __future__ import annotations

import math

from pliant.emulator.servo import BIT_OVERLOAD, OFF, Drive, Servo

BIT_CURRENT = 0x08
_BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 57_600, 38_400, 19_200)
#: Motor duty [1] per radian of position error and per unit of P gain, and largest duty [1], from
#: published measurements.
DUTY_PER_P, FULL_DUTY = 0.166, 0.97
#: Unit of the speed registers [rad/s]: one encoder step per second, with the factory value of the
#: register Phase.
STEP = 2.0 * math.pi / 4096
#: Value of Torque Enable that sets Homing Offset so that the present position reads 2048.
SET_MIDDLE = 128


class StsServo(Servo):
    """Emulated STS servo: Torque Limit bounds the motor duty, and an overload lowers this bound.

    The error byte of a reply reports only conditions such as overheating. A write that the servo
    rejects has no effect and gives no error. Assumptions: writing a goal or Torque Enable ends the
    overload protection; values out of range are rejected, goals beyond the position limits clipped.
    """

    protocol = 1
    bauds = _BAUDS

    def on_power(self) -> None:
        """At power-up, set Torque Limit to its maximum, and the goal to the present position."""
        self._latched, self._over_current, self._overload = 0, 0.0, 0.0
        self.put("torque_limit", self.get("max_torque_limit"))
        self.put("goal_position", self.position)

    @property
    def position(self) -> int:
        """Return the present position [counts]: encoder count minus Homing Offset.

        Outside multi-turn mode the position wraps to 0 to 4095.
        """
        raw = round(self.shaft.angle / self.model.count) - self.get("homing_offset")
        return raw if self._multi_turn else raw % 4096

    def raw_of(self, count: float) -> float:
        """Return the encoder count at which `count` is reported: `count` plus Homing Offset."""
        return count + self.get("homing_offset")

    @property
    def gain_register(self) -> str:
        """Return the name of the register with the P gain."""
        return "p_coefficient"

    def model_stiffness(self, gain: int, volts: float) -> float:
        """Return the stiffness [N·m/rad]: the duty is proportional to gain and position error."""
        return DUTY_PER_P * gain * self.stall_at(volts)

    @property
    def _multi_turn(self) -> bool:
        free = self.get("min_position_limit") == 0 == self.get("max_position_limit")
        return free or bool(self.get("phase") & 0x10)

    @property
    def level(self) -> int:
        """Return the reply level: 2 if all instructions are answered, 1 if only reads and pings."""
        return 2 if self.get("response_level") else 1

    def status(self) -> int:
        """Return the error bits of the present conditions: voltage, heat, current, overload."""
        return self.faults() | self._latched

    def check_read(self, address: int, length: int) -> int:
        """Return 0: every read is accepted; `resolve` handles addresses beyond the table."""
        return 0

    def resolve(self, address: int, length: int) -> list[int]:
        """Return the table address of each of `length` bytes from `address` on.

        An address beyond the table gives the last byte of the table, which is unused.
        """
        last = self.table.size - 1
        return [min(byte, last) for byte in range(address, address + length)]

    def check_write(self, address: int, data: bytes) -> int:
        """Return 0 if the written block is accepted; -1 if it is ignored without an error reply."""
        after = bytearray(self.memory)
        after[address : address + len(data)] = data
        for register in self.table.span(address, len(data)):
            value = register.decode(after[register.address : register.address + register.size])
            if not register.writable or not register.low <= value <= register.high:
                return -1
        return 0

    def on_write(self, address: int, data: bytes) -> None:
        """Apply side effects of a write: a goal switches torque on, unlocked EEPROM is stored."""
        for register in self.table.span(address, len(data)):
            if register.area == "eeprom" and self.get("lock") == 0:
                self.keep(register.address, register.size)
            if register.name == "goal_position":
                self._cut_goal()
                self.put("torque_enable", 1)
            if register.name in {"goal_position", "torque_enable"}:
                self._latched, self._overload, self._over_current = 0, 0.0, 0.0
            if register.name == "torque_enable" and self.get("torque_enable") == SET_MIDDLE:
                raw = round(self.shaft.angle / self.model.count)
                self.put("homing_offset", (raw - 2048 + 2048) % 4096 - 2048)
                self.put("torque_enable", 0)

    def _cut_goal(self) -> None:
        low, high = self.get("min_position_limit"), self.get("max_position_limit")
        if not self._multi_turn:
            self.put("goal_position", max(low, min(self.get("goal_position"), high)))

    def drive(self) -> Drive:
        """Return the motor request: duty proportional to the position error, bounded.

        The bound is Torque Limit, or Protective Torque after an overload if that is smaller.
        """
        if not self.enabled or not self.plugged or self.get("operating_mode") != 0:
            return OFF
        stall, share = self.stall, self.get("torque_limit") / 1000.0
        if self._latched & BIT_OVERLOAD:
            share = min(share, self.get("protective_torque") / 100.0)
        goal = self.raw_of(self.get("goal_position"))
        if not self._multi_turn:
            raw = round(self.shaft.angle / self.model.count) - self.get("homing_offset")
            goal += raw // 4096 * 4096
        speed = abs(self.get("goal_velocity"))
        return Drive(
            goal=goal * self.model.count,
            stiffness=self.stiffness,
            ceiling=stall * min(share, FULL_DUTY),
            speed=speed * STEP if speed else math.inf,
            dead=self.get("cw_dead_zone") * self.model.count,
            slope=self.model.motor.slope,
        )

    def protect(self, seconds: float) -> None:
        """Latch the bits of overload and over-current after their protection times.

        Conditions that the register Unloading Condition enables switch torque off; only the
        overload lowers the torque limit instead, see `drive`. `seconds` is the time since the last
        call [s].
        """
        if abs(self.duty) * 100.0 > self.get("overload_torque"):
            self._overload += seconds
        else:
            self._overload = 0.0
        if self._overload > self.get("protection_time") * 0.010 and self._overload > 0.0:
            self._latched |= BIT_OVERLOAD
        if abs(self.current) > self.get("protection_current") * self.model.current_unit:
            self._over_current += seconds
        else:
            self._over_current = 0.0
        if self._over_current > self.get("over_current_protection_time") * 0.010:
            self._latched |= BIT_CURRENT
        if self.status() & self.get("unloading_condition") & ~BIT_OVERLOAD:
            self.put("torque_enable", 0)

    def trip(self, bit: int) -> None:
        """Set the error bit `bit`, as if its condition was detected.

        It stays set until a goal or Torque Enable is written.
        """
        self._latched |= bit
        self.protect(0.0)

    def refresh(self) -> None:
        """Write the present values and states of the servo to its registers."""
        self.put("present_position", self.position)
        self.put("present_velocity", self.shaft.speed / STEP)
        self.put("present_load", self.duty * 1000.0)
        self.put("present_voltage", self.supply * 10.0)
        self.put("present_temperature", self.temperature)
        self.put("registered", self.registered is not None)
        self.put("status", self.status())
        self.put("moving", abs(self.shaft.speed) > self.get("moving_threshold") * 50 * STEP)
        self.put("present_current", self.current / self.model.current_unit)
