"""Assignment of servos to joints, and the conversion between joint units and registers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import floor, pi
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, Servos
from pliant._validation import real
from pliant.servo.models import by_number, get_model

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

    from pliant._typing import Array
    from pliant.servo.models import ServoModel


@dataclass(frozen=True)
class Calibration:
    """Entry of one servo in a LeRobot calibration file.

    Attributes:
        id: Servo id.
        drive_mode: 1 if LeRobot inverts normalised values. For Dynamixel servos, 1 also reverses
            the counts.
        homing_offset: Offset that the servo adds to (Dynamixel) or subtracts from (Feetech) its
            encoder count [counts].
        range_min, range_max: Positions that the servo reports at the ends of the travel [counts].
    """

    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

    @property
    def middle(self) -> float:
        """Position at LeRobot's zero angle, the middle of the travel [counts]."""
        return (self.range_min + self.range_max) / 2.0

    def check_range(self, joint: str, row: ServoModel) -> None:
        """Check that the ends of the travel are valid positions of the servo.

        Raises:
            ConfigError: An end of the travel is outside the counts of the servo's encoder. For a
                multi-turn servo, one turn beyond either end of the encoder is allowed.
        """
        margin = row.max_position + 1 if row.family.multi_turn else 0
        low, high = -margin, row.max_position + margin
        for key in ("range_min", "range_max"):
            if not low <= getattr(self, key) <= high:
                is_small = max(abs(self.range_min), abs(self.range_max)) <= 360
                hint = ", or its range is in degrees instead of counts" if is_small else ""
                raise ConfigError(
                    f"{joint}.{key} is {getattr(self, key)}, and positions of {row.name} run from "
                    f"{low} to {high}: the calibration is of another servo, or was changed by hand"
                    f"{hint}"
                )

    def registers(self, known: Container[str]) -> dict[str, int]:
        """Return, by register name, the values that LeRobot writes from its calibration file.

        At each connection LeRobot compares these registers with the file. `known` are the names of
        the servo's registers; others are omitted, e.g. Drive Mode, which Feetech servos lack.
        """
        written = {
            "homing_offset": self.homing_offset,
            "position_min": self.range_min,
            "position_max": self.range_max,
            "drive_mode": self.drive_mode,
        }
        return {name: value for name, value in written.items() if name in known}


