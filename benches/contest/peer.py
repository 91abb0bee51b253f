"""Interface that every compared implementation (peer) provides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from contest.problem import Array

Pair = tuple[Array, Array]


@dataclass
class Peer:
    """One implementation of the work; missing parts are None.

    Attributes:
        version: Name and version, for the table.
        kinematics: q (n,) → pose (4, 4) and Jacobian (6, n), world-aligned, of the tool.
        step: q (n,) and target (4, 4) → goal (n,) [rad] and torque limit (n,) [N·m].
        batch: Q (N, n) → poses (N, 4, 4) and Jacobians (N, 6, n).
        batch_size: N of the timed batch; smaller for a Python loop.
        kinematics_call, step_call: Statement of the timed loop, with `f` the function above and
            everything of `names`; it must return the results.
    """

    version: str
    kinematics: Callable[..., Pair] | None = None
    step: Callable[..., Any] | None = None
    batch: Callable[[Array], Pair] | None = None
    batch_size: int = 100_000
    kinematics_call: str = "T, J = f(q)"
    step_call: str = "goal, limit = f(q, t)"
    names: dict[str, Any] = field(default_factory=dict)

    def step_pair(self, q: Array, target: Array) -> Pair:
        """Return goal and limit of one step."""
        assert self.step is not None
        found = self.step(q, target)
        return found if isinstance(found, tuple) else (found.goal, found.torque_limit)


def loop(kinematics: Callable[[Array], Pair]) -> Callable[[Array], Pair]:
    """Return a batch function that calls `kinematics` for each configuration in a Python loop.

    It is for libraries without a batch call. Each call allocates the result arrays.
    """
    import numpy as np

    def batch(configurations: Array) -> Pair:
        n = len(configurations)
        poses, jacobians = np.empty((n, 4, 4)), np.empty((n, 6, configurations.shape[1]))
        for i, q in enumerate(configurations):
            poses[i], jacobians[i] = kinematics(q)
        return poses, jacobians

    return batch
