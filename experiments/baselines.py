"""Baseline controllers for comparison.

All of them are made for a model and a control period, and step like `pliant.Controller`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments.setups import AXES, servos

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from experiments.conditions import FromModel

    Array = NDArray[np.float64]

#: Springs [N/m], [N·m/rad]: stable bounds through position servos at 100 Hz, and with torque
#: sources at 1 kHz.
STIFFNESS, TORQUE_STIFFNESS = (800.0, 20.0), (1600.0, 40.0)
#: Lead of the goal where the limit itself is the torque command [rad].
FAR = 1.0
#: Shares of friction and damping that are fed forward, and the speed of full friction [rad/s], as
#: in the default law; filter of the velocity [s].
FRICTION_SHARE, DAMPING_SHARE, FRICTION_SPEED, FILTER = 0.9, 0.8, 0.05, 0.02


@dataclass(frozen=True)
class Goals:
    """Goals (n,) [rad] and torque limits (n,) [N·m]."""

    goal: Array
    torque_limit: Array


class Joints:
    """Resistance of gears: dry friction and damping at a filtered velocity."""

    def __init__(self, model: pliant.Model, period: float) -> None:
        """Take the servo table of a model and a control period [s]."""
        table = servos(model)
        self._friction = np.asarray(table.friction)
        self._damping = np.asarray(table.damping)
        self._period = period

    def reset(self, q: Array) -> None:
        """Start at rest in q (n,) [rad]."""
        self._before, self.velocity = q.copy(), np.zeros(q.size)

    def see(self, q: Array) -> None:
        """Process a reading (n,) [rad]."""
        raw = (q - self._before) / self._period
        self.velocity += self._period / (FILTER + self._period) * (raw - self.velocity)
        self._before = q.copy()

    def resistance(self, friction: float, damping: float) -> Array:
        """Return the torque (n,) [N·m] of shares of friction and damping at this velocity."""
        dry = self._friction * np.tanh(self.velocity / FRICTION_SPEED)
        return friction * dry + damping * self._damping * self.velocity


class JointPosition:
    """Inverse kinematics and stiff servos, at full torque or at a fraction of it."""

    def __init__(self, model: pliant.Model, period: float, *, fraction: float = 1.0) -> None:
        """Take the arm; `fraction` of the servos' torque is the limit of every joint."""
        self._model = model
        self._limit = fraction * np.asarray(servos(model).max_torque)

    def reset(self, q: Array) -> None:
        """Start in q (n,) [rad]."""
        self._goal = q.copy()

    def step(self, q: Array, target: Array) -> Goals:
        """Follow the pose (4, 4) of the target, whatever the arm does."""
        self._goal = np.asarray(self._model.inverse_kinematics(target, self._goal).q)
        return Goals(self._goal, self._limit)


class Impedance:
    """A Cartesian spring ``τ = Jᵀ K e + g + N k (q_rest - q)``, optionally friction compensated.

    As a torque source it is an arm with torque-controlled joints: the goal is far ahead on the
    right side, so that the limit is the torque. As `servo` it is a goal ``q + τ/k_p`` at full
    limits.
    """

    def __init__(
        self,
        model: pliant.Model,
        period: float,
        *,
        soft: str = "y",
        stiffness: tuple[float, float] = STIFFNESS,
        spring: float = 0.0,
        servo: bool = False,
        compensated: bool = False,
    ) -> None:
        """Take the arm.

        Args:
            model: The arm, with its servos.
            period: Control period [s].
            soft: Axes with a `spring` of their own [N/m, N·m/rad].
            stiffness: Of the others [N/m, N·m/rad].
            spring: Of the soft axes.
            servo: True: through the goals of position servos instead of as torques.
            compensated: True: feed forward friction and damping of the servo table, in the same
                shares as the default law.
        """
        free = [name in soft.split() for name in AXES]
        self._spring = np.where(free, spring, np.repeat(stiffness, 3))
        self._model, self._servo = model, servo
        self._kp = np.asarray(servos(model).kp)
        self._torque = np.asarray(servos(model).max_torque)
        self._joints = Joints(model, period) if compensated else None

    def reset(self, q: Array) -> None:
        """Start in q (n,) [rad], the posture of the null space."""
        self._rest = q.copy()
        if self._joints is not None:
            self._joints.reset(q)

    def step(self, q: Array, target: Array) -> Goals:
        """Turn the pose error into torques."""
        pose, jacobian = self._model.kinematics(q)
        force = self._spring * np.asarray(pliant.functional.pose_error(pose, target))
        inverse = np.linalg.pinv(jacobian)
        null = self._rest - q
        null = null - inverse @ (jacobian @ null)
        torque = jacobian.T @ force + self._model.gravity(q) + 0.1 * self._kp * null
        if self._joints is not None:
            self._joints.see(q)
            torque = torque + self._joints.resistance(FRICTION_SHARE, DAMPING_SHARE)
        if self._servo:
            return Goals(q + torque / self._kp, self._torque)
        return Goals(q + np.copysign(FAR, torque), np.minimum(np.abs(torque), self._torque))


def stiff_joints() -> FromModel:
    """Return position control of the joints at full torque."""
    return JointPosition


def uniform_limit(fraction: float) -> FromModel:
    """Return position control of the joints, every limit at a fraction of the torque."""
    return partial(JointPosition, fraction=fraction)


def torque_impedance(
    *,
    soft: str = "y",
    stiffness: tuple[float, float] = TORQUE_STIFFNESS,
    spring: float = 0.0,
    compensated: bool = False,
) -> FromModel:
    """Return ideal impedance; to be run at 1 kHz."""
    return partial(
        Impedance, soft=soft, stiffness=stiffness, spring=spring, compensated=compensated
    )


def servo_impedance(*, soft: str = "y", stiffness: tuple[float, float] = STIFFNESS) -> FromModel:
    """Return impedance through the goals of position servos."""
    return partial(Impedance, soft=soft, stiffness=stiffness, servo=True)
