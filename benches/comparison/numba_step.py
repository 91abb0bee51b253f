"""Control step of law `paper` as loops that Numba compiles."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from comparison import problem
from comparison.peer import Pair
from comparison.problem import Array

KEPT_SHARE = np.where(np.arange(6) == problem.YIELDS, 1.0 - problem.ETA, 1.0)
SOFT = np.where(np.arange(6) == problem.YIELDS, problem.SOFT, problem.HOLD)
FIRM = np.where(np.arange(6) == problem.YIELDS, problem.FIRM, problem.HOLD)
D_MINUS, D_PLUS = problem.D_MINUS, problem.D_PLUS
DAMPING, GAIN, HORIZON = problem.DAMPING, problem.GAIN, problem.HORIZON
ALPHA, NULL = problem.ALPHA, problem.NULL


def compile_for(
    arm: problem.Arm,
) -> tuple[Callable[..., Pair], Callable[..., Any], Callable[..., Pair]]:
    """Compile the functions of the implementation, with the arm's data as constants.

    Returns:
        The functions `kinematics`, `step` and `batch` of `Implementation`.
    """
    links, n = arm.links, arm.n
    middle, weights, rest_q = arm.middle, arm.limit_weights, arm.rest

    @njit(error_model="numpy", inline="always")
    def fill(q: Array, pose: Array, jacobian: Array) -> None:
        frame, rotated = np.empty((3, 4)), np.empty((3, 2))
        axes, origins = np.empty((3, n)), np.empty((3, n))
        frame[:] = links[0, :3]
        for i in range(n):
            c, s = math.cos(q[i]), math.sin(q[i])
            for r in range(3):
                axes[r, i], origins[r, i] = frame[r, 2], frame[r, 3]
                rotated[r, 0] = c * frame[r, 0] + s * frame[r, 1]
                rotated[r, 1] = c * frame[r, 1] - s * frame[r, 0]
            for r in range(3):
                x, y, z, p = rotated[r, 0], rotated[r, 1], frame[r, 2], frame[r, 3]
                for k in range(4):
                    frame[r, k] = (
                        x * links[i + 1, 0, k] + y * links[i + 1, 1, k] + z * links[i + 1, 2, k]
                    )
                frame[r, 3] += p
        for r in range(3):
            for k in range(4):
                pose[r, k] = frame[r, k]
            pose[3, r] = 0.0
        pose[3, 3] = 1.0
        for i in range(n):
            ax, ay, az = axes[0, i], axes[1, i], axes[2, i]
            x, y, z = (
                frame[0, 3] - origins[0, i],
                frame[1, 3] - origins[1, i],
                frame[2, 3] - origins[2, i],
            )
            jacobian[0, i] = ay * z - az * y
            jacobian[1, i] = az * x - ax * z
            jacobian[2, i] = ax * y - ay * x
            jacobian[3, i], jacobian[4, i], jacobian[5, i] = ax, ay, az

    @njit(error_model="numpy")
    def kinematics(q: Array) -> Pair:
        pose, jacobian = np.empty((4, 4)), np.empty((6, n))
        fill(q, pose, jacobian)
        return pose, jacobian

    @njit(error_model="numpy")
    def batch(configurations: Array) -> Pair:
        count = len(configurations)
        poses, jacobians = np.empty((count, 4, 4)), np.empty((count, 6, n))
        for i in range(count):
            fill(configurations[i], poses[i], jacobians[i])
        return poses, jacobians

    @njit(error_model="numpy", inline="always")
    def deviation(pose: Array, target: Array, e: Array) -> None:
        rotation = np.empty((3, 3))
        for r in range(3):
            e[r] = target[r, 3] - pose[r, 3]
            for c in range(3):
                rotation[r, c] = (
                    target[r, 0] * pose[c, 0]
                    + target[r, 1] * pose[c, 1]
                    + target[r, 2] * pose[c, 2]
                )
        x, y, z = (
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        )
        sine = math.sqrt(x * x + y * y + z * z)
        angle = math.atan2(sine, rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1.0)
        scale = angle / sine if sine > 1e-12 else 0.5
        e[3], e[4], e[5] = scale * x, scale * y, scale * z

    @njit(error_model="numpy", inline="always")
    def inverse(jacobian: Array, p: Array) -> None:
        m = np.empty((6, 6))
        for r in range(6):
            for c in range(r + 1):
                total = 0.0
                for i in range(n):
                    total += jacobian[r, i] * jacobian[c, i]
                m[r, c] = total
            m[r, r] += DAMPING * DAMPING
            for i in range(n):
                p[r, i] = jacobian[r, i]
        for j in range(6):
            reciprocal = 1.0 / m[j, j]
            for i in range(j + 1, 6):
                factor = m[i, j] * reciprocal
                for c in range(j + 1, i + 1):
                    m[i, c] -= factor * m[c, j]
                for k in range(n):
                    p[i, k] -= factor * p[j, k]
        for j in range(5, -1, -1):
            reciprocal = 1.0 / m[j, j]
            for k in range(n):
                p[j, k] *= reciprocal
            for i in range(j + 1, 6):
                factor = m[i, j] * reciprocal
                for k in range(n):
                    p[j, k] -= factor * p[i, k]

    @njit(error_model="numpy")
    def step(q: Array, target: Array) -> Pair:
        pose, jacobian, e, p = np.empty((4, 4)), np.empty((6, n)), np.empty(6), np.empty((6, n))
        fill(q, pose, jacobian)
        deviation(pose, target, e)
        inverse(jacobian, p)
        goal, limit = np.zeros(n), np.zeros(n)
        gradient, null = np.empty(n), np.empty(n)
        for i in range(n):
            gradient[i] = (q[i] - rest_q[i]) + weights[i] * (q[i] - middle[i])
            null[i] = gradient[i]
        for r in range(6):
            adapted = KEPT_SHARE[r] * e[r]
            dot, total = 0.0, 0.0
            for i in range(n):
                dot += jacobian[r, i] * gradient[i]
                total += abs(p[r, i])
            c = min(max((D_PLUS[r] - abs(adapted)) / (D_PLUS[r] - D_MINUS[r]), 0.0), 1.0)
            share = (c * SOFT[r] + (1.0 - c) * FIRM[r]) / total
            for i in range(n):
                goal[i] += p[r, i] * (GAIN * adapted)
                null[i] -= p[r, i] * dot
                limit[i] += abs(p[r, i]) * share
        total = 0.0
        for i in range(n):
            total += abs(null[i])
        for i in range(n):
            goal[i] = q[i] + HORIZON * (goal[i] - ALPHA * null[i])
            limit[i] += abs(null[i]) * (NULL / total)
        return goal, limit

    return kinematics, step, batch
