"""Sources of the arm for the browser page: a configuration, or a scene with a simulated arm."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from pliant._core import ConfigError
from pliant.arm import Arm
from pliant.config import connect
from pliant.config.factory import table_fixtures
from pliant.config.loader import builtin_text, list_arms, parse
from pliant.config.schema import resolve_path
from pliant.drive import MonotonicClock
from pliant.loop import LatenessHistogram
from pliant.sim import Plant, SimDrive
from pliant.sim.postures import task_axes
from pliant.view.scenes import scenes

if TYPE_CHECKING:
    from pathlib import Path

    from pliant._core import Settings
    from pliant.config import Config
    from pliant.drive import Clock
    from pliant.view.scenes import Scene


@dataclass(kw_only=True)
class Source(ABC):
    """Base class of objects that create the arm for each run of a `Session`.

    Attributes:
        where: `simulated`, or the backend of the configuration.
        axes: Names of the task axes, separated by spaces.
        rate: Control rate [Hz].
        paced: True: a simulation must be slowed down to real time.
        settings: Initial settings; None: those of the preset of the scene.
        scenes: Scenes by name; empty for a configuration.
        name: Name of the present scene; empty for a configuration.
        config: The configuration; None for a simulated scene.
        urdf: Path of the URDF; None for a URDF in the package.
        table: Height of the table under the arm, base axes [m]; None: unknown.
    """

    where: str
    axes: str
    rate: float
    paced: bool
    settings: Settings | None = None
    scenes: Mapping[str, Scene] = field(default_factory=dict)
    name: str = ""
    config: Config | None = None
    urdf: Path | None = None
    table: float | None = None

    @property
    def scene(self) -> Scene | None:
        """The present scene; None for a configuration, which has no scenes."""
        return self.scenes.get(self.name)

    @abstractmethod
    def arm(self) -> Arm:
        """Return a new arm; its torque is not switched on."""


class Simulated(Source):
    """A built-in arm in a simulated scene, on the table of its ready configuration.

    Args:
        robot: Name of the built-in arm.
        scene: Name of the initial scene.
        rate: Control rate [Hz].
        paced: True: simulate in real time; False: as fast as possible.

    Raises:
        ConfigError: The arm or scene does not exist.
    """

    def __init__(
        self, robot: str, scene: str = "free", rate: float = 100.0, *, paced: bool = True
    ) -> None:
        """Load the model of the arm, and its scenes."""
        self.model, known = scenes(robot)
        if scene not in known:
            raise ConfigError(f"{robot} has no scene {scene!r}; it has {', '.join(known)}")
        axes = " ".join(task_axes(self.model.n))
        self._file = parse(builtin_text(robot)) if robot in list_arms() else None
        super().__init__(
            where="simulated",
            axes=axes,
            rate=rate,
            paced=paced,
            scenes=known,
            name=scene,
            table=None if self._file is None else self._file.robot.table,
        )

    def arm(self) -> Arm:
        """Return the arm in a new simulation of the present scene."""
        scene = self.scenes[self.name]
        table = [] if self._file is None else table_fixtures(self._file)
        plant = Plant(self.model, rate=self.rate, scene=[*table, *scene.make()])
        plant.reset(scene.q)
        return Arm(self.model, SimDrive(plant), rate=self.rate)


class Configured(Source):
    """The arm of a configuration file, on the backend that the file names.

    Args:
        config: The configuration.
        **options: Options of `pliant.Arm` that override those of the file.
    """

    def __init__(self, config: Config, **options: Any) -> None:
        """Take settings and paths from the configuration; no port is opened."""
        settings, path = config.settings(), config.robot.urdf
        super().__init__(
            where=config.backend,
            axes=settings.task.axes,
            rate=config.loop.rate,
            paced=config.backend == "sim",
            settings=settings,
            config=config,
            urdf=None if path is None else resolve_path(config, path),
            table=config.robot.table,
        )
        self._connect = partial(connect, config, **options)

    def arm(self) -> Arm:
        """Return a new arm of the configuration; enable it only after the last one has closed."""
        return self._connect()


#: Lag of a simulation behind real time above which it does not catch up the excess [s].
MAX_LATENESS = 0.03
#: Time window over which the speed of the simulation is measured [s].
SPEED_WINDOW = 2.0


class RealtimePacer:
    """Makes a simulation run in real time, by waiting after every reading of the drive.

    If the computer is too slow, the simulation runs in slow motion, and no tick is missed.

    Attributes:
        lateness: Histogram of the lateness of readings behind real time.
    """

    def __init__(self, clock: Clock) -> None:
        """Start at the present time of `clock`, the clock of the simulation."""
        self._clock, self._wall = clock, MonotonicClock()
        self._offset = self._wall.now() - clock.now()
        self._history: deque[tuple[float, float]] = deque([(self._wall.now(), clock.now())])
        self.lateness = LatenessHistogram()

    def wait(self) -> None:
        """Wait until real time has reached simulated time.

        If the simulation is late by more than `MAX_LATENESS`, the excess is never caught up.
        """
        now = self._clock.now()
        lateness = self._wall.now() - (now + self._offset)
        self.lateness.add(lateness)
        if lateness > MAX_LATENESS:
            self._offset += lateness - MAX_LATENESS
        else:
            self._wall.wait_until(now + self._offset)
        self._history.append((time.perf_counter(), now))
        while self._history[-1][0] - self._history[0][0] > SPEED_WINDOW:
            self._history.popleft()

    @property
    def speed(self) -> float:
        """Simulated seconds per real second over the last `SPEED_WINDOW` [1]; at most 1."""
        (wall, first), (end, last) = self._history[0], self._history[-1]
        return min((last - first) / (end - wall), 1.0) if end - wall > 0.5 * SPEED_WINDOW else 1.0
