"""Simulated scenes: posture of the arm, surroundings, scripted events."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pliant import robots
from pliant._core import Model
from pliant.sim import ForceProfile, HandoverObject, Wall, door, drawer
from pliant.sim.grasp import RELEASE_DISTANCE
from pliant.sim.postures import AT_DOOR, VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pliant._typing import Array
    from pliant.sim import Fixture, Hand, Plant


#: Speed of a scripted target [m/s], its distance [m], and its rest at the end [s].
SPEED, WAY, REST = 0.06, 0.26, 1.5
#: Postures of small arms: gripper ahead, with room on all sides [rad].
AHEAD = {"so101": (0.0, -0.3, 0.3, 0.9, 0.0), "koch": (0.0, -0.3, 0.3, 0.9, 0.0)}
#: Distance of the target's motion into the wall, and of the wall [m].
INTO, DISTANCE = 0.12, 0.05
#: Time course of a person who takes the object [s].
TAKES = ForceProfile(start=0.3, rise=1.5, end=30.0)
#: Time course before that: no force.
NEVER = ForceProfile(start=1e9, rise=1.0, end=2e9)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One scene.

    Attributes:
        about: One sentence.
        preset: Name of the initial settings.
        q: Initial posture (n,) [rad].
        make: Makes the surroundings.
        play: Label of the button; empty: no button.
        way: Displacement of the scripted target, there and back (3,) [m].
    """

    about: str
    preset: str
    q: Array
    make: Callable[[], list[Hand | Fixture]] = field(default=list)
    play: str = ""
    way: tuple[float, float, float] | None = None

    def target(self, home: Array, time: float) -> Array | None:
        """Return the target (4, 4) at a time [s] after the button was pressed; None at the end."""
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


def scenes(robot: str) -> tuple[Model, Mapping[str, Scene]]:
    """Return a built-in arm and its scenes; only `arm7` has doors and drawers.

    Raises:
        ConfigError: No such arm.
    """
    if robot != "arm7":
        return robots.load(robot), generic_scenes(np.array(AHEAD[robot]))
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
        about="Its slide is 10° off the pull; y and z follow it.",
        preset="drawer",
        q=AT_DOOR,
        make=lambda: [drawer(axis=_slide_direction(10.0))],
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
        about="It carries an unknown 0.3 kg, and opens its hand once pulled 5 cm away.",
        preset="hand_over",
        q=VERTICAL,
        make=lambda: [HandoverObject(course=NEVER)],
        play="A person takes it",
    )
    return robots.arm7(), {
        "free": free,
        "door": opens,
        "drawer": slides,
        "wall": meets,
        "hand-over": gives,
    }


def generic_scenes(q: Array) -> Mapping[str, Scene]:
    """Return scenes for any arm at a posture (n,) [rad]."""
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
    """Let a person take the object in the grip; return False without one."""
    for thing in plant.fixtures:
        if isinstance(thing, HandoverObject):
            start = plant.time + TAKES.start
            thing.course = ForceProfile(start=start, rise=TAKES.rise, end=start + TAKES.end)
            return True
    return False


def release_when_pulled(plant: Plant, home: Array) -> None:
    """Open the grip once the tool was pulled away from its start (4, 4)."""
    for thing in plant.fixtures:
        if isinstance(thing, HandoverObject) and thing.released is None:
            taken = np.linalg.norm(plant.tool[:3, 3] - home[:3, 3]) > RELEASE_DISTANCE
            if taken and plant.time > thing.course.start:
                thing.release(plant)


def wall_planes(plant: Plant) -> tuple[tuple[Array, Array], ...]:
    """Return the walls of the scene: a point (3,) and the direction (3,) into each."""
    out = []
    for record in plant.hands:
        if isinstance(record.hand, Wall):
            into = np.asarray(record.hand.into, dtype=np.float64)
            start = plant.ground_truth.frame(record.hand.at).start
            out.append((start + record.hand.distance * into, into))
    return tuple(out)


def _wall() -> Wall:
    return Wall(distance=DISTANCE, damping=20.0)


def _slide_direction(degrees: float) -> tuple[float, float, float]:
    """Return the direction of a slide toward the robot, turned in the horizontal plane."""
    angle = np.deg2rad(degrees)
    return -float(np.cos(angle)), float(np.sin(angle)), 0.0
