"""Division of records into segments of steady joint motion, each averaged to one regression row.

While joint i moves with speed v, direction s = ±1 and acceleration a, its servo torque τ_i is

    k_p,i (lead_i − b_i sign τ_i) = τ_i = τ_e,i + s (f_i + l_i |τ_e,i| + m_i |τ_i|) + D_i v + M_i a,

with the servo stiffness k_p, lead = goal − q (joint positions) averaged over the segment, the dead
band b, and the load τ_e = g(q) + Y(q) φ − J_vᵀ F of gravity g, payload φ = (mass, mass times
centre) and a constant horizontal force F at the tool. f is the dry friction, l its growth with
load, m its growth with motor torque, M the inertia. D is the resistance per speed: of gears,
back-EMF, the servo's own damping, and k_p T_d for the delay T_d of the bus. If the torque limit
drives the joint, τ_i is that limit, and D has neither the servo's damping nor the delay.
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


#: Length of the time window of a speed measurement, and minimum duration of a segment [s].
SPEED_WINDOW, MIN_LENGTH = 0.12, 0.16
#: A motion counts as steady if measured over planned speed is between these bounds [1].
STEADY_RATIO = (0.5, 1.6)
#: Segments whose torque exceeds this share of the torque limit are dropped, because the limit may
#: have reduced it [1].
LIMIT_SHARE = 0.7


@dataclass(frozen=True)
class Segment:
    """Means over a steady motion of one joint: one row of the regression.

    Attributes:
        joint: Index of the joint.
        by_limit: True if the torque limit drove the joint.
        drive: Mean lead (goal minus position) [rad]; if `by_limit`, mean signed torque limit [N·m].
        gravity: Torque that holds the joint at the mean positions without payload [N·m].
        payload: Row of `payload_rows` (4,): torque per mass [N·m/kg] and per first moment [N/kg].
        force: Row of `force_rows` (2,): torque per horizontal force at the tool [m].
        speed: Mean speed [rad/s].
        acceleration: Mean acceleration [rad/s²].
        samples: Number of averaged ticks (control cycles).
    """

    joint: int
    by_limit: bool
    drive: float
    gravity: float
    payload: Array
    force: Array
    speed: float
    acceleration: float
    samples: int

    @property
    def direction(self) -> float:
        """Sign of the mean speed: +1 or -1."""
        return float(np.sign(self.speed))


def payload_rows(model: Model, q: ArrayLike) -> Array:
    """Return Y(q) (n, 4): Y φ are the joint torques that hold a payload φ = (m, m c) at the tool.

    m is the mass [kg] and c the centre of mass in the tool frame [m]. The torques are ``−J_vᵀ g m −
    J_ωᵀ (R m c × g)``, with the linear and angular rows J_v and J_ω of the Jacobian, the gravity
    vector g and the rotation R of the tool.
    """
    pose, jacobian = model.kinematics(q)
    g = np.asarray(model.gravity_vector)
    columns = np.cross(pose[:3, :3].T, g)  # rows: column k of the rotation × gravity
    return np.column_stack([-jacobian[:3].T @ g, -jacobian[3:].T @ columns.T])


def force_rows(model: Model, q: ArrayLike) -> Array:
    """Return the joint torques per horizontal force at the tool (n, 2) [m] that hold against it.

    A vertical force is not included, because it acts like the weight of a payload. Without gravity,
    the first two axes of the base count as horizontal.
    """
    jacobian = np.asarray(model.kinematics(q)[1])
    return -jacobian[:3].T @ horizontal_axes(model)


def horizontal_axes(model: Model) -> Array:
    """Return two orthogonal unit vectors (3, 2) in base axes, perpendicular to gravity."""
    g = np.asarray(model.gravity_vector)
    down = g / np.linalg.norm(g) if g.any() else np.array([0.0, 0.0, -1.0])
    axis = np.eye(3)[np.argmin(np.abs(down))]
    first = axis - down * (axis @ down)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(down, first)])


def bare_gravity(model: Model, q: ArrayLike) -> Array:
    """Return the torques (n,) [N·m] that hold the arm, with the payload of the model left out."""
    gravity = np.asarray(model.gravity(q))
    if model.payload is None:
        return gravity
    return gravity - payload_rows(model, q) @ first_moments(model.payload.mass, model.payload.com)


def first_moments(mass: float, com: ArrayLike) -> Array:
    """Return mass and first moments (mass times centre) of a payload as array (4,) [kg, kg·m]."""
    return np.concatenate([[mass], mass * np.asarray(com, dtype=np.float64)])


def find_segments(rig: Excitation, record: Record) -> list[Segment]:
    """Return all segments of steady motion in a record, joint by joint."""
    q, goal, limit, planned = record.arrays()
    if len(q) < 3:
        return []
    half = max(round(0.5 * SPEED_WINDOW / rig.period), 1)
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
        is_steady = full & (ratio > STEADY_RATIO[0]) & (ratio < STEADY_RATIO[1])
        for start, end in true_ranges(is_steady):
            row = _average(rig, record, joint, (start, end), (q, goal, limit))
            if row is not None:
                out.append(row)
    return out


def all_segments(rig: Excitation) -> list[Segment]:
    """Return the segments of steady motion in all records of the excitation."""
    return [segment for record in rig.records for segment in find_segments(rig, record)]


def true_ranges(mask: Mask) -> list[tuple[int, int]]:
    """Return first index and end index (exclusive) of each run of True values in a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _average(
    rig: Excitation,
    record: Record,
    joint: int,
    ticks: tuple[int, int],
    data: tuple[Array, Array, Array],
) -> Segment | None:
    """Return the segment of one joint over the range `ticks` (first, end) of a record.

    `data` holds positions [rad], goals [rad] and torque limits [N·m], (N, n) each. Return None if
    the range is too short, or if the torque limit may have reduced the torque of a joint that
    follows goals.
    """
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
        force=force_rows(rig.model, middle)[joint],
        speed=float((q[end - 1, joint] - q[start, joint]) / span),
        acceleration=float((rates[1] - rates[0]) / max(span - pace, rig.period)),
        samples=end - start,
    )
