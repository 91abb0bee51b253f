"""Tasks of the environments: scene, start, progress and force."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pliant import sim
from pliant.sim.postures import AT_DOOR, VERTICAL

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array
    from pliant.sim import Plant

#: Angle of an open door [rad].
OPEN = float(np.deg2rad(60.0))
#: Force band in which a touch of a surface counts as progress [N].
TOUCH = (2.0, 10.0)


@dataclass(frozen=True)
class Episode:
    """One episode of a task.

    Attributes:
        scene: Objects of `pliant.sim.Plant`, with the episode's random parameters.
        parameters: The random parameters, for `info`.
    """

    scene: Sequence[Any]
    parameters: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """A task: the scene of an episode, its start and its measure of progress.

    The reward of a step is the increase of progress, minus ``force_weight (F / free_force - 1)``
    per second while the force F on the tool exceeds `free_force`, plus 1 at success or minus 1 at
    failure.

    Attributes:
        seconds: Length of an episode [s].
        decision_rate: Steps of the environment per second [Hz].
        free_force: Force on the tool that does not reduce the reward [N].
        force_weight: Reduction of the reward per second at twice this force [1/s].
        max_force: Force at which an episode ends in failure [N].
    """

    seconds: float = 8.0
    decision_rate: float = 20.0
    free_force: float = 15.0
    force_weight: float = 0.1
    max_force: float = 150.0
    #: Axes whose softness an action sets.
    soft: ClassVar[str] = "y yaw"
    #: Initial joint positions of `arm7` (7,) [rad].
    start: ClassVar[Array] = VERTICAL
    #: True if the scene is one object on a joint in the arm's grip, whose forces MuJoCo computes
    #: without Python: one MuJoCo call then runs a whole control period, without `measure`.
    native: ClassVar[bool] = False

    @abstractmethod
    def episode(self, rng: np.random.Generator) -> Episode:
        """Return an episode with random parameters."""

    @abstractmethod
    def progress(self, before: Array, move: Array, place: Array, force: Array, dt: float) -> Array:
        """Return the progress of all arms after a control tick.

        Args:
            before: Progress before the tick (N,), 0 at the start and 1 at success.
            move: Change of `place` in the tick (N,).
            place: First value of `measure` (N,); if `native`, position of the grasped object's
                joint.
            force: Force on the tool (N,) [N].
            dt: Length of the tick [s].
        """

    def measure(self, episode: Episode, plant: Plant) -> tuple[float, float]:
        """Return, for one arm, the coordinate that determines progress, and the tool force [N].

        The coordinate is a position or depth of the tool or of the object.
        """
        raise NotImplementedError


def _count_touch(force: Array, before: Array, gain: Array | float) -> Array:
    """Return the progress with `gain` for each arm whose force is within the band `TOUCH`."""
    touches = (TOUCH[0] <= force) & (force <= TOUCH[1])
    return np.where(touches, np.minimum(before + gain, 1.0), before)


@dataclass(frozen=True, kw_only=True)
class Door(Task):
    """Open a door of unknown radius and friction by 60°; its handle is in a rigid grip.

    Attributes:
        radius: Least and largest distance of the handle from the hinge [m].
        friction: Least and largest dry friction of the hinge [N·m].
    """

    radius: tuple[float, float] = (0.2, 0.45)
    friction: tuple[float, float] = (0.2, 3.0)
    start: ClassVar[Array] = AT_DOOR
    native: ClassVar[bool] = True

    def episode(self, rng: np.random.Generator) -> Episode:
        """Return an episode with a closed door that opens toward the arm."""
        radius, friction = rng.uniform(*self.radius), rng.uniform(*self.friction)
        door = sim.Door(hinge=(0.0, -radius, 0.0), friction=friction, grip="rigid")
        return Episode([door], {"radius": radius, "friction": friction})

    def progress(self, before: Array, move: Array, place: Array, force: Array, dt: float) -> Array:
        """Return the progress from the opening angle."""
        return np.maximum(before, np.minimum(place / OPEN, 1.0))


@dataclass(frozen=True, kw_only=True)
class Drawer(Task):
    """Pull a drawer open by 0.2 m; its slide is not parallel to the x axis.

    Attributes:
        angle: Largest horizontal angle between slide and x axis [deg].
        friction: Least and largest dry friction of the slide [N].
    """

    angle: float = 20.0
    friction: tuple[float, float] = (1.0, 8.0)
    start: ClassVar[Array] = AT_DOOR

    def episode(self, rng: np.random.Generator) -> Episode:
        """Return a closed drawer."""
        angle, friction = rng.uniform(-self.angle, self.angle), rng.uniform(*self.friction)
        axis = (-float(np.cos(np.deg2rad(angle))), float(np.sin(np.deg2rad(angle))), 0.0)
        return Episode(
            [sim.drawer(axis=axis, friction=friction)], {"angle": angle, "friction": friction}
        )

    def progress(self, before: Array, move: Array, place: Array, force: Array, dt: float) -> Array:
        """Return the progress from the opening."""
        return np.minimum(place / 0.2, 1.0)

    def measure(self, episode: Episode, plant: Plant) -> tuple[float, float]:
        """Return the widest opening [m], and the force in the grip."""
        (box,) = episode.scene
        return float(box.widest), float(np.linalg.norm(box.force))


@dataclass(frozen=True, kw_only=True)
class Wall(Task):
    """Find a wall at an unknown distance and touch it with 2 to 10 N for 2 s.

    Attributes:
        distance: Least and largest distance of the wall along x [m].
        stiffness: Least and largest stiffness of the wall [N/m]; drawn on a logarithmic scale.
    """

    distance: tuple[float, float] = (0.02, 0.10)
    stiffness: tuple[float, float] = (1e3, 3e4)
    soft: ClassVar[str] = "x"

    def episode(self, rng: np.random.Generator) -> Episode:
        """Return a wall perpendicular to x."""
        distance = rng.uniform(*self.distance)
        stiffness = float(np.exp(rng.uniform(*np.log(self.stiffness))))
        wall = sim.Wall(distance=distance, stiffness=stiffness)
        return Episode([wall], {"distance": distance, "stiffness": stiffness})

    def progress(self, before: Array, move: Array, place: Array, force: Array, dt: float) -> Array:
        """Return the progress from the time within the force band."""
        return _count_touch(force, before, dt / 2.0)

    def measure(self, episode: Episode, plant: Plant) -> tuple[float, float]:
        """Return 0 and the force of the wall."""
        return 0.0, float(np.linalg.norm(plant.hands[0].force))


@dataclass(frozen=True, kw_only=True)
class Wipe(Task):
    """Wipe 0.3 m of an uneven surface along y, with a force of 2 to 10 N.

    Attributes:
        unevenness: Least and largest amplitude of the surface's height [m].
        below: Least and largest distance of the surface below the tool at the start [m].
    """

    unevenness: tuple[float, float] = (0.0, 0.012)
    below: tuple[float, float] = (0.005, 0.03)
    soft: ClassVar[str] = "z roll pitch"

    def episode(self, rng: np.random.Generator) -> Episode:
        """Return a surface below the tool."""
        unevenness, below = rng.uniform(*self.unevenness), rng.uniform(*self.below)
        surface = sim.Surface(unevenness=unevenness, below=below)
        return Episode([surface], {"unevenness": unevenness, "below": below})

    def progress(self, before: Array, move: Array, place: Array, force: Array, dt: float) -> Array:
        """Return the progress from the distance along y within the force band."""
        return _count_touch(force, before, np.abs(move) / 0.3)

    def measure(self, episode: Episode, plant: Plant) -> tuple[float, float]:
        """Return the tool's position along y [m], and the force of the surface."""
        return float(plant.tool[1, 3]), float(np.linalg.norm(plant.hands[0].force))


