"""Validation of the arguments of `Plant`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, Servos, ShapeError
from pliant._servo_tables import spread
from pliant._validation import format_value, instance, real

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._core import Model
    from pliant._typing import Array


#: Default step of the physics [s].
STEP = 0.001
#: Decimals of the rates that an error proposes, and largest number of periods to try for each.
RATE_DECIMALS, MAX_PERIODS = 3, 10_000


def physics_steps(dt: float, rate: float, *, name: str = "rate") -> int:
    """Return the number of physics steps of `dt` [s] per control period at `rate` [Hz].

    `name` is the name of the rate in error messages.

    Raises:
        ConfigError: A number is out of range, or a period is not a whole number of steps.
    """
    dt, rate = (real(value, key) for value, key in ((dt, "dt"), (rate, name)))
    if not (np.isfinite(dt) and 0.0 < dt <= 0.01):
        raise ConfigError(f"dt must be in (0, 0.01] s, got {dt!r}")
    if not (np.isfinite(rate) and rate > 0.0):
        raise ConfigError(f"{name} must be positive [Hz], got {rate!r}")
    steps = round(1.0 / (rate * dt))
    if steps < 1 or not _divides(steps, rate, dt):
        raise ConfigError(
            f"{name} = {rate:g} Hz: its period is not a whole number of the simulator's steps of "
            f"{dt:g} s; rates that fit: {', '.join(f'{r:g}' for r in _near_rates(rate, dt))} Hz"
        )
    return steps


def _divides(steps: int, rate: float, dt: float) -> bool:
    """Return True if `steps` steps of `dt` [s] are one period at `rate` [Hz]."""
    return abs(steps * rate * dt - 1.0) <= 1e-9


def _near_rates(rate: float, dt: float) -> list[float]:
    """Return the nearest rates [Hz] below and above `rate` that fit, with few decimals."""
    first, out = max(int(1.0 / (rate * dt)), 1), []
    for candidates in (
        range(first + 1, first + MAX_PERIODS),
        range(first, max(first - MAX_PERIODS, 0), -1),
    ):
        rates = ((k, round(1.0 / (k * dt), RATE_DECIMALS)) for k in candidates)
        fitting = (value for k, value in rates if value > 0.0 and _divides(k, value, dt))
        out += [value] if (value := next(fitting, None)) is not None else []
    return out or [1.0 / (first * dt)]


def extra(model: Model, servos: Any | None) -> dict[str, Servos]:
    """Validate and return the servo tables of off-chain joints by name.

    Tables of joints that the model does not have are omitted.
    """
    names = {joint.name for joint in model.joints} - set(model.joint_names)
    tables = {}
    for name, table in dict(servos or {}).items():
        instance(table, Servos, f"extra_servos[{name!r}]")
        if name in model.joint_names:
            raise ConfigError(f"extra_servos[{name!r}]: the joint is of the chain; use servos")
        if name in names:
            tables[name] = spread(table, 1)
    return tables


def load(payload: Any) -> tuple[float, Array] | None:
    """Return mass [kg] and centre of mass (3,) [m] of a payload, None without payload.

    `payload` is a pair of these, or a `Payload`.
    """
    if payload is None:
        return None
    try:
        mass, com = (payload.mass, payload.com) if hasattr(payload, "mass") else payload
        mass, com = float(mass), np.asarray(com, dtype=np.float64)
    except (TypeError, ValueError):
        mass, com = np.nan, np.zeros(0)
    if not (np.isfinite(mass) and mass >= 0.0) or com.shape != (3,) or not np.isfinite(com).all():
        raise ConfigError(
            f"payload is a mass >= 0 kg and a centre (3,) m, as in (0.3, [0, 0, 0.05]), "
            f"got {format_value(payload)}"
        )
    return mass, com


def per_joint(value: ArrayLike, n: int, name: str, *, low: float = -np.inf) -> Array:
    """Validate a scalar or an array (n,), and return it as an array (n,), one value per joint.

    Args:
        value: A number, or one number per joint.
        n: Number of joints.
        name: Name of the value in error messages.
        low: Smallest value allowed.

    Returns:
        A new float64 array of shape (n,).

    Raises:
        ShapeError: The array has neither one nor n entries.
        ConfigError: An entry is not a number, not finite or below `low`.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(
            f"{name} must be a number or {n} numbers, one per joint; got {value!r}"
        ) from None
    if array.shape not in {(), (1,), (n,)}:
        raise ShapeError(
            f"{name} has shape {array.shape}; give a number or an array of shape ({n},)"
        )
    array = np.broadcast_to(array, n).copy()
    if not np.all(np.isfinite(array)):
        raise ConfigError(f"{name} is not finite: {array.tolist()}")
    if np.any(array < low):
        raise ConfigError(f"{name} must be at least {low:g}, got {array.min():g}")
    return array
