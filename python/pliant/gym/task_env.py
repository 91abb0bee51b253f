"""Environment of one simulated arm at a task."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces

from pliant._core import ConfigError
from pliant._validation import vector
from pliant.gym._arms import Arms
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant._typing import Array
    from pliant.gym.soft_action import SoftAction
    from pliant.gym.tasks import Task


class TaskEnv(gymnasium.Env[dict[str, "Array"], "Array"]):
    """A policy moves the target of `arm7` and chooses the softness of some axes.

    Each step runs the compliant controller at 100 Hz for one period of the task's decision rate.
    Observations are a `Dict` of float64 arrays: `q` (7,) [rad]; `dq` (7,) [rad/s]; `tool` (9,), the
    position in base axes [m] and the first two columns of the rotation matrix; `deviation` of the
    target from the tool (6,) [m, rad]; `force` (6,) and its `uncertainty` (6,) [N, N·m], estimated
    without a force sensor; and `caps`, the present caps of the soft axes [N, N·m]. `info` contains
    the true `force` [N], `progress`, `is_success` and the random parameters of the scene.

    Args:
        task: The task.
        action: Mapping of actions; None: twist and the softness of the task's axes.
        render_mode: "rgb_array": `render` returns pictures; None: no pictures.
        width, height: Size of the pictures [pixel].

    Attributes:
        picture_size: Height and width of the pictures [pixel].

    Raises:
        ConfigError: `action` names an axis twice or an axis that does not exist, there is no such
            render mode, or a picture has no pixel.
    """

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - the name and the type are Gymnasium's

    def __init__(
        self,
        task: Task,
        *,
        action: SoftAction | None = None,
        render_mode: str | None = None,
        width: int = 320,
        height: int = 240,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f'render_mode {render_mode!r}; choose "rgb_array" or None')
        if min(width, height) < 1:
            raise ConfigError(f"pictures of {width} x {height} pixels: both must be at least 1")
        self.task, self.render_mode, self.picture_size = task, render_mode, (height, width)
        self.metadata = {**self.metadata, "render_fps": round(task.decision_rate)}
        self._renderer: Any = None
        self._arms = Arms(task, action, 1)
        self.action = self._arms.action
        self.action_space: spaces.Space[Any] = action_space(self._arms)
        self.observation_space: spaces.Space[dict[str, Any]] = observation_space(self._arms)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode with new random parameters."""
        super().reset(seed=seed)
        self.close()
        self._arms.reset(0, self.np_random)
        return self._observation(), self._arms.info(0)

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Run the controller for one decision period; see `gymnasium.Env.step` for the results.

        Raises:
            ShapeError: `action` has the wrong shape, or an entry is not finite; nothing has moved.
        """
        assert self._arms.episodes[0] is not None, "call reset() first"
        (size,) = self.action_space.shape or ()
        values = vector(action, size, "action")
        rewards, success, failure = self._arms.step(values[None], np.array([True]))
        end = bool(success[0] or failure[0])
        return self._observation(), float(rewards[0]), end, False, self._arms.info(0)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) of arm and scene; None without a render mode.

        Walls and surfaces are not visible, because they only exert forces.

        Raises:
            ConfigError: There is no display, and MuJoCo was not told to draw without one.
        """
        if self.render_mode is None:
            return None
        plant = self._arms.plants[0]
        assert plant is not None, "call reset() first"
        if self._renderer is None:
            _check_display()
            plant.mj_model.vis.headlight.ambient[:] = 0.6
            # MuJoCo's buffer for drawing has 640 x 480 pixels, if the model gives no other size.
            buffer = plant.mj_model.vis.global_
            buffer.offheight, buffer.offwidth = self.picture_size
            self._renderer = mujoco.Renderer(plant.mj_model, *self.picture_size)
            self._camera = mujoco.MjvCamera()
            self._camera.lookat[:], self._camera.distance = (0.25, 0.0, -0.18), 1.25
            self._camera.azimuth, self._camera.elevation = 130.0, -18.0
        self._renderer.update_scene(plant.mj_data, self._camera)
        picture: NDArray[np.uint8] = self._renderer.render()
        return picture

    def close(self) -> None:
        """Free the drawing context."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _observation(self) -> dict[str, Array]:
        return {name: rows[0] for name, rows in self._arms.observation().items()}


def _check_display() -> None:
    """Raise an error where MuJoCo's default way to draw aborts the process."""
    has_display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    chosen = os.environ.get("MUJOCO_GL", "glfw").lower()
    if sys.platform == "linux" and not has_display and chosen in ("", "glfw"):
        message = "no display to draw on: set MUJOCO_GL=egl (or osmesa) before Python starts"
        raise ConfigError(message)


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
