"""Interface of the implementations that the speed comparison times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from comparison.problem import Array

Pair = tuple[Array, Array]


@dataclass
class Implementation:
    """Compared implementation of up to three functions; missing functions are None.

    Attributes:
        version: Name and version of the library, for the table.
        kinematics: Function q (n,) → pose (4, 4) and Jacobian (6, n) of the tool in base axes.
        step: Function q (n,), target (4, 4) → goal (n,) [rad], torque limit (n,) [N·m].
        batch: Function Q (N, n) → poses (N, 4, 4), Jacobians (N, 6, n).
        batch_size: Number N of configurations of the timed batch.
        kinematics_call, step_call: Python statement that the timed loop executes. In it, `f` is the
            function `kinematics` or `step`, and `q` and `t` are joint positions and target pose.
        names: Values of the other variables in these statements.
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
        """Call `step`; return joint goals (n,) [rad] and torque limits (n,) [N·m] as a tuple."""
        assert self.step is not None
        result = self.step(q, target)
        return result if isinstance(result, tuple) else (result.goal, result.torque_limit)


def loop(kinematics: Callable[[Array], Pair]) -> Callable[[Array], Pair]:
    """Return a batch function that calls `kinematics` in a Python loop.

    Implementations whose library has no batch function use it. Each call of the returned function
    allocates the result arrays.
    """
    import numpy as np

    def batch(configurations: Array) -> Pair:
        n = len(configurations)
        poses, jacobians = np.empty((n, 4, 4)), np.empty((n, 6, configurations.shape[1]))
        for i, q in enumerate(configurations):
            poses[i], jacobians[i] = kinematics(q)
        return poses, jacobians

    return batch
