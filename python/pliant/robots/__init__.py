"""Built-in arm models with servo parameters; their geometry consists of primitive shapes.

| name | joints | servos |
|---|---|---|
| `arm7` | 7, anthropomorphic, after the description of Cosero's arm | EX-106+ and RX-64 |
| `so101` | 5 and a gripper, SO-101-like | STS3215 at 7.4 V, P gain 16 |
| `koch` | 5 and a gripper, Koch-like | XL430 at 11.1 V (pan, lift), XL330 at 5 V, factory gains |

The models are neither copies nor measurements of real robots. For a real robot, use its own URDF
and servo parameters. The servo parameters here define the simulated servos, so their
`stiffness_known` is True. With a configuration file or a servo bus, the servo parameters come from
there, and the stiffness is known only after identification.
"""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, Model, Servos

if TYPE_CHECKING:
    from collections.abc import Callable


#: One encoder count of a 12-bit servo [rad].
COUNT_12_BIT = 2.0 * np.pi / 4096


def arm7(**options: Any) -> Model:
    """Return an arm with seven joints: EX-106+ servos in shoulder and elbow, RX-64 in the wrist.

    Args:
        **options: Options of `pliant.Model.from_urdf` (`payload`, `gravity`, `limits`, ...).

    Returns:
        The model from `base` to `tool`, which is in the open hand. The damping of its servos
        includes the back-EMF, so their limit type is `current` (a limit without back-EMF).
    """
    return _load("arm7.urdf", _arm7_servos, options)


def so101(**options: Any) -> Model:
    """Return an arm with five joints and a gripper: STS3215 servos at 7.4 V with P gain 16.

    Args:
        **options: Options of `pliant.Model.from_urdf`. The gripper is not part of the chain; it is
            fixed at angle 0 [rad] unless `locked` gives another angle.

    Returns:
        The model from `base` to `tool`.
    """
    return _load("so101_like.urdf", _so101_servos, options)


def koch(**options: Any) -> Model:
    """Return an arm with five joints and a gripper: XL430 and XL330 servos.

    Args:
        **options: Options of `pliant.Model.from_urdf`. The gripper is not part of the chain; it is
            fixed at angle 0 [rad] unless `locked` gives another angle.

    Returns:
        The model from `base` to `tool`.
    """
    return _load("koch_like.urdf", _koch_servos, options)


_ARMS: dict[str, Callable[..., Model]] = {"arm7": arm7, "so101": so101, "koch": koch}


def names() -> tuple[str, ...]:
    """Return the names of the built-in arms."""
    return tuple(_ARMS)


def load(name: str, **options: Any) -> Model:
    """Return a built-in arm by name.

    Args:
        name: One of `names()`.
        **options: Options of `pliant.Model.from_urdf`.

    Returns:
        A new model with servo parameters.

    Raises:
        ConfigError: The name is unknown; the message lists the known ones.
    """
    if name not in _ARMS:
        raise ConfigError(f"no built-in arm {name!r}; there are {', '.join(_ARMS)}")
    return _ARMS[name](**options)


def _load(file: str, servos: Callable[[], Servos], options: dict[str, Any]) -> Model:
    text = resources.files(__name__).joinpath(file).read_text(encoding="utf-8")
    return Model.from_urdf_str(
        text, **{"base": "base", "tip": "tool", "servos": servos(), **options}
    )


def _arm7_servos() -> Servos:
    """Return the parameters of four EX-106+ and three RX-64; `damping` includes the back-EMF."""
    return Servos(
        kp=[150.0] * 4 + [60.0] * 3,
        max_torque=[10.7] * 4 + [6.4] * 3,
        friction=[0.20] * 4 + [0.10] * 3,
        damping=[1.2] * 4 + [0.8] * 3,
        kv=[1.5] * 4 + [0.5] * 3,
        armature=[0.012] * 4 + [0.008] * 3,
        stiffness_known=True,
    )


def _so101_servos() -> Servos:
    """Return the parameters of five STS3215 at 7.4 V, whose torque is limited by PWM.

    Stall torque is 1.9 N·m, no-load speed 52 rpm. The stiffness kp is 0.166/rad times P gain (16)
    times stall torque. Total damping is 0.6 N·m·s/rad; of this, stall torque over no-load speed is
    due to the back-EMF and the rest to the gears.
    """
    stall, no_load = 1.9, 5.45
    return Servos(
        kp=[5.1] * 5,
        max_torque=[stall] * 5,
        friction=[0.08] * 5,
        damping=[0.6 - stall / no_load] * 5,
        armature=[0.028] * 5,
        encoder_step=[COUNT_12_BIT] * 5,
        limit_type="pwm",
        no_load_speed=[no_load] * 5,
        stiffness_known=True,
    )


def _koch_servos() -> Servos:
    """Return the parameters of two XL430-W250 at 11.1 V and three XL330-M288 at 5 V.

    The stiffness kp is 0.00576/rad times P gain times stall torque, with the factory P gains 640
    (XL430) and 400 (XL330). Stall torque and no-load speed are those published by the maker:
    1.4 N·m and 57 rpm (XL430), 0.52 N·m and 103 rpm (XL330). Friction, gear damping and rotor
    inertia are not published and are assumed.
    """
    return Servos(
        kp=[5.2] * 2 + [1.2] * 3,
        max_torque=[1.4] * 2 + [0.52] * 3,
        friction=[0.05] * 2 + [0.02] * 3,
        damping=[0.05] * 2 + [0.012] * 3,
        armature=[0.008] * 2 + [0.002] * 3,
        encoder_step=[COUNT_12_BIT] * 5,
        limit_type="pwm",
        no_load_speed=[6.0] * 2 + [10.8] * 3,
        stiffness_known=True,
    )