@dataclass(frozen=True, kw_only=True)
class ServoSpec:
    """One joint and its servo.

    ``count = zero + sign · gear_ratio · q · resolution / 2π``, with joint angle q [rad] and encoder
    counts per turn `resolution`.

    Attributes:
        name: Joint name.
        model: Servo model, as `pliant.servo.list_models()` lists them.
        model_number: Register Model Number of a servo that is not in the table of models, but has
            the control table of `model`; None: the number of `model`.
        no_load: No-load speed at the rated voltage [rpm]; None: the value of the model.
        voltage: Lowest and highest supply voltage [V]; None: those of the model.
        id: Id on the bus.
        port: Serial port, e.g. ``/dev/ttyUSB0``.
        sign: +1 if counts rise with the joint angle, else -1.
        zero: Encoder count at joint angle 0, not necessarily whole, at most one joint turn outside
            the encoder's range; None: the middle of the servo's range.
        gear_ratio: Turns of the servo per turn of the joint, above 0.
        secondary: Id and sign of a second servo on the same joint. The zero of that servo is
            computed at open from the first servo, because the joint couples both.
        lower, upper: Software position limits [rad]; None: the limits in the servo's registers.
        stall: Stall torque at the rated voltage [N·m]; None: the value of the model.
        torque_offset: Torque lost in the gears [N·m]: joint torque is limit register times torque
            per unit, minus this.
        kp: Identified joint stiffness [N·m/rad]; None: it is computed from the gain register.
        gain: Gain register with which `kp` was identified; `kp` is scaled in proportion to the
            servo's register. None: `kp` is valid for the present gain.
        friction: Identified dry friction [N·m]; None: the value of the model.
        damping: Identified viscous damping of the gears [N·m·s/rad]; None: the value of the model.
        calibration: LeRobot's calibration of this joint; checked against the servo at open.

    Raises:
        ConfigError: A value is out of range, or the model is unknown.
    """

    name: str
    model: str
    id: int
    port: str
    sign: int = 1
    zero: float | None = None
    gear_ratio: float = 1.0
    secondary: tuple[int, int] | None = None
    lower: float | None = None
    upper: float | None = None
    stall: float | None = None
    torque_offset: float = 0.0
    kp: float | None = None
    gain: int | None = None
    friction: float | None = None
    damping: float | None = None
    calibration: Calibration | None = None
    model_number: int | None = None
    no_load: float | None = None
    voltage: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        row = self.row
        highest = 253 if row.family.protocol == "p1" else 252
        ids, signs = map(list, zip(*self.servos, strict=True))
        for number in ids:
            if not 0 <= number <= highest:
                raise ConfigError(f"{self.name}: id {number} is outside 0..{highest}")
        if len(set(ids)) < len(ids):
            raise ConfigError(
                f"{self.name}: the secondary has the id of the first servo, {self.id}"
            )
        if any(sign not in {-1, 1} for sign in signs):
            raise ConfigError(f"{self.name}: a sign is +1 or -1, got {signs}")
        if self.zero is not None:
            self._check_zero(self.zero)
        units = {"gear_ratio": "", "stall": " N·m", "kp": " N·m/rad", "no_load": " rpm"}
        for what, unit in units.items():
            value = getattr(self, what)
            if value is not None and not 0.0 < value < np.inf:
                raise ConfigError(f"{self.name}: {what} must be above 0{unit}, got {value!r}")
        for what in ("torque_offset", "friction", "damping"):
            value = getattr(self, what)
            if value is not None and not 0.0 <= value < np.inf:
                raise ConfigError(f"{self.name}: {what} is at least 0, got {value!r}")
        bounds = [b for b in (self.lower, self.upper) if b is not None]
        if not np.isfinite(bounds).all() or (len(bounds) == 2 and bounds[0] >= bounds[1]):
            raise ConfigError(f"{self.name}: lower must be below upper [rad], got {bounds}")
        known = [] if self.model_number is None else by_number(self.model_number)
        if known and row.name not in [model.name for model in known]:
            raise ConfigError(
                f"{self.name}: model_number {self.model_number} is that of {known[0].name}, not of "
                f"a servo that the package does not know: model = {known[0].name!r}"
            )
        low, high = row.voltage
        if not (np.isfinite(low) and 0.0 < low < high < np.inf):
            raise ConfigError(f"{self.name}: voltage is lowest and highest [V], got {row.voltage}")

    def _check_zero(self, zero: float) -> None:
        """Raise `ConfigError` if `zero` is more than one joint turn outside the encoder's range."""
        turn = self.row.counts_per_turn * max(self.gear_ratio, 1.0)
        low, high = -turn, self.row.max_position + turn
        if not low <= zero <= high:
            raise ConfigError(
                f"{self.name}: zero is a count of {self.row.name} from {low:.0f} to {high:.0f} "
                f"(0 to {self.row.max_position}, and a turn of the joint at either end), got "
                f"{zero!r}"
            )

    @cached_property
    def row(self) -> ServoModel:
        """Data of the servo model; values in this spec replace the values of the table."""
        row = get_model(self.model)
        if all(value is None for value in (self.model_number, self.no_load, self.voltage)):
            return row
        return replace(
            row,
            model_number=row.model_number if self.model_number is None else self.model_number,
            no_load=row.no_load if self.no_load is None else ((row.rated, self.no_load),),
            voltage=row.voltage if self.voltage is None else self.voltage,
        )

    @property
    def servos(self) -> tuple[tuple[int, int], ...]:
        """Id and sign of each servo of the joint."""
        first = ((self.id, self.sign),)
        return first if self.secondary is None else (*first, self.secondary)


