"""Sources of the arm behind a page: a configuration, or the simulator with its scenes."""

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
from pliant.config.schema import inside
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
    """Source of the arms of a session.

    Attributes:
        where: `simulated`, or the backend of the joints.
        axes: Task axes.
        rate: Control rate [Hz].
        paced: True if its time is simulated and runs in step with real time.
        settings: Initial settings; None: a preset of the scene.
        scenes: Scenes by name; empty without.
        name: Name of the scene.
        config: The configuration; None without one.
        urdf: File of the arm's URDF; None if the package contains it.
        table: Height of the table under the arm [m]; None: not known.
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
        """The present scene, None without scenes."""
        return self.scenes.get(self.name)

    @abstractmethod
    def arm(self) -> Arm:
        """Return the arm, with its torque unchanged."""


class Simulated(Source):
    """A built-in arm on the simulator, in one of its scenes.

    Args:
        robot: Its name.
        scene: Initial scene.
        rate: Control rate [Hz].
        paced: True: simulated time in step with real time; False: as fast as possible.

    Raises:
        ConfigError: The arm or scene does not exist.
    """

    def __init__(
        self, robot: str, scene: str = "free", rate: float = 100.0, *, paced: bool = True
    ) -> None:
        """Load the arm and its scenes."""
        self.model, known = scenes(robot)
        if scene not in known:
            raise ConfigError(f"{robot} has no scene {scene!r}; it has {', '.join(known)}")
        axes = " ".join(task_axes(self.model.n))
        super().__init__(
            where="simulated", axes=axes, rate=rate, paced=paced, scenes=known, name=scene
        )

    def arm(self) -> Arm:
        """Return an arm in a new simulation."""
        scene = self.scenes[self.name]
        plant = Plant(self.model, rate=self.rate, scene=scene.make())
        plant.reset(scene.q)
        return Arm(self.model, SimDrive(plant), rate=self.rate)


class Configured(Source):
    """The arm of a configuration, on its backend.

    Args:
        config: The configuration.
        **options: Options of `pliant.Arm`, in place of the file's.
    """

    def __init__(self, config: Config, **options: Any) -> None:
        """Read the configuration before any port is opened."""
        settings, path = config.settings(), config.robot.urdf
        super().__init__(
            where=config.backend,
            axes=settings.task.axes,
            rate=config.loop.rate,
            paced=config.backend == "sim",
            settings=settings,
            config=config,
            urdf=None if path is None else inside(config, path),
            table=config.robot.table,
        )
        self._connect = partial(connect, config, **options)

    def arm(self) -> Arm:
        """Return the arm, on the port that the previous one has closed."""
        return self._connect()


#: Largest delay that is caught up [s]; the rest of a longer delay is not.
SLACK = 0.03
#: Time window of the speed measurement [s].
WINDOW = 2.0


class RealtimePacer:
    """Waits after every reading until real time has caught up with the simulation.

    If the computer is too slow, the simulation runs in slow motion and no tick is missed.

    Attributes:
        lateness: Lateness of every reading.
    """

    def __init__(self, clock: Clock) -> None:
        """Start now."""
        self._clock, self._wall = clock, MonotonicClock()
        self._lag = self._wall.now() - clock.now()
        self._seen: deque[tuple[float, float]] = deque([(self._wall.now(), clock.now())])
        self.lateness = LatenessHistogram()

    def wait(self) -> None:
        """Sleep, or accept the delay if the simulation is late."""
        now = self._clock.now()
        late = self._wall.now() - (now + self._lag)
        self.lateness.add(late)
        if late > SLACK:
            self._lag += late - SLACK
        else:
            self._wall.wait_until(now + self._lag)
        self._seen.append((time.perf_counter(), now))
        while self._seen[-1][0] - self._seen[0][0] > WINDOW:
            self._seen.popleft()

    @property
    def speed(self) -> float:
        """Return the simulated seconds per real second, over the last two seconds."""
        (wall, first), (end, last) = self._seen[0], self._seen[-1]
        return min((last - first) / (end - wall), 1.0) if end - wall > 0.5 * WINDOW else 1.0
