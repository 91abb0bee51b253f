"""Warning about torque limits that are too low to hold the arm."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant._core import Model, Servos

    Array = NDArray[np.float64]

#: Share of the weight below which a limit is too low, and for how long before a warning [s].
SHARE, LASTING = 0.5, 0.2


class Shortfall:
    """Monitor of limits that a program writes itself; commands of a controller are not checked.

    A limit is too low if it is below half of the joint's gravity torque g(q), and limit plus
    friction is below all of it: ``limit < 0.5 |g|`` and ``limit + τ_f < |g|``.
    """

    def __init__(self, model: Model, servos: Servos) -> None:
        """Start without a low limit."""
        self._names, self._friction = model.joint_names, np.asarray(servos.friction)
        self._since: float | None = None
        self._said = False

    def none(self) -> None:
        """Reset the timer, because a controller sent this command."""
        self._since = None

    def look(self, limit: Array, gravity: Array, now: float) -> None:
        """Warn once if limits (n,) [N·m] stay too low for g (n,) [N·m]; `now` is the time [s].

        Warns:
            RuntimeWarning: The joint with the largest shortfall.
        """
        weight = np.abs(gravity)
        short = (limit < SHARE * weight) & (limit + self._friction < weight)
        if self._said or not short.any():
            self._since = None
            return
        self._since = now if self._since is None else self._since
        if now - self._since <= LASTING:
            return
        self._said = True
        worst = int(np.where(short, weight - limit, -np.inf).argmax())
        warnings.warn(
            f"{self._names[worst]} may exert {limit[worst]:.3g} N·m, and this pose needs "
            f"{weight[worst]:.3g}: the arm sinks or falls. Limits are sent as they are; None keeps "
            "the last, a Controller's carry the weight, arm.lower() brings the arm down, and "
            "arm.disable_torque() lets go of it by name",
            RuntimeWarning,
            stacklevel=4,
        )
