"""Limits below the weight, written without a controller: sent as they are, and said once."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant import Model, Servos

    Array = NDArray[np.float64]

#: Share of the weight below which a limit counts as short, and for how long it must be so [s].
SHARE, LASTING = 0.5, 0.2


class Shortfall:
    """Watches what a program asks for itself; a controller's commands know what they leave out.

    A joint is short whose limit is below half of its weight g(q), and together with its friction
    below all of it: ``limit < 0.5 |g|`` and ``limit + τ_f < |g|``.
    """

    def __init__(self, model: Model, servos: Servos) -> None:
        """Nothing was short so far."""
        self._names, self._friction = model.joint_names, np.asarray(servos.friction)
        self._since: float | None = None
        self._said = False

    def none(self) -> None:
        """A controller commands: what was short before does not count any more."""
        self._since = None

    def look(self, limit: Array, gravity: Array, now: float) -> None:
        """Warn once where limits (n,) [N·m] have been short of g (n,) [N·m] until `now` [s].

        Warns:
            RuntimeWarning: Names the joint that lacks most.
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
