"""Objects that are in use: a second call gives an explained error and never a panic."""

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


def made():
    controller = pliant.Controller(MODEL, pliant.Settings.firm(task="xyz"))
    contact = pliant.ContactEstimator(controller)
    target = MODEL.forward_kinematics(Q)
    command = controller.step(Q, target)
    contact.update(Q, sent=(command.goal, command.torque_limit))
    return controller, contact, target


def uses(controller, contact, target):
    """Return all calls that could use controller or contact estimator at the same time."""
    command = controller.step(Q, target)
    sent = (command.goal, command.torque_limit)
    return {
        "contact.update": lambda: contact.update(Q, sent=sent),
        "contact.update_series": lambda: contact.update_series(
            np.tile(Q, (3, 1)), sent=(np.tile(sent[0], (3, 1)), np.tile(sent[1], (3, 1)))
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


NAMES = list(uses(*made()))


@pytest.mark.parametrize("name", NAMES)
def test_arguments_may_use_the_controller_that_reads_them(name):
    controller, contact, target = made()
    use = uses(controller, contact, target)[name]
    calls = [
        lambda: controller.step(Q, Accessor(use)),
        lambda: controller.step(Array(use), target),
        lambda: controller.step(Q, target, dq=Array(use)),
        lambda: controller.step_joints(Q, Array(use)),
        lambda: controller.reset(Array(use)),
        lambda: controller.capture_gravity(Q, Array(use)),
        lambda: contact.update(Array(use)),
        lambda: contact.uncertainty_at(Array(use)),
    ]
    for call in calls:
        call()


def test_a_batch_state_may_be_used_while_its_arguments_are_read():
    controller, _, target = made()
    state = controller.batch_state(2)
    rows = np.array([Q, Q])
    use = lambda: controller.step_batch(rows, target, state=state)  # noqa: E731
    state.reset([0], Q=Array(use))
    controller.step_batch(rows, Accessor(use), state=state)


def test_a_contact_in_another_thread_meets_no_panic():
    controller, contact, _target = made()
    over, odd, calls = threading.Event(), [], []
    accessor = Accessor(lambda: over.wait(1e-4))

    def watch():
        while not over.is_set():
            try:
                contact.update(Q)
            except BaseException as error:
                odd.append(error)
            calls.append(1)

    thread = threading.Thread(target=watch)
    thread.start()
    for _ in range(300):
        controller.step(Q, accessor)
    over.set()
    thread.join()
    assert calls
    assert not odd, repr(odd[0])


def test_objects_in_use_raise():
    """The state of a batch cannot be changed while the batch runs without interpreter lock."""
    controller, _, target = made()
    rows = np.tile(Q, (20_000, 1))
    state = controller.batch_state(len(rows))
    over, said = threading.Event(), []

    def disturb():
        while not over.is_set():
            try:
                state.reset([0])
            except RuntimeError as error:
                said.append(str(error))

    thread = threading.Thread(target=disturb)
    thread.start()
    deadline = 200
    while not said and deadline:
        deadline -= 1
        try:
            controller.step_batch(rows, target, state=state)
        except RuntimeError as error:
            said.append(str(error))
    over.set()
    thread.join()
    assert said
    assert "this BatchState is in use by another call" in said[0]
    assert "threading.Lock" in said[0]


def test_masked_arrays_are_no_numbers():
    controller, contact, target = made()
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


def test_numpy_truth_values_are_no_numbers():
    controller, contact, target = made()
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
    controller, _, target = made()
    out = controller.step(Q, target)
    goal = out.goal.copy()

    def freeze():
        out.goal.flags.writeable = False

    moved = target.copy()
    moved[2, 3] += 0.05
    limit = controller.step(Q, target).torque_limit.copy()
    with pytest.raises(TypeError, match="writable"):
        controller.step(Array(freeze), moved, out=out)
    assert np.array_equal(out.goal, goal)
    assert np.array_equal(controller.step(Q, target).torque_limit, limit)


def test_a_description_is_read_once(tmp_path):
    """The URDF is read once, so that the text kept for pickles is that of the model."""
    import os

    text = pliant.robots.koch().source[0]
    path = tmp_path / "arm.urdf"
    path.write_text(text, newline="\n")
    assert pliant.Model.from_urdf(path, tip="tool").source[0] == text
    pipe = tmp_path / "pipe.urdf"
    if hasattr(os, "mkfifo"):
        os.mkfifo(pipe)
    for wrong in (pipe, tmp_path) if pipe.exists() else (tmp_path,):
        with pytest.raises(pliant.UrdfError, match="it is not a file"):
            pliant.Model.from_urdf(wrong, tip="tool")
