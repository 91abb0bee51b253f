"""Checks of a plant's arguments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant import ConfigError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def physics_steps(dt: float, rate: float) -> int:
    """Physics steps per control period."""
    if not (np.isfinite(dt) and 0.0 < dt <= 0.01):
        raise ConfigError(f"dt must be in (0, 0.01] s, got {dt!r}")
    if not (np.isfinite(rate) and rate > 0.0):
        raise ConfigError(f"rate must be positive [Hz], got {rate!r}")
    steps = round(1.0 / (rate * dt))
    if steps < 1 or abs(steps * rate * dt - 1.0) > 1e-9:
        raise ConfigError(f"a period of 1/{rate:g} s is no whole number of steps of {dt:g} s")
    return steps


def load(payload: Any) -> tuple[float, Array] | None:
    """Check an unknown load, a pair or a `Payload`."""
    if payload is None:
        return None
    mass, com = (payload.mass, payload.com) if hasattr(payload, "mass") else payload
    com = np.asarray(com, dtype=np.float64)
    if not (np.isfinite(mass) and mass >= 0.0) or com.shape != (3,) or not np.isfinite(com).all():
        raise ConfigError(f"payload is a mass >= 0 kg and a centre (3,) m, got {payload!r}")
    return float(mass), com
