"""Environment of many simulated arms at one task; one batch steps their controllers."""

from __future__ import annotations

import itertools
import os
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from pliant._core import ConfigError
from pliant.gym._arms import Arms
from pliant.gym.task_env import action_space, observation_space

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array, Mask
    from pliant.gym.soft_action import SoftAction
    from pliant.gym.tasks import Task


class VectorTaskEnv(gymnasium.vector.VectorEnv[dict[str, "Array"], "Array", Any]):
    """Many arms of `TaskEnv` in one process: threads run MuJoCo, `step_batch` the controllers.

    Spaces, rewards, episodes and `info` are those of `gymnasium.vector.SyncVectorEnv` over
    `TaskEnv`, bit for bit: ``reset(seed=s)`` gives arm i the seed ``s + i``.

    Args:
        task: The task.
        num_envs: Number of arms.
        action: Mapping of actions; None: twist and the softness of the task's axes.
        autoreset_mode: Step in which an arm starts its next episode: `NextStep` or `SameStep`.
            `Disabled`: the arm stands still with reward 0 and unchanged flags, until a `reset` of
            all arms or of those in ``options={"reset_mask": mask}``.
        max_episode_steps: Steps after which an episode is truncated; None: no limit.
        threads: Number of threads; None: one per core.
        render_mode: Must be None: there are no pictures.

    Raises:
        ConfigError: A number is out of range, or `action` names an axis that does not exist.
    """

    def __init__(
        self,
        task: Task,
        *,
        num_envs: int = 1,
        action: SoftAction | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        for name, value in (("num_envs", num_envs), ("threads", threads)):
            if value is not None and value < 1:
                raise ConfigError(f"{name} must be at least 1, got {value}")
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            known = ", ".join(mode.value for mode in AutoresetMode)
            message = f"autoreset_mode {autoreset_mode!r}; choose from {known}"
            raise ConfigError(message) from None
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.task, self.num_envs, self.render_mode = task, num_envs, render_mode
        self._max_steps = max_episode_steps
        count = min(threads or os.cpu_count() or 1, num_envs)
        # Each thread steps its own block of arms, so that threads wait for each other once per
        # step.
        bounds = [num_envs * i // count for i in range(count + 1)]
        self._blocks = [slice(a, b) for a, b in itertools.pairwise(bounds)]
        self._arms = [Arms(task, action, block.stop - block.start) for block in self._blocks]
        self._pool = ThreadPoolExecutor(count) if count > 1 else None
        self.action = self._arms[0].action
        self.single_action_space = action_space(self._arms[0])
        self.single_observation_space = observation_space(self._arms[0])
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._rngs: list[np.random.Generator] = []
        self._parameters: dict[str, Array] = {}
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._ended, self._terminated, self._truncated = np.zeros((3, num_envs), dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start new episodes: of all arms, or of those in the mask ``options["reset_mask"]``.

        Args:
            seed: Seed s, from which arm i gets s + i; or one seed per arm. None: the random
                generators continue.
            options: ``{"reset_mask": mask}`` with a mask (N,), not all False.

        Raises:
            ConfigError: The mask or the number of seeds is invalid.
        """
        mask = self._reset_mask(options)
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise ConfigError(f"seed has {len(seeds)} entries for {self.num_envs} arms")
        if not self._rngs:
            self._rngs = [seeding.np_random()[0] for _ in range(self.num_envs)]
        for row, own in enumerate(seeds or ()):
            if own is not None and mask[row]:
                self._rngs[row], _ = seeding.np_random(own)
        infos: dict[str, Any] = {}
        self._restart(mask, infos)
        return self._observation(), infos

    def step(self, actions: Array) -> tuple[dict[str, Array], Array, Mask, Mask, dict[str, Any]]:
        """Run the controllers of all arms for one period of the decision rate.

        Raises:
            ConfigError: There was no `reset` yet, or `actions` has the wrong shape, or an entry for
                an arm that moves is not finite; nothing has moved.
        """
        if not self._rngs:
            raise ConfigError("step before reset: call reset() first")
        mode = self.autoreset_mode
        actions = np.asarray(actions, dtype=np.float64)
        if actions.shape != self.action_space.shape:
            wanted = self.action_space.shape
            raise ConfigError(f"actions have shape {actions.shape}, expected {wanted}")
        moving = ~self._ended
        wrong = moving & ~np.isfinite(actions).all(axis=1)
        if wrong.any():
            raise ConfigError(f"the action of arm {int(wrong.argmax())} has an entry NaN or inf")
        rewards, success, failure = self._step(actions, moving)
        rewards = np.where(moving, rewards, 0.0)
        self._steps[moving] += 1
        terminated = (success | failure) & moving
        truncated = np.zeros(self.num_envs, dtype=bool)
        if self._max_steps is not None:
            truncated = (self._steps >= self._max_steps) & moving
        if mode is AutoresetMode.DISABLED:
            terminated, truncated = terminated | self._terminated, truncated | self._truncated
            self._terminated, self._truncated = terminated, truncated
        ended = terminated | truncated
        if mode is AutoresetMode.SAME_STEP:
            infos = self._infos(~ended)
            last = self._observation() if ended.any() else {}
            for row in np.flatnonzero(ended).tolist():
                arms, own = self._place(row)
                final = {name: values[row].copy() for name, values in last.items()}
                self._add_info(infos, {"final_obs": final, "final_info": arms.info(own)}, row)
            self._restart(ended, infos)
        else:
            infos = self._infos(moving | (mode is AutoresetMode.DISABLED))
            if mode is AutoresetMode.NEXT_STEP:
                self._restart(self._ended.copy(), infos)
            self._ended = ended
        return self._observation(), rewards, terminated.copy(), truncated.copy(), infos

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def _step(self, actions: Array, rows: Mask) -> tuple[Array, Mask, Mask]:
        """Step the arms `rows` (N,), block by block; return rewards, success and failure (N,)."""

        def run(i: int) -> tuple[Array, Mask, Mask]:
            block = self._blocks[i]
            return self._arms[i].step(actions[block], rows[block])

        if self._pool is None:
            return run(0)
        parts = list(self._pool.map(run, range(len(self._blocks))))
        rewards, success, failure = (np.concatenate(part) for part in zip(*parts, strict=True))
        return rewards, success, failure

    def _restart(self, rows: Mask, infos: dict[str, Any]) -> None:
        """Start new episodes of the arms `rows` (N,), and add their `info` to `infos`."""
        for row in np.flatnonzero(rows).tolist():
            arms, own = self._place(row)
            arms.reset(own, self._rngs[row])
            info = arms.info(own)
            self._add_info(infos, info, row)
            for name in info.keys() - {"force", "progress", "is_success"}:
                self._parameters.setdefault(name, np.zeros(self.num_envs))[row] = info[name]
        self._steps[rows] = 0
        for flags in (self._ended, self._terminated, self._truncated):
            flags[rows] = False

    def _infos(self, rows: Mask) -> dict[str, Any]:
        """Return the `info` of the arms `rows` (N,), as `_add_info` does row by row, but faster."""
        if not rows.any():
            return {}
        progress = np.concatenate([arms.progress() for arms in self._arms])
        values = {
            "force": np.concatenate([arms.force for arms in self._arms]),
            "progress": progress,
            "is_success": progress >= 1.0,
            **self._parameters,
        }
        infos: dict[str, Any] = {}
        every = bool(rows.all())
        for name, value in values.items():
            here = value.copy() if every else np.where(rows, value, np.zeros((), value.dtype))
            infos[name], infos[f"_{name}"] = here, rows.copy()
        return infos

    def _observation(self) -> dict[str, Array]:
        parts = [arms.observation() for arms in self._arms]
        if len(parts) == 1:
            return parts[0]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _place(self, row: int) -> tuple[Arms, int]:
        """Return the block that holds arm `row`, and the arm's index in it."""
        i = next(i for i, block in enumerate(self._blocks) if row < block.stop)
        return self._arms[i], row - self._blocks[i].start

    def _reset_mask(self, options: dict[str, Any] | None) -> Mask:
        """Return the mask (N,) of the arms to reset."""
        if options is None or "reset_mask" not in options:
            return np.ones(self.num_envs, dtype=bool)
        mask = np.asarray(options["reset_mask"])
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ConfigError(
                f"reset_mask must be a mask ({self.num_envs},) of bool that is not all False, got "
                f"shape {mask.shape} of {mask.dtype}"
            )
        return mask
