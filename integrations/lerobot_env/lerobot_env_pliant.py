"""Tasks of `pliant.gym` as environments of LeRobot: ``--env.type=pliant --env.task=Door-v0``.

LeRobot imports this module by its name and finds the configuration registered here.
"""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGE, OBS_STATE

import pliant
from pliant.gym import Door, Drawer, Plug, SoftAction, TaskEnv, Wall, Wipe
from pliant.gym.tasks import Task

#: Tasks by the name of their class, with the text that a policy reads.
TASKS: dict[str, tuple[type[Task], str]] = {
    "Door": (Door, "Open the door."),
    "Drawer": (Drawer, "Pull the drawer open."),
    "Plug": (Plug, "Insert the plug into the hole."),
    "Wall": (Wall, "Touch the wall lightly."),
    "Wipe": (Wipe, "Wipe the surface."),
}
#: Observations of `pliant.gym` in each vector of LeRobot.
PARTS = {
    "agent_pos": ("q", "dq", "tool"),
    "environment_state": ("deviation", "force", "uncertainty", "caps"),
}
#: Rate of the controller [Hz].
RATE = 100


class LeRobotTask(gymnasium.ObservationWrapper[Any, Any, Any]):
    """A task with LeRobot's names of observations.

    Args:
        env: The task.
        description: Text that a policy reads.
        pixels: True: a camera image is part of the observation.
    """

    def __init__(self, env: TaskEnv, description: str, *, pixels: bool) -> None:
        super().__init__(env)
        self.task_description = self.task = description
        self._pixels = pixels
        parts_space: Any = env.observation_space
        sizes = {name: space.shape[0] for name, space in parts_space.items()}
        self.observation_space = spaces.Dict(
            {
                name: spaces.Box(-np.inf, np.inf, (sum(sizes[part] for part in parts),), np.float32)
                for name, parts in PARTS.items()
            }
        )
        if pixels:
            size = (*env.picture_size, 3)
            self.observation_space["pixels"] = spaces.Box(0, 255, size, np.uint8)

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Return the vectors of `PARTS` (float32), and the camera image if `pixels` is True."""
        out: dict[str, Any] = {
            name: np.concatenate([observation[part] for part in parts]).astype(np.float32)
            for name, parts in PARTS.items()
        }
        if self._pixels:
            out["pixels"] = self.env.render()
        return out


@EnvConfig.register_subclass("pliant")
@dataclass
class PliantEnv(EnvConfig):
    """Configuration of a task of `pliant.gym`.

    Attributes:
        task: `Door-v0`, `Drawer-v0`, `Plug-v0`, `Wall-v0` or `Wipe-v0`.
        fps: Actions per second [Hz], a divisor of 100.
        seconds: Length of an episode [s].
        motion: Meaning of the first entries of an action: `twist`, `pose` or `joints`.
        soft: Axes whose softness is part of the action, as "y yaw"; None: those of the task.
        obs_type: `state`, or `pixels_state` with a camera image.
        observation_width, observation_height: Size of the images [pixel].

    Raises:
        ConfigError: A field names something that does not exist, or a number is out of range.
    """

    task: str | None = "Door-v0"
    fps: int = 20
    seconds: float = 8.0
    motion: str = "twist"
    soft: str | None = None
    obs_type: str = "state"
    observation_width: int = 320
    observation_height: int = 240

    def __post_init__(self) -> None:
        """Check the fields, and take the sizes of action and observation from the task."""
        known = [f"{name}-v0" for name in TASKS]
        if self.task not in known:
            raise pliant.ConfigError(f"task {self.task!r}; choose from {', '.join(known)}")
        if self.fps < 1 or RATE % self.fps:
            raise pliant.ConfigError(f"fps = {self.fps} Hz does not divide {RATE} Hz: use 10 or 20")
        if not self.seconds > 0.0:
            raise pliant.ConfigError(f"seconds must be above 0 s, got {self.seconds:g}")
        if self.obs_type not in ("state", "pixels_state"):
            raise pliant.ConfigError(f"obs_type {self.obs_type!r}; choose from state, pixels_state")
        env: Any = make_task(**self._options)
        states = {"agent_pos": FeatureType.STATE, "environment_state": FeatureType.ENV}
        kinds = {**states, "pixels": FeatureType.VISUAL}
        self.features = {ACTION: PolicyFeature(FeatureType.ACTION, env.action_space.shape)} | {
            name: PolicyFeature(kinds[name], space.shape)
            for name, space in env.observation_space.items()
        }
        self.features_map = {
            ACTION: ACTION,
            "agent_pos": OBS_STATE,
            "environment_state": OBS_ENV_STATE,
            "pixels": OBS_IMAGE,
        }

    @property
    def package_name(self) -> str:
        """Name of the module that registers the tasks."""
        return __name__

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `gymnasium.make`."""
        return self._options | {"max_episode_steps": round(self.seconds * self.fps)}

    @property
    def _options(self) -> dict[str, Any]:
        return {
            "task": str(self.task).removesuffix("-v0"),
            "fps": self.fps,
            "seconds": self.seconds,
            "motion": self.motion,
            "soft": self.soft,
            "pixels": self.obs_type == "pixels_state",
            "width": self.observation_width,
            "height": self.observation_height,
        }


def make_task(
    task: str,
    *,
    fps: int,
    seconds: float,
    motion: Any,
    soft: str | None,
    pixels: bool,
    width: int,
    height: int,
) -> LeRobotTask:
    """Return a task, from which `lerobot-eval` can render a video; arguments as in `PliantEnv`."""
    kind, description = TASKS[task]
    env = TaskEnv(
        kind(seconds=seconds, decision_rate=float(fps)),
        action=SoftAction(soft=kind.soft if soft is None else soft, motion=motion),
        render_mode="rgb_array",
        width=width,
        height=height,
    )
    return LeRobotTask(env, description, pixels=pixels)


for _task in TASKS:
    gymnasium.register(id=f"{__name__}/{_task}-v0", entry_point=f"{__name__}:make_task")
