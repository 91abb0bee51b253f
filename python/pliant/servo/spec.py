"""Assignment of a servo to a joint: ids, signs, zero, gear and identified values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError
from pliant.servo.models import find

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pliant.servo.calibration import Calibration
    from pliant.servo.models import ServoModel


@dataclass(frozen=True, kw_only=True)
class ServoSpec:
    """One joint and its servo.

    ``count = zero + sign · gear · q · resolution / 2π``.

    Attributes:
        name: Joint name.
        model: Servo model, as `pliant.servo.names()` lists them.
        id: Id on the bus.
        port: Serial port, e.g. ``/dev/ttyUSB0``.
        sign: +1 if counts rise with the joint angle, else -1.
        zero: Count at q = 0, may be fractional; None: the middle of the servo's range.
        gear: Turns of the servo per turn of the joint, above 0.
        secondary: Id and sign of a second servo on the same joint. Its zero is found at open from
            the first servo, because the joint couples them.
        lower, upper: Software position limits [rad]; None: those of the servo.
        stall: Stall torque at the rated voltage, overrides the table [N·m].
        torque_offset: Torque loss in the gears: ``torque = k · register - offset`` [N·m].
        kp: Identified joint stiffness, overrides that of the gain register [N·m/rad].
        friction, damping: Identified values of the gears [N·m, N·m·s/rad].
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
    gear: float = 1.0
    secondary: tuple[int, int] | None = None
    lower: float | None = None
    upper: float | None = None
    stall: float | None = None
    torque_offset: float = 0.0
    kp: float | None = None
    friction: float | None = None
    damping: float | None = None
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        """Check the ranges."""
        row = self.row
        highest = 253 if row.family.protocol == "p1" else 252
        ids = [self.id] if self.secondary is None else [self.id, self.secondary[0]]
        signs = [self.sign] if self.secondary is None else [self.sign, self.secondary[1]]
        for number in ids:
            if not 0 <= number <= highest:
                raise ConfigError(f"{self.name}: id {number} is outside 0..{highest}")
        if len(set(ids)) < len(ids):
            raise ConfigError(
                f"{self.name}: the secondary has the id of the first servo, {self.id}"
            )
        if any(sign not in {-1, 1} for sign in signs):
            raise ConfigError(f"{self.name}: a sign is +1 or -1, got {signs}")
        if not (np.isfinite(self.gear) and self.gear > 0.0):
            raise ConfigError(f"{self.name}: gear must be above 0, got {self.gear!r}")
        if self.zero is not None and not np.isfinite(self.zero):
            raise ConfigError(f"{self.name}: zero is a count, got {self.zero!r}")
        if self.stall is not None and not (np.isfinite(self.stall) and self.stall > 0.0):
            raise ConfigError(f"{self.name}: stall must be above 0 N·m, got {self.stall!r}")
        if not (np.isfinite(self.torque_offset) and self.torque_offset >= 0.0):
            raise ConfigError(f"{self.name}: torque_offset is at least 0, got {self.torque_offset}")
        for what in ("kp", "friction", "damping"):
            value = getattr(self, what)
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise ConfigError(f"{self.name}: {what} is at least 0, got {value!r}")
        if self.kp == 0.0:
            raise ConfigError(f"{self.name}: kp must be above 0 N·m/rad, got 0")
        bounds = [b for b in (self.lower, self.upper) if b is not None]
        if not np.isfinite(bounds).all() or (len(bounds) == 2 and bounds[0] >= bounds[1]):
            raise ConfigError(f"{self.name}: lower must be below upper [rad], got {bounds}")

    @property
    def row(self) -> ServoModel:
        """Row of the model in the servo table."""
        return find(self.model)

    @property
    def servos(self) -> tuple[tuple[int, int], ...]:
        """Id and sign of each servo of the joint."""
        own = ((self.id, self.sign),)
        return own if self.secondary is None else (*own, self.secondary)


def check_specs(given: Iterable[ServoSpec]) -> tuple[ServoSpec, ...]:
    """Check conditions across joints: unique names and ids, one protocol per port.

    Raises:
        ConfigError: Names or ids repeat, or Dynamixel 1.0 and 2.0 share a port.
    """
    specs = tuple(given)
    if not specs:
        raise ConfigError("a chain needs at least one servo")
    seen: dict[tuple[str, int], str] = {}
    protocols: dict[str, tuple[str, str]] = {}
    names = [spec.name for spec in specs]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"two joints are named {name!r}")
    for spec in specs:
        for number, _ in spec.servos:
            if (other := seen.get((spec.port, number))) is not None:
                raise ConfigError(f"{other} and {spec.name} both have id {number} on {spec.port}")
            seen[spec.port, number] = spec.name
        protocol = spec.row.family.protocol
        first, joint = protocols.setdefault(spec.port, (protocol, spec.name))
        if first != protocol:
            one, two = (joint, spec.name) if first == "p1" else (spec.name, joint)
            raise ConfigError(
                f"{spec.port} has {one} on Protocol 1.0 and {two} on Protocol 2.0: one port speaks "
                "one protocol (Feetech and Protocol 1.0 may share). Put the Protocol 2.0 servos on "
                "an adapter of their own and give them its port"
            )
    return specs
