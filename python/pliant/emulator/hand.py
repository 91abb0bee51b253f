"""Simulated hand of a person who guides an emulated arm, with or without torque."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from pliant._core import Model
    from pliant.sim import Plant
    from pliant.sim._model_builder import Build

    Motion = Callable[[float], Mapping[str, float]]

#: Stiffness of the hand's grip, as natural frequency of a joint's inertia on that spring [rad/s].
GRIP = 30.0
#: Largest torque of the hand on a joint, in addition to the torque that holds the arm [N·m].
MAX_TORQUE = 1.0
#: Amplitude of the motion `wave` [rad].
AMPLITUDE = 0.3
#: Period of the first joint in the motion `wave`, and its increase from joint to joint [s].
PERIOD, PERIOD_STEP = 4.0, 0.7
#: Duration of the transition from the initial joint positions to the motion [s].
TAKE_TIME = 3.0
#: Times in the motion `ranges` [s]: all joints stay in mid-range for `MIDDLE_TIME`; then each joint
#: in turn moves through its range and back in `RANGE_TIME`.
MIDDLE_TIME, RANGE_TIME = 20.0, 6.0


class JointHand:
    """Simulated hand that moves joints along a motion and holds their weight.

    A damped spring of bounded torque pulls each joint. A servo with torque on resists the hand.

    Args:
        motion: Function of the time since the hand took hold [s] that returns joint positions by
            name [rad]; the hand does not touch other joints.
        interval: Time at which the hand takes hold and time at which it lets go [s], counted from
            the time at which all joints of the chain first had torque. None: it holds the arm from
            the start on, also without torque, and never lets go.

    Raises:
        ConfigError: The times are not finite, not in order, or negative.
    """

    def __init__(self, motion: Motion, *, interval: tuple[float, float] | None = None) -> None:
        if interval is not None and not 0.0 <= interval[0] < interval[1] < math.inf:
            raise ConfigError(
                f"a hand holds the arm from a time >= 0 s to a later one, got {interval[0]:g} s to "
                f"{interval[1]:g} s"
            )
        self._motion, self.interval = motion, interval
        self._start: dict[str, float] = {}
        self._inertia: dict[str, float] = {}

    def add(self, build_spec: Build) -> None:
        """Add nothing: the hand has no body."""

    def place(self, plant: Plant) -> None:
        """Release the joints at a reset; the next step starts from their new positions."""
        self._start = {}

    def before(self, plant: Plant) -> None:
        """Do nothing before a physics step."""

    def after(self, plant: Plant) -> None:
        """Do nothing after a physics step."""

    def during(self, plant: Plant) -> None:
        """Apply the hand's torques, which also hold the weight, to the joints for one step."""
        model, data = plant.mj_model, plant.mj_data
        begin, end = (0.0, math.inf) if self.interval is None else self.interval
        # The time of an arm that is held until its torque comes on starts only then.
        if not begin <= data.time < end:
            return
        time = data.time - begin
        targets = self._motion(time)
        if not self._start:
            self._take_hold(plant, targets)
        progress = _smooth(time / TAKE_TIME)
        for name, target in targets.items():
            dof = int(model.joint(name).dofadr[0])
            position, speed = float(data.joint(name).qpos[0]), float(data.qvel[dof])
            goal = self._start[name] + progress * (target - self._start[name])
            torque = self._inertia[name] * GRIP * (GRIP * (goal - position) - 2.0 * speed)
            torque = min(max(torque, -MAX_TORQUE), MAX_TORQUE)
            data.qfrc_applied[dof] += torque + float(data.qfrc_bias[dof])

    def _take_hold(self, plant: Plant, names: Iterable[str]) -> None:
        """Store the present position and inertia of each joint.

        The grip's stiffness is proportional to the inertia, which keeps the simulation stable.
        """
        from pliant.sim._mujoco import mujoco

        model, data = plant.mj_model, plant.mj_data
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        for name in names:
            i = int(model.joint(name).dofadr[0])
            self._start[name], self._inertia[name] = float(data.joint(name).qpos[0]), mass[i, i]


def wave(model: Model, start: Mapping[str, float]) -> Motion:
    """Return a motion in which every joint oscillates about its start, each with its own period.

    Args:
        model: The robot, for the position limits.
        start: Initial joint positions by name [rad].
    """
    limits = _limits(model)

    def motion(time: float) -> dict[str, float]:
        out = {}
        for number, (name, middle) in enumerate(start.items()):
            low, high = limits.get(name, (-math.inf, math.inf))
            period = PERIOD + PERIOD_STEP * number
            position = middle + AMPLITUDE * math.sin(2.0 * math.pi * time / period)
            out[name] = min(max(position, low), high)
        return out

    return motion


def ranges(model: Model, start: Mapping[str, float]) -> Motion:
    """Return a motion for calibration: all joints in mid-range, then each joint end to end.

    Args:
        model: The robot, for the position limits.
        start: Initial joint positions by name [rad]; a joint without limits stays there.
    """
    limits = {name: ends for name, ends in _limits(model).items() if name in start}
    middle = dict(start) | {name: 0.5 * (low + high) for name, (low, high) in limits.items()}

    def motion(time: float) -> dict[str, float]:
        out = dict(middle)
        if time > MIDDLE_TIME and limits:
            number, within = divmod((time - MIDDLE_TIME) / RANGE_TIME, 1.0)
            name = list(limits)[int(number) % len(limits)]
            low, high = limits[name]
            out[name] += 0.5 * (high - low) * math.sin(2.0 * math.pi * within)
        return out

    return motion


def _limits(model: Model) -> dict[str, tuple[float, float]]:
    """Return lower and upper position limit by joint name, for joints with finite limits."""
    return {
        joint.name: (joint.lower, joint.upper)
        for joint in model.joints
        if joint.lower is not None
        and joint.upper is not None
        and math.isfinite(joint.upper - joint.lower)
    }


def _smooth(share: float) -> float:
    """Return ``3 s² - 2 s³`` for s = `share` clipped to [0, 1]: a smooth rise from 0 to 1."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)
