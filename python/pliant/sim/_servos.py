"""Servos of a simulated arm: torques from goals and limits, and overload protection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError
from pliant._validation import instance
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant._typing import Array, Mask
    from pliant.sim._bus import Command
    from pliant.sim._model_builder import Build
    from pliant.sim._parameters import Gains


@dataclass(frozen=True, kw_only=True)
class Overload:
    """Overload protection of a servo: after a long overload it reduces the torque until a reset.

    Attributes:
        threshold: Share of the usable torque that counts as overload, in (0, 1].
        seconds: Duration of an overload above which the protection trips [s].
        remains: Share of the usable torque after a trip: 0 for Dynamixel, 0.2 for the STS3215.
    """

    threshold: float = 0.95
    seconds: float = 3.0
    remains: float = 0.0

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        if not 0.0 < self.threshold <= 1.0:
            raise ConfigError(f"Overload.threshold must be in (0, 1], got {self.threshold:g}")
        if not self.seconds >= 0.0:
            raise ConfigError(f"Overload.seconds must be at least 0 s, got {self.seconds:g}")
        if not 0.0 <= self.remains <= 1.0:
            raise ConfigError(f"Overload.remains must be in [0, 1], got {self.remains:g}")


class OverloadTrip:
    """State of the overload protection of all servos of the chain."""

    def __init__(self, n: int, rule: Overload | None) -> None:
        """Create the state of n servos that have not tripped; `rule` None: no protection."""
        self._rule = rule
        self._seconds = np.zeros(n)
        self.tripped = np.zeros(n, dtype=bool)

    def limit(
        self,
        limit: Array,
        torque: Array,
        usable: Array,
        period: float,
    ) -> Array:
        """Update the protection after a control period, and return the torque limits to apply.

        Args:
            limit: Commanded torque limits (n,) [N·m].
            torque: Mean servo torques in the last period (n,) [N·m].
            usable: Usable torques (n,) [N·m].
            period: Length of the period [s].

        Returns:
            Torque limits (n,) [N·m], reduced for servos whose protection has tripped.
        """
        if self._rule is None:
            return limit
        over = np.abs(torque) >= self._rule.threshold * usable - 1e-9
        self._seconds = np.where(over, self._seconds + period, 0.0)
        self.tripped |= self._seconds > self._rule.seconds
        return np.where(self.tripped, np.minimum(limit, self._rule.remains * usable), limit)


def check_overload(overload: Any | None) -> Overload | None:
    """Validate and return the overload protection of the servos, or None without protection."""
    kind = "e.g. Overload(threshold=0.95, seconds=3.0)"
    return None if overload is None else instance(overload, Overload, "overload", kind)


class ServoBank:
    """Servos of the n chain joints and of off-chain joints in a compiled MuJoCo model.

    Attributes:
        torque: Mean torque of the chain's servos over the last control period (n,) [N·m], without
            friction and damping of the gears.
        held: Rest goal [rad] and largest torque [N·m] of each off-chain joint with a servo, by
            name.
        needs_drive: True if `drive` must be called before every physics step.
    """

    def __init__(
        self,
        built: Build,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        gains: Gains,
        *,
        deadband: Array,
        overload: Overload | None,
    ) -> None:
        """Look up the joints and actuators of `built` in the compiled model."""
        self._model, self._data, self._gains = model, data, gains
        # Views of MuJoCo's memory: access through attributes of `data` takes longer than the sums.
        self._positions, self._speeds = data.qpos, data.qvel
        self._inputs, self._forces = data.ctrl, data.actuator_force
        self._ranges = model.actuator_forcerange
        joints = [model.joint(name) for name in built.chain]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dof = np.array([joint.dofadr[0] for joint in joints])
        self._servo = np.array([model.actuator(name).id for name in built.chain])
        first = int(self._servo[0])
        is_block = bool((np.diff(self._servo) == 1).all())
        # A slice of neighbours is accessed in a fraction of the time of an array of indices.
        self._block: slice | NDArray[np.int_] = self._servo
        if is_block:
            self._block = slice(first, first + self._servo.size)
        self.held = {
            name: (rest, float(model.actuator(name).forcerange[1]))
            for name, rest in built.held.items()
        }
        # MuJoCo's indices of position and actuator of these joints: a look-up by name is slow.
        self._held_at = {
            name: (int(model.joint(name).qposadr[0]), int(model.actuator(name).id))
            for name in self.held
        }
        self._deadband, self._overload = deadband, overload
        self.needs_drive = bool(deadband.any())

    def reset(self, q: Array) -> None:
        """Set the chain to the positions q (n,) [rad] and other joints to their rest angles."""
        n = q.size
        self._positions[self._qpos] = q
        for name, (rest, _) in self.held.items():
            self._positions[self._held_at[name][0]] = rest
        self._place_followers()
        self._trip = OverloadTrip(n, self._overload)
        self.torque, self._sum, self._steps = np.zeros(n), np.zeros(n), 0

    def _place_followers(self) -> None:
        """Set each mimic joint to the angle that follows from the angle of its driving joint."""
        model, qpos = self._model, self._data.qpos
        for i in range(model.neq):
            if model.eq_type[i] != mujoco.mjtEq.mjEQ_JOINT:
                continue
            follower, driver = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
            angle = float(qpos[model.jnt_qposadr[driver]]) if driver >= 0 else 0.0
            offset, slope = model.eq_data[i, :2]
            qpos[model.jnt_qposadr[follower]] = offset + slope * angle

    @property
    def addresses(self) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """MuJoCo's indices of degrees of freedom (n,) and actuators (n,) of the chain's joints."""
        return self._dof, self._servo

    @property
    def q(self) -> Array:
        """True joint positions (n,) [rad]."""
        q: Array = self._positions[self._qpos]
        return q

    @property
    def dq(self) -> Array:
        """True joint velocities (n,) [rad/s]."""
        dq: Array = self._speeds[self._dof]
        return dq

    @property
    def tripped(self) -> Mask:
        """Mask (n,) of the servos whose overload protection has tripped."""
        return self._trip.tripped.copy()

    def angles(self) -> dict[str, float]:
        """Return the positions of the off-chain joints by name [rad]."""
        return {name: float(self._positions[at]) for name, (at, _) in self._held_at.items()}

    def apply(self, command: Command, period: float) -> None:
        """Set goals and torque limits of the servos from a command, at the start of a period.

        `period` is the control period [s].
        """
        usable = self._gains.torque
        limit = self._trip.limit(command.limit, self.torque, usable, period)
        force, servo = self._ranges, self._block
        force[servo, 0], force[servo, 1] = -limit, limit
        self._goal = command.goal
        self._inputs[servo] = command.goal
        for name, (goal, max_limit) in command.extra.items():
            index = self._held_at[name][1]
            force[index] = (-max_limit, max_limit)
            self._inputs[index] = goal
        self._sum[:] = 0.0
        self._steps = 0

    def drive(self) -> None:
        """Set the inputs of servos with a dead band; called before a step if `needs_drive`.

        The input is the goal, moved toward the position by at most the dead band.
        """
        error = np.maximum(self._goal - self.q, -self._deadband)
        np.minimum(error, self._deadband, out=error)
        self._inputs[self._block] = self._goal - error

    def count(self) -> None:
        """Add the servo torques of a physics step to the sum for the mean of the control period."""
        self._sum += self._forces[self._block]
        self._steps += 1

    def run(self, steps: int) -> None:
        """Run physics steps without external forces, and add the servo torques of each."""
        model, data, forces, servo = self._model, self._data, self._forces, self._block
        total, step = self._sum, mujoco.mj_step
        for _ in range(steps):
            step(model, data)
            total += forces[servo]
        self._steps += steps

    def close(self) -> None:
        """End the control period: set `torque` to the mean over its physics steps."""
        self.torque = self._sum / max(self._steps, 1)
