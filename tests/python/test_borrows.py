"""Arguments that run Python code or change while they are read, and objects in use by a call.

A second call while an object is in use works or gives an explained error, never a panic. An array
or file is accepted only if it is read as it is: no masked arrays, no booleans as numbers.
"""

import threading

import numpy as np
import pytest

import pliant

MODEL = pliant.robots.koch()
Q = np.array([0.1, 0.2, -0.3, 0.4, 0.0])


class Accessor:
    """A pose whose matrix is computed by a function of the test, at the time of reading."""

    def __init__(self, run):
        self._run = run

    @property
    def homogeneous(self):
        self._run()
        return MODEL.forward_kinematics(Q)


class Array:
    """Joint positions that a function of the test computes at the time of reading."""

    def __init__(self, run):
        self._run = run

    def __array__(self, dtype=None, copy=None):
        self._run()
        return Q.copy()


def make_objects():
    controller = pliant.Controller(MODEL, pliant.Settings.firm(task="xyz"))
    contact = pliant.ContactEstimator(controller)
    target = MODEL.forward_kinematics(Q)
    command = controller.step(Q, target)
    contact.update(Q, sent=(command.goal, command.torque_limit))
    return controller, contact, target


def uses(controller, contact, target):
    """Return all calls that could use controller or contact estimator at the same time."""
    command = controller.step(Q, target)
    arrays = (command.goal, command.torque_limit)
    return {
        "contact.update": lambda: contact.update(Q, sent=arrays),
        "contact.update_series": lambda: contact.update_series(
            np.tile(Q, (3, 1)), sent=tuple(np.tile(array, (3, 1)) for array in arrays)
        ),
        "contact.uncertainty_at": lambda: contact.uncertainty_at(Q),
        "contact.typical_uncertainty": contact.typical_uncertainty,
        "contact.latency": lambda: contact.latency,
        "ContactEstimator": lambda: pliant.ContactEstimator(controller),
        "step": lambda: controller.step(Q, target),
        "step_joints": lambda: controller.step_joints(Q, Q),
        "step_batch": lambda: controller.step_batch(Q[None], target),
        "reset": lambda: controller.reset(Q),
        "update": lambda: controller.update(controller.settings),
        "set_payload": lambda: controller.set_payload(0.0),
        "set_delay": lambda: controller.set_delay(0.01),
        "set_gravity": lambda: controller.set_gravity([0, 0, -9.81]),
        "report": lambda: controller.report(Q),
        "check": lambda: controller.check(Q),
        "reading": lambda: controller.diagnostics.deviation,
    }


NAMES = list(uses(*make_objects()))


@pytest.mark.parametrize("name", NAMES)
def test_arguments_may_use_the_controller_that_reads_them(name):
    controller, contact, target = make_objects()
    inner_call = uses(controller, contact, target)[name]
    calls = [
        lambda: controller.step(Q, Accessor(inner_call)),
        lambda: controller.step(Array(inner_call), target),
        lambda: controller.step(Q, target, dq=Array(inner_call)),
        lambda: controller.step_joints(Q, Array(inner_call)),
        lambda: controller.reset(Array(inner_call)),
        lambda: controller.capture_gravity(Q, Array(inner_call)),
        lambda: contact.update(Array(inner_call)),
        lambda: contact.uncertainty_at(Array(inner_call)),
    ]
    for call in calls:
        call()


def test_a_batch_state_may_be_used_while_its_arguments_are_read():
    controller, _, target = make_objects()
    state = controller.batch_state(2)
    rows = np.array([Q, Q])
    call = lambda: controller.step_batch(rows, target, state=state)  # noqa: E731
    state.reset([0], Q=Array(call))
    controller.step_batch(rows, Accessor(call), state=state)


def test_a_contact_estimator_may_be_used_in_another_thread():
    controller, contact, _target = make_objects()
    is_over, unexpected, calls = threading.Event(), [], []
    accessor = Accessor(lambda: is_over.wait(1e-4))

    def watch():
        while not is_over.is_set():
            try:
                contact.update(Q)
            except BaseException as error:
                unexpected.append(error)
            calls.append(1)

    thread = threading.Thread(target=watch)
    thread.start()
    for _ in range(300):
        controller.step(Q, accessor)
    is_over.set()
    thread.join()
    assert calls
    assert not unexpected, repr(unexpected[0])