def check_specs(specs: Iterable[ServoSpec]) -> tuple[ServoSpec, ...]:
    """Check conditions across joints (unique names and ids, one protocol per port); return specs.

    Raises:
        ConfigError: There are no specs, names or ids repeat, or Dynamixel 1.0 and 2.0 share a port.
    """
    specs = tuple(specs)
    if not specs:
        raise ConfigError("a chain needs at least one servo")
    owners: dict[tuple[str, int], str] = {}
    protocols: dict[str, tuple[str, str]] = {}
    names = [spec.name for spec in specs]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"two joints are named {name!r}")
    for spec in specs:
        for number, _ in spec.servos:
            if (other := owners.get((spec.port, number))) is not None:
                raise ConfigError(f"{other} and {spec.name} both have id {number} on {spec.port}")
            owners[spec.port, number] = spec.name
        protocol = spec.row.family.protocol
        first, joint = protocols.setdefault(spec.port, (protocol, spec.name))
        if first != protocol:
            p1_joint, p2_joint = (joint, spec.name) if first == "p1" else (spec.name, joint)
            raise ConfigError(
                f"{spec.port} has {p1_joint} on Protocol 1.0 and {p2_joint} on Protocol 2.0: one "
                "port speaks one protocol (Feetech and Protocol 1.0 may share). Put the Protocol "
                "2.0 servos on an adapter of their own and give them its port"
            )
    return specs


RPM = 2.0 * pi / 60.0  # one revolution per minute [rad/s]


def at_voltage(table: tuple[tuple[float, float], ...], voltage: float) -> float:
    """Return the value at a supply voltage [V] from a table ((V, value), ...), ascending.

    The value is interpolated linearly between the entries. Outside of the table it is proportional
    to the voltage, as stall torque and no-load speed of a motor are.
    """
    for (v0, y0), (v1, y1) in pairwise(table):
        if v0 <= voltage <= v1:
            return y0 + (y1 - y0) * (voltage - v0) / (v1 - v0)
    v, y = table[0] if voltage < table[0][0] else table[-1]
    return y * voltage / v


