"""Gymnasium environments in which a policy chooses how soft the arm is (extra `gym`).

    >>> import gymnasium, pliant.gym
    >>> env = gymnasium.make("pliant/Door-v0")
    >>> observation, info = env.reset(seed=0)

The import registers `pliant/Door-v0`, `Drawer`, `Plug`, `Wall` and `Wipe`. An action moves the
target and sets one number per soft axis, from -1 (softest) to 1 (firm). Many arms in parallel:

    >>> envs = gymnasium.make_vec(
    ...     "pliant/Door-v0", num_envs=64, vectorization_mode="vector_entry_point"
    ... )
"""

from pliant._extras import missing

try:
    import gymnasium
except ImportError as error:
    raise ImportError(missing("pliant.gym", "gym")) from error

from pliant.gym.soft_action import SoftAction
from pliant.gym.task_env import TaskEnv
from pliant.gym.tasks import Door, Drawer, Episode, Plug, Task, Wall, Wipe
from pliant.gym.vector_env import VectorTaskEnv

__all__ = [
    "Door",
    "Drawer",
    "Episode",
    "Plug",
    "SoftAction",
    "Task",
    "TaskEnv",
    "VectorTaskEnv",
    "Wall",
    "Wipe",
]

for _task in (Door(), Drawer(), Plug(), Wall(), Wipe()):
    gymnasium.register(
        id=f"pliant/{type(_task).__name__}-v0",
        entry_point="pliant.gym:TaskEnv",
        vector_entry_point="pliant.gym:VectorTaskEnv",
        kwargs={"task": _task},
        max_episode_steps=round(_task.seconds * _task.decision_rate),
    )
