"""What is refused, and in which words: argument, value, bound, and what else there is."""

from __future__ import annotations

import numpy as np
import pytest

import pliant


def refused(call, *args, **kwargs) -> str:
    with pytest.raises((pliant.PliantError, TypeError, OSError)) as caught:
        call(*args, **kwargs)
    return str(caught.value)


@pytest.mark.parametrize("dt", [1.01, 10.0])
def test_a_time_in_milliseconds_is_no_time(controller, model, q, target, dt):
    said = rf"dt [s] = {dt:g} is outside (0, 1]; is it in milliseconds?"
    assert refused(controller.step, q, target, dt=dt) == said
    assert refused(controller.step_joints, q, q, dt=dt) == said
    assert refused(controller.step_batch, q[None], target, dt=dt) == said
    assert refused(pliant.Contact(controller).update, q, dt=dt) == said
    for taken in (controller, pliant.Controller(model, pliant.Settings(rate=1.0))):
        taken.step(q, target, dt=None if taken is not controller else 1.0)
    assert refused(controller.step, q, target, dt=0.0) == "dt [s] = 0 is outside (0, 1]"
    assert refused(controller.step, q, target, dt=np.nan) == "dt [s] = NaN is outside (0, 1]"


@pytest.mark.parametrize("axis", range(3))
def test_a_place_in_millimetres_is_no_place(model, q, target, axis):
    controller = pliant.Controller(model, pliant.Settings(task="xyz"))
    lone = target[:3, 3].copy()
    lone[axis] = target[axis, 3] = -250.0
    said = f"position {'xyz'[axis]} [m] = -250 is outside ±100; is it in millimetres?"
    assert refused(controller.step, q, target) == f"target: {said}"
    assert refused(controller.step, q, lone) == f"target: {said}"
    assert refused(controller.step_batch, q[None], target) == f"targets: {said}"
    assert refused(controller.step_batch, q[None], lone[None]).endswith(said)
    assert refused(model.inverse_kinematics, target, q).endswith(said)
    lone[axis] = 99.0
    goals = controller.step_batch(np.stack([q, q]), lone).goal
    assert np.isfinite(goals).all()
    assert np.isfinite(controller.step(q, lone).goal).all()


def test_what_is_not_a_number_is_said_plainly(model, q, target):
    lost = np.where(np.arange(7) == 2, np.nan, q)
    name = model.joint_names[2]
    assert refused(model.forward_kinematics, lost) == f"q[2] ({name}) = NaN is outside ±1e6"
    controller = pliant.Controller(model)
    assert refused(controller.step, lost, target) == f"q[2] ({name}) = NaN is outside ±1e6"
    target[0, 3] = np.inf
    said = refused(controller.step, q, target)
    assert said == "target: position x [m] = inf is outside ±100"
