"""Benchmark problem: the bench arm, 64 states, and the parameters of law `paper`.

The module parses the URDF without `pliant`, so that an error of pliant's parser does not affect the
other implementations.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

URDF = Path(__file__).resolve().parents[1] / "arm7_bench.urdf"
TOOL = "tool"
STATES = 64
#: Parameters of law `paper`, equations (3) to (12) of the paper: damping λ of the pseudo-inverse,
#: gain K_x [1/s], horizon h [s], null-space gain α [1/s], weight of the joint-limit cost.
DAMPING, GAIN, HORIZON, ALPHA, LIMIT_WEIGHT = 0.02, 4.0, 0.25, 4.0, 0.1
#: Index of the soft axis (y), and its target adaptation η.
YIELDS, ETA = 1, 0.9
#: Deviations d⁻ at which the compliance starts to fall from 1, and d⁺ at which it is 0, of x, y, z
#: [m] and roll, pitch, yaw [rad].
D_MINUS = np.array([0.01] * 3 + [0.04] * 3)
D_PLUS = np.array([0.1] * 3 + [0.4] * 3)
#: Torque budgets [N·m]: soft axis at small deviation, at large deviation, stiff axis, null space.
SOFT, FIRM, HOLD, NULL = 0.5, 10.0, 10.0, 2.0


@dataclass(frozen=True)
class Arm:
    """Arm of the comparison, with frames in which every joint turns about its z axis.

    Attributes:
        links: Constant transforms between these frames (n + 1, 4, 4). The tool's pose is the
            product of links[i] Rz(q_i) over the joints i, times links[n].
        lower, upper: Position limits (n,) [rad].
    """

    links: Array
    lower: Array
    upper: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.lower)

    @property
    def middle(self) -> Array:
        """Middle of each joint's range (n,) [rad]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def limit_weights(self) -> Array:
        """Weight of each joint in the joint-limit cost (n,): `LIMIT_WEIGHT` / (half its range)²."""
        return LIMIT_WEIGHT / (0.5 * (self.upper - self.lower)) ** 2

    @property
    def rest(self) -> Array:
        """Posture that the null-space motion approaches (n,) [rad]."""
        return self.middle + 0.1


def bench_arm() -> Arm:
    """Read and return the arm of the comparison from its URDF.

    The URDF is a serial chain whose joints are listed from base to tool.
    """
    links, lower, upper = [], [], []
    pose = np.eye(4)
    for joint in ET.parse(URDF).getroot().iter("joint"):
        pose = pose @ _origin(joint.find("origin"))
        if joint.get("type") == "revolute":
            axis, limit = joint.find("axis"), joint.find("limit")
            assert axis is not None
            assert limit is not None
            axis_rotation = np.eye(4)
            axis_rotation[:3, :3] = _z_to(_numbers(axis.get("xyz", "1 0 0")))
            links.append(pose @ axis_rotation)
            pose = axis_rotation.T
            lower.append(float(limit.get("lower", "nan")))
            upper.append(float(limit.get("upper", "nan")))
    return Arm(np.array([*links, pose]), np.array(lower), np.array(upper))


def states(arm: Arm) -> list[tuple[Array, Array]]:
    """Return `STATES` pairs of joint positions (n,) [rad] along a closed path.

    The second of a pair is a little further on the path; the tool's pose there is the target.
    """

    def at(angle: float, phase: float) -> Array:
        wave = np.sin(angle + 0.9 * np.arange(arm.n) + phase)
        return arm.middle + 0.2 * (arm.upper - arm.lower) * wave

    angles = [2.0 * np.pi * s / STATES for s in range(STATES)]
    return [(at(turn, 0.0), at(turn, 0.05)) for turn in angles]


def many(arm: Arm, count: int) -> Array:
    """Return joint positions (count, n) [rad] over the joint ranges by a golden-ratio sequence."""
    fraction = (np.arange(count * arm.n) * 0.618033988749895) % 1.0
    return arm.lower + fraction.reshape(count, arm.n) * (arm.upper - arm.lower)


def _origin(origin: ET.Element | None) -> Array:
    out = np.eye(4)
    if origin is not None:
        (cr, cp, cy), (sr, sp, sy) = (
            f(_numbers(origin.get("rpy", "0 0 0"))) for f in (np.cos, np.sin)
        )
        out[:3, :3] = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        out[:3, 3] = _numbers(origin.get("xyz", "0 0 0"))
    return out


def _z_to(axis: Array) -> Array:
    """Return a rotation matrix (3, 3) whose third column is the direction `axis` (3,)."""
    z = axis / np.linalg.norm(axis)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _numbers(text: str) -> Array:
    return np.array([float(token) for token in text.split()])
