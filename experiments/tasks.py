"""The presets in their simulated scenes: drawer, surface, hand-over, plug."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from experiments.poses import displaced, pull, tool
from experiments.simulation import NOMINAL, Trace, run
from pliant.sim import HandoverObject, Socket, Surface, drawer
from pliant.sim.grasp import RELEASE_DISTANCE
from pliant.sim.postures import AT_DOOR, VERTICAL

if TYPE_CHECKING:
    from experiments.disturbances import Law
    from experiments.poses import Array
    from experiments.simulation import Conditions
    from pliant.sim import Plant


#: Distance of the target when pulling a drawer of 0.25 m, and when pushing it beyond its closed
#: position [m].
DRAWN, BACK = 0.28, 0.03
#: Speed of the drawer's target [m/s]; time of its reversal [s].
DRAWER_SPEED, TURNS = 0.05, 8.0
#: Half-lengths of the figure of eight that the pad wipes, x and y [m]; its period in y [s].
STROKE, STROKE_TIME = (0.04, 0.10), 8.0
#: Time until the pad is lowered and wiping begins [s].
DOWN = 3.0
#: Path of a plug's target from 20 mm above the mouth, 10 mm deeper than the hole [m]; speed [m/s].
INSERTION, INSERTION_SPEED = 0.06, 0.02
#: Depth of the tip below the mouth that counts as inside [m].
INSIDE = 0.028


@dataclass(frozen=True, kw_only=True)
class DrawerResult:
    """Result of a drawer.

    Attributes:
        way: Largest opening [m].
        left: Opening at the end [m].
        force: Largest force in the grip, with the impact at the end stop [N].
        held: Force in the grip at the end [N].
        across: Largest part of it across the slide [N].
        torque: Largest torque in the grip [N·m].
        trace: The run.
    """

    way: float
    left: float
    force: float
    held: float
    across: float
    torque: float
    trace: Trace


def pull_drawer(
    law: Law, *, degrees: float = 10.0, shut: bool = False, conditions: Conditions = NOMINAL
) -> DrawerResult:
    """Pull along -x at 0.05 m/s on a drawer with another slide direction, and beyond its end stop.

    Args:
        law: Settings of a controller, or a baseline.
        degrees: Angle between the slide and the pull, in the horizontal plane [deg].
        shut: True: push it shut again afterwards.
        conditions: Loop, bus and assumptions.
    """
    angle = np.deg2rad(degrees)
    box = drawer(axis=(-float(np.cos(angle)), float(np.sin(angle)), 0.0))
    start = tool(AT_DOOR)

    def target(t: float) -> Array:
        out = min(max(t - 1.0, 0.0) * DRAWER_SPEED, DRAWN)
        back = min(max(t - TURNS, 0.0) * DRAWER_SPEED, DRAWN + BACK)
        return displaced(start, "x", back - out)

    duration = TURNS + (DRAWN + BACK) / DRAWER_SPEED + 0.5 if shut else TURNS
    trace = run(conditions.build(box), conditions.controller(law), target, duration, q=AT_DOOR)
    return DrawerResult(
        way=box.widest,
        left=box.opening,
        force=box.peak_force,
        held=box.force,
        across=box.across,
        torque=box.peak_torque,
        trace=trace,
    )


@dataclass(frozen=True, kw_only=True)
class WipeResult:
    """Result of a pad on a surface.

    Attributes:
        mean, least, most: Of the normal force while wiping, means over a tick [N].
        off: Largest distance of the pad from its path, along the surface [m].
        trace: The run.
    """

    mean: float
    least: float
    most: float
    off: float
    trace: Trace


def wipe(
    law: Law,
    *,
    behind: float = 0.025,
    unevenness: float = 0.010,
    friction: float = 0.4,
    conditions: Conditions = NOMINAL,
) -> WipeResult:
    """Lower a pad onto an uneven surface and draw a figure of eight on it, for one round.

    Args:
        law: Settings of a controller, or a baseline.
        behind: Distance of the target behind the mean surface [m].
        unevenness: Height of its hills, and depth of its valleys [m].
        friction: Coefficient μ between pad and surface.
        conditions: Loop, bus and assumptions.
    """
    surface = Surface(unevenness=unevenness, friction=friction)
    start = tool(VERTICAL)

    def target(t: float) -> Array:
        phase = 2.0 * np.pi * max(t - DOWN, 0.0) / STROKE_TIME
        pose = displaced(start, "y", STROKE[1] * float(np.sin(phase)))
        pose[0, 3] += STROKE[0] * float(np.sin(2.0 * phase))
        pose[2, 3] -= min(max(0.02 * (t - 0.5), 0.0), surface.below + behind)
        return pose

    plant = conditions.build(surface)
    trace = run(plant, conditions.controller(law), target, DOWN + STROKE_TIME, q=VERTICAL)
    wiping = trace.t > DOWN
    normal = trace.force[wiping, 2]
    return WipeResult(
        mean=float(normal.mean()),
        least=float(normal.min()),
        most=float(normal.max()),
        off=float(np.hypot(*trace.error[wiping, :2].T).max()),
        trace=trace,
    )


@dataclass(frozen=True, kw_only=True)
class HandoverResult:
    """Result of a hand-over.

    Attributes:
        effort: Largest force of the person [N].
        released: Time at which the gripper opened [s]; None: never.
        sag: Sag of the arm under the object before the person came [m].
        fastest: Largest speed of the tool afterwards [m/s].
        trace: The run.
    """

    effort: float
    released: float | None
    sag: float
    fastest: float
    trace: Trace


def hand_over(law: Law, *, mass: float = 0.3, conditions: Conditions = NOMINAL) -> HandoverResult:
    """Hold an object of unknown weight until a person moves it 0.05 m away; then let it go.

    Args:
        law: Settings of a controller, or a baseline.
        mass: Of the object, unknown to the controller [kg].
        conditions: Loop, bus and assumptions.
    """
    thing = HandoverObject(mass=mass)
    start = tool(VERTICAL)

    def open_when_taken(time: float, plant: Plant) -> None:
        taken = float(np.linalg.norm(plant.tool[:3, 3] - start[:3, 3])) > RELEASE_DISTANCE
        if thing.released is None and time > thing.course.start and taken:
            thing.release(plant)

    plant = conditions.build(thing)
    controller = conditions.controller(law)
    trace = run(plant, controller, start, 6.0, q=VERTICAL, on_tick=open_when_taken)
    steps = np.linalg.norm(np.diff(trace.position, axis=0), axis=1) * conditions.rate
    before = trace.at(thing.course.start)
    return HandoverResult(
        effort=thing.peak_effort,
        released=thing.released,
        sag=float(np.linalg.norm(trace.error[before, :3])),
        fastest=float(steps[before:].max()),
        trace=trace,
    )


@dataclass(frozen=True, kw_only=True)
class PlugResult:
    """Result of a plug.

    Attributes:
        inside: True if it went in.
        along, across: Largest contact force along and across the hole, over 10 ms [N].
        off: Distance of the tip from its path at the first touch, across the hole [m].
        trace: The run.
    """

    inside: bool
    along: float
    across: float
    off: float
    trace: Trace


def plug_in(
    law: Law,
    *,
    offset: tuple[float, float] = (0.0, 0.0),
    tilt: tuple[float, float] = (0.0, 0.0),
    conditions: Conditions = NOMINAL,
) -> PlugResult:
    """Push a round plug of 20 mm down into a square hole that is off its assumed pose.

    Args:
        law: Settings of a controller, or a baseline.
        offset: Offset of the hole from its assumed position, x and y [m].
        tilt: Its rotation about x and y [rad].
        conditions: Loop, bus and assumptions.
    """
    socket = Socket(offset=(*offset, -0.02), tilt=(*tilt, 0.0))
    start = tool(VERTICAL)
    target = pull(start, INSERTION, axis="z", speed=-INSERTION_SPEED)
    touched: list[float] = []

    def notice(time: float, plant: Plant) -> None:
        if not touched and socket.force > 0.0:
            touched.append(float(np.hypot(*(plant.tool[:2, 3] - start[:2, 3]))))

    plant = conditions.build(socket)
    trace = run(plant, conditions.controller(law), target, 6.0, q=VERTICAL, on_tick=notice)
    return PlugResult(
        inside=socket.deepest > INSIDE,
        along=socket.peak_along,
        across=socket.peak_across,
        off=touched[0] if touched else 0.0,
        trace=trace,
    )


#: Holes misplaced by 2 mm and turned by 2 deg: offset [m], tilt [rad].
MISPLACED: tuple[tuple[tuple[float, float], tuple[float, float]], ...] = tuple(
    ((2e-3 * x, 2e-3 * y), (float(np.deg2rad(2.0 * a)), float(np.deg2rad(2.0 * b))))
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1))
    for a, b in ((0, 0), (1, 0), (0, -1), (-1, 1))
)