@dataclass(frozen=True, kw_only=True)
class Plug(Task):
    """Insert a plug 28 mm deep into a hole that is offset and tilted by an unknown amount.

    Attributes:
        offset: Largest offset of the hole along x and y [m].
        tilt: Largest tilt of the hole about x and y [deg].
    """

    offset: float = 0.003
    tilt: float = 2.0
    soft: ClassVar[str] = "x y z roll pitch"

    def episode(self, rng: np.random.Generator) -> Episode:
        """Return a hole 20 mm below the plug."""
        x, y = rng.uniform(-self.offset, self.offset, 2)
        roll, pitch = np.deg2rad(rng.uniform(-self.tilt, self.tilt, 2))
        hole = sim.Socket(offset=(x, y, -0.02), tilt=(roll, pitch, 0.0))
        return Episode([hole], {"x": x, "y": y, "roll": float(roll), "pitch": float(pitch)})

    def progress(self, before: Array, move: Array, place: Array, force: Array, dt: float) -> Array:
        """Return the progress from the depth."""
        return np.clip(place / 0.028, 0.0, 1.0)

    def measure(self, episode: Episode, plant: Plant) -> tuple[float, float]:
        """Return the largest depth [m], and the force of the contacts."""
        (hole,) = episode.scene
        return float(hole.deepest), float(hole.force)
