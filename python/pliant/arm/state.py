"""What an arm reports at one moment."""

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
    """What the bus reports, joints in chain order; None where a servo does not say.

    Attributes:
        q: Joint positions (n,) [rad], the last good ones where this tick brought none.
        dq: Joint velocities (n,) [rad/s].
        time: When the positions were sampled, on the clock of the arm [s].
        fresh: Whether every joint's position is new in this tick.
        extra: Positions of the joints off the chain (a gripper) by name [rad].
        age: How old each position is (n,) [s].
        load: What each servo says it exerts (n,) [N·m].
        current: Of each servo (n,) [A].
        voltage: At each servo (n,) [V]; NaN where not yet asked.
        temperature: Of each servo (n,) [°C]; NaN where not yet asked.
        faults: What is wrong, in sentences; empty when healthy.
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
        """Without ages the positions count as new."""
        if self.age.shape != self.q.shape:
            object.__setattr__(self, "age", np.zeros_like(self.q))
