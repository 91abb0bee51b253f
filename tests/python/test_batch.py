"""Batch calls: equal to single steps bit for bit, output arrays, invalid rows, threads."""

from __future__ import annotations

import copy
import pickle
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st

import pliant

FIELDS = ("goal", "torque_limit", "speed_limit")
LAWS = {
    "cap": pliant.Settings.soft("y"),
    "paper": pliant.Settings.paper(axes={"y": pliant.Axis(soft=0.5, adaptation=0.9)}),
    "impedance": pliant.Settings(law="impedance", axes={"y": pliant.Axis(soft=4.0)}),
}


def arms(model, count, seed=3):
    """Return postures, some stretched out and some at their limits, and targets."""
    rng = np.random.default_rng(seed)
    q = model.lower + (model.upper - model.lower) * rng.uniform(0.1, 0.9, (count, model.n))
    q[::7, 3:] = 0.0
    q[1::7] = np.where(q[1::7] > 0.0, model.upper, model.lower)
    targets = model.forward_kinematics_batch(q + rng.uniform(-0.2, 0.2, q.shape))
    return q, targets


def same(command, row, single):
    return all(
        getattr(command, field)[row].tobytes() == getattr(single, field).tobytes()
        for field in FIELDS
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("count", [0, 1, 5, 200])
def test_rows_have_the_bits_of_single_steps(model, law, count):
    controller = pliant.Controller(model, LAWS[law])
    state = controller.batch_state(count)
    assert (len(state), state.n) == (count, 7)
    controllers = [pliant.Controller(model, LAWS[law]) for _ in range(min(count, 20))]
    for tick in range(4):
        q, targets = arms(model, count, tick)
        dq = 0.1 * q if tick == 2 else None
        command = controller.step_batch(q, targets, state=state, dt=0.005, dq=dq)
        assert all(getattr(command, field).shape == (count, 7) for field in FIELDS)
        for row, instance in enumerate(controllers):
            speed = None if dq is None else dq[row]
            assert same(command, row, instance.step(q[row], targets[row], dt=0.005, dq=speed))


@pytest.mark.parametrize("law", LAWS)
def test_without_a_state_rows_are_first_steps_without_slew(model, law):
    controller = pliant.Controller(model, LAWS[law])
    free = LAWS[law].replace(
        tracking=pliant.Tracking(goal_slew=np.inf), max_tool_speed=(np.inf, np.inf)
    )
    q, targets = arms(model, 100)
    controller.step(q[3], targets[3])
    command = controller.step_batch(q, targets)
    for row in range(100):
        assert same(command, row, pliant.Controller(model, free).step(q[row], targets[row]))
    assert np.array_equal(controller.diagnostics.q_predicted, q[3]), "its own readings stay"


@budget(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(LAWS)), st.integers(1, 130))
def test_any_batch_is_its_rows(seed, law, count):
    model = pliant.robots.arm7()
    controller = pliant.Controller(model, LAWS[law])
    q, targets = arms(model, count, seed)
    state = controller.batch_state(count)
    state.reset(slice(None, None, 2), 0.5 * q[::2])
    command = controller.step_batch(q, targets, state=state)
    row = seed % count
    single = pliant.Controller(model, LAWS[law])
    if row % 2 == 0:
        single.reset(0.5 * q[row])
    assert same(command, row, single.step(q[row], targets[row]))


FORMS = {
    "list": lambda a: a.tolist(),
    "strided": lambda a: np.repeat(a, 2, axis=0)[::2],
    "fortran": np.asfortranarray,
    "big endian": lambda a: a.astype(">f8"),
    "memoryview": memoryview,
    "reversed": lambda a: a[::-1].copy()[::-1],
}


