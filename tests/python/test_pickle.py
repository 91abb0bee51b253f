"""Models and controllers, copied and pickled: they continue identically."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

import pliant

COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    **{f"pickle {n}": lambda x, n=n: pickle.loads(pickle.dumps(x, n)) for n in range(2, 6)},
}
LAWS = {
    "cap": pliant.Settings.soft("y", tracking=pliant.Tracking(integrate=0.3), delay=0.02),
    "impedance": pliant.Settings.soft(
        "y yaw", law="impedance", tracking=pliant.Tracking(goal_slew=0.3)
    ),
    "paper": pliant.Settings.paper(),
    "fewer axes": pliant.Settings(
        task="xyz",
        paper_options=pliant.functional.PaperOptions(posture_weights=np.arange(1.0, 8.0)),
    ),
}


def bits(command: pliant.Command) -> tuple[bytes, bytes, bytes]:
    return tuple(x.tobytes() for x in (command.goal, command.torque_limit, command.speed_limit))


def told(controller: pliant.Controller, q: np.ndarray) -> None:
    """Change all parts of a controller's state that its methods can change."""
    controller.set_payload(0.3, (0.0, 0.01, 0.05))
    controller.set_gravity((0.5, 0.0, -9.7))
    controller.set_delay(0.03)
    controller.capture_gravity(q, q + 0.02)


def steps(controller, q, target, count=30):
    return [bits(controller.step(q + 0.002 * i, target, dt=0.011)) for i in range(count)]


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("law", LAWS)
def test_a_copy_goes_on_to_the_bit(model, q, target, way, law):
    controller = pliant.Controller(model, LAWS[law])
    fresh = COPIES[way](controller)
    assert steps(controller, q, target, 8) == steps(fresh, q, target, 8)
    told(controller, q)
    running = COPIES[way](controller)
    assert running is not controller
    assert running.settings == controller.settings
    assert running.servos == controller.servos
    before = controller.diagnostics.deviation
    here = steps(controller, q, target)
    controller.reset(q)
    assert steps(running, q, target) == here
    assert running.diagnostics.gain_factor == controller.diagnostics.gain_factor
    assert (before != running.diagnostics.deviation).any()
    changed = LAWS[law].replace(tracking=pliant.Tracking(gain=2.0))
    for one in (controller, running):
        one.update(changed)
        one.reset(q)
    assert steps(controller, q, target) == steps(running, q, target)


@pytest.mark.parametrize("way", COPIES)
def test_a_copied_model_is_the_same(model, servos, q, way):
    given = {
        "tip": "tool",
        "payload": pliant.Payload(0.2, (0.0, 0.0, 0.03)),
        "gravity": np.array([0.0, 1.0, -9.0]),
        "limits": {model.joint_names[1]: (-1.5, 1.0)},
    }
    own = pliant.Model.from_urdf_str(model.source[0], **given)
    given["limits"].clear()
    given["gravity"][:] = 0.0
    for first in (model, own, own.with_servos(servos), pliant.robots.so101()):
        second = COPIES[way](first)
        at = q[: first.n]
        for call in ("forward_kinematics", "jacobian", "gravity"):
            assert getattr(first, call)(at).tobytes() == getattr(second, call)(at).tobytes()
        assert (first.frames, first.joint_names) == (second.frames, second.joint_names)
        assert (first.servos, first.tip, first.base) == (second.servos, second.tip, second.base)
        assert first.upper.tobytes() == second.upper.tobytes()
        assert repr(first) == repr(second)


@pytest.mark.parametrize("way", COPIES)
def test_a_copied_command_is_the_same(controller, q, target, way):
    command = controller.step(q, target)
    again = COPIES[way](command)
    assert type(again) is pliant.Command
    assert bits(again) == bits(command)
    # Without a speed limit its numbers are infinite.
    free = pliant.Command(q, np.ones(q.size))
    assert bits(COPIES[way](free)) == bits(free)


def test_copies_share_what_cannot_change(model, controller):
    assert copy.copy(model) is model
    assert copy.deepcopy([model])[0] is model
    assert copy.deepcopy(controller).model is model


def test_a_pickle_leaves_readings_behind_and_a_copy_does_not(controller, q, target):
    controller.step(q, target)
    assert (
        copy.copy(controller).diagnostics.deviation.tobytes()
        == controller.diagnostics.deviation.tobytes()
    )
    assert str(copy.deepcopy(controller).report()) == str(controller.report())
    away = pickle.loads(pickle.dumps(controller))
    assert not away.diagnostics.deviation.any()
    assert str(away.report(q)) == str(controller.report(q))


def test_what_another_arm_carried_is_refused(model, q, target):
    other = pliant.robots.so101()
    for spoil, match in (
        (lambda c: c.step(q, target), "state"),
        (lambda c: told(c, q), "captured"),
    ):
        controller = pliant.Controller(
            model,
            LAWS["fewer axes"].replace(
                paper_options=pliant.functional.PaperOptions(posture_weights=None)
            ),
        )
        spoil(controller)
        make, (_, settings, _, numbers) = controller.__reduce__()
        with pytest.raises(pliant.ShapeError, match=f"{match} has shape"):
            make(other, settings, other.servos, numbers)


def test_a_process_of_its_own_gives_the_same_bits(controller, q, target):
    controller.step(q, target)
    # Unlike a `Pool`, an executor whose process cannot unpickle its work fails instead of hanging.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        there = pool.submit(steps, controller, q, target).result(timeout=60)
    assert there == steps(controller, q, target)


def test_what_a_model_was_made_of_cannot_be_changed_through_its_source():
    arm = pliant.robots.arm7()
    name = arm.joint_names[1]
    model = pliant.Model.from_urdf_str(arm.source[0], tip="tool", limits={name: (-0.5, 0.5)})
    model.source[1]["limits"][name] = (-0.1, 0.1)
    again = pickle.loads(pickle.dumps(model))
    assert np.array_equal(again.upper, model.upper)


def test_a_controller_that_can_no_longer_hold_its_arm_is_read_back():
    # The check of the servos' strength in the constructor must not be repeated in this pose.
    arm = pliant.robots.arm7()
    q = 0.5 * (arm.lower + arm.upper)
    controller = pliant.Controller(arm, pliant.Settings.soft("y"))
    target = arm.forward_kinematics(q)
    controller.step(q, target)
    controller.set_gravity((0.0, 0.0, -99.0))
    again = pickle.loads(pickle.dumps(controller))
    assert bits(again.step(q, target)) == bits(controller.step(q, target))


def test_gravity_that_the_servos_cannot_hold_is_rejected():
    arm = pliant.robots.arm7()
    weak = pliant.Servos(kp=50.0, max_torque=0.5, friction=0.01, stiffness_known=True)
    controller = pliant.Controller(arm, pliant.Settings.paper(), weak)
    before = controller.settings
    with pytest.raises(pliant.OutOfRangeError, match="torque that holds the arm"):
        controller.update(before.replace(gravity=True))
    assert controller.settings == before