def test_objects_in_use_raise():
    """The state of a batch cannot be changed while the batch runs without interpreter lock."""
    controller, _, target = make_objects()
    rows = np.tile(Q, (20_000, 1))
    state = controller.batch_state(len(rows))
    is_over, messages = threading.Event(), []

    def disturb():
        while not is_over.is_set():
            try:
                state.reset([0])
            except RuntimeError as error:
                messages.append(str(error))

    thread = threading.Thread(target=disturb)
    thread.start()
    attempts = 200
    while not messages and attempts:
        attempts -= 1
        try:
            controller.step_batch(rows, target, state=state)
        except RuntimeError as error:
            messages.append(str(error))
    is_over.set()
    thread.join()
    assert messages
    assert "this BatchState is in use by another call" in messages[0]
    assert "threading.Lock" in messages[0]


def test_masked_arrays_are_refused():
    controller, contact, target = make_objects()
    masked = np.ma.array(Q, mask=[True, False, False, False, False])
    pose = np.ma.array(target, mask=False)
    for call in (
        lambda: controller.step(masked, target),
        lambda: controller.step(Q, pose),
        lambda: controller.step(Q, target, dq=masked),
        lambda: controller.step_joints(Q, masked),
        lambda: controller.step_batch(np.ma.array([Q, Q]), target),
        lambda: controller.step_batch([masked, masked], target),
        lambda: controller.step_batch(np.array([Q]), np.ma.array(target[None])),
        lambda: contact.update(masked),
        lambda: MODEL.forward_kinematics(masked),
        lambda: pliant.Settings(null_space=pliant.NullSpace(posture=masked)),
    ):
        with pytest.raises(TypeError, match=r"masked array"):
            call()


def test_numpy_booleans_are_not_accepted_as_numbers():
    controller, contact, target = make_objects()
    for value in (True, np.bool_(True), np.array(True), np.array(False)):
        for call in (
            lambda value=value: controller.step(Q, target, dt=value),
            lambda value=value: controller.set_delay(value),
            lambda value=value: contact.update(Q, dt=value),
            lambda value=value: pliant.Settings(
                paper_options=pliant.functional.PaperOptions(horizon=value)
            ),
            lambda value=value: pliant.Axis(soft=value),
        ):
            with pytest.raises((TypeError, pliant.ConfigError)):
                call()
    for value in (np.float32(0.01), np.float64(0.01), np.array(0.01), np.int64(1), 1):
        controller.step(Q, target, dt=value)


def test_a_command_that_cannot_be_written_is_refused_before_the_step():
    controller, _, target = make_objects()
    out = controller.step(Q, target)
    goal = out.goal.copy()

    def freeze():
        out.goal.flags.writeable = False

    moved_target = target.copy()
    moved_target[2, 3] += 0.05
    limit = controller.step(Q, target).torque_limit.copy()
    with pytest.raises(TypeError, match="writable"):
        controller.step(Array(freeze), moved_target, out=out)
    assert np.array_equal(out.goal, goal)
    assert np.array_equal(controller.step(Q, target).torque_limit, limit)


def test_a_description_is_read_once(tmp_path):
    """The URDF is read once, so that pickles contain the text from which the model was made."""
    import os

    text = pliant.robots.koch().source[0]
    path = tmp_path / "arm.urdf"
    path.write_text(text, newline="\n")
    assert pliant.Model.from_urdf(path, tip="tool").source[0] == text
    pipe = tmp_path / "pipe.urdf"
    if hasattr(os, "mkfifo"):
        os.mkfifo(pipe)
    for source in (pipe, tmp_path) if pipe.exists() else (tmp_path,):
        with pytest.raises(pliant.UrdfError, match="it is not a file"):
            pliant.Model.from_urdf(source, tip="tool")
