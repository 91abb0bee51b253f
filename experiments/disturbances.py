"""Hands that drag, push or tap, the loss of the host, and walls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from experiments import metrics
from experiments.poses import AXES, arm, pull, servos, tool
from experiments.simulation import NOMINAL, Trace, run
from pliant.sim import Wall
from pliant.sim.ground_truth import WRIST
from pliant.sim.hand import STRONG, Drag, ForceProfile, Push, Twist, tap
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable

    import pliant
    from experiments.poses import Array
    from experiments.simulation import Conditions, FromModel
    from pliant.sim import Plant

    Law = pliant.Settings | FromModel

#: Hand of at most 15 N that moves 0.08 m in 4 s: slow, so that dry friction dominates.
SLOW = Drag(distance=0.08, course=ForceProfile(start=2.0, rise=4.0, end=6.5))


@dataclass(frozen=True, kw_only=True)
class DragResult:
    """Result of a hand that drags one axis from 2 to 5 s and then lets go.

    Attributes:
        moved: Largest change of the dragged axis since the hand came, while it pulls [m or rad].
        before: Largest change of that axis in the 2 s before the hand comes [m or rad].
        force: Largest mean over a tick of the hand's force or torque [N or N·m].
        peak: Largest force or torque of the hand in any physics step [N or N·m].
        held: Mean force while the hand holds still, along the axis; positive: toward + [N or N·m].
        position: Largest deviation of the other positions while the hand pulls [m].
        drift: The same, relative to their values when the hand came [m].
        rotation: Largest deviation of the other rotations [rad].
        back: Distance of the axis from its start 1 s after the release, unsigned [m or rad].
        end: Distance of the axis from its start at the end of the run [m or rad].
        stays: Distance between the axis' farthest position and its final one [m or rad].
        fastest: Largest speed of a joint after the release [rad/s].
        trace: The run.
    """

    moved: float
    before: float
    force: float
    peak: float
    held: float
    position: float
    drift: float
    rotation: float
    back: float
    end: float
    stays: float
    fastest: float
    trace: Trace


def drag(
    law: Law,
    hand: Drag | Twist = STRONG,
    *,
    q: Array = VERTICAL,
    duration: float = 9.0,
    conditions: Conditions = NOMINAL,
) -> DragResult:
    """Let a hand drag the arm away from a constant target and let go.

    Args:
        law: Settings of a controller, or a baseline.
        hand: The hand; its axis is a name.
        q: Start (7,) [rad]; the target is the tool's pose there.
        duration: Length of the run [s].
        conditions: Loop, bus and assumptions.
    """
    plant = conditions.build(hand)
    controller = conditions.controller(law)
    trace = run(plant, controller, tool(q), duration, q=q, on_tick=_grip)
    axis = AXES.index(str(hand.axis))
    translation = axis < 3
    felt = trace.force[:, axis] if translation else trace.moment[:, axis - 3]
    first = plant.hands[0]
    along = trace.moved[:, axis]
    farthest = metrics.moved(trace, axis)
    positions = metrics.others(axis, "xyz")
    return DragResult(
        moved=farthest,
        before=metrics.largest(along[trace.between(0.0, metrics.PULLING[0])]),
        force=metrics.largest(felt),
        peak=first.peak_force if translation else first.peak_torque,
        held=float(felt[trace.between(*metrics.HELD)].mean()),
        position=metrics.deviation(trace, positions),
        drift=metrics.drift(trace, positions),
        rotation=metrics.deviation(trace, metrics.others(axis, "rpy")),
        back=abs(float(along[trace.at(metrics.PULLING[1] + 1.0)])),
        end=abs(float(along[-1])),
        stays=abs(abs(float(along[-1])) - farthest),
        fastest=metrics.largest(trace.dq[trace.t > metrics.PULLING[1]]),
        trace=trace,
    )


def opposite(hand: Drag) -> Drag:
    """Return the same hand, pulling the other way."""
    return replace(hand, distance=-hand.distance)


def _grip(time: float, plant: Plant) -> None:
    """Let the hand measure its distance from the arm's position when it comes."""
    if abs(time - metrics.PULLING[0]) < 0.5 * plant.period:
        plant.ground_truth.remember()


@dataclass(frozen=True, kw_only=True)
class PushResult:
    """Result of a constant push.

    Attributes:
        moved: Largest change along the push [m].
        position: Largest deviation of the other positions [m].
        rotation: Largest deviation of the rotations [rad].
        back: Distance along the push 1 s after it ended [m].
        trace: The run.
    """

    moved: float
    position: float
    rotation: float
    back: float
    trace: Trace


