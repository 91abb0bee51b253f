"""Implementation of kinematics and control step with pliant's public functions."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

import pliant
from comparison import problem
from comparison.peer import Implementation, Pair
from comparison.problem import Array


def controller(model: pliant.Model) -> pliant.Controller:
    """Return a controller with law `paper` and the parameters of `problem`.

    The damping λ is constant, the null-space projector is the paper's, and the null space avoids
    joint limits. Gravity compensation and step limits are off.
    """
    endless = {"max_velocity": np.inf, "soft_step_limit": np.inf}
    stiff = pliant.Axis(**endless)
    soft = pliant.Axis(soft=problem.SOFT, firm=problem.FIRM, adaptation=problem.ETA, **endless)
    settings = pliant.Settings.paper(
        axes={"xz rpy": stiff, "y": soft},
        tracking=pliant.Tracking(damping=problem.DAMPING, joint_speed=[1e3] * model.n),
        null_space=pliant.NullSpace(
            projector="paper",
            limit_avoidance=problem.LIMIT_WEIGHT,
            posture=problem.bench_arm().rest,
        ),
    )
    servos = pliant.Servos(kp=[100.0] * model.n, max_torque=[100.0] * model.n)
    return pliant.Controller(model, settings, servos)


def make() -> Implementation:
    """Return pliant's implementation.

    Its timed calls of the kinematics write into preallocated arrays.
    """
    model = pliant.Model.from_urdf(problem.URDF, tip=problem.TOOL)
    law_controller = controller(model)
    pose, jacobian = np.empty((4, 4)), np.empty((6, model.n))
    states: dict[int, Any] = {}

    def batch(configurations: Array) -> Pair:
        count = len(configurations)
        if count not in states:
            states[count] = (np.empty((count, 4, 4)), np.empty((count, 6, model.n)))
        return model.kinematics_batch(configurations, out=states[count])

    takes_arrays = "out" in str(inspect.signature(model.kinematics_batch))
    return Implementation(
        version=f"pliant {pliant.__version__}, {instructions(law_controller)}",
        kinematics=model.kinematics,
        kinematics_call="k(q, out=arrays)",
        names={"k": model.kinematics, "arrays": (pose, jacobian)},
        step=law_controller.step,
        step_call="c = f(q, t); c.goal; c.torque_limit",
        batch=batch if takes_arrays else model.kinematics_batch,
    )


def instructions(of: pliant.Controller) -> str:
    """Return the name of the instruction set that the controller's code path uses."""
    return str(getattr(of, "simd_level", "one path for all machines"))
