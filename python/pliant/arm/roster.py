"""Mapping between the servos of a drive and the joints of an arm, on and off the chain."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, OutOfRangeError
from pliant._servo_tables import take
from pliant._validation import given, mapping, real
from pliant.arm.belief import FASTEST

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from pliant._core import Model, Servos
    from pliant.drive import Drive

    Array = NDArray[np.float64]
    Orders = Mapping[str, tuple[float, float]]

#: Format of orders for joints off the chain, as errors show it.
EXTRA = "as {'gripper': (goal [rad], limit [N·m])}"


class Roster:
    """Joints of a drive, split into chain joints and others.

    Attributes:
        names: All joint names in drive order (N,).
        chain: Indices of the chain's joints in drive order (n,).
        beside: Indices of the joints off the chain.
        extra: Names of the joints off the chain.
    """

    def __init__(self, model: Model, drive: Drive) -> None:
        """Match the joint names of the model and the drive.

        Raises:
            ConfigError: A joint of the chain has no servo, or a name is not unique.
        """
        self.names = tuple(drive.names)
        if len(set(self.names)) != len(self.names):
            raise ConfigError(f"two servos have one joint name: {', '.join(self.names)}")
        missing = [name for name in model.joint_names if name not in self.names]
        if missing:
            raise ConfigError(
                f"no servo is named {', '.join(missing)}; the servos are {', '.join(self.names)}, "
                f"the joints of {model.name!r} from {model.base!r} to {model.tip!r} "
                f"{', '.join(model.joint_names)}"
            )
        self.chain = np.array([self.names.index(name) for name in model.joint_names])
        self.beside = np.setdiff1d(np.arange(len(self.names)), self.chain)
        self.extra = tuple(self.names[i] for i in self.beside)

    def index(self, name: str) -> int:
        """Return the index of a joint in drive order."""
        return self.names.index(name)

    def servos(self, drive: Drive) -> Servos:
        """Return the chain's servo parameters from the drive's table, in chain order."""
        size = len(self.names)
        table = take(drive.servos, size, self.chain)
        known = getattr(drive, "stiffness_known", None)
        if known is None:
            return table
        return table.replace(stiffness_known=bool(np.broadcast_to(known, size)[self.chain].all()))

    def fastest(self, model: Model) -> Array:
        """Return the largest speeds (N,) [rad/s]: the model's limits, else `FASTEST`."""
        fastest = np.full(len(self.names), FASTEST)
        known = np.asarray(model.velocity_limit)
        fastest[self.chain] = np.where(np.isfinite(known), known, FASTEST)
        return fastest

    def join(self, chain: Array, beside: Array) -> Array:
        """Merge chain values (n,) and other values into a vector (N,) in drive order."""
        both = np.empty(len(self.names))
        both[self.chain], both[self.beside] = chain, beside
        return both

    def check(self, orders: Orders) -> dict[str, tuple[float, float]]:
        """Return checked goals [rad] and limits [N·m] of joints off the chain.

        Raises:
            TypeError: Not a mapping. ConfigError: Unknown joint, or not two numbers.
                OutOfRangeError: Not finite, or a negative limit.
        """
        checked = {}
        for name, order in mapping(orders, "extra", EXTRA).items():
            if name not in self.extra:
                there = ", ".join(self.extra) or "none"
                raise ConfigError(
                    f"no joint {name!r} off the chain to write to; there are: {there}"
                )
            try:
                goal, limit = order
            except (TypeError, ValueError):
                raise ConfigError(f"extra must be {EXTRA}, got {given(order)} for {name}") from None
            goal, limit = real(goal, f"goal of {name}"), real(limit, f"limit of {name}")
            if not (math.isfinite(goal) and math.isfinite(limit) and limit >= 0.0):
                raise OutOfRangeError(
                    f"extra[{name!r}] must be a finite goal and a limit >= 0, got {goal:g} and "
                    f"{limit:g}"
                )
            checked[name] = (goal, limit)
        return checked