def push(
    law: Law, force: float, *, axis: str = "y", at: str = WRIST, conditions: Conditions = NOMINAL
) -> PushResult:
    """Push with a constant force [N] along a base axis: up in 2 to 3 s, gone at 5 s.

    Args:
        law: Settings of a controller, or a baseline.
        force: The force, with its sign [N].
        axis: Base axis.
        at: Frame that is pushed, `wrist` or `tool`.
        conditions: Loop, bus and assumptions.
    """
    index = AXES.index(axis)
    hand = Push(force_vector=tuple(force * np.eye(3)[index]), at=at)
    trace = run(conditions.build(hand), conditions.controller(law), tool(VERTICAL), 7.0, q=VERTICAL)
    return PushResult(
        moved=metrics.moved(trace, index),
        position=metrics.deviation(trace, metrics.others(index, "xyz")),
        rotation=metrics.deviation(trace, [3, 4, 5]),
        back=abs(float(trace.moved[trace.at(6.0), index])),
        trace=trace,
    )


def push_stiff(law: Law, axis: str, size: float, *, conditions: Conditions = NOMINAL) -> float:
    """Push the tool along or about an axis with a constant `size` [N or N·m].

    Returns:
        Deviation of that axis [m or rad]: mean of 3 to 3.9 s, in the direction of the push.
    """
    index = AXES.index(axis)
    vector = tuple(size * np.eye(3)[index % 3])
    course = ForceProfile(start=1.5, rise=0.5, end=4.0)
    if index < 3:
        hand = Push(force_vector=vector, course=course)
    else:
        hand = Push(torque_vector=vector, course=course)
    trace = run(conditions.build(hand), conditions.controller(law), tool(VERTICAL), 4.0, q=VERTICAL)
    mean = float(trace.moved[trace.between(3.0, 3.9), index].mean())
    return mean * float(np.sign(size))


def tapped(law: Law, axis: str, *, force: float = 6.0, conditions: Conditions = NOMINAL) -> float:
    """Tap the tool along a base axis at 1 s.

    Returns:
        Rms speed of the joints from 4 to 6 s [rad/s], which stays large if the loop oscillates.
    """
    hand = tap(tuple(force * np.eye(3)[AXES.index(axis)]))
    trace = run(conditions.build(hand), conditions.controller(law), tool(VERTICAL), 6.0, q=VERTICAL)
    return metrics.speed(trace, 4.0, 6.0)


@dataclass(frozen=True, kw_only=True)
class IdleResult:
    """Motion of an untouched arm.

    Attributes:
        error: Distance of the tool from its target at the end [m].
        angle: Angle of the tool from its target at the end [rad].
        speed: Rms speed of the joints in the last 2 s [rad/s].
        walk: Change of the position in the last 2 s [m].
        trace: The run.
    """

    error: float
    angle: float
    speed: float
    walk: float
    trace: Trace


def idle(
    law: Law, duration: float = 4.0, *, q: Array = VERTICAL, conditions: Conditions = NOMINAL
) -> IdleResult:
    """Hold still for `duration` seconds, at least 3."""
    trace = run(conditions.build(), conditions.controller(law), tool(q), duration, q=q)
    late = trace.between(duration - 2.0, duration)
    return IdleResult(
        error=float(np.linalg.norm(trace.error[-1, :3])),
        angle=float(np.linalg.norm(trace.error[-1, 3:])),
        speed=metrics.speed(trace, duration - 2.0, duration),
        walk=float(np.linalg.norm(trace.position[-1] - trace.position[late][0])),
        trace=trace,
    )


# --- Host loss: the servos keep their last goals and limits, and a hand comes ---

#: Time at which the bus falls silent, and duration of the hand's motion [s].
DEATH, RISE = 1.9, 7.5


@dataclass(frozen=True, kw_only=True)
class HostLossResult:
    """Force on a hand that moved an arm after a host loss.

    Attributes:
        force: Largest force against the hand, mean over a tick [N].
        formula: min over the joints of (L + τ_f + s g)/|a|, a = Jᵀd, at the pose of that force [N].
        moved: Motion of the tool between the host loss and the hand, or without a hand at all [m].
        trace: The run.
    """

    force: float
    formula: float
    moved: float
    trace: Trace


def static_force(q: Array, limit: Array, direction: Array) -> float:
    """Return the push at the tool under which the first joint gives way.

    Args:
        q: Posture (n,) [rad].
        limit: Torque limits (n,) [N·m].
        direction: Of the push, a unit vector (3,) in base axes.

    Returns:
        The force [N].
    """
    model = arm()
    _, jacobian = model.kinematics(q)
    lever = jacobian[:3].T @ direction
    friction = np.asarray(servos().friction)
    room = limit + friction + np.sign(lever) * model.gravity(q)
    felt = np.abs(lever) > 1e-9
    return float((room[felt] / np.abs(lever[felt])).min())


