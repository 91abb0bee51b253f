"""Experiments with external forces: hands that drag, push or tap, host loss, and walls."""

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
from pliant.sim.hand import DRAG_80N, Drag, ForceProfile, Push, Twist, tap
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable

    import pliant
    from experiments.poses import Array
    from experiments.simulation import Conditions, FromModel
    from pliant.sim import Plant

    Law = pliant.Settings | FromModel

#: Hand of at most 15 N that moves 0.08 m in 4 s, so slowly that dry friction dominates.
SLOW = Drag(distance=0.08, course=ForceProfile(start=2.0, rise=4.0, end=6.5))


@dataclass(frozen=True, kw_only=True)
class DragResult:
    """Result of a hand that drags one axis from 2 to 5 s and then releases the arm.

    Attributes:
        moved: Largest change of the dragged axis while the hand pulls [m or rad].
        before: Largest distance of the dragged axis from its start in the 2 s before the hand pulls
            [m or rad].
        force: Largest force or torque of the hand, averaged over a control period [N or N·m].
        peak: Largest force or torque of the hand in any physics step [N or N·m].
        held: Mean force or torque of the resting hand along the axis, signed [N or N·m].
        position: Largest distance of another position from its value at the start of the run, while
            the hand pulls [m].
        drift: Largest distance of another position from its value at the start of the pull, while
            the hand pulls [m].
        rotation: Largest distance of another rotation from its value at the start of the run, while
            the hand pulls [rad].
        back: Distance of the dragged axis from its start 1 s after the release [m or rad].
        end: Distance of the dragged axis from its start at the end of the run [m or rad].
        stays: Difference between `moved` and `end` [m or rad].
        fastest: Largest speed of a joint after the release [rad/s].
        trace: Recorded run.
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
    hand: Drag | Twist = DRAG_80N,
    *,
    q: Array = VERTICAL,
    duration: float = 9.0,
    conditions: Conditions = NOMINAL,
) -> DragResult:
    """Drag the arm away from a constant target, release it, and return the result.

    Args:
        law: Settings of a controller, or factory of a baseline controller.
        hand: The hand, whose axis must be given by name.
        q: Start pose (7,) [rad]; the target is the tool's pose there.
        duration: Duration of the run [s].
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    plant = conditions.build(hand)
    controller = conditions.controller(law)
    trace = run(plant, controller, tool(q), duration, q=q, on_tick=_grip)
    axis = AXES.index(str(hand.axis))
    translation = axis < 3
    hand_force = trace.force[:, axis] if translation else trace.moment[:, axis - 3]
    first = plant.hands[0]
    displacement = trace.moved[:, axis]
    farthest = metrics.moved(trace, axis)
    positions = metrics.others(axis, "xyz")
    return DragResult(
        moved=farthest,
        before=metrics.largest(displacement[trace.between(0.0, metrics.PULLING[0])]),
        force=metrics.largest(hand_force),
        peak=first.peak_force if translation else first.peak_torque,
        held=float(hand_force[trace.between(*metrics.HELD)].mean()),
        position=metrics.deviation(trace, positions),
        drift=metrics.drift(trace, positions),
        rotation=metrics.deviation(trace, metrics.others(axis, "rpy")),
        back=abs(float(displacement[trace.at(metrics.PULLING[1] + 1.0)])),
        end=abs(float(displacement[-1])),
        stays=abs(abs(float(displacement[-1])) - farthest),
        fastest=metrics.largest(trace.dq[trace.t > metrics.PULLING[1]]),
        trace=trace,
    )


def opposite(hand: Drag) -> Drag:
    """Return a hand that pulls in the opposite direction."""
    return replace(hand, distance=-hand.distance)


def _grip(time: float, plant: Plant) -> None:
    """Make the present pose the zero of the hand's displacement when the hand begins to pull.

    It is a callback of `run` with the time [s] and the simulated arm.
    """
    if abs(time - metrics.PULLING[0]) < 0.5 * plant.period:
        plant.ground_truth.remember()


