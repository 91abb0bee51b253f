"""Weighted least-squares fit over all segments: stiffness, friction, damping and payload at once.

Multiplying the stiffness by the lead makes the equation linear in every unknown. The assumed values
enter as priors, one more row per unknown with its own error. An unknown that the poses cannot
determine thus keeps its assumed value and error.
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


#: Unknowns of each joint, in the order of their columns: k_p [N·m/rad], f [N·m], l and m [1],
#: D and d [N·m·s/rad], M [kg·m²], dead band b [rad], and ratio of true to commanded torque of a
#: limit, minus one [1].
NAMES = ("kp", "friction", "load", "motor", "total", "outer", "inertia", "deadband", "scale")
#: Prior of a servo's dead band: 0 with this standard deviation [rad].
DEAD = 1e-3
#: Iterations of the linearised fit.
ROUNDS = 8
#: Prior of the distance of a payload's centre from the tool's origin: standard deviation [m].
LEVER = 0.1
#: Prior of a payload's mass: standard deviation, as a share of the mass that the arm can lift.
MASS = 0.5


@dataclass(frozen=True, kw_only=True)
class Priors:
    """Standard deviations of the priors.

    Attributes:
        kp: Of the stiffness, relative.
        friction, damping: Of friction and damping, relative.
        limit: Of the true torque at a limit, relative.
        load: Of the share of the load that adds to friction [1]; 0 leaves it out.
        payload: True if there may be a payload.
    """

    kp: float = 0.5
    friction: float = 3.0
    damping: float = 3.0
    limit: float = 0.05
    load: float | Array = 0.0
    payload: bool = True


@dataclass(frozen=True)
class Solution:
    """Result of the fit.

    Attributes:
        value: Unknowns of each joint by name, (n,) each; scaled as in `NAMES`.
        sigma: Their standard deviations.
        payload: φ = (m, m c) (4,) [kg, kg m].
        payload_covariance: Covariance of φ (4, 4).
        separated: Reduction of the error of each direction of φ by the data alone (4,): 0 none, 1
            complete.
        spread: Ratio of the residuals to their assumed noise.
        rows: Slides used.
    """

    value: dict[str, Array]
    sigma: dict[str, Array]
    payload: Array
    payload_covariance: Array
    separated: Array
    spread: float
    rows: int


def noise(rig: Excitation, segment: Segment, kp: Array, friction: Array, dead: Array) -> float:
    """Return the standard deviation of one row [N·m]: varying friction, counts, model errors.

    A torque just above the dead band may have crossed it within the slide.
    """
    i = segment.joint
    counts = kp[i] * max(rig.count[i], 1e-4) * 0.5 / np.sqrt(segment.samples)
    band = 0.0
    if not segment.by_limit:
        edge = kp[i] * abs(dead[i])
        band = (0.5 if kp[i] * abs(segment.drive) < 4.0 * edge else 0.1) * edge
    known = (0.04 * friction[i]) ** 2 + (1e-3 * rig.torque[i]) ** 2
    return float(np.sqrt(known + counts**2 + band**2))


def solve(rig: Excitation, segments: Sequence[Segment], priors: Priors) -> Solution:
    """Fit all unknowns, in `ROUNDS` iterations with updated linearisation and noise."""
    solution = None
    for _ in range(ROUNDS):
        solution = _fit(rig, segments, priors, solution)
    assert solution is not None
    return solution


def predicted(segment: Segment, solution: Solution) -> float:
    """Return the torque [N·m] of a servo in a segment, by the present solution."""
    i, value = segment.joint, solution.value
    load = segment.gravity + float(segment.payload @ solution.payload)
    motor = abs(segment.drive) * (1.0 if segment.by_limit else value["kp"][i])
    dry = value["friction"][i] + value["load"][i] * abs(load) + value["motor"][i] * motor
    viscous = value["outer" if segment.by_limit else "total"][i] * segment.speed
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
    dead = np.zeros(n) if last is None else last.value["deadband"]
    width = len(NAMES) * n + 4
    at = {name: k * n for k, name in enumerate(NAMES)}
    design, right = np.zeros((len(segments), width)), np.zeros(len(segments))
    for k, segment in enumerate(segments):
        i, row = segment.joint, design[k]
        load = segment.gravity
        if last is not None:
            load += float(segment.payload @ last.payload)
        if segment.by_limit:
            row[at["scale"] + i] = segment.drive
            row[at["outer"] + i] = -segment.speed
            right[k] = segment.gravity - segment.drive
        else:
            # Linear around the last values. The lead is the predicted one: a noisy regressor would
            # bias the stiffness of joints without gravity toward zero.
            torque = kp[i] * segment.drive if last is None else predicted(segment, last)
            row[at["kp"] + i] = torque / kp[i]
            row[at["deadband"] + i] = -kp[i] * np.sign(torque)
            row[at["total"] + i] = -segment.speed
            right[k] = segment.gravity + torque - kp[i] * segment.drive
        row[at["friction"] + i] = -segment.direction
        row[at["load"] + i] = -segment.direction * abs(load)
        row[at["motor"] + i] = -segment.direction * abs(
            segment.drive * (1.0 if segment.by_limit else kp[i])
        )
        row[at["inertia"] + i] = -segment.acceleration
        row[-4:] = -segment.payload
        sigma = noise(rig, segment, kp, friction, dead)
        row /= sigma
        right[k] /= sigma
    mean, sd = _prior(rig, priors, width, at)
    if last is not None:
        # Prior of the centre for a payload of the present mass.
        sd[-3:] = (
            np.maximum(LEVER * max(last.payload[0], 0.05), 1e-6) if priors.payload else sd[-3:]
        )
    # Scaled by the priors, so that the information is comparable between unknowns.
    scaled = design * sd
    information = scaled.T @ scaled
    covariance = np.linalg.inv(information + np.eye(width))
    delta = covariance @ (scaled.T @ (right - design @ mean))
    x = mean + sd * delta
    residual = right - design @ x
    used = float(np.trace(information @ covariance))
    spread = float(np.sqrt(residual @ residual / max(len(segments) - used, 1.0)))
    covariance = covariance * max(spread, 1.0) ** 2
    deviation = sd * np.sqrt(np.minimum(np.diag(covariance), 1.0))
    value = {name: x[at[name] : at[name] + n] for name in NAMES}
    value["scale"] = 1.0 + value["scale"]
    own = np.linalg.eigvalsh(covariance[-4:, -4:])[::-1]
    return Solution(
        value=value,
        sigma={name: deviation[at[name] : at[name] + n] for name in NAMES},
        payload=x[-4:],
        payload_covariance=covariance[-4:, -4:] * np.outer(sd[-4:], sd[-4:]),
        separated=1.0 - np.sqrt(np.clip(own, 0.0, 1.0)),
        spread=spread,
        rows=len(segments),
    )


def _prior(rig: Excitation, priors: Priors, width: int, at: dict[str, int]) -> tuple[Array, Array]:
    """Return means and standard deviations of the priors of all unknowns."""
    n = rig.n
    mean, sd = np.zeros(width), np.full(width, 1e-9)
    outer = rig.damping + rig.back_emf
    for name, middle, error in (
        ("kp", rig.kp, priors.kp * rig.kp),
        ("friction", rig.friction, priors.friction * np.maximum(rig.friction, 0.01 * rig.torque)),
        ("load", 0.0, np.maximum(priors.load, 1e-9)),
        ("motor", 0.0, np.maximum(priors.load, 1e-9)),
        ("deadband", 0.0, DEAD),
        ("total", outer + rig.kv, priors.damping * (outer + rig.kv + 0.02 * rig.torque)),
        ("outer", outer, priors.damping * (outer + 0.02 * rig.torque)),
        ("inertia", 0.0, 0.01 * rig.kp),
        ("scale", 0.0, priors.limit),
    ):
        columns = slice(at[name], at[name] + n)
        mean[columns], sd[columns] = middle, error
    if priors.payload:
        model = rig.model
        weight = float(np.linalg.norm(model.gravity_vector)) or 1.0
        lift = MASS * float(rig.torque.max()) / (0.5 * model.reach) / weight
        sd[-4], sd[-3:] = lift, LEVER * lift
        known = model.payload
        if known is not None:
            mean[-4], mean[-3:] = known.mass, known.mass * np.asarray(known.com)
    return mean, sd


#: Longest delay tried [s], physics step [s], and compared length of each response [s].
MAX_DELAY, STEP, COMPARED_TIME = 0.08, 0.001, 0.06
#: Inertias tried, as k_p times the square of a time [s].
INERTIAS = np.geomspace(0.008, 0.12, 28) ** 2


@dataclass(frozen=True)
class Delay:
    """A measured delay.

    Attributes:
        seconds: Time from the reading to the arrival of the goal, T_d [s].
        sigma: Its standard deviation [s].
        joints: Delay estimated from each joint alone (n,) [s].
    """

    seconds: float
    sigma: float
    joints: Array


def fit_delay(
    rig: Excitation, records: Sequence[Record], solution: Solution, gravity: Array
) -> Delay:
    """Fit the delay to the steps of all joints, one record each, under `gravity` (n,) [N·m]."""
    grid = np.arange(0.0, MAX_DELAY + STEP / 2, STEP)
    misfit = np.array(
        [
            _misfit(rig, record, j, solution, gravity=float(gravity[j]), grid=grid)
            for j, record in enumerate(records)
        ]
    )
    floor = misfit.min(axis=1, keepdims=True)
    # Weight each joint by its best fit.
    total = (misfit / floor).sum(axis=0)
    each = grid[np.argmin(misfit, axis=1)]
    best = _vertex(grid, total)
    middle = np.median(np.abs(each - np.median(each)))
    sigma = max(1.5 * middle / np.sqrt(len(each)), STEP)
    return Delay(best, float(sigma), each)


def _vertex(grid: Array, cost: Array) -> float:
    """Return the minimum of a sampled curve, by a parabola through its lowest three samples."""
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
    """Return the mean squared position error of a joint's simulated step responses [rad²].

    One value for each delay in `grid` [s]: the smallest over the trial inertias. Each includes the
    variance of the encoder's resolution, which is the same for all delays.
    """
    q, goal, limit, _ = (rows[:, joint] for rows in record.arrays())
    value = {name: float(array[joint]) for name, array in solution.value.items()}
    late, inertia = (x.ravel() for x in np.meshgrid(grid, INERTIAS * value["kp"], indexing="ij"))
    outer = max(value["outer"], 0.0)
    inner = np.maximum(value["total"] - outer - value["kp"] * late, 0.0)
    dry = max(value["friction"], 0.0)
    jumps = np.flatnonzero(np.abs(np.diff(goal)) > 0.0) + 1
    cost, ticks = np.zeros(late.size), max(round(COMPARED_TIME / rig.period), 5)
    per_tick = max(round(rig.period / STEP), 1)
    dt = rig.period / per_tick
    for k in jumps:
        if k + ticks >= len(q):
            continue
        position, speed = np.full(late.size, q[k]), np.zeros(late.size)
        for tick in range(ticks):
            for sub in range(per_tick):
                now = (tick * per_tick + sub) * dt
                target = np.where(now >= late - 1e-9, goal[k], goal[k - 1])
                torque = value["kp"] * (target - position) - inner * speed
                torque = np.clip(torque, -limit[k], limit[k]) - gravity
                speed = (speed + dt / inertia * torque) / (1.0 + dt / inertia * outer)
                slip = np.maximum(np.abs(speed) - dt / inertia * dry, 0.0)
                speed = np.sign(speed) * slip
                position = position + dt * speed
            cost += (position - q[k + tick + 1]) ** 2
    cost /= max(len(jumps) * ticks, 1)
    cost += (0.3 * max(rig.count[joint], 1e-4)) ** 2
    best: Array = cost.reshape(grid.size, INERTIAS.size).min(axis=1)
    return best