def die(law: Law, push: str | None = "+y", *, conditions: Conditions = NOMINAL) -> HostLossResult:
    """Silence the bus at 1.9 s, then let a strong hand move the tool by 0.15 m within 7.5 s.

    Args:
        law: Settings of a controller, or a baseline.
        push: Sign and axis of the hand, None for no hand.
        conditions: Loop, bus and assumptions.
    """
    silent = conditions.with_plant(bus_outage=(DEATH, np.inf))
    hands = []
    direction = np.zeros(3)
    if push is not None:
        direction[AXES.index(push[1:])] = -1.0 if push[0] == "-" else 1.0
        course = ForceProfile(start=2.0, rise=RISE, end=np.inf)
        hands.append(replace(STRONG, axis=tuple(direction), course=course))
    trace = run(
        silent.build(*hands), silent.controller(law), tool(VERTICAL), 2.0 + RISE, q=VERTICAL
    )
    felt = trace.force @ direction
    worst = int(np.argmax(felt))
    death = trace.at(DEATH)
    limit = trace.limit[death]
    alone = trace.between(DEATH, 2.0 if push is not None else np.inf)
    return HostLossResult(
        force=float(felt[worst]),
        formula=static_force(trace.q[worst], limit, direction) if push is not None else np.inf,
        moved=metrics.largest(trace.moved[alone, :3] - trace.moved[death, :3]),
        trace=trace,
    )


# --- Motion into a wall: impact, and remaining force ---

#: Directions into the wall: the axis that is soft, and the sign.
DIRECTIONS = {"+x": ("x", 1.0), "+y": ("y", 1.0), "-z": ("z", -1.0)}
STIFFNESSES = (2e3, 2e4)
SPEEDS = (0.05, 0.10, 0.25)
#: Distance of the wall, and of the target behind its surface [m].
GAP, BEHIND = 0.05, 0.10


@dataclass(frozen=True, kw_only=True)
class ImpactResult:
    """Forces on the wall.

    Attributes:
        peak: Largest force of any physics step [N].
        later: Largest mean over a tick from 0.3 s after the first touch on [N].
        final: Mean force of the last half second [N].
        allowed: cap + v √(k m), of a mass m that meets a spring k at speed v [N].
        mass: Effective mass m of the arm along the wall's normal, rotors included [kg].
        trace: The run.
    """

    peak: float
    later: float
    final: float
    allowed: float
    mass: float
    trace: Trace


def effective_mass(plant: Plant, axis: int) -> float:
    """Return the effective mass [kg] along a base axis: 1 / (n J M⁻¹ Jᵀ nᵀ), with rotors."""
    model, data = plant.mj_model, plant.mj_data
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, plant.ground_truth.frame("tool").site)
    row = jacobian[axis]
    return float(1.0 / (row @ np.linalg.solve(inertia, row)))


def bump(
    law: Callable[..., Law],
    direction: str = "+x",
    *,
    speed: float = 0.10,
    stiffness: float = 2e4,
    cap: float = 15.0,
    conditions: Conditions = NOMINAL,
) -> ImpactResult:
    """Run into a wall 0.05 m away with a target that continues for another 0.10 m.

    Args:
        law: Makes the settings from the soft axis, `soft`, and `eta`.
        direction: One of `DIRECTIONS`.
        speed: Of the target [m/s].
        stiffness: Of the wall [N/m].
        cap: Force that the law promises at a large deviation [N].
        conditions: Loop, bus and assumptions.
    """
    axis, sign = DIRECTIONS[direction]
    index = "xyz".index(axis)
    wall = Wall(into=tuple(sign * np.eye(3)[index]), distance=GAP, stiffness=stiffness)
    plant = conditions.build(wall)
    plant.reset(VERTICAL)
    mass = effective_mass(plant, index)
    target = pull(tool(VERTICAL), GAP + BEHIND, axis=axis, speed=sign * speed)
    duration = 1.0 + (GAP + BEHIND) / speed + 3.0
    trace = run(plant, conditions.controller(law(soft=axis, eta=0.0)), target, duration, q=VERTICAL)
    force = np.abs(trace.force[:, index])
    touched = float(trace.t[int(np.argmax(force > 0.0))])
    return ImpactResult(
        peak=plant.hands[0].peak_force,
        later=float(force[trace.t > touched + 0.3].max()),
        final=float(force[trace.t > duration - 0.5].mean()),
        allowed=cap + speed * float(np.sqrt(stiffness * mass)),
        mass=mass,
        trace=trace,
    )
