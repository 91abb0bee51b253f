"""`Moment`, the data of one tick for conditions and actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, Controller, Task, WrenchEstimate
from pliant._validation import AXES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True)
class Moment:
    """Data of one tick.

    Attributes:
        controller: Controller of the arm.
        time: Time since the monitor started [s].
        dt: Time since the last tick [s].
        q: Measured joint positions (n,) [rad].
        tool: Measured pose of the tool (4, 4).
        wanted: The caller's target pose (4, 4).
        felt: Estimated wrench on the tool; None if no condition needs it.
        guard: Multiple of the uncertainty that a force must exceed to count.
    """

    controller: Controller
    time: float
    dt: float
    q: Array
    tool: Array
    wanted: Array
    felt: WrenchEstimate | None
    guard: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the task's axes."""
        return self.controller.settings.task.names

    @property
    def deviation(self) -> Array:
        """Target minus actual (k,) [m, rad] at the last step, task frame."""
        return self.controller.diagnostics.deviation

    @property
    def speed(self) -> Array:
        """Velocity of the tool (k,) [m/s, rad/s] along the task's axes."""
        velocity = self.controller.diagnostics.velocity if self.felt is None else self.felt.velocity
        moved: Array = self.controller.diagnostics.task_jacobian @ velocity
        return moved

    def force(self) -> WrenchEstimate:
        """Return the estimated wrench on the tool.

        Raises:
            ConfigError: The monitor has no contact estimator.
        """
        if self.felt is None:
            raise ConfigError("this watch feels no force: give it contact=ContactEstimator(...)")
        return self.felt

    @property
    def base_from_task(self) -> Array:
        """Axes of the task (3, 3) as columns, in base axes."""
        frame = self.controller.settings.task.frame
        if isinstance(frame, str):
            return self.tool[:3, :3] if frame == "tool" else np.eye(3)
        return frame


def indices(axes: str, names: Sequence[str] = AXES) -> tuple[int, ...]:
    """Return the indices of an axis key's axes in `names`.

    Raises:
        ConfigError: The key is invalid, or an axis is not among the names.
    """
    wanted = Task(axes).names
    absent = [name for name in wanted if name not in names]
    if absent:
        raise ConfigError(
            f"axes {', '.join(absent)} are not of this task; it has {' '.join(names)}"
        )
    return tuple(list(names).index(name) for name in wanted)