@pytest.mark.parametrize("form", FORMS)
def test_other_forms_of_arrays_give_the_same_bits(model, form):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 9)
    expected = controller.step_batch(q, targets, dq=0.1 * q)
    make = FORMS[form]
    result = controller.step_batch(make(q), make(targets), dq=make(0.1 * q))
    assert all(getattr(result, f).tobytes() == getattr(expected, f).tobytes() for f in FIELDS)
    single = q.astype(np.float32)
    doubled = controller.step_batch(single.astype(float), targets)
    assert np.array_equal(controller.step_batch(single, targets).goal, doubled.goal)


def test_one_target_for_all_in_every_form_that_a_step_takes(model):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 4)
    common_target = targets[2].copy()
    expected = controller.step_batch(q, np.stack([common_target] * 4)).goal
    for form in (
        common_target,
        common_target.tolist(),
        pliant.Pose(common_target),
        np.asfortranarray(common_target),
    ):
        assert np.array_equal(controller.step_batch(q, form).goal, expected)
    poses = [pliant.Pose(target) for target in targets]
    assert np.array_equal(
        controller.step_batch(q, poses).goal, controller.step_batch(q, targets).goal
    )


def test_positions_alone_where_no_rotation_is_controlled(model):
    lateral = pliant.Controller(model, pliant.Settings(task=pliant.Task(axes="xyz")))
    q, targets = arms(model, 4)
    positions = targets[:, :3, 3]
    rotated_targets = targets.copy()
    rotated_targets[:, :3, :3] = np.eye(3)
    expected = lateral.step_batch(q, rotated_targets).goal
    assert np.array_equal(lateral.step_batch(q, positions).goal, expected)
    assert np.array_equal(lateral.step_batch(q, positions.copy()).goal, expected)
    assert np.array_equal(
        lateral.step_batch(q, positions[1]).goal,
        lateral.step_batch(q, np.stack([positions[1]] * 4)).goal,
    )
    full = pliant.Controller(model, LAWS["cap"])
    with pytest.raises(pliant.ShapeError, match=r"targets has shape \(4, 3\)"):
        full.step_batch(q, positions)
    with pytest.raises(pliant.ShapeError, match="says nothing of the task's rotations"):
        full.step_batch(q, positions[0])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"Q": np.zeros((4, 6))}, r"Q has shape \(4, 6\), expected \(N, 7\)"),
        ({"Q": np.zeros(7)}, r"Q has shape \(7,\), expected \(N, 7\)"),
        ({"targets": np.zeros((3, 4, 4))}, r"targets has shape \(3, 4, 4\), expected \(N, 4, 4\) "),
        ({"targets": np.zeros((4, 7))}, r"targets has shape \(4, 7\), expected \(4, 4\), \(N, 4"),
        ({"targets": np.zeros(7)}, r"targets has shape \(7,\)"),
        ({"dq": np.zeros((3, 7))}, r"dq has shape \(3, 7\), expected \(4, 7\)"),
        ({"dt": -1.0}, r"dt \[s\] = -1 is outside"),
        ({"state": 3}, r"state has shape \(3 arms of 7 joints\), expected \(4 arms"),
        ({"Q": "words"}, "Q must be an array of numbers"),
        ({"targets": None}, "targets must be an array of numbers"),
        ({"dt": "soon"}, "dt must be a number"),
        ({"invalid": "nam"}, "invalid: must be one of 'raise', 'nan', .*did you mean 'nan'"),
        ({"out": np.zeros((4, 7))}, "out must be a command of a batch, or arrays"),
    ],
)
def test_arguments_that_do_not_fit_are_named(model, change, match):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 4)
    inputs = {"Q": q, "targets": targets} | change
    if "state" in inputs:
        inputs["state"] = controller.batch_state(inputs["state"])
    with pytest.raises((pliant.PliantError, TypeError), match=match):
        controller.step_batch(**inputs)


