"""NumPy implementation of kinematics and law `paper`.

It is the reference for the results of all implementations, and it computes the law for those whose
library has only kinematics.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from comparison import problem
from comparison.peer import Implementation, Pair
from comparison.problem import Array


def kinematics_of(arm: problem.Arm) -> Callable[[Array], Pair]:
    """Return a function that computes the tool's pose and Jacobian at joint positions (n,)."""
    n, links, last = arm.n, arm.links[:-1], arm.links[-1]
    first, second, local = links[:, :, 0], links[:, :, 1], links.copy()
    frames = np.empty((n, 4, 4))

    def kinematics(q: Array) -> Pair:
        c, s = np.cos(q)[:, None], np.sin(q)[:, None]
        local[:, :, 0] = c * first + s * second
        local[:, :, 1] = c * second - s * first
        here = frames[0]
        here[:] = local[0]
        for i in range(1, n):
            here = np.matmul(here, local[i], out=frames[i])
        pose = here @ last
        axis = frames[:, :3, 2].T
        (x, y, z), (ax, ay, az) = pose[:3, 3:] - frames[:, :3, 3].T, axis
        jacobian = np.empty((6, n))
        jacobian[0] = ay * z - az * y
        jacobian[1] = az * x - ax * z
        jacobian[2] = ax * y - ay * x
        jacobian[3:] = axis
        return pose, jacobian

    return kinematics


def batch_of(arm: problem.Arm) -> Callable[[Array], Pair]:
    """Return a function that computes poses and Jacobians of N joint positions (N, n) at once."""

    def batch(configurations: Array) -> Pair:
        count, n = configurations.shape
        cosine, sine = np.cos(configurations)[..., None], np.sin(configurations)[..., None]
        here, frames = np.eye(4), []
        for i in range(n):
            link = arm.links[i]
            local = np.broadcast_to(link, (count, 4, 4)).copy()
            local[..., 0] = cosine[:, i] * link[:, 0] + sine[:, i] * link[:, 1]
            local[..., 1] = cosine[:, i] * link[:, 1] - sine[:, i] * link[:, 0]
            here = here @ local
            frames.append(here)
        pose = here @ arm.links[n]
        jacobian = np.empty((count, 6, n))
        for i, frame in enumerate(frames):
            axis = frame[:, :3, 2]
            jacobian[:, :3, i] = np.cross(axis, pose[:, :3, 3] - frame[:, :3, 3])
            jacobian[:, 3:, i] = axis
        return pose, jacobian

    return batch


def law_of(arm: problem.Arm) -> Callable[[Array, Array, Array, Array], Pair]:
    """Return a function that evaluates law `paper`, equations (3) to (12) of the paper, in NumPy.

    Its arguments are joint positions, target pose, and the tool's pose and Jacobian. It returns
    joint goals [rad] and torque limits [N·m].
    """
    compliant = np.arange(6) == problem.YIELDS
    # Share of each axis' deviation that remains after the target has been adapted, 1 − η.
    remaining = 1.0 - problem.ETA * compliant
    gains = problem.GAIN * remaining
    width = problem.D_PLUS - problem.D_MINUS
    weights, middle, rest_q = arm.limit_weights, arm.middle, arm.rest
    e = np.empty(6)

    def law(q: Array, target: Array, pose: Array, jacobian: Array) -> Pair:
        e[:3] = target[:3, 3] - pose[:3, 3]
        rotation = target[:3, :3] @ pose[:3, :3].T
        x, y, z = (
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        )
        sine = math.sqrt(x * x + y * y + z * z)
        angle = math.atan2(sine, rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1.0)
        scale = angle / sine if sine > 1e-12 else 0.5
        e[3], e[4], e[5] = scale * x, scale * y, scale * z
        gram = jacobian @ jacobian.T
        gram.flat[::7] += problem.DAMPING**2
        inverse = np.linalg.solve(gram, jacobian).T
        gradient = (q - rest_q) + weights * (q - middle)
        null = gradient - inverse @ (jacobian @ gradient)
        goal = q + problem.HORIZON * (inverse @ (gains * e) - problem.ALPHA * null)
        shares = np.abs(inverse)
        shares /= shares.sum(axis=0)
        null_share = np.abs(null)
        c = np.minimum(np.maximum((problem.D_PLUS - np.abs(remaining * e)) / width, 0.0), 1.0)
        strength = np.where(compliant, c * problem.SOFT + (1.0 - c) * problem.FIRM, problem.HOLD)
        return goal, shares @ strength + null_share * (problem.NULL / null_share.sum())

    return law


def with_law(
    arm: problem.Arm, kinematics: Callable[[Array], Pair]
) -> Callable[[Array, Array], Pair]:
    """Return a function that computes a control step: the given kinematics, then law `paper`.

    Its arguments are joint positions and target pose; it returns goals and torque limits.
    """
    law = law_of(arm)

    def step(q: Array, target: Array) -> Pair:
        pose, jacobian = kinematics(q)
        return law(q, target, pose, jacobian)

    return step


def make() -> Implementation:
    """Return the implementation that computes kinematics and law with NumPy."""
    arm = problem.bench_arm()
    kinematics = kinematics_of(arm)
    return Implementation(
        version=f"NumPy {np.__version__}",
        kinematics=kinematics,
        step=with_law(arm, kinematics),
        batch=batch_of(arm),
        batch_size=20_000,
    )
