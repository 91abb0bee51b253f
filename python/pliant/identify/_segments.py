"""Division of records into slides: stretches of steady motion of a joint, averaged to one row each.

While joint i slides with speed v, direction s = ±1 and acceleration a, its servo torque is

    k_p,i (lead_i − b_i sign τ_i) = τ_i = τ_e,i + s (f_i + l_i |τ_e,i| + m_i |τ_i|) + D_i v + M_i a,

where τ_e = g(q) + Y(q) φ is the load, φ = (m, m c) the payload, lead = goal − q averaged over the
stretch, b the servo's dead band, and D the total speed-dependent resistance: gears, back-EMF, the
servo's own damping, and k_p T_d for the delay of the bus. For a joint whose torque is set by its
limit, that torque replaces k_p lead, and its D contains neither the servo's own damping nor the
delay.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._core import Model
    from pliant._typing import Array, Mask
    from pliant.identify._excitation import Excitation, Record


#: Time window of the speed measurement, and least length of a slide [s].
WINDOW, MIN_LENGTH = 0.12, 0.16
#: Ratio of measured to planned speed within which a joint slides steadily.
STEADY = (0.5, 1.6)
#: Share of the torque limit above which the limit may have cut the torque.
LIMIT_SHARE = 0.7


@dataclass(frozen=True)
class Segment:
    """One row of the regression.

    Attributes:
        joint: Index.
        by_limit: True if the torque was set by the limit.
        drive: Mean lead [rad], or torque [N·m] if `by_limit`.
        gravity: Torque that holds the arm there without payload [N·m].
        payload: Row Y (4,), the torque of a payload per (m, m c) [N·m/kg, N/kg].
        speed: Mean speed [rad/s].
        acceleration: Mean acceleration [rad/s²].
        samples: Ticks averaged.
    """

    joint: int
    by_limit: bool
    drive: float
    gravity: float
    payload: Array
    speed: float
    acceleration: float
    samples: int

    @property
    def direction(self) -> float:
        """Sign of the speed."""
        return float(np.sign(self.speed))


def payload_rows(model: Model, q: ArrayLike) -> Array:
    """Return Y(q) (n, 4): Y φ is the torque that holds a payload φ = (m, m c), tool frame.

    ``Y_m = −J_vᵀ g`` for the mass at the tool's origin, and ``−J_ωᵀ (R m c × g)`` for its lever
    arm.
    """
    pose, jacobian = model.kinematics(q)
    g = np.asarray(model.gravity_vector)
    turned = np.cross(pose[:3, :3].T, g)  # rows: R e_k × g
    return np.column_stack([-jacobian[:3].T @ g, -jacobian[3:].T @ turned.T])


def bare_gravity(model: Model, q: ArrayLike) -> Array:
    """Return the torques (n,) [N·m] that hold the arm without its model's payload."""
    gravity = np.asarray(model.gravity(q))
    if model.payload is None:
        return gravity
    return gravity - payload_rows(model, q) @ first_moments(model.payload.mass, model.payload.com)


def first_moments(mass: float, com: ArrayLike) -> Array:
    """Return φ = (m, m c) (4,) [kg, kg m]."""
    return np.concatenate([[mass], mass * np.asarray(com, dtype=np.float64)])


def find_segments(rig: Excitation, record: Record) -> list[Segment]:
    """Return all steady segments of a record, joint by joint."""
    q, goal, limit, planned = record.arrays()
    if len(q) < 3:
        return []
    half = max(round(0.5 * WINDOW / rig.period), 1)
    speed = np.zeros_like(q)
    speed[half:-half] = (q[2 * half :] - q[: -2 * half]) / (2.0 * half * rig.period)
    joints = range(rig.n) if record.driven < 0 else [record.driven]
    out = []
    for joint in joints:
        top = np.abs(planned[:, joint]).max()
        if top <= 0.0:
            continue
        full = np.abs(planned[:, joint]) > 0.98 * top
        ratio = speed[:, joint] / np.where(full, planned[:, joint], 1.0)
        good = full & (ratio > STEADY[0]) & (ratio < STEADY[1])
        for start, end in runs(good):
            row = _average(rig, record, joint, (start, end), (q, goal, limit))
            if row is not None:
                out.append(row)
    return out


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return start and end (exclusive) of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _average(
    rig: Excitation,
    record: Record,
    joint: int,
    ticks: tuple[int, int],
    data: tuple[Array, Array, Array],
) -> Segment | None:
    """Average ticks start … end of one joint; None if too short or cut by the limit."""
    (start, end), (q, goal, limit) = ticks, data
    if (end - start) * rig.period < MIN_LENGTH:
        return None
    before, after = slice(start, end - 1), slice(start + 1, end)
    span = (end - 1 - start) * rig.period
    lead = goal[before, joint] - 0.5 * (q[before, joint] + q[after, joint])
    by_limit = record.driven >= 0
    if by_limit:
        drive = float(np.mean(np.sign(lead) * limit[before, joint]))
    else:
        drive = float(lead.mean())
        kp = rig.kp[joint] / rig.stiffness_uncertainty
        if (kp * np.abs(lead) > LIMIT_SHARE * limit[before, joint]).any():
            return None
    middle = q[start:end].mean(axis=0)
    third = max((end - start) // 3, 2)
    first, last = q[start : start + third, joint], q[end - third : end, joint]
    pace = (third - 1) * rig.period
    rates = (first[-1] - first[0]) / pace, (last[-1] - last[0]) / pace
    return Segment(
        joint=joint,
        by_limit=by_limit,
        drive=drive,
        gravity=float(bare_gravity(rig.model, middle)[joint]),
        payload=payload_rows(rig.model, middle)[joint],
        speed=float((q[end - 1, joint] - q[start, joint]) / span),
        acceleration=float((rates[1] - rates[0]) / max(span - pace, rig.period)),
        samples=end - start,
    )
