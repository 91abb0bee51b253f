"""Feetech STS3215: Protocol 1.0 framing, its own table and rules."""

from __future__ import annotations

import math

from pliant.emulator.servo import BIT_OVERLOAD, OFF, Drive, Servo

BIT_CURRENT = 0x08
_BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 57_600, 38_400, 19_200)
#: Duty per radian of error per count of P, and the largest duty, from published measurements.
DUTY_PER_P, FULL_DUTY = 0.166, 0.97
#: One count of speed: a step per second with the factory's Phase [rad/s].
STEP = 2.0 * math.pi / 4096
#: Torque Enable value that sets the present position as the middle.
SET_MIDDLE = 128


class StsServo(Servo):
    """A servo that limits its duty by Torque Limit; an overload cuts to the protective torque.

    Its error byte holds only conditions; rejected writes are ignored without an error.
    Assumptions: a write of a goal or of the torque switch ends the overload protection; values out
    of range are ignored, goals beyond the position limits are clipped.
    """

    protocol = 1
    bauds = _BAUDS

    def on_power(self) -> None:
        """Set Torque Limit to its maximum, and the goal to the present position."""
        self._latched, self._over_current, self._overload = 0, 0.0, 0.0
        self.put("torque_limit", self.get("max_torque_limit"))
        self.put("goal_position", self.position)

    @property
    def position(self) -> int:
        """Present position [counts]: raw minus Homing Offset, by default within a turn."""
        raw = round(self.shaft.angle / self.model.count) - self.get("homing_offset")
        return raw if self._multi_turn else raw % 4096

    def raw_of(self, count: float) -> float:
        """Return the raw count; the reported one excludes Homing Offset."""
        return count + self.get("homing_offset")

    @property
    def _multi_turn(self) -> bool:
        free = self.get("min_position_limit") == 0 == self.get("max_position_limit")
        return free or bool(self.get("phase") & 0x10)

    @property
    def level(self) -> int:
        """Return the level: response level 1 answers all; 0 answers reads and pings."""
        return 2 if self.get("response_level") else 1

    def status(self) -> int:
        """Return the conditions: voltage, heat, current, overload."""
        return self.faults() | self._latched

    def check_read(self, address: int, length: int) -> int:
        """Accept every read; addresses beyond the table read as 0."""
        return 0

    def resolve(self, address: int, length: int) -> list[int]:
        """Map bytes beyond the table to its empty last byte."""
        last = self.table.size - 1
        return [min(byte, last) for byte in range(address, address + length)]

    def check_write(self, address: int, data: bytes) -> int:
        """Return -1, an error without a reply, if a block is ignored; else 0."""
        after = bytearray(self.memory)
        after[address : address + len(data)] = data
        for register in self.table.span(address, len(data)):
            value = register.decode(after[register.address : register.address + register.size])
            if not register.writable or not register.low <= value <= register.high:
                return -1
        return 0

    def on_write(self, address: int, data: bytes) -> None:
        """Store EEPROM while unlocked; a goal switches torque on."""
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
        """Return a duty in proportion to the error, up to Torque Limit or the protective torque."""
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
            stiffness=DUTY_PER_P * self.get("p_coefficient") * stall,
            ceiling=stall * min(share, FULL_DUTY),
            speed=speed * STEP if speed else math.inf,
            dead=self.get("cw_dead_zone") * self.model.count,
            slope=self.model.motor.slope,
        )

    def protect(self, seconds: float) -> None:
        """Overload for Protection Time cuts to the protective torque; the rest unloads."""
        if abs(self.duty) * 100.0 > self.get("overload_torque"):
            self._overload += seconds
        else:
            self._overload = 0.0
        if self._overload > self.get("protection_time") * 0.010 and self._overload > 0.0:
            self._latched |= BIT_OVERLOAD
        if abs(self.current) > self.get("protection_current") * self.model.unit:
            self._over_current += seconds
        else:
            self._over_current = 0.0
        if self._over_current > self.get("over_current_protection_time") * 0.010:
            self._latched |= BIT_CURRENT
        if self.status() & self.get("unloading_condition") & ~BIT_OVERLOAD:
            self.put("torque_enable", 0)

    def trip(self, bit: int) -> None:
        """Latch a condition until a goal or the torque switch is written."""
        self._latched |= bit
        self.protect(0.0)

    def refresh(self) -> None:
        """Update position, velocity, load, voltage, temperature, status, current."""
        self.put("present_position", self.position)
        self.put("present_velocity", self.shaft.speed / STEP)
        self.put("present_load", self.duty * 1000.0)
        self.put("present_voltage", self.supply * 10.0)
        self.put("present_temperature", self.temperature)
        self.put("registered", self.registered is not None)
        self.put("status", self.status())
        self.put("moving", abs(self.shaft.speed) > self.get("moving_threshold") * 50 * STEP)
        self.put("present_current", self.current / self.model.unit)