@dataclass(frozen=True, kw_only=True)
class PushResult:
    """Result of a constant push.

    Attributes:
        moved: Largest displacement of the tool along the push [m].
        position: Largest displacement of the tool along another base axis during the push [m].
        rotation: Largest rotation of the tool about a base axis during the push [rad].
        back: Distance of the tool from its start along the push, 1 s after the push ended [m].
        trace: Recorded run.
    """

    moved: float
    position: float
    rotation: float
    back: float
    trace: Trace


def push(
    law: Law, force: float, *, axis: str = "y", at: str = WRIST, conditions: Conditions = NOMINAL
) -> PushResult:
    """Push along a base axis with a force that rises from 2 to 3 s and ends at 5 s.

    Args:
        law: Settings of a controller, or factory of a baseline controller.
        force: Signed force [N].
        axis: Base axis of the push: `x`, `y` or `z`.
        at: Pushed frame, `wrist` or `tool`.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
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
    """Push the tool along or about a base axis with a constant force or torque [N or N·m].

    Returns:
        Mean displacement of the tool from 3 to 3.9 s, in the direction of the push [m or rad].
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


def speed_after_tap(
    law: Law, axis: str, *, force: float = 6.0, conditions: Conditions = NOMINAL
) -> float:
    """Push the tool briefly along a base axis at 1 s, with a force [N].

    Returns:
        Rms speed of the joints from 4 to 6 s [rad/s]; a large value means oscillation.
    """
    hand = tap(tuple(force * np.eye(3)[AXES.index(axis)]))
    trace = run(conditions.build(hand), conditions.controller(law), tool(VERTICAL), 6.0, q=VERTICAL)
    return metrics.speed(trace, 4.0, 6.0)


@dataclass(frozen=True, kw_only=True)
class IdleResult:
    """Motion of an untouched arm.

    Attributes:
        error: Distance of the tool from its target position at the end [m].
        angle: Angle between the tool and its target orientation at the end [rad].
        speed: Rms speed of the joints in the last 2 s [rad/s].
        walk: Change of the tool's position in the last 2 s [m].
        trace: Recorded run.
    """

    error: float
    angle: float
    speed: float
    walk: float
    trace: Trace


def idle(
    law: Law, duration: float = 4.0, *, q: Array = VERTICAL, conditions: Conditions = NOMINAL
) -> IdleResult:
    """Hold a constant target for `duration` [s], at least 3, and return the motion of the arm."""
    trace = run(conditions.build(), conditions.controller(law), tool(q), duration, q=q)
    is_late = trace.between(duration - 2.0, duration)
    return IdleResult(
        error=float(np.linalg.norm(trace.error[-1, :3])),
        angle=float(np.linalg.norm(trace.error[-1, 3:])),
        speed=metrics.speed(trace, duration - 2.0, duration),
        walk=float(np.linalg.norm(trace.position[-1] - trace.position[is_late][0])),
        trace=trace,
    )


# --- Host loss: the servos keep their last goals and limits, and a hand moves the arm ---

#: Time of the host loss, and duration of the hand's motion after it [s].
HOST_LOSS_TIME, RISE = 1.9, 7.5


@dataclass(frozen=True, kw_only=True)
class HostLossResult:
    """Force on a hand that moved an arm after a host loss.

    Attributes:
        force: Largest force on the hand, averaged over a control period [N].
        formula: Static estimate by `static_force` in the pose of the largest force [N].
        moved: Largest displacement of the tool along a base axis after the host loss, before the
            hand moves it [m].
        trace: Recorded run.
    """

    force: float
    formula: float
    moved: float
    trace: Trace


def static_force(q: Array, limit: Array, direction: Array) -> float:
    """Return the smallest push at the tool that moves a joint against its torque limit [N].

    The push is the minimum over the joints of (L + τ_f + sign(a) g)/|a|, with torque limit L, dry
    friction τ_f and gravity torque g of a joint [N·m], and its lever a in Jᵀd [m].

    Args:
        q: Joint positions (n,) [rad].
        limit: Torque limits L (n,) [N·m].
        direction: Direction d of the push, a unit vector (3,) in base axes.
    """
    model = arm()
    _, jacobian = model.kinematics(q)
    lever = jacobian[:3].T @ direction
    friction = np.asarray(servos().friction)
    room = limit + friction + np.sign(lever) * model.gravity(q)
    is_moved = np.abs(lever) > 1e-9
    return float((room[is_moved] / np.abs(lever[is_moved])).min())


