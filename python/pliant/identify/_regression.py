"""Least-squares fit of stiffness, friction, damping and payload together; fit of the loop's delay.

The least-squares fit solves the equation in the docstring of module `_segments`, linearised around
the previous iteration, for all segments together. The assumed values are Gaussian priors: an
unknown that the data do not determine keeps its assumed value and standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array
    from pliant.identify._excitation import Excitation, Record
    from pliant.identify._segments import Segment


#: Unknowns of each joint, in the order of their columns, with the symbols of module `_segments`:
#: `kp`: stiffness k_p [N·m/rad];
#: `friction`: dry friction f [N·m];
#: `load`, `motor`: increase of friction per load torque (l) and per motor torque (m) [1];
#: `goal_damping`: viscous resistance D while the servo follows its goal [N·m·s/rad];
#: `limit_damping`: viscous resistance D while the torque limit drives the joint [N·m·s/rad];
#: `inertia`: M [kg·m²];
#: `deadband`: dead band b [rad];
#: `scale`: relative error of the torque limit, true over commanded minus 1 [1].
NAMES = (
    *("kp", "friction", "load", "motor", "goal_damping", "limit_damping"),
    *("inertia", "deadband", "scale"),
)
#: Columns of the unknowns that all joints share: payload (mass, mass times centre), and horizontal
#: force at the tool.
PAYLOAD, MASS, MOMENTS, FORCE = slice(-6, -2), -6, slice(-5, -2), slice(-2, None)
#: Standard deviation of the prior of the servo's dead band [rad]; its mean is 0.
DEADBAND_SIGMA = 1e-3
#: Number of iterations of the linearised fit.
ITERATIONS = 8
#: Standard deviation of the prior of the payload's centre of mass, per axis of the tool frame [m].
COM_SIGMA = 0.1
#: Standard deviation of the prior of the payload's mass, as a share of the mass that the arm can
#: lift at half of its reach [1]. The weight of this mass is the standard deviation of the prior of
#: the force at the tool.
MASS_SIGMA_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class Priors:
    """Standard deviations of the Gaussian priors of the fit.

    Attributes:
        kp: Standard deviation of the stiffness, relative to the assumed stiffness [1].
        friction, damping: Standard deviations of friction and damping, relative to the assumed
            values [1].
        limit: Standard deviation of the ratio of true to commanded torque limit [1].
        load: Standard deviation of the growth of friction with load, one per joint or one for all
            joints [1]; 0: friction does not grow with load.
        payload: True: the payload is fitted; False: it keeps the value of the model.
    """

    kp: float = 0.5
    friction: float = 3.0
    damping: float = 3.0
    limit: float = 0.05
    load: float | Array = 0.0
    payload: bool = True


@dataclass(frozen=True)
class Solution:
    """Result of the least-squares fit.

    Attributes:
        value: Fitted unknowns of all joints (n,) by name, in the units of `NAMES`; `scale` is the
            ratio of true to commanded torque limit.
        sigma: Standard deviations of the unknowns (n,) by name.
        payload: Payload φ = (m, m c) (4,): mass m [kg], and mass times centre of mass c [kg·m].
        payload_covariance: Covariance of φ (4, 4).
        force: Horizontal force at the tool (2,) along `horizontal_axes` [N].
        force_covariance: Covariance of the force (2, 2).
        sigma_reduction: Share by which the data reduce the prior standard deviation of φ, along
            four orthogonal directions of the scaled φ (4,): 0: not at all; 1: to zero.
        residual_ratio: Root mean square of the residuals over their assumed standard deviations
            [1].
        rows: Number of fitted segments.
    """

    value: dict[str, Array]
    sigma: dict[str, Array]
    payload: Array
    payload_covariance: Array
    force: Array
    force_covariance: Array
    sigma_reduction: Array
    residual_ratio: float
    rows: int


def noise(rig: Excitation, segment: Segment, kp: Array, friction: Array, deadband: Array) -> float:
    """Return the standard deviation of one segment's torque [N·m].

    It combines varying friction, encoder resolution, model errors and the servo's dead band. The
    dead band adds more noise to small torques, which may change sign within the segment.
    """
    i = segment.joint
    counts = kp[i] * max(rig.count[i], 1e-4) * 0.5 / np.sqrt(segment.samples)
    deadband_error = 0.0
    if not segment.by_limit:
        deadband_torque = kp[i] * abs(deadband[i])
        deadband_error = (
            0.5 if kp[i] * abs(segment.drive) < 4.0 * deadband_torque else 0.1
        ) * deadband_torque
    known = (0.04 * friction[i]) ** 2 + (1e-3 * rig.torque[i]) ** 2
    return float(np.sqrt(known + counts**2 + deadband_error**2))


def solve(rig: Excitation, segments: Sequence[Segment], priors: Priors) -> Solution:
    """Return the last of `ITERATIONS` fits of all unknowns, each linearised around the previous."""
    solution = None
    for _ in range(ITERATIONS):
        solution = _fit(rig, segments, priors, solution)
    assert solution is not None
    return solution


def predict_torque(segment: Segment, solution: Solution) -> float:
    """Return the mean servo torque that a solution predicts for a segment [N·m]."""
    i, value = segment.joint, solution.value
    load = segment.gravity + float(
        segment.payload @ solution.payload + segment.force @ solution.force
    )
    motor = abs(segment.drive) * (1.0 if segment.by_limit else value["kp"][i])
    dry = value["friction"][i] + value["load"][i] * abs(load) + value["motor"][i] * motor
    viscous = value["limit_damping" if segment.by_limit else "goal_damping"][i] * segment.speed
    return float(
        load + segment.direction * dry + viscous + value["inertia"][i] * segment.acceleration
    )


def _fit(
    rig: Excitation,
    segments: Sequence[Segment],
    priors: Priors,
    last: Solution | None,
) -> Solution:
    n = rig.n
    kp = rig.kp if last is None else np.clip(last.value["kp"], 0.1 * rig.kp, 10.0 * rig.kp)
    friction = rig.friction if last is None else np.maximum(last.value["friction"], 0.0)
    deadband = np.zeros(n) if last is None else last.value["deadband"]
    width = len(NAMES) * n + 6
    column = {name: k * n for k, name in enumerate(NAMES)}
    design, right = np.zeros((len(segments), width)), np.zeros(len(segments))
    for k, segment in enumerate(segments):
        i, row = segment.joint, design[k]
        load = segment.gravity
        if last is not None:
            load += float(segment.payload @ last.payload + segment.force @ last.force)
        if segment.by_limit:
            row[column["scale"] + i] = segment.drive
            row[column["limit_damping"] + i] = -segment.speed
            right[k] = segment.gravity - segment.drive
        else:
            # Multiply k_p by the predicted, not the measured lead (goal minus position): noise of
            # the measured lead would bias the stiffness of joints without gravity load toward zero.
            torque = kp[i] * segment.drive if last is None else predict_torque(segment, last)
            row[column["kp"] + i] = torque / kp[i]
            row[column["deadband"] + i] = -kp[i] * np.sign(torque)
            row[column["goal_damping"] + i] = -segment.speed
            right[k] = segment.gravity + torque - kp[i] * segment.drive
        row[column["friction"] + i] = -segment.direction
        row[column["load"] + i] = -segment.direction * abs(load)
        row[column["motor"] + i] = -segment.direction * abs(
            segment.drive * (1.0 if segment.by_limit else kp[i])
        )
        row[column["inertia"] + i] = -segment.acceleration
        row[PAYLOAD], row[FORCE] = -segment.payload, -segment.force
        sigma = noise(rig, segment, kp, friction, deadband)
        row /= sigma
        right[k] /= sigma
    mean, sd = _prior(rig, priors, width, column)
    if last is not None:
        # Convert the prior of the centre to one of mass times centre by the mass found last.
        sd[MOMENTS] = (
            np.maximum(COM_SIGMA * max(last.payload[0], 0.05), 1e-6)
            if priors.payload
            else sd[MOMENTS]
        )
    # Scale the unknowns by their prior standard deviations: the prior then adds an identity matrix.
    scaled = design * sd
    information = scaled.T @ scaled
    covariance = np.linalg.inv(information + np.eye(width))
    delta = covariance @ (scaled.T @ (right - design @ mean))
    x = mean + sd * delta
    residual = right - design @ x
    effective_parameters = float(np.trace(information @ covariance))
    freedom = max(len(segments) - effective_parameters, 1.0)
    residual_ratio = float(np.sqrt(residual @ residual / freedom))
    covariance = covariance * max(residual_ratio, 1.0) ** 2
    deviation = sd * np.sqrt(np.minimum(np.diag(covariance), 1.0))
    value = {name: x[column[name] : column[name] + n] for name in NAMES}
    value["scale"] = 1.0 + value["scale"]
    eigenvalues = np.linalg.eigvalsh(covariance[PAYLOAD, PAYLOAD])[::-1]
    return Solution(
        value=value,
        sigma={name: deviation[column[name] : column[name] + n] for name in NAMES},
        payload=x[PAYLOAD],
        payload_covariance=covariance[PAYLOAD, PAYLOAD] * np.outer(sd[PAYLOAD], sd[PAYLOAD]),
        force=x[FORCE],
        force_covariance=covariance[FORCE, FORCE] * np.outer(sd[FORCE], sd[FORCE]),
        sigma_reduction=1.0 - np.sqrt(np.clip(eigenvalues, 0.0, 1.0)),
        residual_ratio=residual_ratio,
        rows=len(segments),
    )


def _prior(
    rig: Excitation, priors: Priors, width: int, column: dict[str, int]
) -> tuple[Array, Array]:
    """Return means and standard deviations (width,) of the priors of all unknowns.

    `column` maps the name of an unknown to its first column; it has one column per joint.
    """
    n = rig.n
    mean, sd = np.zeros(width), np.full(width, 1e-9)
    damping = rig.damping + rig.back_emf
    for name, centre, sigma in (
        ("kp", rig.kp, priors.kp * rig.kp),
        ("friction", rig.friction, priors.friction * np.maximum(rig.friction, 0.01 * rig.torque)),
        ("load", 0.0, np.maximum(priors.load, 1e-9)),
        ("motor", 0.0, np.maximum(priors.load, 1e-9)),
        ("deadband", 0.0, DEADBAND_SIGMA),
        (
            "goal_damping",
            damping + rig.kv,
            priors.damping * (damping + rig.kv + 0.02 * rig.torque),
        ),
        ("limit_damping", damping, priors.damping * (damping + 0.02 * rig.torque)),
        ("inertia", 0.0, 0.01 * rig.kp),
        ("scale", 0.0, priors.limit),
    ):
        columns = slice(column[name], column[name] + n)
        mean[columns], sd[columns] = centre, sigma
    model = rig.model
    weight = float(np.linalg.norm(model.gravity_vector)) or 1.0
    force = MASS_SIGMA_SHARE * float(rig.torque.max()) / (0.5 * model.reach)
    # Without this unknown, a cable that pulls at the tool would be taken for a change of k_p.
    sd[FORCE] = force
    if priors.payload:
        lift = force / weight
        sd[MASS], sd[MOMENTS] = lift, COM_SIGMA * lift
        known = model.payload
        if known is not None:
            mean[MASS], mean[MOMENTS] = known.mass, known.mass * np.asarray(known.com)
    return mean, sd


#: Largest delay that the fit of the delay tries [s].
MAX_DELAY = 0.08
#: Difference of the delays that are tried, and time step of the simulated step responses [s].
TIME_STEP = 0.001
#: Time for which simulated and measured step responses are compared [s].
COMPARED_TIME = 0.06
#: Joint inertias that are tried in the fit of the delay, divided by the stiffness k_p [s²].
INERTIAS = np.geomspace(0.008, 0.12, 28) ** 2


@dataclass(frozen=True)
class Delay:
    """A measured delay of the control loop.

    Attributes:
        seconds: Time from reading the positions to the arrival of the goal at the servos [s].
        sigma: Standard deviation of the delay [s].
        joints: Delay estimated from each joint alone (n,) [s].
    """

    seconds: float
    sigma: float
    joints: Array


def fit_delay(
    rig: Excitation, records: Sequence[Record], solution: Solution, gravity: Array
) -> Delay:
    """Return the delay for which simulated step responses of all joints fit the measured ones best.

    Args:
        rig: Model and servo parameters of the arm.
        records: Recorded step responses, one record per joint.
        solution: Fitted stiffness, friction and damping.
        gravity: Torques that hold the arm against gravity (n,) [N·m].
    """
    grid = np.arange(0.0, MAX_DELAY + TIME_STEP / 2, TIME_STEP)
    misfit = np.array(
        [
            _misfit(rig, record, j, solution, gravity=float(gravity[j]), grid=grid)
            for j, record in enumerate(records)
        ]
    )
    floor = misfit.min(axis=1, keepdims=True)
    # Divide the misfit of each joint by its minimum, so that all joints have the same weight.
    total = (misfit / floor).sum(axis=0)
    joint_delays = grid[np.argmin(misfit, axis=1)]
    best = _parabola_minimum(grid, total)
    spread_of_delays = np.median(np.abs(joint_delays - np.median(joint_delays)))
    sigma = max(1.5 * spread_of_delays / np.sqrt(len(joint_delays)), TIME_STEP)
    return Delay(best, float(sigma), joint_delays)


def _parabola_minimum(grid: Array, cost: Array) -> float:
    """Return the minimum position of a sampled curve, by a parabola through three samples.

    The parabola passes through the lowest sample and its two neighbours. If the lowest sample is
    the first or the last one, its position is returned.
    """
    k = int(np.argmin(cost))
    if not 0 < k < len(grid) - 1:
        return float(grid[k])
    a, b, c = cost[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return (
        float(grid[k] + 0.5 * (a - c) / bend * (grid[1] - grid[0])) if bend > 0 else float(grid[k])
    )


def _misfit(
    rig: Excitation, record: Record, joint: int, solution: Solution, *, gravity: float, grid: Array
) -> Array:
    """Return the mean squared difference of simulated and measured step responses [rad²].

    The result has one value per delay in `grid` [s]: the smallest over all inertias of `INERTIAS`.
    Each value includes the variance due to the resolution of the encoder.
    """
    q, goal, limit, _ = (rows[:, joint] for rows in record.arrays())
    value = {name: float(array[joint]) for name, array in solution.value.items()}
    delay, inertia = (x.ravel() for x in np.meshgrid(grid, INERTIAS * value["kp"], indexing="ij"))
    damping = max(value["limit_damping"], 0.0)
    servo_damping = np.maximum(value["goal_damping"] - damping - value["kp"] * delay, 0.0)
    dry = max(value["friction"], 0.0)
    jumps = np.flatnonzero(np.abs(np.diff(goal)) > 0.0) + 1
    cost, ticks = np.zeros(delay.size), max(round(COMPARED_TIME / rig.period), 5)
    per_tick = max(round(rig.period / TIME_STEP), 1)
    dt = rig.period / per_tick
    for k in jumps:
        if k + ticks >= len(q):
            continue
        position, speed = np.full(delay.size, q[k]), np.zeros(delay.size)
        for tick in range(ticks):
            for sub in range(per_tick):
                now = (tick * per_tick + sub) * dt
                target = np.where(now >= delay - 1e-9, goal[k], goal[k - 1])
                torque = value["kp"] * (target - position) - servo_damping * speed
                torque = np.clip(torque, -limit[k], limit[k]) - gravity
                speed = (speed + dt / inertia * torque) / (1.0 + dt / inertia * damping)
                slip = np.maximum(np.abs(speed) - dt / inertia * dry, 0.0)
                speed = np.sign(speed) * slip
                position = position + dt * speed
            cost += (position - q[k + tick + 1]) ** 2
    cost /= max(len(jumps) * ticks, 1)
    cost += (0.3 * max(rig.count[joint], 1e-4)) ** 2
    best: Array = cost.reshape(grid.size, INERTIAS.size).min(axis=1)
    return best
