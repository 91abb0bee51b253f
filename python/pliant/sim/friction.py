"""Dry friction of gears with Stribeck effect and load dependence, for the simulated arm.

The torque of dry friction [N·m] is at most

``base + s stribeck + |k_e τ_e - k_m τ_m| + s |k_es τ_e - k_ms τ_m| + s opposed quadratic``

with the motor torque τ_m and the load torque τ_e on the joint [N·m] (equal and opposite at rest)
and the Stribeck share ``s = exp(-|ω/ω_s|^a)`` of the joint speed ω (1 at rest, 0 in fast motion).
The coefficients are attributes of `Friction`: k_e `external`, k_m `motor`, k_es
`external_stribeck`, k_ms `motor_stribeck`, q_e `external_quadratic`, q_m `motor_quadratic`, ω_s
`speed`, a `exponent`. ``opposed`` is 1 while τ_e and τ_m have opposite signs, else 0. ``quadratic``
is ``q_e τ_e²`` while |τ_m| > |τ_e|, and ``q_m τ_m²`` while |τ_e| > |τ_m|.

These are the models M1 to M6 of Duclusaud et al., Extended Friction Models for the Physics
Simulation of Servo Actuators, arXiv 2410.08650 (2024). M2 has only the first two terms, M4 has
``k_e = k_m``, M6 has all terms. Their viscous term is in the damping of the servo table.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, Servos
from pliant.sim._checks import per_joint

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from pliant._typing import Array
    from pliant.sim._mujoco import mujoco


@dataclass(frozen=True, kw_only=True)
class Friction:
    """Gear friction as a function of speed and load; each entry is a scalar or (n,), at least 0.

    Attributes:
        base: Constant part of the friction [N·m].
        stribeck: Additional friction at rest [N·m].
        motor, external: Additional friction per motor torque and per load torque [1].
        motor_stribeck, external_stribeck: Additional friction at rest, per motor torque and per
            load torque [1].
        motor_quadratic, external_quadratic: Additional friction at rest, per squared motor torque
            and per squared load torque [1/(N·m)].
        speed: Speed at which the additional friction at rest has fallen to the share 1/e [rad/s],
            above 0.
        exponent: Exponent of this fall with speed; a larger value gives a steeper fall.
    """

    base: ArrayLike = 0.0
    stribeck: ArrayLike = 0.0
    motor: ArrayLike = 0.0
    external: ArrayLike = 0.0
    motor_stribeck: ArrayLike = 0.0
    external_stribeck: ArrayLike = 0.0
    motor_quadratic: ArrayLike = 0.0
    external_quadratic: ArrayLike = 0.0
    speed: ArrayLike = 1.0
    exponent: ArrayLike = 1.0

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        for field in fields(self):
            try:
                value = np.asarray(getattr(self, field.name), dtype=np.float64)
            except (TypeError, ValueError):
                text = f"{getattr(self, field.name)!r}"
                raise ConfigError(f"Friction.{field.name} must be numbers, got {text}") from None
            if not (np.isfinite(value).all() and (value >= 0.0).all()):
                raise ConfigError(f"Friction.{field.name} must be at least 0, got {value.tolist()}")
        if not (np.asarray(self.speed) > 0.0).all():
            raise ConfigError(f"Friction.speed must be above 0 rad/s, got {self.speed!r}")

    def largest(self, motor: ArrayLike, external: ArrayLike, speed: ArrayLike) -> Array:
        """Return the largest torque of dry friction [N·m]; the module docstring has the equation.

        Args:
            motor: Motor torque [N·m].
            external: Load torque [N·m].
            speed: Joint speed [rad/s].
        """
        motor, external = np.asarray(motor, dtype=np.float64), np.asarray(external, np.float64)
        share = np.exp(-(np.abs(np.asarray(speed) / self.speed) ** np.asarray(self.exponent)))
        at_rest = self.stribeck + np.abs(
            np.multiply(self.external_stribeck, external) - np.multiply(self.motor_stribeck, motor)
        )
        from_load, from_motor = np.abs(external), np.abs(motor)
        quadratic = np.where(
            from_load < from_motor,
            np.multiply(self.external_quadratic, external**2),
            np.where(from_load > from_motor, np.multiply(self.motor_quadratic, motor**2), 0.0),
        )
        at_rest = at_rest + np.where(motor * external < 0.0, quadratic, 0.0)
        load = np.abs(np.multiply(self.external, external) - np.multiply(self.motor, motor))
        out: Array = self.base + load + share * at_rest
        return out

    def at_rest(self, torque: ArrayLike) -> Array:
        """Return the largest dry friction [N·m] of a joint at rest that holds the load `torque`."""
        torque = np.asarray(torque, dtype=np.float64)
        return self.largest(torque, -torque, 0.0)

    def spread(self, n: int) -> Friction:
        """Return a copy in which every attribute is an array with one entry per joint, (n,).

        Raises:
            ShapeError: An entry is neither a scalar nor of length n.
        """
        names = [field.name for field in fields(self)]
        return Friction(**{name: per_joint(getattr(self, name), n, name) for name in names})

    def assumed(self, servos: Servos) -> Servos:
        """Return a copy of the servo table with this friction, for a controller.

        A controller knows only one load torque per joint. Motor and load torque are equal and
        opposite except for friction, so their coefficients are added. The quadratic terms are
        omitted. With x the joint speed over `speed`, the controller's Stribeck curve
        ``1/(1 + x + x²)`` approximates ``exp(-x^exponent)``.
        """
        return servos.replace(
            friction=self.base,
            load_friction=np.add(self.motor, self.external),
            stribeck=self.stribeck,
            load_stribeck=np.add(self.motor_stribeck, self.external_stribeck),
            stribeck_speed=self.speed,
        )

    @staticmethod
    def of(joints: Sequence[Friction]) -> Friction:
        """Return the friction of an arm from the friction of each joint, base to tip."""
        names = [field.name for field in fields(Friction)]
        columns = {name: np.array([getattr(joint, name) for joint in joints]) for name in names}
        return Friction(**columns)


#: Friction of Dynamixel MX-106 and MX-64 at 15 V and Feetech STS3215 at 7.4 V, for the model M6 of
#: Duclusaud et al. (2024), identified on a pendulum by its authors (github.com/Rhoban/bam, rounded
#: to three digits).
MX106 = Friction(
    base=0.0,
    stribeck=0.122,
    motor=0.198,
    external=0.0222,
    motor_stribeck=0.199,
    external_stribeck=0.0871,
    motor_quadratic=0.01,
    external_quadratic=7.3e-5,
    speed=1.75,
    exponent=1.14,
)
MX64 = Friction(
    base=0.0,
    stribeck=0.123,
    motor=0.311,
    external=0.0,
    motor_stribeck=0.188,
    external_stribeck=0.0141,
    motor_quadratic=0.00691,
    external_quadratic=0.01,
    speed=2.58,
    exponent=0.841,
)
STS3215 = Friction(
    base=0.0533,
    stribeck=0.0,
    motor=0.0449,
    external=0.244,
    motor_stribeck=0.0,
    external_stribeck=0.142,
    motor_quadratic=0.00759,
    external_quadratic=0.0034,
    speed=0.371,
    exponent=9.93,
)


class Gears:
    """Updates the dry friction of the n joints of a compiled MuJoCo model in every physics step."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        friction: Friction,
        dof: NDArray[np.int_],
        servo: NDArray[np.int_],
    ) -> None:
        """Store the friction model, and MuJoCo's indices of the joints.

        Args:
            model: MuJoCo model.
            data: MuJoCo state.
            friction: Friction of the joints, scalars or arrays (n,).
            dof: Index of each joint's degree of freedom (n,).
            servo: Index of each joint's actuator (n,).
        """
        self._model, self._data = model, data
        self._friction, self._dof, self._servo = friction.spread(dof.size), dof, servo
        # Views of MuJoCo's memory: access through attributes of `data` takes longer than the sums.
        self._speeds, self._forces, self._bias = data.qvel, data.actuator_force, data.qfrc_bias
        self._torques = data.qfrc_applied, data.qfrc_actuator, data.qfrc_constraint
        self._losses = model.dof_frictionloss

    def loads(self) -> tuple[Array, Array]:
        """Return motor torques and load torques on the joints (n,) [N·m], in the last step.

        The load torques do not contain dry friction and damping of the joints.
        """
        data, dof = self._data, self._dof
        friction = np.zeros(self._model.nv)
        # Constraints of dry friction come after the equalities. All are joints: there is no tendon.
        rows = slice(data.ne, data.ne + data.nf)
        friction[data.efc_id[rows]] = data.efc_force[rows]
        motor: Array = self._forces[self._servo]
        applied, actuator, constraint = self._torques
        total = applied + actuator + constraint - friction
        external: Array = (total - self._bias)[dof] - motor
        return motor, external

    def update(self) -> Array:
        """Set the joints' dry friction from the loads of the last step; return it (n,) [N·m]."""
        motor, external = self.loads()
        loss = self._friction.largest(motor, external, self._speeds[self._dof])
        self._losses[self._dof] = loss
        return loss
