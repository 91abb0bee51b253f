"""Array arguments of all functions: forms that are accepted give equal results, others
an error that names the argument."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import pliant

GOLDEN = Path(__file__).resolve().parents[1] / "data" / "golden"


class _Sub(np.ndarray):
    """A subclass of ndarray."""


class _Holder:
    """An object with the array interface, which NumPy can read."""

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


#: Forms of the same float64 vector or matrix.
FORMS = {
    "list": lambda a: a.tolist(),
    "tuple": lambda a: tuple(a.tolist()),
    "strided": lambda a: np.repeat(a, 2, axis=0)[::2],
    "fortran": np.asfortranarray,
    "big endian": lambda a: a.astype(">f8"),
    "read-only": _readonly,
    "reversed": lambda a: a[::-1].copy()[::-1],
    "unaligned": _unaligned,
    "subclass": lambda a: a.view(_Sub),
    "long double": lambda a: a.astype(np.longdouble),
    "object with __array__": _Holder,
    "memoryview": memoryview,
}


def _calls():
    """Return, for every array argument: name, valid value, and a call that returns an array."""
    servos = pliant.Servos(kp=[150.0] * 4 + [60.0] * 3, max_torque=[10.7] * 4 + [6.4] * 3)
    model = pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool", servos=servos)
    q = np.array([0.3, -0.4, 0.2, -1.2, 0.5, 0.6, -0.3])
    target = model.forward_kinematics(q)
    target[:3, 3] += [0.02, -0.03, 0.01]
    soft = pliant.Settings.soft("y", tracking=pliant.Tracking(gain=1.0))

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

    jacobian, twist = model.jacobian(q), np.array([0.01, 0.02, 0.0, 0.1, 0.0, -0.1])
    inverse = pliant.functional.damped_pseudo_inverse(jacobian, 0.1)
    projector = pliant.functional.null_space_projector(jacobian)
    activation = pliant.functional.activation(inverse, projector)
    vector = np.arange(1.0, 8.0)
    hold = [1.0] * 6
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
        "step twist": ("twist", twist, lambda v: step(twist=v)),
        "step gradient": ("gradient", q, lambda v: step(gradient=v)),
        "step_joints q": ("q", q, lambda v: fresh().step_joints(v, 0.9 * q).goal),
        "step_joints q_target": ("q_target", 0.9 * q, lambda v: fresh().step_joints(q, v).goal),
        "reset q": ("q", q, after_reset),
        "capture_gravity q": ("q", q, lambda v: fresh().capture_gravity(v, q + 0.02)),
        "capture_gravity goal": ("goal", q + 0.02, lambda v: fresh().capture_gravity(q, v)),
        "damped_pseudo_inverse J": (
            "J",
            jacobian,
            lambda v: pliant.functional.damped_pseudo_inverse(v, 0.1),
        ),
        "null_space_projector J": ("J", jacobian, pliant.functional.null_space_projector),
        "activation J_pinv": (
            "J_pinv",
            inverse,
            lambda v: pliant.functional.activation(v, projector),
        ),
        "activation N": ("N", projector, lambda v: pliant.functional.activation(inverse, v)),
        "activation gradient": (
            "gradient",
            q,
            lambda v: pliant.functional.activation(inverse, projector, v),
        ),
        "responsibility dx": (
            "dx",
            twist,
            lambda v: pliant.functional.responsibility(inverse, v, projector, q, 1.0),
        ),
        "joint_torque_limits A": (
            "A",
            activation,
            lambda v: pliant.functional.joint_torque_limits(v, vector),
        ),
        "joint_torque_limits strength": (
            "strength",
            vector,
            lambda v: pliant.functional.joint_torque_limits(activation, v),
        ),
        "compliance deviation": (
            "deviation",
            twist,
            lambda v: pliant.functional.compliance(v, 0.01, 0.1),
        ),
        "compliance firm_from": (
            "firm_from",
            twist + 1,
            lambda v: pliant.functional.compliance(twist, 0.01, v),
        ),
        "holding_torque soft": (
            "soft",
            twist,
            lambda v: pliant.functional.holding_torque([0.5] * 6, v, hold, hold, True),
        ),
        "from_wxyz quaternion": (
            "quaternion",
            np.array([0.5, -0.5, 0.5, 0.5]),
            lambda v: pliant.Pose.from_wxyz([0.0, 0.0, 0.0], v).matrix,
        ),
        "from_rpy position": (
            "position",
            twist[:3],
            lambda v: pliant.Pose.from_rpy(v, [0.1, 0.2, 0.3]).matrix,
        ),
        "pose_error actual": (
            "actual",
            target,
            lambda v: pliant.functional.pose_error(v, np.eye(4)),
        ),
        "adapt_target target": (
            "target",
            target,
            lambda v: pliant.functional.adapt_target(np.eye(4), v, 0.5, "y"),
        ),
    }


CALLS = _calls()
each_argument = pytest.mark.parametrize(("name", "good", "call"), CALLS.values(), ids=CALLS)


def same_bits(a, b):
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


@each_argument
@pytest.mark.parametrize("form", FORMS)
def test_other_forms_give_the_same_bits(name, good, call, form):
    assert same_bits(call(FORMS[form](good)), call(np.ascontiguousarray(good)))


@each_argument
def test_single_precision_and_integers_are_widened(name, good, call):
    if name in {"target", "actual", "quaternion"}:  # rounding to float32 makes the rotation invalid
        return
    single = good.astype(np.float32)
    assert same_bits(call(single), call(single.astype(np.float64)))
    if name != "firm_from":
        integers = np.zeros(good.shape, dtype=np.int64)
        assert same_bits(call(integers), call(integers.astype(np.float64)))


@each_argument
@pytest.mark.parametrize("bad", ["longer", "shorter", "deeper", "empty", "scalar"])
def test_wrong_shapes_name_argument_shape_and_expectation(name, good, call, bad):
    if bad == "scalar" and name in {"deviation", "firm_from", "soft"}:
        return  # a single number applies to all joints
    if name == "deviation" and bad in {"longer", "shorter", "empty"}:
        return  # any length is valid
    if name == "J" and bad in {"longer", "shorter"}:
        return  # any size up to (6, 16) is valid
    axis = 0 if name == "J_pinv" else -1
    value = {
        "longer": np.concatenate([good, good], axis=axis),
        "shorter": np.delete(good, -1, axis=axis),
        "deeper": good[None],
        "empty": np.empty((0,)),
        "scalar": np.float64(0.5),
    }[bad]
    with pytest.raises(pliant.ShapeError) as raised:
        call(value)
    error = raised.value
    assert isinstance(error, ValueError)
    assert error.what is not None
    assert error.expected
    assert error.got in str(error)
    related = {"Q": ("Q",), "J_pinv": ("J_pinv", "N"), "N": ("N",), "A": ("A", "strength")}
    assert error.what.startswith(related.get(name, (name, "soft_until", "dx")))


@each_argument
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_numbers_are_refused_by_name(name, good, call, bad):
    value = np.array(good)
    value[(-1,) * good.ndim if name not in {"target", "actual"} else (0, 3)] = bad
    with pytest.raises(pliant.OutOfRangeError) as error:
        call(value)
    assert error.value.value is not None
    assert not np.isfinite(error.value.value)


@each_argument
@pytest.mark.parametrize(
    "bad",
    [
        "text",
        None,
        ["a"] * 7,
        [1.0, [2.0]],
        np.ones(7, dtype=complex),
        [True] * 7,
        {1: 2},
        object(),
    ],
    ids=["text", "none", "texts", "ragged", "complex", "flags", "dict", "object"],
)
def test_objects_without_numbers_are_type_errors_by_name(name, good, call, bad):
    if bad is None and name in {"dq", "twist", "gradient"}:
        return  # None is the default
    with pytest.raises(TypeError, match=f"^{name} must be an array of numbers"):
        call(bad)


def test_a_joint_is_named():
    model = pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool")
    with pytest.raises(pliant.OutOfRangeError, match=r"q\[3\] \(elbow_pitch\) = NaN is outside"):
        model.gravity([0.0, 0.0, 0.0, np.nan, 0.0, 0.0, 0.0])
    with pytest.raises(pliant.OutOfRangeError, match=r"Q\[1\]: q\[0\] \(shoulder_pitch\)"):
        model.gravity_batch(
            np.diag([0.0, np.inf, 0.0, 0.0, 0.0, 0.0, 0.0])[:, [1, 0, 2, 3, 4, 5, 6]]
        )


@settings(max_examples=200, deadline=None)
@given(
    arrays.arrays(
        dtype=st.sampled_from(
            [np.float64, np.float32, np.int16, np.uint8, np.bool_, np.complex128]
        ),
        shape=arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=8),
    )
)
def test_no_array_gets_past_the_checks(array):
    _, _, call = CALLS["step q"]
    try:
        goal = call(array)
    except (pliant.PliantError, TypeError):
        return
    assert array.shape == (7,)
    assert array.dtype.kind in "fiu"
    assert np.isfinite(goal).all()


def test_batches_of_any_size_agree_with_single_calls():
    model = pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool")
    generator = np.random.default_rng(1)
    for count in (0, 1, 5):
        batch = generator.uniform(-1.0, 1.0, (count, 7))
        poses, jacobians = model.kinematics_batch(batch, "local")
        torques = model.gravity_batch(batch)
        assert poses.shape == (count, 4, 4)
        assert jacobians.shape == (count, 6, 7)
        assert torques.shape == (count, 7)
        assert same_bits(poses, model.forward_kinematics_batch(batch))
        assert same_bits(jacobians, model.jacobian_batch(batch, reference="local"))
        for row, pose, jacobian, torque in zip(batch, poses, jacobians, torques, strict=True):
            single = model.kinematics(row, reference="local")
            assert same_bits(pose, single[0])
            assert same_bits(jacobian, single[1])
            assert same_bits(torque, model.gravity(row))


def test_kinematics_into_the_callers_arrays():
    model = pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool")
    q = np.linspace(-1.0, -0.1, 7)
    out = (np.zeros((4, 4)), np.zeros((6, 7)))
    assert model.kinematics(q, out=out) is out
    pose, jacobian = model.kinematics(q)
    assert same_bits(out[0], pose)
    assert same_bits(out[1], jacobian)
    with pytest.raises(pliant.ShapeError, match=r"out\[1\] has shape \(6, 6\), expected \(6, 7\)"):
        model.kinematics(q, out=(out[0], np.zeros((6, 6))))
    for array in (np.zeros((6, 7), dtype=np.float32), np.zeros((7, 6)).T, _readonly(out[1])):
        with pytest.raises(
            TypeError, match=r"out\[1\] must be a writable float64 array in C order"
        ):
            model.kinematics(q, out=(out[0], array))
    with pytest.raises(TypeError, match="out must be a pair"):
        model.kinematics(q, out=[out[0], out[1]])


class Meddler:
    """A target that replaces the data of an earlier argument while it is read."""

    def __init__(self, array, target):
        self.array, self.target = array, target

    @property
    def matrix(self):
        self.array.resize((4096,), refcheck=False)
        self.array[:] = 1e9
        return self.target


def test_a_target_that_changes_q_while_it_is_read_is_seen_by_the_step(model):
    controller = pliant.Controller(model)
    q = 0.5 * (model.lower + model.upper)
    target = model.forward_kinematics(q)
    controller.step(q, target)
    with pytest.raises(pliant.ShapeError, match="q has shape"):
        controller.step(q, Meddler(q, target))


class Reshaper(Meddler):
    """Like `Meddler`, for an argument that is an array of targets."""

    def __array__(self, dtype=None, copy=None):
        self.array.resize((0, 7), refcheck=False)
        return np.asarray(self.target)


def test_a_batch_whose_q_changes_while_targets_are_read_is_refused(model):
    controller = pliant.Controller(model)
    q = np.array(np.tile(0.5 * (model.lower + model.upper), (200, 1)))
    target = model.forward_kinematics(q[0])
    with pytest.raises(ValueError, match="Q changed while the other arguments were read"):
        controller.step_batch(q, Reshaper(q, target))
