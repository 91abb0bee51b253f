"""Conversion between joint units (rad, N·m, rad/s) and servo registers.

One torque-limit model serves all families. A duty limit bounds the PWM, hence the torque *at
stall*: ``register = full · (τ + τ_offset) / τ_stall(V)``. Because of the back-EMF, a motor that
moves in the direction of its torque exerts less, and a motor that is pushed backwards exerts more.
A current limit bounds the current: ``register = (τ + τ_offset) / k_t / A_per_count`` with the
secant ``k_t = τ_stall / I_stall``. Both round down, so that no limit exceeds the requested one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import floor, pi
from typing import TYPE_CHECKING

from pliant._core import ConfigError

if TYPE_CHECKING:
    from pliant.servo.models import ServoModel
    from pliant.servo.spec import ServoSpec

RPM = 2.0 * pi / 60.0  # [rad/s]


def at_voltage(table: tuple[tuple[float, float], ...], voltage: float) -> float:
    """Return the value of a table ((V, value), ...) at a voltage.

    Interpolation is linear between the entries. Outside, the value is proportional to the voltage,
    as are stall torque and no-load speed of a motor.
    """
    for (v0, y0), (v1, y1) in pairwise(table):
        if v0 <= voltage <= v1:
            return y0 + (y1 - y0) * (voltage - v0) / (v1 - v0)
    v, y = table[0] if voltage < table[0][0] else table[-1]
    return y * voltage / v


@dataclass(frozen=True)
class Units:
    """Conversions of one joint and one of its servos, at one supply voltage.

    Attributes:
        spec: Joint and servo.
        voltage: Supply voltage [V].
        zero: Count of the servo at q = 0.
        sign: +1 if its counts rise with the joint angle, else -1.
    """

    spec: ServoSpec
    voltage: float
    zero: float
    sign: int

    @staticmethod
    def of(spec: ServoSpec, voltage: float | None = None) -> Units:
        """Create the units of the first servo at a voltage, by default the rated one.

        Raises:
            ConfigError: The voltage is not above 0.
        """
        volts = spec.row.rated if voltage is None else float(voltage)
        if not volts > 0.0:
            raise ConfigError(f"{spec.name}: the supply voltage must be above 0 V, got {volts!r}")
        zero = (spec.row.counts + 1) / 2 if spec.zero is None else float(spec.zero)
        return Units(spec, volts, zero, spec.sign)

    @cached_property
    def row(self) -> ServoModel:
        """Row of the model in the servo table."""
        return self.spec.row

    @cached_property
    def count(self) -> float:
        """Joint angle of one encoder count [rad]."""
        return 2.0 * pi / (self.row.resolution * self.spec.gear)

    @cached_property
    def _stall(self) -> float:
        """Stall torque of one servo at its horn [N·m]."""
        torque = at_voltage(self.row.stall, self.voltage)
        if self.spec.stall is not None:
            torque *= self.spec.stall / at_voltage(self.row.stall, self.row.rated)
        return torque

    @cached_property
    def _share(self) -> float:
        """Joint torque per torque of one servo: gear ratio times number of servos."""
        return self.spec.gear * len(self.spec.servos)

    @cached_property
    def no_load_speed(self) -> float:
        """Joint speed at no load [rad/s]."""
        return at_voltage(self.row.no_load, self.voltage) * RPM / self.spec.gear

    @cached_property
    def full(self) -> int:
        """Largest value of the limit register."""
        return self.row.current_max if self.row.kind == "current" else self.row.family.full_duty

    @cached_property
    def torque_per_unit(self) -> float:
        """Joint torque of one unit of the limit register [N·m]."""
        if self.row.kind == "current":
            rated = at_voltage(self.row.stall, self.row.rated)
            constant = (self.spec.stall or rated) / self.row.stall_current  # [N·m/A]
            return constant * self.row.current_unit * self._share
        return self._stall / self.row.family.full_duty * self._share

    def torque(self, register: int) -> float:
        """Return the joint torque of a limit register [N·m]; signed for load and current."""
        size = abs(register) * self.torque_per_unit - self.spec.torque_offset
        return max(size, 0.0) * (1 if register >= 0 else -1)

    def register(self, torque: float, ceiling: int | None = None) -> int:
        """Return the limit register of a joint torque, rounded down, from 0 to the ceiling.

        Args:
            torque: Joint torque, at least 0 [N·m].
            ceiling: Largest register value allowed; default: the model's.
        """
        most = self.full if ceiling is None else min(ceiling, self.full)
        if torque <= 0.0:
            return 0
        # Add a rounding tolerance, so that a result of `torque` converts back to the same count.
        counts = (torque + self.spec.torque_offset) / self.torque_per_unit
        return max(0, min(floor(counts * (1.0 + 1e-12) + 1e-9), most))

    def load(self, register: int) -> float:
        """Return the joint torque of a load register, positive toward rising counts [N·m]."""
        share = register / self.row.family.full_load
        return share * self._stall * self._share

    def usable(self, ceiling: int) -> float:
        """Return the joint torque at a ceiling, at most the stall torque [N·m]."""
        return min(self.torque(min(ceiling, self.full)), self._stall * self._share)

    def angle(self, counts: float) -> float:
        """Return the joint angle of a servo position [rad]."""
        return self.sign * (counts - self.zero) * self.count

    def counts(self, angle: float) -> int:
        """Return the servo position at a joint angle, rounded, not clamped."""
        return round(self.zero + self.sign * angle / self.count)

    def velocity(self, register: int) -> float:
        """Return the joint velocity of a speed register [rad/s]."""
        return self.sign * register * self.row.speed_unit * RPM / self.spec.gear

    def speed_register(self, speed: float) -> int:
        """Return the speed cap register of a joint speed: at least 1, because 0 means no cap."""
        counts = abs(speed) * self.spec.gear / (self.row.speed_unit * RPM)
        return max(1, min(floor(counts), self.row.family.speed_max))

    def stiffness(self, gain: int) -> float:
        """Return k_p of the joint from the gain register [N·m/rad].

        ``k_p = τ_stall · (duty per radian of error)``. A current-limited servo in mode 5 converts
        position error into current: P/128 current counts per position count. These are initial
        values: the sources agree within a factor of two (docs/ports.md).
        """
        row, gear = self.row, self.spec.gear
        if row.kind == "current":
            return gain / 128.0 * self.torque_per_unit / self.count
        if row.gain == 0.0:  # a slope [counts] over which the torque rises to full
            return self._stall * self._share / (max(gain, 1) * self.count)
        return self._stall * self._share * row.gain * gain * gear
