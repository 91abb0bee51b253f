"""Compliant task-space control for arms with back-drivable position servos.

    >>> import pliant
    >>> model = pliant.robots.arm7()
    >>> controller = pliant.Controller(model, pliant.Settings.soft("y"))

Conventions: SI units; joints are ordered base to tip, task axes x y z roll pitch yaw; 6-vectors
have the linear part first; poses are `base_from_tool` (4, 4); a deviation is target minus actual;
gravity torques are those that hold the arm.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from pliant._core import (
    Axis,
    Command,
    Compensation,
    ConfigError,
    ContactEstimator,
    Controller,
    FrameNotFoundError,
    Model,
    NullSpace,
    OutOfRangeError,
    Payload,
    PliantError,
    Pose,
    ServoError,
    ServoFaultError,
    Servos,
    ServoTimeoutError,
    Settings,
    ShapeError,
    Task,
    TorqueLimits,
    Tracking,
    UrdfError,
    __version__,
)

if TYPE_CHECKING:
    from pliant import arm as arm
    from pliant import config as config
    from pliant import feasibility as feasibility
    from pliant import functional as functional
    from pliant import identify as identify
    from pliant import log as log
    from pliant import model as model
    from pliant import reactions as reactions
    from pliant import robots as robots
    from pliant import servo as servo
    from pliant import sim as sim
    from pliant import teach as teach
    from pliant import types as types
    from pliant._validation import AXES as AXES
    from pliant.arm import Arm as Arm
    from pliant.config import connect as connect
    from pliant.identify.hand_guiding import HandGuiding as HandGuiding
    from pliant.loop import Loop as Loop
    from pliant.loop import Tick as Tick
    from pliant.reactions import Reaction as Reaction
    from pliant.reactions import ReactionMonitor as ReactionMonitor

__all__ = [
    "AXES",
    "Arm",
    "Axis",
    "Command",
    "Compensation",
    "ConfigError",
    "ContactEstimator",
    "Controller",
    "FrameNotFoundError",
    "HandGuiding",
    "Loop",
    "Model",
    "NullSpace",
    "OutOfRangeError",
    "Payload",
    "PliantError",
    "Pose",
    "Reaction",
    "ReactionMonitor",
    "ServoError",
    "ServoFaultError",
    "ServoTimeoutError",
    "Servos",
    "Settings",
    "ShapeError",
    "Task",
    "Tick",
    "TorqueLimits",
    "Tracking",
    "UrdfError",
    "__version__",
    "connect",
]

#: Public submodules that `pliant.NAME` imports at first use: they need extras or import slowly.
_PARTS = (
    "arm",
    "config",
    "feasibility",
    "functional",
    "gym",
    "identify",
    "log",
    "model",
    "reactions",
    "robots",
    "servo",
    "sim",
    "teach",
    "teleop",
    "types",
)
#: Public names that are imported at first use, each with the submodule that defines it.
_NAMES = {
    "AXES": "pliant._validation",
    "Arm": "pliant.arm",
    "HandGuiding": "pliant.identify.hand_guiding",
    "Loop": "pliant.loop",
    "Reaction": "pliant.reactions",
    "ReactionMonitor": "pliant.reactions",
    "Tick": "pliant.loop",
    "connect": "pliant.config.factory",
}


def __getattr__(name: str) -> Any:
    if name in _NAMES:
        return getattr(importlib.import_module(_NAMES[name]), name)
    if name in _PARTS:
        try:
            return importlib.import_module(f"pliant.{name}")
        except ImportError as error:
            # `hasattr` and `inspect` expect this class. `from pliant import NAME` imports again
            # and raises the `ImportError`.
            raise AttributeError(str(error)) from error
    raise AttributeError(f"module 'pliant' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_PARTS])
