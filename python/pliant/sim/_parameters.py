"""Servo parameters of a simulated arm, per joint and in SI units.

The controller uses the servo table (`pliant.Servos`). The plant takes the same table, another one,
or scaled values, to test the effect of wrong assumptions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, Servos
from pliant._servo_tables import spread
from pliant._validation import instance
from pliant.sim._checks import per_joint

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from pliant._typing import Array


#: Position error at which a servo of unknown gain is assumed to reach its full effort [rad].
FULL_EFFORT_ERROR = 0.07
#: Friction and damping of a servo without data, as shares of its effort [1] and [s/rad].
FRICTION_SHARE, DAMPING_SHARE = 0.02, 0.10
#: Rotor inertia of a servo without data, as a multiple of its gain [s^2]: puts the servo's own
#: mode at 100 rad/s.
ARMATURE_SHARE = 1e-4


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Parameters of one servo per joint, as arrays of shape (n,).

    Attributes:
        kp: Stiffness of the position loop [N·m/rad].
        kv: Damping of the position loop, inside the limit [N·m·s/rad].
        torque: Largest usable torque, the upper bound of every limit [N·m].
        friction: Dry friction of the gears, outside the limit [N·m].
        damping: Viscous damping outside the limit: gears and, for `pwm`, back-EMF [N·m·s/rad].
        armature: Rotor inertia seen at the joint [kg·m²].
    """

    kp: Array
    kv: Array
    torque: Array
    friction: Array
    damping: Array
    armature: Array

    def scaled(self, kp: ArrayLike, friction: ArrayLike, damping: ArrayLike) -> Gains:
        """Return a copy with parameters multiplied by these factors, scalars or (n,)."""
        n = self.kp.size
        return replace(
            self,
            kp=self.kp * per_joint(kp, n, "kp_scale", low=0.0),
            friction=self.friction * per_joint(friction, n, "friction_scale", low=0.0),
            damping=self.damping * per_joint(damping, n, "damping_scale", low=0.0),
        )


def tabulate(model: Any, servos: Any | None) -> Servos:
    """Return the servo table of a model with n entries, or a guess from its efforts.

    Args:
        model: The robot. Without `servos`, its `servos` or its `effort_limit` are used.
        servos: The table. None: the model's own, or else a guess from the efforts.

    Returns:
        The table. ``stiffness_known`` of a guess is False.

    Raises:
        ConfigError: A joint has neither servo data nor an effort.
        ShapeError: The table is for another number of joints.
        TypeError: `servos` is no table.
    """
    table = getattr(model, "servos", None) if servos is None else instance(servos, Servos, "servos")
    return _guess(model) if table is None else spread(table, model.n)


def resolve(table: Servos) -> Gains:
    """Return the parameters of the simulated servos for a servo table.

    A servo that limits its PWM duty gives ``clip(u, ±L) - (torque / w0) dq``: the back-EMF acts
    outside the limit. A moving joint thus has less torque than L, and a joint pushed backwards has
    more. Current-limited servos have no such term.

    Args:
        table: Table from `tabulate`.

    Returns:
        Arrays of the table's length.
    """
    damping = np.array(table.damping)
    if table.limit_type == "pwm" and table.no_load_speed is not None:
        damping = damping + np.asarray(table.max_torque) / np.maximum(table.no_load_speed, 1e-6)
    return Gains(
        kp=np.array(table.kp),
        kv=np.array(table.kv),
        torque=np.array(table.max_torque),
        friction=np.array(table.friction),
        damping=damping,
        armature=np.array(table.armature),
    )


def _guess(model: Any) -> Servos:
    """Guess servos from the URDF's efforts, for a first look at an unidentified robot."""
    effort = [np.nan if e is None else float(e) for e in model.effort_limit]
    unknown = [name for name, e in zip(model.joint_names, effort, strict=True) if not e > 0.0]
    if unknown:
        raise ConfigError(
            f"nothing is known about the servos of {', '.join(unknown)}: no table, no effort in "
            "the URDF; name their models in [servo] of a configuration file, or pass "
            "servos=pliant.Servos(...)"
        )
    return guess(effort)


def guess(effort: Sequence[float]) -> Servos:
    """Return a servo table from efforts alone [N·m]."""
    torque = np.array(effort, dtype=np.float64)
    kp = torque / FULL_EFFORT_ERROR
    return Servos(
        kp=kp,
        max_torque=torque,
        friction=FRICTION_SHARE * torque,
        damping=DAMPING_SHARE * torque,
        armature=ARMATURE_SHARE * kp,
    )
