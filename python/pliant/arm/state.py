"""State of an arm in one cycle."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """State of an arm in one cycle, joints in chain order; None if the servos do not report it.

    Attributes:
        q: Joint positions (n,) [rad]; the last good ones if this tick brought none.
        dq: Joint velocities (n,) [rad/s].
        time: Sample time of the positions, on the arm's clock [s].
        fresh: Whether every joint's position is new in this tick.
        extra: Positions of the joints off the chain (a gripper) by name [rad].
        age: Age of each position (n,) [s].
        load: Torque as each servo estimates it (n,) [N·m].
        current: Current of each servo (n,) [A].
        voltage: Supply voltage at each servo (n,) [V]; NaN before the first reading.
        temperature: Temperature of each servo (n,) [°C]; NaN before the first reading.
        faults: Present faults, one sentence each; empty if healthy.
    """

    q: Array
    dq: Array | None = None
    time: float = 0.0
    fresh: bool = True
    extra: Mapping[str, float] = field(default_factory=dict)
    age: Array = field(default_factory=lambda: np.zeros(0))
    load: Array | None = None
    current: Array | None = None
    voltage: Array | None = None
    temperature: Array | None = None
    faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Set the ages to 0 if they are not given."""
        if self.age.shape != self.q.shape:
            object.__setattr__(self, "age", np.zeros_like(self.q))
