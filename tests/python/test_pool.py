"""Memory pool of results: a loop allocates nothing, and a result in use never changes."""

from __future__ import annotations

import copy
import ctypes
import gc
import sys
import threading
import weakref
from queue import SimpleQueue

import numpy as np
import pytest

import pliant

FIELDS = ("goal", "torque_limit", "speed_limit")


def run(controller, q, target, count):
    """Step through different states, so that all commands differ."""
    for i in range(count):
        controller.step(q + 1e-3 * i, target)


def values(command):
    return [getattr(command, field).copy() for field in FIELDS]


def unchanged(command, before):
    return all(
        np.array_equal(getattr(command, field), value)
        for field, value in zip(FIELDS, before, strict=True)
    )


def test_a_plain_loop_makes_three_commands(controller, q, target):
    for i in range(1000):
        command = controller.step(q + 1e-4 * i, target)
        assert command.goal.shape == command.torque_limit.shape == command.speed_limit.shape == (7,)
    assert controller.commands_made == 3


def test_kept_commands_are_all_different_and_never_change(controller, q, target):
    commands = [controller.step(q + 1e-3 * i, target) for i in range(50)]
    before = [values(command) for command in commands]
    run(controller, q, target, 50)
    assert len({id(command.goal) for command in commands}) == 50
    assert all(unchanged(command, b) for command, b in zip(commands, before, strict=True))


#: By name: function that makes a view of an array's data, and function that reads the view.
VIEWS = {
    "array": (lambda a: a, bytes),
    "slice": (lambda a: a[2:5], bytes),
    "reverse": (lambda a: a[::-1], lambda v: v.tobytes()),
    "reshape": (lambda a: a.reshape(7, 1), bytes),
    "bits": (lambda a: a.view(np.int64), bytes),
    "strides": (lambda a: np.lib.stride_tricks.as_strided(a, (3,), (8,)), bytes),
    "memoryview": (memoryview, bytes),
    "ctypes": (lambda a: a.ctypes, lambda v: bytes(v.data_as(POINTER).contents)),
    "iterator": (lambda a: a.flat, lambda v: v.copy().tobytes()),
}
POINTER = ctypes.POINTER(ctypes.c_double * 7)


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("view", VIEWS)
def test_every_view_of_an_array_protects_it(controller, q, target, field, view):
    make_view, read_view = VIEWS[view]
    run(controller, q, target, 3)
    array_view = make_view(getattr(controller.step(q, target), field))
    before = read_view(array_view)
    run(controller, q + 0.1, target, 9)
    assert read_view(array_view) == before


def test_a_weak_reference_protects_an_array_too(controller, q, target):
    reference = weakref.ref(controller.step(q, target).goal)
    before = reference().copy()
    run(controller, q + 0.1, target, 9)
    assert reference() is None or np.array_equal(reference(), before)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    "change",
    [
        lambda a: a.resize(9, refcheck=False),
        lambda a: a.resize(3, refcheck=False),
        lambda a: setattr(a, "shape", (1, 7)),
        lambda a: setattr(a, "dtype", np.int64),
        lambda a: setattr(a, "strides", (0,)),
        lambda a: a.setflags(write=False),
        lambda a: setattr(a, "dtype", ">f8"),
    ],
    ids=["longer", "shorter", "shape", "dtype", "strides", "flags", "bytes"],
)
def test_an_array_changed_in_place_is_given_up(controller, q, target, change):
    run(controller, q, target, 3)
    for _ in range(3):
        change(controller.step(q, target).goal)
    for i in range(6):
        command = controller.step(q + 1e-3 * i, target)
        assert command.goal.shape == (7,)
        assert command.goal.dtype == np.float64
        assert command.goal.flags.carray
        assert np.isfinite(command.goal).all()
        command.goal[:] = 0.0  # the array is writable, and is not used again


def test_what_a_user_writes_into_a_command_does_not_reach_the_controller(
    model, controller, q, target
):
    other = pliant.Controller(model, controller.settings)
    for i in range(10):
        command = controller.step(q + 1e-3 * i, target)
        expected = other.step(q + 1e-3 * i, target)
        assert np.array_equal(command.goal, expected.goal)
        expected.goal[:] = np.nan
        expected.torque_limit[:] = np.nan


def test_out_overwrites_the_callers_command(controller, q, target):
    command = controller.step(q, target)
    view = command.goal
    again = controller.step(q + 0.01, target, out=command)
    assert again is command
    assert command.goal is view
    assert controller.step_joints(q, 0.9 * q, out=command) is command
    command.torque_limit.flags.writeable = False
    before = controller.diagnostics.q_predicted
    with pytest.raises(TypeError, match="out must be a command whose arrays are writable"):
        controller.step(q + 0.5, target, out=command)
    assert np.array_equal(controller.diagnostics.q_predicted, before)
    with pytest.raises(TypeError):
        controller.step(q, target, out=view)


def test_commands_cannot_be_changed(controller, q, target):
    command = controller.step(q, target)
    with pytest.raises(AttributeError):
        command.goal = np.zeros(7)
    assert "torque_limit=array" in repr(command)
    with pytest.raises(TypeError):
        type(command)()


def test_one_controller_per_thread_gives_what_it_gives_alone(model, q, target):
    def drive(offset, results):
        controller = pliant.Controller(model, pliant.Settings.soft("y"))
        results.extend(controller.step(q + offset + 1e-4 * i, target) for i in range(300))

    sequential, concurrent = [[], [], [], []], [[], [], [], []]
    for i, results in enumerate(sequential):
        drive(0.01 * i, results)
    threads = [threading.Thread(target=drive, args=(0.01 * i, t)) for i, t in enumerate(concurrent)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for a, b in zip(sequential, concurrent, strict=True):
        for x, y in zip(a, b, strict=True):
            assert np.array_equal(x.goal, y.goal)
            assert np.array_equal(x.torque_limit, y.torque_limit)


def test_what_another_thread_holds_never_changes(controller, q, target):
    queue, violations = SimpleQueue(), []

    def watch():
        while (item := queue.get()) is not None:
            violations.extend(
                before
                for _ in range(20)
                for view, before in zip(*item, strict=True)
                if not np.array_equal(view, before)
            )

    thread = threading.Thread(target=watch)
    thread.start()
    for i in range(2000):
        command = controller.step(q + 1e-4 * i, target)
        queue.put(
            ([getattr(command, field)[1:] for field in FIELDS], [v[1:] for v in values(command)])
        )
    queue.put(None)
    thread.join()
    assert not violations


def test_a_step_while_arguments_are_read_comes_before(controller, q, target):
    class Nosy:
        def as_matrix(self):
            controller.step(q, target)
            return target

    twin = copy.copy(controller)
    twin.step(q, target)
    expected = twin.step(q, target)
    result = controller.step(q, Nosy())
    assert np.array_equal(result.goal, expected.goal)
    assert np.array_equal(result.torque_limit, expected.torque_limit)


def test_nothing_leaks(controller, q, target):
    array, pose = q.copy(), target.copy()
    run(controller, array, pose, 10)
    counts = sys.getrefcount(array), sys.getrefcount(pose), sys.getrefcount(controller)
    for _ in range(1000):
        controller.step(array, pose, dq=array, gradient=array)
        with pytest.raises(ValueError, match="q has shape"):
            controller.step(array[:3], pose)
    gc.collect()
    assert counts == (sys.getrefcount(array), sys.getrefcount(pose), sys.getrefcount(controller))