@dataclass(frozen=True)
class Units:
    """Conversions between joint units and registers of one servo, at one supply voltage.

    Attributes:
        spec: Joint and servo.
        voltage: Supply voltage [V].
        zero: Count of the servo at joint angle 0.
        sign: +1 if the servo's counts rise with the joint angle, else -1.
    """

    spec: ServoSpec
    voltage: float
    zero: float
    sign: int

    @staticmethod
    def of(spec: ServoSpec, voltage: float | None = None) -> Units:
        """Return the conversions of a joint's first servo at a supply voltage [V].

        If `voltage` is None, it is the rated voltage.

        Raises:
            ConfigError: The voltage is not above 0.
        """
        volts = spec.row.rated if voltage is None else float(voltage)
        if not volts > 0.0:
            raise ConfigError(f"{spec.name}: the supply voltage must be above 0 V, got {volts!r}")
        zero = (spec.row.max_position + 1) / 2 if spec.zero is None else float(spec.zero)
        return Units(spec, volts, zero, spec.sign)

    @cached_property
    def row(self) -> ServoModel:
        """Data of the servo model."""
        return self.spec.row

    @cached_property
    def count(self) -> float:
        """Joint angle of one encoder count [rad]."""
        return 2.0 * pi / (self.row.counts_per_turn * self.spec.gear_ratio)

    @cached_property
    def _stall(self) -> float:
        """Stall torque of one servo at its output (horn), at this supply voltage [N·m]."""
        torque = at_voltage(self.row.stall, self.voltage)
        if self.spec.stall is not None:
            torque *= self.spec.stall / at_voltage(self.row.stall, self.row.rated)
        return torque

    @cached_property
    def _ratio(self) -> float:
        """Joint torque per torque of one servo: gear ratio times number of servos on the joint."""
        return self.spec.gear_ratio * len(self.spec.servos)

    @cached_property
    def _usable(self) -> dict[int, float]:
        """Cached results of `usable`."""
        return {}

    @cached_property
    def no_load_speed(self) -> float:
        """Joint speed without load at this supply voltage [rad/s]."""
        return at_voltage(self.row.no_load, self.voltage) * RPM / self.spec.gear_ratio

    @cached_property
    def full(self) -> int:
        """Largest value of the limit register."""
        return (
            self.row.current_max if self.row.limit_type == "current" else self.row.family.full_duty
        )

    @cached_property
    def torque_per_unit(self) -> float:
        """Joint torque of one unit of the limit register [N·m]."""
        if self.row.limit_type == "current":
            rated = at_voltage(self.row.stall, self.row.rated)
            constant = (self.spec.stall or rated) / self.row.stall_current  # [N·m/A]
            return constant * self.row.current_unit * self._ratio
        return self._stall / self.row.family.full_duty * self._ratio

    def torque(self, register: int) -> float:
        """Return the joint torque [N·m] of a limit register, or of a current register with sign."""
        magnitude = abs(register) * self.torque_per_unit - self.spec.torque_offset
        return max(magnitude, 0.0) * (1 if register >= 0 else -1)

    def register(self, torque: float, ceiling: int | None = None) -> int:
        """Return the value of the limit register for a joint torque, rounded down.

        Args:
            torque: Joint torque, at least 0 [N·m].
            ceiling: Largest register value allowed; default: the maximum of the model.
        """
        maximum = self.full if ceiling is None else min(ceiling, self.full)
        if torque <= 0.0:
            return 0
        # Tolerance for rounding: `register(torque(n)) == n` for every value n.
        counts = (torque + self.spec.torque_offset) / self.torque_per_unit
        return max(0, min(floor(counts * (1.0 + 1e-12) + 1e-9), maximum))

    def load(self, register: int) -> float:
        """Return the joint torque [N·m] of a load register value; positive toward rising counts."""
        fraction = register / self.row.family.full_load
        return fraction * self._stall * self._ratio

    def usable(self, ceiling: int) -> float:
        """Return the joint torque [N·m] at the limit register value `ceiling`.

        It is at most the stall torque.
        """
        torque = self._usable.get(ceiling)
        if torque is None:
            torque = min(self.torque(min(ceiling, self.full)), self._stall * self._ratio)
            self._usable[ceiling] = torque
        return torque

    def angle(self, counts: float) -> float:
        """Return the joint angle [rad] of a servo position [counts]."""
        return self.sign * (counts - self.zero) * self.count

    def counts(self, angle: float) -> int:
        """Return the servo position [counts] at a joint angle [rad], rounded, not clamped."""
        return round(self.zero + self.sign * angle / self.count)

    def velocity(self, register: int) -> float:
        """Return the joint velocity [rad/s] of a speed register value."""
        return self.sign * register * self.row.speed_unit * RPM / self.spec.gear_ratio

    def stiffness(self, gain: int) -> float:
        """Return the stiffness k_p of the joint [N·m/rad] for a value of the gain register.

        k_p is stall torque times motor duty per radian of position error. For a current-limited
        servo (operating mode 5) it follows from P/128 counts of current per encoder count of error,
        with P the gain register. Sources for these gains agree only within a factor of two
        (docs/ports.md): identify k_p on the arm.
        """
        row, gear = self.row, self.spec.gear_ratio
        if row.limit_type == "current":
            return gain / 128.0 * self.torque_per_unit / self.count
        if row.gain == 0.0:  # the register is the error in counts at full torque (EX, RX)
            return self._stall * self._ratio / (max(gain, 1) * self.count)
        return self._stall * self._ratio * row.gain * gain * gear