def lose_host(
    law: Law, push: str | None = "+y", *, conditions: Conditions = NOMINAL
) -> HostLossResult:
    """Stop the host at 1.9 s, then move the tool with a hand by 0.15 m within 7.5 s.

    Args:
        law: Settings of a controller, or factory of a baseline controller.
        push: Direction of the hand's motion as sign and base axis; None: no hand.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    silent = conditions.with_plant(bus_outage=(HOST_LOSS_TIME, np.inf))
    hands = []
    direction = np.zeros(3)
    if push is not None:
        direction[AXES.index(push[1:])] = -1.0 if push[0] == "-" else 1.0
        course = ForceProfile(start=2.0, rise=RISE, end=np.inf)
        hands.append(replace(DRAG_80N, axis=tuple(direction), course=course))
    trace = run(
        silent.build(*hands), silent.controller(law), tool(VERTICAL), 2.0 + RISE, q=VERTICAL
    )
    hand_force = trace.force @ direction
    worst = int(np.argmax(hand_force))
    death = trace.at(HOST_LOSS_TIME)
    limit = trace.limit[death]
    is_evaluated = trace.between(HOST_LOSS_TIME, 2.0 if push is not None else np.inf)
    return HostLossResult(
        force=float(hand_force[worst]),
        formula=static_force(trace.q[worst], limit, direction) if push is not None else np.inf,
        moved=metrics.largest(trace.moved[is_evaluated, :3] - trace.moved[death, :3]),
        trace=trace,
    )


# --- Motion into a wall: force at the impact and at rest ---

#: Directions of motion into the wall by name: soft axis, and sign of the motion.
DIRECTIONS = {"+x": ("x", 1.0), "+y": ("y", 1.0), "-z": ("z", -1.0)}
STIFFNESSES = (2e3, 2e4)
SPEEDS = (0.05, 0.10, 0.25)
#: Distance of the wall from the tool, and final distance of the target behind the wall's surface
#: [m].
GAP, BEHIND = 0.05, 0.10


@dataclass(frozen=True, kw_only=True)
class ImpactResult:
    """Forces on a wall into which the arm moves.

    Attributes:
        peak: Largest force in any physics step [N].
        later: Largest force from 0.3 s after the first contact on, averaged over a control period
            [N].
        final: Mean force in the last half second [N].
        allowed: Bound cap + v √(k m) of `peak` [N]: the cap of the soft axis [N], plus the impact
            force of the mass m at the target's speed v on a wall of stiffness k.
        mass: Effective mass m of the arm along the wall's normal, including rotors [kg].
        trace: Recorded run.
    """

    peak: float
    later: float
    final: float
    allowed: float
    mass: float
    trace: Trace


def effective_mass(plant: Plant, axis: int) -> float:
    """Return the effective mass of the arm at the tool along a base axis, with rotors [kg].

    It is 1 / (j M⁻¹ jᵀ), with the row j of the tool's Jacobian for the axis and the joint-space
    inertia matrix M.
    """
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
    """Move the target to 0.10 m behind a wall, 0.05 m away from the tool; return the forces.

    Args:
        law: Function that returns settings for the arguments `soft` (soft axis) and `eta`.
        direction: Key of `DIRECTIONS`.
        speed: Speed of the target [m/s].
        stiffness: Stiffness of the wall [N/m].
        cap: Cap of the soft axis at a large deviation [N].
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
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
    contact_time = float(trace.t[int(np.argmax(force > 0.0))])
    return ImpactResult(
        peak=plant.hands[0].peak_force,
        later=float(force[trace.t > contact_time + 0.3].max()),
        final=float(force[trace.t > duration - 0.5].mean()),
        allowed=cap + speed * float(np.sqrt(stiffness * mass)),
        mass=mass,
        trace=trace,
    )
