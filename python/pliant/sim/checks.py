"""Checks of a plant's arguments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, Servos
from pliant._servo_tables import spread
from pliant._validation import format_value, instance, number
from pliant.sim.imperfections import Overload

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pliant.sim.hand import Hand
    from pliant.sim.scene import Fixture

    Array = NDArray[np.float64]


def physics_steps(dt: float, rate: float) -> int:
    """Return the physics steps per control period."""
    dt, rate = (_float(value, name) for value, name in ((dt, "dt"), (rate, "rate")))
    if not (np.isfinite(dt) and 0.0 < dt <= 0.01):
        raise ConfigError(f"dt must be in (0, 0.01] s, got {dt!r}")
    if not (np.isfinite(rate) and rate > 0.0):
        raise ConfigError(f"rate must be positive [Hz], got {rate!r}")
    steps = round(1.0 / (rate * dt))
    if steps < 1 or abs(steps * rate * dt - 1.0) > 1e-9:
        raise ConfigError(f"a period of 1/{rate:g} s is no whole number of steps of {dt:g} s")
    return steps


def table(servos: Any | None) -> Servos | None:
    """Check the servo table; None passes."""
    return None if servos is None else instance(servos, Servos, "servos")


def extra(model: Any, servos: Any | None) -> dict[str, Servos]:
    """Check the servo tables of off-chain joints; leave out joints that the model lacks."""
    names = {joint.name for joint in model.joints} - set(model.joint_names)
    found = {}
    for name, own in dict(servos or {}).items():
        instance(own, Servos, f"extra_servos[{name!r}]")
        if name in model.joint_names:
            raise ConfigError(f"extra_servos[{name!r}]: the joint is of the chain; use servos")
        if name in names:
            found[name] = spread(own, 1)
    return found


def protection(overload: Any | None) -> Overload | None:
    """Check the overload protection of the servos; None passes."""
    kind = "e.g. Overload(threshold=0.95, seconds=3.0)"
    return None if overload is None else instance(overload, Overload, "overload", kind)


def off_chain(value: str) -> None:
    """Check the treatment of off-chain joints."""
    if value not in {"held", "welded"}:
        raise ConfigError(f"off_chain is 'held' or 'welded', got {format_value(value)}")


def creep(value: float) -> float:
    """Check the creep factor; MuJoCo has no dry friction that holds a joint entirely."""
    return number(value, "creep", 1e-3, 1.0)


def split(scene: Iterable[Hand | Fixture]) -> tuple[list[Hand], list[Fixture]]:
    """Separate hands (force laws) from fixtures (things with bodies).

    Raises:
        TypeError: `scene` is not iterable, or an item is neither a hand nor a fixture.
    """
    hands: list[Hand] = []
    fixtures: list[Fixture] = []
    try:
        items: list[Any] = list(scene)
    except TypeError:
        raise TypeError(
            f"scene must be a list of hands and fixtures, got {format_value(scene)}"
        ) from None
    for i, item in enumerate(items):
        if hasattr(item, "add"):
            fixtures.append(item)
        elif hasattr(item, "at"):
            hands.append(item)
        else:
            known = "a hand (Drag, Push, Wall …) nor a fixture (door(), Surface …) of pliant.sim"
            raise TypeError(f"scene[{i}] is neither {known}, got {format_value(item)}")
    return hands, fixtures


def load(payload: Any) -> tuple[float, Array] | None:
    """Check the payload unknown to the controller: a pair or a `Payload`."""
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


def _float(value: Any, name: str) -> float:
    """Convert to float; the caller checks the range."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{name} must be a number, got {format_value(value)}") from None