def test_results_into_the_callers_arrays(model):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 150)
    expected = controller.step_batch(q, targets)
    arrays = tuple(np.full((150, 7), -1.0) for _ in FIELDS)
    command = controller.step_batch(q, targets, out=arrays)
    assert all(
        getattr(command, field) is array for field, array in zip(FIELDS, arrays, strict=True)
    )
    again = controller.step_batch(q[::-1].copy(), targets[::-1].copy(), out=command)
    assert again is command
    assert all(np.array_equal(arrays[i], getattr(expected, f)[::-1]) for i, f in enumerate(FIELDS))
    results = [controller.step_batch(q, targets) for _ in range(5)]
    assert len({id(command.goal) for command in results}) == 5, (
        "results that are kept are nobody else's"
    )


def test_arrays_that_cannot_be_written_are_refused(model):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 4)
    state = controller.batch_state(4)
    snapshot = pickle.dumps(state)
    valid = [np.zeros((4, 7)) for _ in FIELDS]
    readonly = np.zeros((4, 7))
    readonly.flags.writeable = False
    for invalid, error in [
        (np.zeros((4, 6)), r"out\[1\] has shape \(4, 6\), expected \(4, 7\)"),
        (np.zeros((5, 7)), r"out\[1\] has shape \(5, 7\)"),
        (np.zeros((4, 7), dtype=np.float32), r"out\[1\] must be a writable float64 array"),
        (np.zeros((7, 4)).T, r"out\[1\] must be a writable float64 array in C order"),
        (readonly, r"out\[1\] must be a writable"),
        ([[0.0] * 7] * 4, r"out\[1\] must be a writable"),
    ]:
        with pytest.raises((pliant.ShapeError, TypeError), match=error):
            controller.step_batch(q, targets, state=state, out=(valid[0], invalid, valid[2]))
    with pytest.raises(ValueError, match=r"out\[0\] and out\[2\] must not share memory"):
        controller.step_batch(q, targets, state=state, out=(valid[0], valid[1], valid[0]))
    room = np.zeros((6, 7))
    with pytest.raises(ValueError, match=r"out\[0\] and out\[1\] must not share memory"):
        controller.step_batch(q, targets, state=state, out=(room[:4], room[2:], valid[2]))
    with pytest.raises(pliant.ShapeError, match=r"out\[0\] has shape \(7,\), expected \(4, 7\)"):
        controller.step_batch(q, targets, state=state, out=controller.step(q[0], targets[0]))
    assert pickle.dumps(state) == snapshot


def test_results_may_overwrite_the_inputs(model):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 150)
    expected = controller.step_batch(q, targets)
    buffer = q.copy()
    controller.step_batch(buffer, targets, out=(buffer, np.zeros_like(q), np.zeros_like(q)))
    assert np.array_equal(buffer, expected.goal)
    room = targets.copy().reshape(-1)
    view = room[: q.size].reshape(q.shape)
    overlapping = room.reshape(targets.shape)
    controller.step_batch(q, overlapping, out=(np.zeros_like(q), view, np.zeros_like(q)))
    assert np.array_equal(view, expected.torque_limit)


def test_a_bad_row_is_named_and_changes_nothing(model):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 150)
    state = controller.batch_state(150)
    controller.step_batch(q, targets, state=state)
    snapshot = pickle.dumps(state)
    invalid_q = q.copy()
    invalid_q[77, 2], invalid_q[140, 0] = np.nan, np.inf
    with pytest.raises(pliant.OutOfRangeError, match=r"^Q\[77\]: q\[2\] \(\w+\) = NaN is outside"):
        controller.step_batch(invalid_q, targets, state=state)
    rotated_targets = targets.copy()
    rotated_targets[5, 0, 0] += 0.1
    with pytest.raises(pliant.ConfigError, match=r"^targets\[5\]: rotation part is not a rotation"):
        controller.step_batch(q, rotated_targets, state=state)
    with pytest.raises(pliant.OutOfRangeError, match=r"^dq\[77\]: dq\[2\]"):
        controller.step_batch(q, targets, state=state, dq=invalid_q)
    assert pickle.dumps(state) == snapshot


