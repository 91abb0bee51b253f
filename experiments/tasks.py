"""Simulated tasks for the presets of `Settings`: drawer, wiping, hand-over, plug insertion."""

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


#: Distance by which the target moves to pull the drawer open, which opens by 0.25 m; and distance
#: of the target beyond the closed position when the drawer is pushed shut [m].
PULL_DISTANCE, PUSH_EXCESS = 0.28, 0.03
#: Speed of the drawer's target [m/s], and time at which its direction reverses [s].
DRAWER_SPEED, REVERSAL_TIME = 0.05, 8.0
#: Amplitudes in x and y of the figure of eight that the pad wipes [m], and time for the figure [s].
STROKE, STROKE_TIME = (0.04, 0.10), 8.0
#: Time at which wiping begins [s]; before it, the pad is lowered onto the surface.
WIPE_START = 3.0
#: Distance [m] and speed [m/s] of the plug's target, from 20 mm above the hole to 10 mm below its
#: floor.
INSERTION, INSERTION_SPEED = 0.06, 0.02
#: The plug counts as inserted if its tip has been deeper in the hole than this [m].
INSIDE = 0.028


@dataclass(frozen=True, kw_only=True)
class DrawerResult:
    """Result of pulling a drawer.

    Attributes:
        way: Largest opening [m].
        left: Opening at the end [m].
        force: Largest force in the grip, including the impact at the end stop [N].
        held: Force in the grip at the end [N].
        across: Largest force in the grip across the slide [N].
        torque: Largest torque in the grip [N·m].
        trace: Recorded run.
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
    """Pull a drawer open with a target that moves on beyond the drawer's end stop.

    The slide of the drawer is not parallel to the motion of the target.

    Args:
        law: Settings of a controller, or factory of a baseline controller.
        degrees: Horizontal angle between the slide and the target's motion along -x [deg].
        shut: True pushes the drawer shut again.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    angle = np.deg2rad(degrees)
    box = drawer(axis=(-float(np.cos(angle)), float(np.sin(angle)), 0.0))
    start = tool(AT_DOOR)

    def target(t: float) -> Array:
        out = min(max(t - 1.0, 0.0) * DRAWER_SPEED, PULL_DISTANCE)
        back = min(max(t - REVERSAL_TIME, 0.0) * DRAWER_SPEED, PULL_DISTANCE + PUSH_EXCESS)
        return displaced(start, "x", back - out)

    duration = (
        REVERSAL_TIME + (PULL_DISTANCE + PUSH_EXCESS) / DRAWER_SPEED + 0.5
        if shut
        else REVERSAL_TIME
    )
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
    """Result of wiping a surface.

    Attributes:
        mean, least, most: Mean, smallest and largest normal force on the surface while wiping [N];
            forces are averages over a control period.
        off: Largest distance of the pad from its path, along the surface [m].
        trace: Recorded run.
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
    """Lower a pad onto an uneven surface and wipe one figure of eight.

    Args:
        law: Settings of a controller, or factory of a baseline controller.
        behind: Depth of the target below the mean surface [m].
        unevenness: Amplitude of the surface's height [m].
        friction: Coefficient μ between pad and surface.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    surface = Surface(unevenness=unevenness, friction=friction)
    start = tool(VERTICAL)

    def target(t: float) -> Array:
        phase = 2.0 * np.pi * max(t - WIPE_START, 0.0) / STROKE_TIME
        pose = displaced(start, "y", STROKE[1] * float(np.sin(phase)))
        pose[0, 3] += STROKE[0] * float(np.sin(2.0 * phase))
        pose[2, 3] -= min(max(0.02 * (t - 0.5), 0.0), surface.below + behind)
        return pose

    plant = conditions.build(surface)
    trace = run(plant, conditions.controller(law), target, WIPE_START + STROKE_TIME, q=VERTICAL)
    wiping = trace.t > WIPE_START
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
        released: Time at which the gripper opened [s]; None if it stayed closed.
        sag: Deviation of the tool under the object's weight before the person pulls [m].
        fastest: Largest speed of the tool after the person started to pull [m/s].
        trace: Recorded run.
    """

    effort: float
    released: float | None
    sag: float
    fastest: float
    trace: Trace


def hand_over(law: Law, *, mass: float = 0.3, conditions: Conditions = NOMINAL) -> HandoverResult:
    """Hold an object until a person has pulled it 0.05 m away; then open the gripper.

    Args:
        law: Settings of a controller, or factory of a baseline controller.
        mass: Mass of the object, unknown to the controller [kg].
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    handover_object = HandoverObject(mass=mass)
    start = tool(VERTICAL)

    def open_when_taken(time: float, plant: Plant) -> None:
        is_taken = float(np.linalg.norm(plant.tool[:3, 3] - start[:3, 3])) > RELEASE_DISTANCE
        if handover_object.released is None and time > handover_object.course.start and is_taken:
            handover_object.release(plant)

    plant = conditions.build(handover_object)
    controller = conditions.controller(law)
    trace = run(plant, controller, start, 6.0, q=VERTICAL, on_tick=open_when_taken)
    steps = np.linalg.norm(np.diff(trace.position, axis=0), axis=1) * conditions.rate
    before = trace.at(handover_object.course.start)
    return HandoverResult(
        effort=handover_object.peak_effort,
        released=handover_object.released,
        sag=float(np.linalg.norm(trace.error[before, :3])),
        fastest=float(steps[before:].max()),
        trace=trace,
    )


@dataclass(frozen=True, kw_only=True)
class PlugResult:
    """Result of inserting a plug.

    Attributes:
        inside: True if the plug was inserted.
        along, across: Largest contact force along and across the hole, filtered with 10 ms [N].
        off: Horizontal distance of the plug's tip from its path at the first contact with the
            socket [m]; 0 without a contact.
        trace: Recorded run.
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
    """Push a round plug of 20 mm down into a square hole that is not at its assumed pose.

    Args:
        law: Settings of a controller, or factory of a baseline controller.
        offset: Offset of the hole from its assumed position, x and y [m].
        tilt: Rotation of the hole from its assumed orientation, about x and y [rad].
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    socket = Socket(offset=(*offset, -0.02), tilt=(*tilt, 0.0))
    start = tool(VERTICAL)
    target = pull(start, INSERTION, axis="z", speed=-INSERTION_SPEED)
    offsets: list[float] = []

    def notice(time: float, plant: Plant) -> None:
        if not offsets and socket.force > 0.0:
            offsets.append(float(np.hypot(*(plant.tool[:2, 3] - start[:2, 3]))))

    plant = conditions.build(socket)
    trace = run(plant, conditions.controller(law), target, 6.0, q=VERTICAL, on_tick=notice)
    return PlugResult(
        inside=socket.deepest > INSIDE,
        along=socket.peak_along,
        across=socket.peak_across,
        off=offsets[0] if offsets else 0.0,
        trace=trace,
    )


#: Pose errors of the hole that are tested, up to 2 mm and 2 deg per axis: arguments `offset` [m]
#: and `tilt` [rad] of `plug_in`.
MISPLACED: tuple[tuple[tuple[float, float], tuple[float, float]], ...] = tuple(
    ((2e-3 * x, 2e-3 * y), (float(np.deg2rad(2.0 * a)), float(np.deg2rad(2.0 * b))))
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1))
    for a, b in ((0, 0), (1, 0), (0, -1), (-1, 1))
)
