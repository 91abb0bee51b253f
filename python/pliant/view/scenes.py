"""Simulated scenes: where the arm stands, what is around it, what happens there."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

import pliant
from pliant.sim import Course, Handed, Wall, door, drawer
from pliant.sim.handed import OPENS
from pliant.sim.postures import AT_DOOR, VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from pliant.sim import Fixture, Hand, Plant

    Array = NDArray[np.float64]

#: Speed of a target that plays [m/s], how far it goes [m], and how long it rests there [s].
SPEED, WAY, REST = 0.06, 0.26, 1.5
#: Where small arms stand: the gripper ahead, with room to every side [rad].
AHEAD = {"so101": (0.0, -0.3, 0.3, 0.9, 0.0), "koch": (0.0, -0.3, 0.3, 0.9, 0.0)}
#: Way into the wall, and its distance [m].
INTO, DISTANCE = 0.12, 0.05
#: When a person who is asked takes the object, and how long the pull lasts [s].
TAKES = Course(start=0.3, rise=1.5, end=30.0)
#: Nobody takes anything yet.
NEVER = Course(start=1e9, rise=1.0, end=2e9)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One scene.

    Attributes:
        about: One sentence.
        preset: Name of the settings it begins with.
        q: Where the arm stands (n,) [rad].
        make: What is around it.
        play: What the button says; empty: there is none.
        way: Where the target goes and comes back from when it is played (3,) [m].
    """

    about: str
    preset: str
    q: Array
    make: Callable[[], list[Hand | Fixture]] = field(default=list)
    play: str = ""
    way: tuple[float, float, float] | None = None

    def target(self, home: Array, time: float) -> Array | None:
        """Target (4, 4) so long [s] after the button was pressed; None once it is over."""
        if self.way is None:
            return None
        length = float(np.linalg.norm(self.way))
        there = length / SPEED
        if time > 2.0 * there + REST:
            return None
        gone = min(time, there) - min(max(time - there - REST, 0.0), there)
        pose = home.copy()
        pose[:3, 3] += np.asarray(self.way) * gone * SPEED / length
        return pose


def scenes(robot: str) -> tuple[pliant.Model, Mapping[str, Scene]]:
    """A built-in arm and its scenes; doors and drawers were measured for `arm7` alone.

    Raises:
        ConfigError: No such arm.
    """
    if robot != "arm7":
        return pliant.robots.load(robot), of_any(np.array(AHEAD[robot]))
    free = Scene(
        about="Nothing around it: push the arm, or drag its target.", preset="soft y", q=VERTICAL
    )
    opens = Scene(
        about="The hand holds the handle; y and yaw give way, so the handle finds its own path.",
        preset="door",
        q=AT_DOOR,
        make=lambda: [door()],
        play="Pull it open",
        way=(-WAY, 0.0, 0.0),
    )
    slides = Scene(
        about="Its slide points 10° beside the pull; y and z follow it.",
        preset="drawer",
        q=AT_DOOR,
        make=lambda: [drawer(axis=_beside(10.0))],
        play="Pull it open",
        way=(-WAY, 0.0, 0.0),
    )
    meets = Scene(
        about="A stiff wall 5 cm ahead: the push-back on x ends at its cap.",
        preset="soft x",
        q=VERTICAL,
        make=lambda: [_wall()],
        play="Run into it",
        way=(INTO, 0.0, 0.0),
    )
    gives = Scene(
        about="It carries 0.3 kg that nobody told it of, and opens its hand once drawn 5 cm away.",
        preset="hand_over",
        q=VERTICAL,
        make=lambda: [Handed(course=NEVER)],
        play="A person takes it",
    )
    return pliant.robots.arm7(), {
        "free": free,
        "door": opens,
        "drawer": slides,
        "wall": meets,
        "hand-over": gives,
    }


def of_any(q: Array) -> Mapping[str, Scene]:
    """Scenes that suit any arm at a posture (n,) [rad]."""
    return {
        "free": Scene(
            about="Nothing around it: push the arm, or drag its target.", preset="soft y", q=q
        ),
        "wall": Scene(
            about="A stiff wall 5 cm ahead: the push-back on x ends at its cap.",
            preset="soft x",
            q=q,
            make=lambda: [_wall()],
            play="Run into it",
            way=(INTO, 0.0, 0.0),
        ),
    }


def take(plant: Plant) -> bool:
    """Let a person take what the arm holds; whether there is such a thing."""
    for thing in plant.fixtures:
        if isinstance(thing, Handed):
            start = plant.time + TAKES.start
            thing.course = Course(start=start, rise=TAKES.rise, end=start + TAKES.end)
            return True
    return False


def let_go_when_taken(plant: Plant, home: Array) -> None:
    """Open the hand once the tool was drawn away from where it began (4, 4)."""
    for thing in plant.fixtures:
        if isinstance(thing, Handed) and thing.released is None:
            taken = np.linalg.norm(plant.tool[:3, 3] - home[:3, 3]) > OPENS
            if taken and plant.time > thing.course.start:
                thing.release(plant)


def planes(plant: Plant) -> tuple[tuple[Array, Array], ...]:
    """Walls of the scene: a point (3,) and the direction (3,) into each."""
    out = []
    for felt in plant.hands:
        if isinstance(felt.hand, Wall):
            into = np.asarray(felt.hand.into, dtype=np.float64)
            start = plant.truth.frame(felt.hand.at).start
            out.append((start + felt.hand.distance * into, into))
    return tuple(out)


def _wall() -> Wall:
    return Wall(distance=DISTANCE, damping=20.0)


def _beside(degrees: float) -> tuple[float, float, float]:
    """Direction of a slide that opens toward the robot, turned in the horizontal plane."""
    angle = np.deg2rad(degrees)
    return -float(np.cos(angle)), float(np.sin(angle)), 0.0
