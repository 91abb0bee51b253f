"""Admittance control driven by motor current: an alternative method on position servos.

The external wrench is estimated from the motors' currents, and a virtual mass and damper turn it
into a motion of the target, which stiff position servos follow. The idea is that of controllers for
arms that report their current and have no force sensor; the code and the numbers are ours.

The current does not show friction: at rest the motor torque may be anywhere within the friction
band around the load. The estimate therefore needs a dead zone, which is the force to start a
motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments.baselines import Goals, Joints
from experiments.setups import AXES, servos

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from experiments.conditions import FromModel

    Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Current:
    """Error model of a servo's reported current.

    Attributes:
        noise: Standard deviation of a reading, as a share of the largest torque.
        count: One count of the register, as a share of the largest torque.
        filter: Time constant of the filter against the noise [s].
    """

    noise: float = 0.01
    count: float = 0.0005
    filter: float = 0.03


@dataclass(frozen=True, kw_only=True)
class Virtual:
    """The virtual body that the estimated force moves.

    Attributes:
        mass: [kg]
        damper: [N·s/m]
        spring: Toward the target [N/m].
        dead_zone: Force below which the estimate counts as zero [N].
        most_speed: Bound of the target's speed, as in the default law [m/s].
    """

    mass: float = 1.0
    damper: float = 20.0
    spring: float = 0.0
    dead_zone: float = 1.0
    most_speed: float = 0.25


class Admittance:
    """One soft translation; the other axes are stiff position control at full torque."""

    def __init__(
        self,
        model: pliant.Model,
        period: float,
        *,
        soft: str = "y",
        current: Current,
        virtual: Virtual,
        seed: int = 0,
    ) -> None:
        """Take the arm, its current sensors and the virtual body; `soft` is x, y or z."""
        self._model, self._period, self._axis = model, period, AXES.index(soft)
        self._current, self._virtual = current, virtual
        table = servos(model)
        self._limit, self._kp = np.asarray(table.max_torque), np.asarray(table.kp)
        self._joints = Joints(model, period)
        self._chance = np.random.default_rng(seed)

    def reset(self, q: Array) -> None:
        """Start at rest in q (n,) [rad]."""
        self._joints.reset(q)
        self._goal = q.copy()
        self._load = self._model.gravity(q)
        self._offset = self._speed = 0.0

    def listen(self, torque: Array) -> None:
        """Read the motors' torques (n,) [N·m] through their current sensors."""
        size, sensor = self._limit, self._current
        seen = torque + sensor.noise * size * self._chance.standard_normal(size.size)
        seen = np.round(seen / (sensor.count * size)) * sensor.count * size
        self._load = self._load + self._period / (sensor.filter + self._period) * (
            seen - self._load
        )

    def step(self, q: Array, target: Array) -> Goals:
        """Move the virtual body by the estimated force; follow it."""
        self._joints.see(q)
        _, jacobian = self._model.kinematics(q)
        gravity = self._model.gravity(q)
        external = gravity + self._joints.resistance(1.0, 1.0) - self._load
        force = float((np.linalg.pinv(jacobian.T) @ external)[self._axis])
        body = self._virtual
        felt = np.sign(force) * max(abs(force) - body.dead_zone, 0.0)
        pull = felt - body.damper * self._speed - body.spring * self._offset
        # Semi-implicit, because of a stiff damper at a slow rate.
        self._speed += pull * self._period / (body.mass + body.damper * self._period)
        self._speed = float(np.clip(self._speed, -body.most_speed, body.most_speed))
        self._offset += self._speed * self._period
        wanted = np.array(target)
        wanted[self._axis, 3] += self._offset
        self._goal = np.asarray(self._model.inverse_kinematics(wanted, self._goal).q)
        return Goals(self._goal + gravity / self._kp, self._limit)


def by_current(*, spring: float = 0.0, soft: str = "y", noise: float = Current.noise) -> FromModel:
    """Make an admittance controller driven by motor current.

    Args:
        spring: Toward the target [N/m].
        soft: The soft translation.
        noise: Of the current, as a share of the largest torque.
    """
    return partial(
        Admittance, soft=soft, current=Current(noise=noise), virtual=Virtual(spring=spring)
    )
