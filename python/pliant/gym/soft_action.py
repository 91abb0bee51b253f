"""Actions of a policy: a motion of the target, and the softness of some axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import Axis, ConfigError, Controller, Settings

if TYPE_CHECKING:
    from pliant._core import Model
    from pliant._typing import Array

#: Adaptation η of an axis at its softest.
MAX_ADAPTATION = 0.9
#: Smallest force cap of an axis, as a share of the force with which it holds.
MIN_SHARE = 0.02


@dataclass(frozen=True, kw_only=True)
class SoftAction:
    """Mapping of an action in [-1, 1] to a motion of the target and to softness.

    The first entries move the target: its velocity along the task axes (`twist`), its displacement
    from the present pose (`pose`), or joint targets relative to the present positions (`joints`).
    The other entries are the softness s of the axes `soft`. The force cap of an axis is
    ``hold 0.02^((1 - s) / 2)``, with the force `hold` of a firm axis, and its adaptation is
    ``0.9 (1 - s) / 2``. Both change together, because with a large adaptation the force does not
    reach the cap.

    Attributes:
        soft: Axes whose softness is part of the action, as "y yaw"; "" for none.
        motion: Meaning of the first entries.
        max_speed: Velocity of the target for an entry of 1 [m/s], [rad/s]. For `pose` and `joints`,
            an entry of 1 is the displacement in 0.1 s at this speed.
    """

    soft: str = "y yaw"
    motion: Literal["twist", "pose", "joints"] = "twist"
    max_speed: tuple[float, float] = (0.1, 0.5)

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        if self.motion not in ("twist", "pose", "joints"):
            raise ConfigError(f"motion {self.motion!r}; choose from twist, pose, joints")
        if not all(speed > 0.0 for speed in self.max_speed):
            raise ConfigError(f"max_speed must be above 0 m/s, rad/s, got {self.max_speed!r}")

    def axes(self, task: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the soft axes.

        Raises:
            ConfigError: A name is no axis of the task.
        """
        names = tuple(self.soft.split())
        for name in names:
            if name not in task:
                raise ConfigError(
                    f"soft {name!r} is no axis of the task, which has {', '.join(task)}"
                )
        return names

    def size(self, model: Model, task: tuple[str, ...]) -> int:
        """Return the number of entries of an action."""
        moved = model.n if self.motion == "joints" else len(task)
        return moved + len(self.axes(task))

    def scales(self, task: tuple[str, ...]) -> Array:
        """Return the velocity of each task axis for an action of 1 (k,) [m/s, rad/s]."""
        linear, angular = self.max_speed
        return np.array([linear if name in "xyz" else angular for name in task])

    def softened(self, settings: Settings, hold: dict[str, float], softness: Array) -> Settings:
        """Return settings with the softness of an action.

        Args:
            settings: Settings of the controller.
            hold: Force with which each axis holds [N, N·m].
            softness: Numbers in [-1, 1], one per soft axis.
        """
        changed: dict[str, Axis] = dict(settings.axes.items())
        names = self.axes(settings.task.names)
        caps, adaptation = self.caps(hold, softness[None])
        for name, cap, share in zip(names, caps[0].tolist(), adaptation[0].tolist(), strict=True):
            changed[name] = Axis(soft=cap, profile="constant", adaptation=share)
        return settings.replace(axes=changed)

    def caps(self, hold: dict[str, float], softness: Array) -> tuple[Array, Array]:
        """Return force caps [N, N·m] and adaptation of the soft axes, each (N, number of axes).

        Args:
            hold: Force with which each axis holds [N, N·m].
            softness: Numbers in [-1, 1] (N, number of soft axes); larger ones are clipped.
        """
        yielding = 0.5 * (1.0 - np.clip(softness, -1.0, 1.0))
        largest = np.array([hold[name] for name in self.soft.split()])
        return largest * MIN_SHARE**yielding, MAX_ADAPTATION * yielding


def holding_forces(model: Model, settings: Settings) -> dict[str, float]:
    """Return the force with which each task axis holds if it does not yield [N, N·m]."""
    firm = Controller(model, Settings.firm(task=settings.task)).axes
    return {name: float(axis.hold) for name, axis in firm.items() if axis.hold is not None}
