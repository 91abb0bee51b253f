"""Servo parameters of a simulated arm, per joint and in SI units.

A controller assumes the values of a servo table (`pliant.Servos`). The simulated arm (`Plant`) uses
the same table, or another table or scaled values, to test the effect of wrong assumptions.
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

    from pliant._core import Model
    from pliant._typing import Array


#: Assumed position error at which a servo without data exerts its effort limit [rad].
FULL_EFFORT_ERROR = 0.07
#: Assumed friction of a servo without data, divided by its effort limit: dry [1], viscous [s/rad].
FRICTION_SHARE, DAMPING_SHARE = 0.02, 0.10
#: Assumed rotor inertia of a servo without data, divided by its stiffness [s²]; the natural
#: frequency of rotor and position loop is then 100 rad/s.
ARMATURE_SHARE = 1e-4


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Parameters of the simulated servos, arrays of shape (n,).

    Attributes:
        kp: Stiffness of the position loop [N·m/rad].
        kv: Damping of the position loop [N·m·s/rad]; the torque limit includes its torque.
        torque: Largest usable torque, the upper bound of every torque limit [N·m].
        friction: Dry friction of the gears [N·m]; it acts in addition to the limited torque.
        damping: Viscous damping of the gears, plus back-EMF for the limit type `pwm` [N·m·s/rad];
            it acts in addition to the limited torque.
        armature: Rotor inertia seen at the joint [kg·m²].
    """

    kp: Array
    kv: Array
    torque: Array
    friction: Array
    damping: Array
    armature: Array

    def scaled(self, kp: ArrayLike, friction: ArrayLike, damping: ArrayLike) -> Gains:
        """Return a copy with stiffness, dry friction and damping multiplied by these factors.

        Each factor is a scalar or an array (n,).
        """
        n = self.kp.size
        return replace(
            self,
            kp=self.kp * per_joint(kp, n, "kp_scale", low=0.0),
            friction=self.friction * per_joint(friction, n, "friction_scale", low=0.0),
            damping=self.damping * per_joint(damping, n, "damping_scale", low=0.0),
        )


def tabulate(model: Model, servos: Any | None) -> Servos:
    """Return the servo table of a model, with n entries.

    Args:
        model: The robot.
        servos: The table. None: the table of the model, or estimates from the effort limits if the
            model has no table.

    Returns:
        The servo table. If it is an estimate, ``stiffness_known`` is False.

    Raises:
        ConfigError: A joint has neither servo data nor an effort limit.
        ShapeError: The table is for another number of joints.
        TypeError: `servos` is not a `Servos` table.
    """
    table = model.servos if servos is None else instance(servos, Servos, "servos")
    return _guess_of(model) if table is None else spread(table, model.n)


def resolve(table: Servos) -> Gains:
    """Return the parameters of the simulated servos for a servo table.

    A PWM-limited servo exerts ``clip(u, ±L) - (τ_max / ω_0) dq`` [N·m], with the torque u of its
    position loop, torque limit L, usable torque τ_max, no-load speed ω_0 and joint velocity dq. The
    second term is the back-EMF, which L does not include. A joint that moves toward its goal thus
    has less torque than L, and a joint pushed backwards has more. Current-limited servos have no
    such term.

    Args:
        table: Table from `tabulate`.

    Returns:
        Parameters of the servos of all joints in the table.
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


def _guess_of(model: Model) -> Servos:
    """Return a servo table estimated from the effort limits in the URDF of a model.

    Raises:
        ConfigError: A joint has no effort limit.
    """
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
    """Return a servo table estimated from effort limits [N·m]."""
    torque = np.array(effort, dtype=np.float64)
    kp = torque / FULL_EFFORT_ERROR
    return Servos(
        kp=kp,
        max_torque=torque,
        friction=FRICTION_SHARE * torque,
        damping=DAMPING_SHARE * torque,
        armature=ARMATURE_SHARE * kp,
    )