def test_bad_rows_are_nan_where_asked_for(model):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 150)
    state, other = controller.batch_state(150), controller.batch_state(150)
    valid = controller.step_batch(q, targets, state=other)
    invalid_q = q.copy()
    invalid_q[[0, 77, 149], 2] = np.nan
    command = controller.step_batch(invalid_q, targets, state=state, invalid="nan")
    fine = np.ones(150, dtype=bool)
    fine[[0, 77, 149]] = False
    for field in FIELDS:
        assert np.isnan(getattr(command, field)[~fine]).all()
        assert np.array_equal(getattr(command, field)[fine], getattr(valid, field)[fine])
    # The other arms continue; the arms that were reset start with their next step.
    again = controller.step_batch(q, targets, state=state)
    onward = controller.step_batch(q, targets, state=other)
    assert np.array_equal(again.goal[fine], onward.goal[fine])
    assert np.array_equal(again.goal[~fine], valid.goal[~fine])


def test_states_can_be_reset_copied_and_pickled(model):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 6)
    state = controller.batch_state(6)
    controller.step_batch(q, targets, state=state)
    copies = [copy.copy(state), copy.deepcopy(state), pickle.loads(pickle.dumps(state))]
    expected = controller.step_batch(q, targets, state=state)
    for other in copies:
        assert np.array_equal(controller.step_batch(q, targets, state=other).goal, expected.goal)
    assert repr(state) == "<BatchState of 6 arms of 7 joints>"
    initial = controller.step_batch(q, targets, state=controller.batch_state(6))
    for indices, rows in [
        (None, range(6)),
        ([0, -1], [0, 5]),
        (np.array([True, False] * 3), [0, 2, 4]),
        (slice(1, 3), [1, 2]),
        (3, [3]),
        ([], []),
    ]:
        state_copy = copy.copy(copies[0])
        state_copy.reset(indices)
        result = controller.step_batch(q, targets, state=state_copy)
        continued = controller.step_batch(q, targets, state=copy.copy(copies[0]))
        for row in range(6):
            reference = initial if row in rows else continued
            assert np.array_equal(result.goal[row], reference.goal[row]), (indices, row)
    with pytest.raises(IndexError):
        state.reset(6)
    with pytest.raises(IndexError):
        state.reset(np.array([True, False]))
    with pytest.raises(IndexError):
        state.reset([0.5])
    before = pickle.dumps(state)
    with pytest.raises(pliant.ShapeError, match=r"Q has shape \(2, 7\), expected \(3, 7\), or"):
        state.reset([0, 1, 2], q[:2])
    with pytest.raises(pliant.OutOfRangeError, match="NaN"):
        state.reset([0, 1], [q[0], np.full(7, np.nan)])
    assert pickle.dumps(state) == before
    with pytest.raises(pliant.OutOfRangeError, match="joints = 0"):
        pliant.types.BatchState(0, [])


def test_python_runs_meanwhile_and_a_state_is_not_shared(model):
    controller = pliant.Controller(model, LAWS["cap"])
    q, targets = arms(model, 60_000)
    state, iterations, errors = controller.batch_state(len(q)), [], []

    def work():
        try:
            for _ in range(3):
                controller.step_batch(q, targets, state=state)
        except RuntimeError as error:
            errors.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    while thread.is_alive():
        iterations.append(None)
        try:
            len(state)
        except RuntimeError as error:
            errors.append(str(error))
    thread.join()
    assert len(iterations) > 100, "this thread had no turn"
    assert errors
    assert all("borrow" in error.lower() for error in errors)


