"""Scenes of a simulated arm for the browser page: start posture, objects, scripted target."""

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


#: Speed of the scripted target [m/s].
TARGET_SPEED = 0.06
#: Travel of the scripted target that pulls a door or drawer [m].
PULL_DISTANCE = 0.26
#: Pause of the scripted target before it returns [s].
REST_TIME = 1.5
#: Start postures (joint positions) of small arms [rad]: the gripper is in front of the base, and
#: every joint can move in both directions.
START_POSTURES = {"so101": (0.0, -0.3, 0.3, 0.9, 0.0), "koch": (0.0, -0.3, 0.3, 0.9, 0.0)}
#: Travel of the scripted target toward the wall [m].
WALL_TRAVEL = 0.12
#: Initial distance of the tool from the wall [m].
WALL_DISTANCE = 0.05
#: Force of a simulated person who takes the object from the gripper: start after the click on the
#: button, time in which the force rises, and duration, all [s].
TAKE_PROFILE = ForceProfile(start=0.3, rise=1.5, end=30.0)
#: Force of the simulated person before the click: its times are after the end of any run [s].
NO_FORCE = ForceProfile(start=1e9, rise=1.0, end=2e9)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One scene of a simulated arm.

    Attributes:
        about: Description in one sentence.
        preset: Name of the preset with the initial settings.
        q: Joint positions at the start (n,) [rad].
        make: Function that returns the objects around the arm.
        play: Label of the button that starts the action of the scene; empty: no action.
        displacement: Motion of the scripted target from the start pose, before it returns (3,) [m];
            None: no scripted target.
    """

    about: str
    preset: str
    q: Array
    make: Callable[[], list[Hand | Fixture]] = field(default=list)
    play: str = ""
    displacement: tuple[float, float, float] | None = None

    def target(self, home: Array, time: float) -> Array | None:
        """Return the scripted target (4, 4) at a time [s] after the click; None after its end.

        The target moves by `displacement` from the pose `home` (4, 4), pauses, and returns.
        """
        if self.displacement is None:
            return None
        distance = float(np.linalg.norm(self.displacement))
        travel_time = distance / TARGET_SPEED
        if time > 2.0 * travel_time + REST_TIME:
            return None
        moving_time = min(time, travel_time) - min(
            max(time - travel_time - REST_TIME, 0.0), travel_time
        )
        pose = home.copy()
        pose[:3, 3] += np.asarray(self.displacement) * moving_time * TARGET_SPEED / distance
        return pose


def scenes(robot: str) -> tuple[Model, Mapping[str, Scene]]:
    """Return a built-in arm and its scenes by name; some scenes exist only for `arm7`.

    Raises:
        ConfigError: No built-in arm has this name.
    """
    if robot != "arm7":
        model = robots.load(robot)
        return model, generic_scenes(start_posture(robot, model))
    generic = generic_scenes(VERTICAL)
    door_scene = Scene(
        about="The hand holds the handle; y and yaw give way, so the handle finds its own path.",
        preset="door",
        q=AT_DOOR,
        make=lambda: [door()],
        play="Pull it open",
        displacement=(-PULL_DISTANCE, 0.0, 0.0),
    )
    drawer_scene = Scene(
        about="Its slide is 10° off the pull; y and z follow it.",
        preset="drawer",
        q=AT_DOOR,
        make=lambda: [drawer(axis=_slide_direction(10.0))],
        play="Pull it open",
        displacement=(-PULL_DISTANCE, 0.0, 0.0),
    )

    handover_scene = Scene(
        about="It carries an unknown 0.3 kg, and opens its hand once pulled 5 cm away.",
        preset="hand_over",
        q=VERTICAL,
        make=lambda: [HandoverObject(course=NO_FORCE)],
        play="A person takes it",
    )
    return robots.arm7(), {
        "free": generic["free"],
        "door": door_scene,
        "drawer": drawer_scene,
        "wall": generic["wall"],
        "hand-over": handover_scene,
    }


def start_posture(robot: str, model: Model) -> Array:
    """Return the joint positions (n,) [rad] of an arm at the start of a scene.

    They are those in `START_POSTURES`, or else halfway between the position limits.
    """
    if robot in START_POSTURES:
        return np.array(START_POSTURES[robot])
    # Clip the limits to ±π, so that a joint without position limits starts at 0.
    middle: Array = np.clip((model.lower, model.upper), -np.pi, np.pi).mean(axis=0)
    return middle


def generic_scenes(q: Array) -> Mapping[str, Scene]:
    """Return the scenes that suit any arm, by name; q: joint positions at the start (n,) [rad]."""
    return {
        "free": Scene(
            about="Nothing around it: push the arm, or drag its target.", preset="soft y", q=q
        ),
        "wall": Scene(
            about="A stiff wall 5 cm ahead: the push-back on x ends at its cap.",
            preset="soft x",
            q=q,
            make=lambda: [Wall(distance=WALL_DISTANCE, damping=20.0)],
            play="Run into it",
            displacement=(WALL_TRAVEL, 0.0, 0.0),
        ),
    }


def take_object(plant: Plant) -> bool:
    """Let a simulated person take the object in the gripper; return False if there is no object."""
    for fixture in plant.fixtures:
        if isinstance(fixture, HandoverObject):
            start = plant.time + TAKE_PROFILE.start
            fixture.course = ForceProfile(
                start=start, rise=TAKE_PROFILE.rise, end=start + TAKE_PROFILE.end
            )
            return True
    return False


def release_when_pulled(plant: Plant, home: Array) -> None:
    """Open the gripper once the person has pulled the tool `RELEASE_DISTANCE` away from `home`.

    `home` is the start pose of the tool (4, 4).
    """
    for fixture in plant.fixtures:
        if isinstance(fixture, HandoverObject) and fixture.released is None:
            is_pulled = np.linalg.norm(plant.tool[:3, 3] - home[:3, 3]) > RELEASE_DISTANCE
            if is_pulled and plant.time > fixture.course.start:
                fixture.release(plant)


def wall_planes(plant: Plant) -> tuple[tuple[Array, Array], ...]:
    """Return a point (3,) [m] and the normal (3,) into the wall, for every wall of the scene."""
    out = []
    for record in plant.hands:
        if isinstance(record.hand, Wall):
            into = np.asarray(record.hand.into, dtype=np.float64)
            start = plant.ground_truth.frame(record.hand.at).start
            out.append((start + record.hand.distance * into, into))
    return tuple(out)


def _slide_direction(degrees: float) -> tuple[float, float, float]:
    """Return the unit vector of the motion of a drawer: -x turned about -z by an angle [deg]."""
    angle = np.deg2rad(degrees)
    return -float(np.cos(angle)), float(np.sin(angle)), 0.0
