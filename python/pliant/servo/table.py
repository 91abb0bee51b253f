"""`pliant.Servos` from servo models and gain registers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, Servos
from pliant._validation import real
from pliant.servo.models import by_number
from pliant.servo.spec import ServoSpec
from pliant.servo.units import Units

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pliant.servo.models import ServoModel

    Array = NDArray[np.float64]


def servos_of(
    models: Sequence[str],
    *,
    voltage: float | None = None,
    gains: Sequence[int | None] | None = None,
) -> Servos:
    """Return the servo parameters of these models, one entry per joint.

    Args:
        models: Servo models base to tip, as `pliant.servo.names()` lists them.
        voltage: Supply voltage [V]; default: the rated voltage of each model.
        gains: Gain registers; None: the maker's default.

    Returns:
        Servos with k_p from the gain register, and usable torque, friction, damping, count and
        no-load speed from the tables. ``stiffness_known`` is False: sources for k_p differ by up to
        a factor of two.

    Raises:
        ConfigError: A model is unknown, the voltage is out of range, or the number of gains differs
            from that of the models.
    """
    if isinstance(models, str):
        raise ConfigError(f"models is a list, one per joint: [{models!r}]")
    given = [None] * len(models) if gains is None else list(gains)
    if len(given) != len(models):
        raise ConfigError(f"{len(given)} gains for {len(models)} servos: one each, or None")
    volts = None if voltage is None else real(voltage, "voltage [V]")
    specs = [ServoSpec(name=f"joint {i}", model=m, id=i + 1, port="") for i, m in enumerate(models)]
    units = []
    for spec in specs:
        low, high = spec.row.voltage
        if volts is not None and not low <= volts <= high:
            others = [row.name for row in by_number(spec.row.number) if _bears(row, volts)]
            variant = f"; for {volts:g} V there is {' or '.join(others)}" if others else ""
            raise ConfigError(
                f"{spec.row.name} takes {low:g} to {high:g} V, got {volts:g} V{variant}; "
                "on several supplies build the arm's servos per joint"
            )
        units.append(Units.of(spec, volts))
    registers = [
        unit.row.gain_default if gain is None else gain
        for unit, gain in zip(units, given, strict=True)
    ]
    return servos(units, registers, [unit.full for unit in units])


def _bears(row: ServoModel, volts: float) -> bool:
    """Return True if a model accepts this supply voltage."""
    low, high = row.voltage
    return low <= volts <= high


def servos(units: Sequence[Units], gains: Sequence[int], ceilings: Sequence[int]) -> Servos:
    """Return the servo parameters of joints at their present voltage, gains and ceilings.

    Values identified on the arm (`ServoSpec.kp`, `friction`, `damping`) replace those of the table.
    k_p counts as known if it was identified for every joint.

    A chain with both duty and current limits is of kind `current`. The back-EMF of its duty joints,
    ``τ_stall / ω_0``, is added to their damping.

    Args:
        units: Conversions of each joint.
        gains: Gain registers.
        ceilings: Largest value of each limit register.
    """
    torque = np.array([u.usable(c) for u, c in zip(units, ceilings, strict=True)])
    speed = np.array([unit.no_load_speed for unit in units])
    # The gear scales friction and damping like torque; damping and inertia once more, by the speed.
    passes = np.array([unit.spec.gear * len(unit.spec.servos) for unit in units])
    gears = np.array([unit.spec.gear for unit in units])
    damping = np.array([unit.row.mechanics.damping for unit in units]) * passes * gears
    duty = np.array([unit.row.kind == "pwm" for unit in units])
    pure = bool(duty.all())
    if not pure:
        stall = np.array([unit.usable(unit.full) for unit in units])
        damping = damping + np.where(duty, stall / speed, 0.0)
    friction = np.array([unit.row.mechanics.friction for unit in units]) * passes
    stiffness = np.array([u.stiffness(g) for u, g in zip(units, gains, strict=True)])
    return Servos(
        kp=_identified(stiffness, [unit.spec.kp for unit in units]),
        max_torque=torque,
        friction=_identified(friction, [unit.spec.friction for unit in units]),
        damping=_identified(damping, [unit.spec.damping for unit in units]),
        armature=np.array([unit.row.mechanics.armature for unit in units]) * passes * gears,
        encoder_step=[unit.count for unit in units],
        limit_type="pwm" if pure else "current",
        no_load_speed=speed if pure else None,
        stiffness_known=all(unit.spec.kp is not None for unit in units),
    )


def _identified(table: Array, own: Sequence[float | None]) -> Array:
    """Return the table's values, replaced by identified ones if given."""
    return np.array([t if o is None else o for t, o in zip(table, own, strict=True)])