def test_threads_with_their_own_states_get_what_they_get_alone(model):
    controller = pliant.Controller(model, LAWS["cap"])

    def drive(seed, results):
        state = controller.batch_state(200)
        for tick in range(5):
            results.append(controller.step_batch(*arms(model, 200, seed + tick), state=state).goal)

    sequential, concurrent = [[] for _ in range(4)], [[] for _ in range(4)]
    for seed, results in enumerate(sequential):
        drive(seed, results)
    threads = [threading.Thread(target=drive, args=(i, t)) for i, t in enumerate(concurrent)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for a, b in zip(sequential, concurrent, strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def row_axes(count, **columns):
    """Return an array (count, 6) with NaN except in the named columns."""
    out = np.full((count, 6), np.nan)
    for name, values in columns.items():
        out[:, pliant.AXES.index(name)] = values
    return out


@pytest.mark.parametrize("law", LAWS)
def test_each_row_may_have_caps_and_adaptation_of_its_own(model, law):
    spring = {"stiffness": 200.0} if law == "impedance" else {}
    axes = {"y": pliant.Axis(soft=0.5, adaptation=0.9, **spring)}
    settings = LAWS[law].replace(axes=axes)
    controller = pliant.Controller(model, settings)
    hold = controller.axes["y"].hold
    rng = np.random.default_rng(5)
    caps, adaptation = rng.uniform(0.0, hold, 20), rng.uniform(0.0, 0.9, 20)
    caps[:2] = 0.0, hold
    controllers = []
    for cap, eta in zip(caps.tolist(), adaptation.tolist(), strict=True):
        axis = pliant.Axis(soft=cap, firm=cap, hold=hold, adaptation=eta, **spring)
        controllers.append(pliant.Controller(model, settings.replace(axes={"y": axis})))
    rows = {"caps": row_axes(20, y=caps), "adaptation": row_axes(20, y=adaptation)}
    state, other = controller.batch_state(20), controller.batch_state(20)
    for tick in range(4):
        q, targets = arms(model, 20, tick)
        command = controller.step_batch(q, targets, state=state, **rows)
        for row, instance in enumerate(controllers):
            assert same(command, row, instance.step(q[row], targets[row]))
        without_options = controller.step_batch(q, targets, state=other)
    assert not np.array_equal(without_options.torque_limit, command.torque_limit)


def test_wrong_caps_and_adaptation_are_named(model):
    controller = pliant.Controller(model, pliant.Settings.soft("y"))
    q, targets = arms(model, 4)
    state = controller.batch_state(4)
    hold = controller.axes["y"].hold
    valid = {"caps": row_axes(4, y=3.0), "adaptation": row_axes(4, y=0.5)}
    controller.step_batch(q, targets, state=state, **valid)
    snapshot = pickle.dumps(state)
    for name, values, kind, message in [
        (
            "caps",
            row_axes(4, y=[1, 1, hold + 1, 1]),
            "OutOfRangeError",
            r"caps\[2\]: y \[N\] = .*hold",
        ),
        (
            "caps",
            row_axes(4, y=-1.0),
            "OutOfRangeError",
            r"caps\[0\]: y \[N\] = -1 is outside \[0, ",
        ),
        ("caps", row_axes(4), "OutOfRangeError", r"caps\[0\]: y \[N\] = NaN is outside"),
        ("caps", row_axes(4, y=1.0, z=2.0), "ConfigError", r"caps\[0\]: z: 2 has no effect, .*NaN"),
        ("caps", np.ones((4, 5)), "ShapeError", r"caps has shape \(4, 5\), expected \(N, 6\)"),
        ("caps", row_axes(3, y=1.0), "ShapeError", r"caps has shape \(3, 6\), expected \(4, 6\)"),
        ("adaptation", row_axes(4, y=1.0), "OutOfRangeError", r"adaptation\[0\]: y = 1 is outside"),
        ("adaptation", row_axes(5, y=0.1), "ShapeError", r"adaptation has shape \(5, 6\)"),
    ]:
        with pytest.raises(getattr(pliant, kind), match=message):
            controller.step_batch(q, targets, state=state, **{**valid, name: values})
        assert pickle.dumps(state) == snapshot
