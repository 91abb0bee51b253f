"""Every array argument: what is converted, to the same bits, and what is refused, by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import pliant

#: Ways to hand over the same float64 vector or matrix.
FORMS = {
    "list": lambda a: a.tolist(),
    "tuple": lambda a: tuple(a.tolist()),
    "strided": lambda a: np.repeat(a, 2, axis=0)[::2],
    "fortran": np.asfortranarray,
    "big endian": lambda a: a.astype(">f8"),
    "read-only": lambda a: _readonly(a),
    "reversed": lambda a: a[::-1].copy()[::-1],
    "unaligned": lambda a: _unaligned(a),
    "subclass": lambda a: a.view(_Sub),
    "long double": lambda a: a.astype(np.longdouble),
    "object with __array__": lambda a: _Holder(a),
    "memoryview": lambda a: memoryview(a),
}


class _Sub(np.ndarray):
    """A subclass of ndarray."""


class _Holder:
    """Something that NumPy can read."""

    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return self.array if dtype is None else self.array.astype(dtype)


def _readonly(array):
    out = array.copy()
    out.flags.writeable = False
    return out


def _unaligned(array):
    room = np.zeros(array.nbytes + 1, dtype=np.uint8)
    out = room[1:].view(np.float64).reshape(array.shape)
    out[...] = array
    return out


def calls(model, q, target):
    """Name of the argument, a good value of it, and a call with it that returns an array."""
    soft = pliant.Settings.soft("y", kx=1.0)

    def fresh():
        controller = pliant.Controller(model, soft)
        controller.reset(q)
        return controller

    def step(**inputs):
        return fresh().step(**{"q": q, "target": target} | inputs).goal

    def after_reset(value):
        controller = pliant.Controller(model, soft)
        controller.reset(value)
        return controller.step(q, target).goal

    jacobian, six = model.jacobian(q), np.array([0.01, 0.02, 0.0, 0.1, 0.0, -0.1])
    inverse = pliant.damped_pseudo_inverse(jacobian, 0.1)
    projector = pliant.null_space_projector(jacobian)
    activation = pliant.activation(inverse, projector)
    eight = np.arange(1.0, 8.0)
    return {
        "kinematics q": ("q", q, lambda v: model.kinematics(v)[1]),
        "forward_kinematics q": ("q", q, model.forward_kinematics),
        "jacobian q": ("q", q, model.jacobian),
        "gravity q": ("q", q, model.gravity),
        "inverse_kinematics q0": ("q0", q, lambda v: model.inverse_kinematics(target, v).q),
        "batch Q": ("Q", np.stack([q, 0.5 * q]), model.jacobian_batch),
        "step q": ("q", q, lambda v: step(q=v)),
        "step target": ("target", target, lambda v: step(target=v)),
        "step dq": ("dq", 0.1 * q, lambda v: step(dq=v)),
        "step twist": ("twist", six, lambda v: step(twist=v)),
        "step gradient": ("gradient", q, lambda v: step(gradient=v)),
        "step_joints q": ("q", q, lambda v: fresh().step_joints(v, 0.9 * q).goal),
        "step_joints q_target": ("q_target", 0.9 * q, lambda v: fresh().step_joints(q, v).goal),
        "reset q": ("q", q, after_reset),
        "capture_gravity q": ("q", q, lambda v: fresh().capture_gravity(v, q + 0.02)),
        "capture_gravity goal": ("goal", q + 0.02, lambda v: fresh().capture_gravity(q, v)),
        "damped_pseudo_inverse J": ("J", jacobian, lambda v: pliant.damped_pseudo_inverse(v, 0.1)),
        "null_space_projector J": ("J", jacobian, pliant.null_space_projector),
        "activation J_pinv": ("J_pinv", inverse, lambda v: pliant.activation(v, projector)),
        "activation N": ("N", projector, lambda v: pliant.activation(inverse, v)),
        "activation gradient": ("gradient", q, lambda v: pliant.activation(inverse, projector, v)),
        "responsibility dx": (
            "dx",
            six,
            lambda v: pliant.responsibility(inverse, v, projector, q, 1.0),
        ),
        "joint_torque_limits A": ("A", activation, lambda v: pliant.joint_torque_limits(v, eight)),
        "joint_torque_limits strength": (
            "strength",
            eight,
            lambda v: pliant.joint_torque_limits(activation, v),
        ),
        "pose_error actual": ("actual", target, lambda v: pliant.pose_error(v, np.eye(4))),
        "adapt_target target": (
            "target",
            target,
            lambda v: pliant.adapt_target(np.eye(4), v, 0.5, "y"),
        ),
    }


NAMES = list(calls(*[None] * 3)) if False else [
    "kinematics q",
    "forward_kinematics q",
    "jacobian q",
    "gravity q",
    "inverse_kinematics q0",
    "batch Q",
    "step q",
    "step target",
    "step dq",
    "step twist",
    "step gradient",
    "step_joints q",
    "step_joints q_target",
    "reset q",
    "capture_gravity q",
    "capture_gravity goal",
    "damped_pseudo_inverse J",
    "null_space_projector J",
    "activation J_pinv",
    "activation N",
    "activation gradient",
    "responsibility dx",
    "joint_torque_limits A",
    "joint_torque_limits strength",
    "pose_error actual",
    "adapt_target target",
]
