"""Sources of the arm behind a page: a configuration, or the simulator with its scenes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

from pliant._core import ConfigError
from pliant.arm import Arm
from pliant.config import connect
from pliant.config.schema import inside
from pliant.sim.postures import task_axes

if TYPE_CHECKING:
    from pathlib import Path

    from pliant._core import Settings
    from pliant.config import Config
    from pliant.view.scenes import Scene


class Source(Protocol):
    """Interface of a source of arms for a session.

    Attributes:
        where: `simulated`, or the backend of the joints.
        axes: Task axes.
        rate: Control rate [Hz].
        settings: Initial settings; None: a preset of the scene.
        scenes: Scenes by name; empty without.
        name: Name of the scene.
        config: The configuration; None without one.
        paced: True if its time is simulated and runs in step with real time.
        urdf: File of the arm's URDF; None if the package contains it.
        table: Height of the table under the arm [m]; None: not known.
    """

    where: str
    axes: str
    rate: float
    settings: Settings | None
    scenes: Mapping[str, Scene]
    name: str
    config: Config | None
    paced: bool
    urdf: Path | None
    table: float | None

    @property
    def scene(self) -> Scene | None:
        """The present scene, None without scenes."""

    def arm(self) -> Arm:
        """Return the arm, with its torque unchanged."""


class Simulated:
    """A built-in arm on the simulator, in one of its scenes.

    Args:
        robot: Its name.
        scene: Initial scene.
        rate: Control rate [Hz].
        paced: True: simulated time in step with real time; False: as fast as possible.
    """

    def __init__(
        self, robot: str, scene: str = "free", rate: float = 100.0, *, paced: bool = True
    ) -> None:
        """Load the arm and its scenes.

        Raises:
            ConfigError: The arm or scene does not exist.
        """
        from pliant.view.scenes import scenes

        self.where, self.rate = "simulated", rate
        self.settings: Settings | None = None
        self.config: Config | None = None
        self.paced = paced
        self.urdf: Path | None = None
        self.table: float | None = None
        self.model, self.scenes = scenes(robot)
        if scene not in self.scenes:
            raise ConfigError(f"{robot} has no scene {scene!r}; it has {', '.join(self.scenes)}")
        self.axes, self.name = " ".join(task_axes(self.model.n)), scene

    @property
    def scene(self) -> Scene | None:
        """The present scene."""
        return self.scenes[self.name]

    def arm(self) -> Arm:
        """Return an arm in a new simulation."""
        from pliant.sim import Plant, SimDrive

        scene = self.scenes[self.name]
        plant = Plant(self.model, rate=self.rate, scene=scene.make())
        plant.reset(scene.q)
        return Arm(self.model, SimDrive(plant), rate=self.rate)


class Configured:
    """The arm of a configuration, on its backend.

    Args:
        config: The configuration.
        **options: Options of `pliant.Arm`, in place of the file's.
    """

    def __init__(self, config: Config, **options: Any) -> None:
        """Read the configuration before any port is opened."""
        self.where: str = config.backend
        self.rate = config.loop.rate
        self.settings: Settings | None = config.settings()
        self.axes = self.settings.task.axes
        self.scenes: Mapping[str, Scene] = {}
        self.name, self.scene = "", None
        self.config: Config | None = config
        path = config.robot.urdf
        self.urdf: Path | None = None if path is None else inside(config, path)
        self.table: float | None = getattr(config.robot, "table", None)
        self._options, self.paced = options, config.backend == "sim"

    def arm(self) -> Arm:
        """Return the arm, on the port that the previous one has closed."""
        assert self.config is not None
        return connect(self.config, **self._options)
