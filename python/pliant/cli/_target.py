"""One external target: parsing of a line, and check against the arm."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, PliantError, Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant._core import Model

    Array = NDArray[np.float64]

KEYS = ("position", "wxyz", "xyzw", "q")


@dataclass(frozen=True)
class Target:
    """A parsed target.

    Attributes:
        position: (3,) [m], base axes; None: unchanged.
        rotation: Quaternion and its order; None: unchanged.
        q: Joint positions (n,) [rad] whose tool pose is the target.
    """

    position: tuple[float, ...] | None = None
    rotation: tuple[str, tuple[float, ...]] | None = None
    q: tuple[float, ...] | None = None

    @classmethod
    def parse(cls, line: str, model: Model) -> Target:
        """Parse a line for an arm.

        Raises:
            ConfigError: The line is no JSON object of the known keys with finite numbers, or its
                target is far out of the arm's reach or limits.
        """
        try:
            data: Any = json.loads(line)
        except RecursionError:
            raise ConfigError(f"target {_short(line)} is nested too deeply") from None
        except ValueError as error:  # also an integer of more digits than Python reads
            raise ConfigError(f"target {_short(line)} is no JSON: {error}") from error
        if not isinstance(data, dict) or not data or set(data) - set(KEYS):
            raise ConfigError(f"a target is an object of {', '.join(KEYS)}; got {_short(line)}")
        numbers = {key: _numbers(key, value, line) for key, value in data.items()}
        if len({"wxyz", "xyzw"} & set(numbers)) == 2 or ("q" in numbers and len(numbers) > 1):
            raise ConfigError(f"a target is q, or position with one quaternion; got {_short(line)}")
        order = next((key for key in ("wxyz", "xyzw") if key in numbers), None)
        rotation = None if order is None else (order, numbers[order])
        target = cls(numbers.get("position"), rotation, numbers.get("q"))
        try:
            target.check(model)
        except PliantError as error:
            raise ConfigError(f"target {_short(line)}: {error}") from error
        return target

    def check(self, model: Model) -> None:
        """Check that the arm can plausibly reach the target.

        Raises:
            OutOfRangeError: The position is far out of reach, or a joint far beyond its limits.
            ShapeError, ConfigError: It is no pose, or has other joints.
        """
        if self.q is not None:
            model.check_joint_target(np.array(self.q))
        pose = self.pose(model, np.eye(4))
        if self.position is not None:
            model.check_target(pose)

    def pose(self, model: Model, before: Array) -> Array:
        """Return the pose (4, 4); missing parts are taken from `before`."""
        if self.q is not None:
            return model.forward_kinematics(np.array(self.q))
        pose = before.copy()
        if self.position is not None:
            pose[:3, 3] = self.position
        if self.rotation is not None:
            order, quaternion = self.rotation
            make = Pose.from_wxyz if order == "wxyz" else Pose.from_xyzw
            pose[:3, :3] = make(pose[:3, 3], quaternion).rotation
        return pose


def _numbers(key: str, value: object, line: str) -> tuple[float, ...]:
    size = {"position": 3, "wxyz": 4, "xyzw": 4}.get(key)
    if not (
        isinstance(value, list)
        and all(type(v) in (int, float) for v in value)
        and (size is None or len(value) == size)
    ):
        raise ConfigError(f"{key} is a list of {size or 'n'} numbers, got {_short(line)}")
    try:
        numbers = tuple(map(float, value))
    except OverflowError:
        raise ConfigError(f"{key} is larger than any number: {_short(line)}") from None
    if not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{key} is not finite: {_short(line)}")
    return numbers


def _short(text: str) -> str:
    text = text.strip()
    return repr(text if len(text) < 60 else f"{text[:57]}...")