def servos_of(
    models: Sequence[str],
    *,
    voltage: float | None = None,
    gains: Sequence[int | None] | None = None,
) -> Servos:
    """Return the servo parameters of these models, one entry per joint.

    Args:
        models: Servo model of each joint, base to tip, as `pliant.servo.list_models()` lists them.
        voltage: Supply voltage [V]; default: the rated voltage of each model.
        gains: Value of each gain register; None: the factory value.

    Returns:
        Servos with k_p from the gain register, and usable torque, friction, damping, encoder step
        and no-load speed of the models. ``stiffness_known`` is False, because sources for k_p
        differ by up to a factor of two.

    Raises:
        ConfigError: `models` is a string, a model is unknown, the voltage is out of range, or the
            number of gains differs from the number of models.
    """
    if isinstance(models, str):
        raise ConfigError(f"models is a list, one per joint: [{models!r}]")
    gain_values = [None] * len(models) if gains is None else list(gains)
    if len(gain_values) != len(models):
        raise ConfigError(f"{len(gain_values)} gains for {len(models)} servos: one each, or None")
    volts = None if voltage is None else real(voltage, "voltage [V]")
    specs = [ServoSpec(name=f"joint {i}", model=m, id=i + 1, port="") for i, m in enumerate(models)]
    units = []
    for spec in specs:
        if volts is not None and not _accepts_voltage(spec.row, volts):
            low, high = spec.row.voltage
            others = [
                row.name for row in by_number(spec.row.model_number) if _accepts_voltage(row, volts)
            ]
            variant = f"; for {volts:g} V there is {' or '.join(others)}" if others else ""
            raise ConfigError(
                f"{spec.row.name} takes {low:g} to {high:g} V, got {volts:g} V{variant}; "
                "on several supplies build the arm's servos per joint"
            )
        units.append(Units.of(spec, volts))
    registers = [
        unit.row.gain_default if gain is None else gain
        for unit, gain in zip(units, gain_values, strict=True)
    ]
    return servos_from_units(units, registers, [unit.full for unit in units])


def _accepts_voltage(row: ServoModel, volts: float) -> bool:
    """Return True if `volts` [V] is within the supply range of the servo model `row`."""
    low, high = row.voltage
    return low <= volts <= high


def servos_from_units(
    units: Sequence[Units], gains: Sequence[int], ceilings: Sequence[int]
) -> Servos:
    """Return the servo parameters of joints at their present voltage, gains and ceilings.

    Values identified on the arm (`ServoSpec.kp`, `friction`, `damping`) replace those of the model.
    `stiffness_known` is True if the stiffness was identified for every joint.

    A chain with both PWM and current limits has the limit type `current`. The back-EMF of its
    PWM-limited joints, stall torque over no-load speed [N·m·s/rad], is added to their damping.

    Args:
        units: Conversions of each joint.
        gains: Gain register value of each joint.
        ceilings: Largest limit register value of each joint.
    """
    torque = np.array([u.usable(c) for u, c in zip(units, ceilings, strict=True)])
    speed = np.array([unit.no_load_speed for unit in units])
    # Joint friction is proportional to the gear ratio, joint damping and inertia to its square.
    ratio = np.array([unit.spec.gear_ratio * len(unit.spec.servos) for unit in units])
    gears = np.array([unit.spec.gear_ratio for unit in units])
    damping = np.array([unit.row.mechanics.damping for unit in units]) * ratio * gears
    is_pwm = np.array([unit.row.limit_type == "pwm" for unit in units])
    all_pwm = bool(is_pwm.all())
    if not all_pwm:
        stall = np.array([unit.usable(unit.full) for unit in units])
        damping = damping + np.where(is_pwm, stall / speed, 0.0)
    friction = np.array([unit.row.mechanics.friction for unit in units]) * ratio
    stiffness = np.array([u.stiffness(g) for u, g in zip(units, gains, strict=True)])
    return Servos(
        kp=_identified(
            stiffness,
            [
                u.spec.kp and u.spec.kp * g / (u.spec.gain or g)
                for u, g in zip(units, gains, strict=True)
            ],
        ),
        max_torque=torque,
        friction=_identified(friction, [unit.spec.friction for unit in units]),
        damping=_identified(damping, [unit.spec.damping for unit in units]),
        armature=np.array([unit.row.mechanics.armature for unit in units]) * ratio * gears,
        encoder_step=[unit.count for unit in units],
        limit_type="pwm" if all_pwm else "current",
        no_load_speed=speed if all_pwm else None,
        stiffness_known=all(unit.spec.kp is not None for unit in units),
    )


def _identified(table: Array, identified: Sequence[float | None]) -> Array:
    """Return `table` with each value replaced by the identified one, unless that is None."""
    return np.array([t if i is None else i for t, i in zip(table, identified, strict=True)])
