"""Grippers and other joints off the chain, each with a goal and a torque limit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError
from pliant._validation import instance, mapping, real

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pliant._core import Model
    from pliant.arm._io import ArmIO

#: Default torque limit of a gripper: the smaller of `DEFAULT_SHARE` of the servo's usable torque
#: and `OVERLOAD_SHARE` of the torque at which its overload protection acts.
DEFAULT_SHARE, OVERLOAD_SHARE = 0.3, 0.9


@dataclass(frozen=True, kw_only=True)
class GripperConfig:
    """Configuration of a gripper.

    Attributes:
        opened, closed: Joint positions when open and when closed [rad; m if prismatic]; None: the
            upper and the lower position limit of the model.
        limit: Default torque limit [N·m; N if prismatic]; None: the smaller of 30 % of the usable
            torque and 90 % of the overload threshold.
        lever: Distance from the axis to the middle of the finger [m]. If given, `Gripper.close`
            takes a force at the finger [N] and `Gripper.width` is in [m]; None: a torque [N·m] and
            an angle [rad].
    """

    opened: float | None = None
    closed: float | None = None
    limit: float | None = None
    lever: float | None = None

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        for name in ("opened", "closed", "limit", "lever"):
            if (value := getattr(self, name)) is not None:
                real(value, f"GripperConfig.{name}")
        if self.limit is not None and not self.limit >= 0.0:
            raise ConfigError(f"GripperConfig.limit must be at least 0 N·m, got {self.limit!r}")
        if self.lever is not None and not self.lever > 0.0:
            raise ConfigError(f"GripperConfig.lever must be above 0 m, got {self.lever!r}")


class Gripper:
    """Gripper: a joint off the chain that opens and closes with a bounded torque.

    `close` sends the closed position as goal; the torque limit bounds the grip force on an object
    between the fingers.

    Attributes:
        name: Joint name.
        opened, closed: Joint positions when open and when closed [rad; m if prismatic].
        limit: Default torque limit [N·m; N if prismatic].
        max_limit: Largest torque limit [N·m; N if prismatic].
    """

    def __init__(
        self,
        name: str,
        config: GripperConfig,
        model: Model,
        *,
        max_limit: float,
        overload: float,
        order: Callable[[str, float, float], None],
        measure: Callable[[str], float],
    ) -> None:
        """Store `config`, completed by limits of the model; only `Arm` creates grippers.

        Raises:
            ConfigError: Neither `config` nor the model gives the ends of the travel.
        """
        joint = next((j for j in model.joints if j.name == name), None)
        self.name, self.max_limit = name, max_limit
        self._sliding = joint is not None and joint.kind == "prismatic"
        self.closed = self._travel_end(
            config.closed, None if joint is None else joint.lower, "closed"
        )
        self.opened = self._travel_end(
            config.opened, None if joint is None else joint.upper, "opened"
        )
        default = min(DEFAULT_SHARE, OVERLOAD_SHARE * overload) * max_limit
        self.limit = default if config.limit is None else min(config.limit, max_limit)
        self._lever, self._order, self._measure = config.lever, order, measure

    def open(self) -> None:
        """Open to the end of the travel, with the default torque limit."""
        self.go(self.opened)

    def close(self, force: float | None = None) -> None:
        """Close until the fingers meet or an object stops them.

        Args:
            force: Largest force at the finger [N] if `GripperConfig.lever` is given or the joint is
                prismatic, else largest joint torque [N·m]; None: the default limit.

        Raises:
            ConfigError: The force is negative, not finite, or above the servo's maximum.
        """
        self.go(self.closed, force)

    def go(self, position: float, force: float | None = None) -> None:
        """Move to a joint position [rad; m if prismatic], clipped to the travel.

        `force` is as in `close`. Invalid values raise `ConfigError`.
        """
        low, high = sorted((self.closed, self.opened))
        position = real(position, f"{self.name}: position")
        if not math.isfinite(position):
            raise ConfigError(f"{self.name}: position is not finite: {position!r}")
        self._order(self.name, min(max(position, low), high), self._torque(force))

    @property
    def position(self) -> float:
        """Last measured joint position [rad; m if prismatic]."""
        return self._measure(self.name)

    @property
    def width(self) -> float:
        """Opening, 0 when closed: [m] with a lever or a prismatic joint, else [rad]."""
        travel = abs(self.position - self.closed)
        if self._sliding or self._lever is None:
            return travel
        return 2.0 * self._lever * math.sin(min(travel, math.pi) / 2.0)

    def _torque(self, force: float | None) -> float:
        """Return the torque limit [N·m; N if prismatic] for the `force` of `close`."""
        if force is None:
            return self.limit
        arm = self._lever if self._lever is not None and not self._sliding else 1.0
        torque = real(force, f"{self.name}: force") * arm
        if not 0.0 <= torque <= self.max_limit:
            raise ConfigError(
                f"{self.name}: force must be between 0 and {self.max_limit / arm:g}, got {force!r}"
            )
        return torque

    def _travel_end(self, configured: float | None, limit: float | None, which: str) -> float:
        """Return the configured end of the travel, or the model's limit if it is None."""
        value = limit if configured is None else configured
        if value is None or not math.isfinite(value):
            raise ConfigError(
                f"gripper {self.name!r} has no limit in the model: give "
                f"GripperConfig({which}=...) [rad]"
            )
        return float(value)


def check_grippers(grippers: Mapping[str, GripperConfig] | None) -> dict[str, GripperConfig]:
    """Validate and return the gripper configurations by joint name; None gives an empty mapping.

    Raises:
        TypeError: `grippers` is not a mapping, or a value is not a `GripperConfig`.
    """
    hint = "as {'gripper': pliant.arm.GripperConfig(lever=0.05)}"
    named = {} if grippers is None else mapping(grippers, "grippers", hint)
    return {
        name: instance(config, GripperConfig, f"grippers[{name!r}]", hint)
        for name, config in named.items()
    }


def make_grippers(
    io: ArmIO,
    grippers: Mapping[str, GripperConfig],
    order: Callable[[str, float, float], None],
    measure: Callable[[str], float],
) -> dict[str, Gripper]:
    """Return one `Gripper` per joint off the chain, by joint name.

    Args:
        io: Read access to the arm.
        grippers: Configurations by joint name; a joint that is not listed has the default.
        order: Function that sends joint name, goal [rad] and torque limit [N·m].
        measure: Function that returns the last position [rad] of a joint. It must not be that of
            `io`, which the arm replaces when the drive opens: a program may keep a gripper.

    Raises:
        ConfigError: A configuration names an unknown joint, or the ends of the travel are missing.
    """
    joints, drive = io.joints, io.drive
    unknown = sorted(set(grippers) - set(joints.extra))
    if unknown:
        known = ", ".join(joints.extra) or "none"
        raise ConfigError(f"no joint {unknown[0]!r} off the chain; there are: {known}")
    overload = np.broadcast_to(getattr(drive, "overload", 1.0), len(joints.names))
    return {
        name: Gripper(
            name,
            grippers.get(name, GripperConfig()),
            io.model,
            max_limit=float(np.broadcast_to(drive.servos.max_torque, len(joints.names))[i]),
            overload=float(overload[i]),
            order=order,
            measure=measure,
        )
        for name, i in zip(joints.extra, joints.off_chain.tolist(), strict=True)
    }
