"""Weighted least-squares fit over all slides: stiffness, friction, damping and payload at once.

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

    from numpy.typing import NDArray

    from pliant.identify.rig import Rig
    from pliant.identify.slides import Slide

    Array = NDArray[np.float64]

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
class Beliefs:
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
    load: float | NDArray[np.float64] = 0.0
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

    value: dict[str, NDArray[np.float64]]
    sigma: dict[str, NDArray[np.float64]]
    payload: NDArray[np.float64]
    payload_covariance: NDArray[np.float64]
    separated: NDArray[np.float64]
    spread: float
    rows: int


def noise(rig: Rig, slide: Slide, kp: Array, friction: Array, dead: Array) -> float:
    """Return the standard deviation of one row [N·m]: varying friction, counts, model errors.

    A torque just above the dead band may have crossed it within the slide.
    """
    i = slide.joint
    counts = kp[i] * max(rig.count[i], 1e-4) * 0.5 / np.sqrt(slide.samples)
    band = 0.0
    if not slide.by_limit:
        edge = kp[i] * abs(dead[i])
        band = (0.5 if kp[i] * abs(slide.drive) < 4.0 * edge else 0.1) * edge
    known = (0.04 * friction[i]) ** 2 + (1e-3 * rig.torque[i]) ** 2
    return float(np.sqrt(known + counts**2 + band**2))


def solve(rig: Rig, slides: Sequence[Slide], beliefs: Beliefs) -> Solution:
    """Fit all unknowns, in `ROUNDS` iterations with updated linearisation and noise."""
    solution = None
    for _ in range(ROUNDS):
        solution = _fit(rig, slides, beliefs, solution)
    assert solution is not None
    return solution


def predicted(slide: Slide, solution: Solution) -> float:
    """Return the torque [N·m] of a servo in a slide, by the present solution."""
    i, value = slide.joint, solution.value
    load = slide.gravity + float(slide.payload @ solution.payload)
    motor = abs(slide.drive) * (1.0 if slide.by_limit else value["kp"][i])
    dry = value["friction"][i] + value["load"][i] * abs(load) + value["motor"][i] * motor
    viscous = value["outer" if slide.by_limit else "total"][i] * slide.speed
    return float(load + slide.direction * dry + viscous + value["inertia"][i] * slide.acceleration)


def _fit(
    rig: Rig,
    slides: Sequence[Slide],
    beliefs: Beliefs,
    last: Solution | None,
) -> Solution:
    n = rig.n
    kp = rig.kp if last is None else np.clip(last.value["kp"], 0.1 * rig.kp, 10.0 * rig.kp)
    friction = rig.friction if last is None else np.maximum(last.value["friction"], 0.0)
    dead = np.zeros(n) if last is None else last.value["deadband"]
    width = len(NAMES) * n + 4
    at = {name: k * n for k, name in enumerate(NAMES)}
    design, right = np.zeros((len(slides), width)), np.zeros(len(slides))
    for k, slide in enumerate(slides):
        i, row = slide.joint, design[k]
        load = slide.gravity
        if last is not None:
            load += float(slide.payload @ last.payload)
        if slide.by_limit:
            row[at["scale"] + i] = slide.drive
            row[at["outer"] + i] = -slide.speed
            right[k] = slide.gravity - slide.drive
        else:
            # Linear around the last values. The lead is the predicted one: a noisy regressor would
            # bias the stiffness of joints without gravity toward zero.
            torque = kp[i] * slide.drive if last is None else predicted(slide, last)
            row[at["kp"] + i] = torque / kp[i]
            row[at["deadband"] + i] = -kp[i] * np.sign(torque)
            row[at["total"] + i] = -slide.speed
            right[k] = slide.gravity + torque - kp[i] * slide.drive
        row[at["friction"] + i] = -slide.direction
        row[at["load"] + i] = -slide.direction * abs(load)
        row[at["motor"] + i] = -slide.direction * abs(
            slide.drive * (1.0 if slide.by_limit else kp[i])
        )
        row[at["inertia"] + i] = -slide.acceleration
        row[-4:] = -slide.payload
        sigma = noise(rig, slide, kp, friction, dead)
        row /= sigma
        right[k] /= sigma
    mean, sd = _prior(rig, beliefs, width, at)
    if last is not None:
        # Prior of the centre for a payload of the present mass.
        sd[-3:] = (
            np.maximum(LEVER * max(last.payload[0], 0.05), 1e-6) if beliefs.payload else sd[-3:]
        )
    # Scaled by the priors, so that the information is comparable between unknowns.
    scaled = design * sd
    information = scaled.T @ scaled
    covariance = np.linalg.inv(information + np.eye(width))
    delta = covariance @ (scaled.T @ (right - design @ mean))
    x = mean + sd * delta
    residual = right - design @ x
    used = float(np.trace(information @ covariance))
    spread = float(np.sqrt(residual @ residual / max(len(slides) - used, 1.0)))
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
        rows=len(slides),
    )


def _prior(rig: Rig, beliefs: Beliefs, width: int, at: dict[str, int]) -> tuple[Array, Array]:
    """Return means and standard deviations of the priors of all unknowns."""
    n = rig.n
    mean, sd = np.zeros(width), np.full(width, 1e-9)
    outer = rig.damping + rig.back_emf
    for name, middle, error in (
        ("kp", rig.kp, beliefs.kp * rig.kp),
        ("friction", rig.friction, beliefs.friction * np.maximum(rig.friction, 0.01 * rig.torque)),
        ("load", 0.0, np.maximum(beliefs.load, 1e-9)),
        ("motor", 0.0, np.maximum(beliefs.load, 1e-9)),
        ("deadband", 0.0, DEAD),
        ("total", outer + rig.kv, beliefs.damping * (outer + rig.kv + 0.02 * rig.torque)),
        ("outer", outer, beliefs.damping * (outer + 0.02 * rig.torque)),
        ("inertia", 0.0, 0.01 * rig.kp),
        ("scale", 0.0, beliefs.limit),
    ):
        columns = slice(at[name], at[name] + n)
        mean[columns], sd[columns] = middle, error
    if beliefs.payload:
        model = rig.model
        weight = float(np.linalg.norm(model.gravity_vector)) or 1.0
        lift = MASS * float(rig.torque.max()) / (0.5 * model.reach) / weight
        sd[-4], sd[-3:] = lift, LEVER * lift
        known = model.payload
        if known is not None:
            mean[-4], mean[-3:] = known.mass, known.mass * np.asarray(known.com)
    return mean, sd
