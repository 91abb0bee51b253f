"""Data that the process of the control loop and the process of the network exchange."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pliant.view.messages import Edit

if TYPE_CHECKING:
    from pliant._core import Model, Servos, Settings
    from pliant._typing import Array


@dataclass(frozen=True, kw_only=True)
class RobotInfo:
    """Description of the arm and its controller at the start of the loop.

    Attributes:
        model: Robot model.
        settings: Settings of the controller.
        servos: Servos of the arm.
        extra: Names of the joints outside the chain, such as the gripper.
    """

    model: Model
    settings: Settings
    servos: Servos
    extra: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ArmState:
    """State of the arm in one tick.

    Attributes:
        time: Time of the positions, nanoseconds since 1970.
        q: Joint positions (n,) [rad].
        dq: Joint velocities (n,) [rad/s], NaN if the servos do not report them.
        load: Joint torques (n,) [N·m], NaN if the servos do not report them.
        extra: Positions of the joints outside the chain [rad].
        wrench: Estimated external force and torque on the tool (6,) [N, N·m], base axes.
    """

    time: int
    q: Array
    dq: Array
    load: Array
    extra: Array
    wrench: Array


@dataclass(frozen=True)
class NewSettings(Edit):
    """Replace the settings of the controller by settings that have been checked for it."""

    settings: Settings
