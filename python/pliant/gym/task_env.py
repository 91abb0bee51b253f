"""Environment of one simulated arm at a task."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces

from pliant import robots
from pliant._core import Axis, ContactEstimator, Controller, Settings
from pliant.gym.soft_action import SoftAction, holding_forces
from pliant.sim import Plant

if TYPE_CHECKING:
    from pliant._typing import Array
    from pliant.gym.tasks import Episode, Task

#: Rate of the controller [Hz].
RATE = 100.0
#: Largest distance of the target from the tool [m], [rad]: it does not run away from a blocked arm.
LEASH = (0.08, 0.5)
#: Bounds of the observed force [N] and torque [N·m], which is unknown in the first tick.
MAX_WRENCH = np.array([100.0] * 3 + [20.0] * 3)


class TaskEnv(gymnasium.Env[dict[str, "Array"], "Array"]):
    """A policy moves the target of `arm7` and chooses the softness of some axes.

    Each step runs the compliant controller at 100 Hz for one period of the task's decision rate.
    Observations are a `Dict` of float64 arrays: `q` (7,) [rad], `dq` (7,) [rad/s], `tool` (9,):
    position in base axes [m] and the first two columns of the rotation matrix, `deviation` of the
    target from the tool (6,) [m, rad], `force` (6,) and its `uncertainty` (6,) [N, N·m] as the
    contact estimator sees them, without a force sensor, and the present `caps` of the soft axes
    [N, N·m]. `info` holds the true `force` [N], `progress`, `is_success` and the scene's random
    parameters.

    Args:
        task: The task.
        action: Mapping of actions; None: twist and the softness of the task's axes.
        render_mode: None: there are no pictures; see `pliant view` for one.

    Raises:
        ConfigError: `action` names an axis twice or one that does not exist.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - the name and the type are Gymnasium's

    def __init__(
        self, task: Task, *, action: SoftAction | None = None, render_mode: str | None = None
    ) -> None:
        self.task, self.render_mode = task, render_mode
        self.action = SoftAction(soft=task.soft) if action is None else action
        self._model = robots.arm7()
        self._settings = Settings(rate=RATE)
        self._axes = self._settings.task.names
        self._hold = holding_forces(self._model, self._settings)
        self._ticks = round(RATE / task.decision_rate)
        size = self.action.size(self._model, self._axes)
        self.action_space: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (size,), np.float32)
        n, soft = self._model.n, len(self.action.axes(self._axes))
        wide = {
            "q": n, "dq": n, "tool": 9, "deviation": 6, "force": 6, "uncertainty": 6, "caps": soft
        }  # fmt: skip
        self.observation_space: spaces.Space[dict[str, Any]] = spaces.Dict(
            {name: spaces.Box(-np.inf, np.inf, (size,), np.float64) for name, size in wide.items()}
        )
        self._episode: Episode | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode with new random parameters."""
        super().reset(seed=seed)
        self._episode = self.task.episode(self.np_random)
        self._plant = Plant(
            self._model,
            scene=self._episode.scene,
            rate=RATE,
            seed=int(self.np_random.integers(2**31)),
        )
        self._plant.reset(self.task.start)
        q = self._plant.read().q
        softest = -np.ones(len(self.action.axes(self._axes)))
        settings = self.action.softened(self._settings, self._hold, softest)
        self._controller = Controller(self._model, settings)
        self._controller.reset(q)
        self._contact = ContactEstimator(self._controller)
        self._target = np.asarray(self._model.forward_kinematics(q))
        self._softness, self._force, self._dq = softest, np.zeros(12), np.zeros(q.size)
        self._force[6:] = MAX_WRENCH
        return self._observation(q), self._info(0.0)

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Run the controller for one period of the decision rate."""
        assert self._episode is not None, "call reset() first"
        given = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        moved, self._softness = np.split(given, [given.size - self._softness.size])
        settings = self.action.softened(self._settings, self._hold, self._softness)
        self._controller.update(settings)
        before, cost, largest = self._episode.progress, 0.0, 0.0
        dt = 1.0 / RATE
        q = self._plant.read().q
        joints = self._start_motion(moved, q)
        for _ in range(self._ticks):
            reading = self._plant.read()
            felt = self._contact.update(reading.q, dt=dt)
            self._dq, q = np.asarray(felt.velocity), reading.q
            self._force = np.concatenate([felt.force, np.minimum(felt.uncertainty, MAX_WRENCH)])
            if joints is not None:
                command = self._controller.step_joints(reading.q, joints, dt=dt)
            else:
                if self.action.motion == "twist":
                    self._move(moved * self.action.scales(self._axes) * dt, reading.q)
                command = self._controller.step(reading.q, self._target, dt=dt)
            self._plant.write(command.goal, command.torque_limit)
            self._plant.advance()
            self.task.update(self._episode, self._plant, dt)
            excess = max(self._episode.force - self.task.free_force, 0.0) / self.task.free_force
            cost += self.task.force_weight * excess * dt
            largest = max(largest, self._episode.force)
        success, failure = self._episode.progress >= 1.0, largest > self.task.max_force
        reward = self._episode.progress - before - cost + float(success) - float(failure)
        return self._observation(q), reward, success or failure, False, self._info(largest)

    def _start_motion(self, moved: Array, q: Array) -> Array | None:
        """Set the target of a `pose` action; return the joint targets (7,) of a `joints` action."""
        if self.action.motion == "joints":
            wanted = q + 0.1 * self.action.max_speed[1] * moved
            return np.clip(wanted, self._model.lower, self._model.upper)
        if self.action.motion == "pose":
            self._target = np.asarray(self._model.forward_kinematics(q))
            self._move(moved * self.action.scales(self._axes) * 0.1, q)
        return None

    def _move(self, change: Array, q: Array) -> None:
        """Move the target along the base axes (6,) [m, rad], no farther than the leash."""
        tool = np.asarray(self._model.forward_kinematics(q))
        target = self._target.copy()
        offset = target[:3, 3] + change[:3] - tool[:3, 3]
        target[:3, 3] = tool[:3, 3] + np.clip(offset, -LEASH[0], LEASH[0])
        turned = _rotation(change[3:]) @ target[:3, :3]
        if _angle(turned @ tool[:3, :3].T) <= LEASH[1]:
            target[:3, :3] = turned
        self._target = target

    def _observation(self, q: Array) -> dict[str, Array]:
        """Return the observation at joint positions q (7,) [rad]."""
        tool = np.asarray(self._model.forward_kinematics(q))
        axes: dict[str, Axis] = dict(self._controller.axes.items())
        names = self.action.axes(self._axes)
        difference = self._target[:3, :3] @ tool[:3, :3].T
        return {
            "q": q.copy(),
            "dq": self._dq.copy(),
            "tool": np.concatenate([tool[:3, 3], tool[:3, 0], tool[:3, 1]]),
            "deviation": np.concatenate(
                [self._target[:3, 3] - tool[:3, 3], _rotation_vector(difference)]
            ),
            "force": self._force[:6].copy(),
            "uncertainty": self._force[6:].copy(),
            "caps": np.array(
                [np.max(np.asarray(axes[name].soft, dtype=np.float64)) for name in names]
            ),
        }

    def _info(self, force: float) -> dict[str, Any]:
        """Return what the policy does not see."""
        assert self._episode is not None
        return {
            "force": force,
            "progress": self._episode.progress,
            "is_success": self._episode.progress >= 1.0,
            **self._episode.parameters,
        }


def _rotation(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out: Array = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return out


def _angle(rotation: Array) -> float:
    """Return the angle of a rotation matrix [rad]."""
    return float(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0)))


def _rotation_vector(rotation: Array) -> Array:
    """Return the rotation vector (3,) [rad] of a rotation matrix by less than half a turn."""
    angle = _angle(rotation)
    axis = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    return 0.5 * axis * (angle / np.sin(angle) if angle > 1e-6 else 1.0)
