"""Environment of one simulated arm at a task."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces

from pliant.gym._arms import Arms

if TYPE_CHECKING:
    from pliant._typing import Array
    from pliant.gym.soft_action import SoftAction
    from pliant.gym.tasks import Task


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
        self._arms = Arms(task, action, 1)
        self.action = self._arms.action
        self.action_space: spaces.Space[Any] = action_space(self._arms)
        self.observation_space: spaces.Space[dict[str, Any]] = observation_space(self._arms)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode with new random parameters."""
        super().reset(seed=seed)
        self._arms.reset(0, self.np_random)
        return self._observation(), self._arms.info(0)

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Run the controller for one period of the decision rate."""
        assert self._arms.episodes[0] is not None, "call reset() first"
        rewards, success, failure = self._arms.step(np.asarray(action)[None], np.array([True]))
        end = bool(success[0] or failure[0])
        return self._observation(), float(rewards[0]), end, False, self._arms.info(0)

    def _observation(self) -> dict[str, Array]:
        return {name: rows[0] for name, rows in self._arms.observation().items()}


def action_space(arms: Arms) -> spaces.Box:
    """Return the space of the actions of one arm."""
    return spaces.Box(-1.0, 1.0, (arms.action_size,), np.float32)


def observation_space(arms: Arms) -> spaces.Dict:
    """Return the space of the observations of one arm."""
    return spaces.Dict(
        {
            name: spaces.Box(-np.inf, np.inf, (size,), np.float64)
            for name, size in arms.sizes.items()
        }
    )
