"""Implementations of kinematics and control step in Python code that Numba or JAX compiles."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from comparison import problem
from comparison.peer import Implementation, Pair


def numba() -> Implementation:
    """Return the Numba implementation, which loops over array elements."""
    import numba as nb

    from comparison import numba_step

    arm = problem.bench_arm()
    functions = numba_step.compile_for(arm)
    return Implementation(f"Numba {nb.__version__}", *functions)


def jax() -> Implementation:
    """Return the JAX implementation: XLA compiles it for the CPU.

    The time includes the conversion of the results to NumPy arrays.
    """
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
    import jax as library
    import jax.numpy as jnp

    library.config.update("jax_enable_x64", True)
    library.config.update("jax_platforms", "cpu")
    arm = problem.bench_arm()
    links = jnp.array(arm.links)
    compliant = np.arange(6) == problem.YIELDS

    def kinematics(q: Any) -> Any:
        pose, frames = links[0], []
        for i in range(arm.n):
            c, s = jnp.cos(q[i]), jnp.sin(q[i])
            first, second = c * pose[:, 0] + s * pose[:, 1], c * pose[:, 1] - s * pose[:, 0]
            frames.append(pose)
            pose = jnp.stack([first, second, pose[:, 2], pose[:, 3]], axis=1) @ links[i + 1]
        columns = [
            jnp.concatenate([jnp.cross(f[:3, 2], pose[:3, 3] - f[:3, 3]), f[:3, 2]]) for f in frames
        ]
        return pose, jnp.stack(columns, axis=1)

    def step(q: Any, target: Any) -> Any:
        pose, jacobian = kinematics(q)
        rotation = target[:3, :3] @ pose[:3, :3].T
        v = jnp.array(
            [
                rotation[2, 1] - rotation[1, 2],
                rotation[0, 2] - rotation[2, 0],
                rotation[1, 0] - rotation[0, 1],
            ]
        )
        sine = jnp.sqrt(v @ v)
        angle = jnp.arctan2(sine, jnp.trace(rotation) - 1.0)
        scale = jnp.where(sine > 1e-12, angle / jnp.where(sine > 1e-12, sine, 1.0), 0.5)
        e = jnp.concatenate([target[:3, 3] - pose[:3, 3], scale * v])
        adapted = (1.0 - problem.ETA * compliant) * e
        gram = jacobian @ jacobian.T + problem.DAMPING**2 * jnp.eye(6)
        factor = library.scipy.linalg.cho_factor(gram)
        inverse = library.scipy.linalg.cho_solve(factor, jacobian).T
        gradient = (q - arm.rest) + arm.limit_weights * (q - arm.middle)
        null = gradient - inverse @ (jacobian @ gradient)
        motion = problem.GAIN * (inverse @ adapted) - problem.ALPHA * null
        shares = jnp.abs(inverse)
        shares = shares / shares.sum(axis=0)
        width = problem.D_PLUS - problem.D_MINUS
        c = jnp.clip((problem.D_PLUS - jnp.abs(adapted)) / width, 0.0, 1.0)
        strength = jnp.where(compliant, c * problem.SOFT + (1.0 - c) * problem.FIRM, problem.HOLD)
        size = jnp.abs(null)
        limit = shares @ strength + problem.NULL * size / size.sum()
        return q + problem.HORIZON * motion, limit

    jit_kinematics, jit_step = library.jit(kinematics), library.jit(step)
    batch = library.jit(library.vmap(kinematics))

    def both(functions: Any) -> Pair:
        first, second = functions
        return np.asarray(first), np.asarray(second)

    return Implementation(
        f"JAX {library.__version__}",
        lambda q: both(jit_kinematics(q)),
        lambda q, target: both(jit_step(q, target)),
        lambda configurations: both(batch(configurations)),
        batch_size=20_000,
    )
