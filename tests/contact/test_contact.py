"""Contact estimation from Python: estimates of a simulated push, and errors of invalid input."""

import numpy as np
import pytest
from mismatch import RANDOM, Mismatch, Parameters

pytest.importorskip("mujoco", reason="contacts are felt in the simulator: extra sim")

import pliant
from experiments import contacts as table
from experiments.contacts import MAIN, Bench, Case, Job, measure
from experiments.poses import arm
from pliant._core import update_contacts
from pliant.sim import ForceProfile, Plant, Push
from pliant.sim.postures import VERTICAL

KNOWN = {"kp_error": 0.0, "gravity_error": 0.0, "friction_error": 0.1}


def controller(**settings):
    return pliant.Controller(arm(), pliant.Settings.soft("y").replace(**settings))


def push_estimates(contact, force=(0.0, 0.0, 0.0), ticks=200, *, build=Plant, tare=None):
    """Return the estimates of all ticks during a push that ramps up from 0.5 to 0.7 s.

    The estimator is tared at tick `tare`; None: never.
    """
    course = ForceProfile(start=0.5, rise=0.2, end=10.0)
    plant = build(arm(), scene=[Push(force_vector=force, course=course)])
    ctl = contact.controller
    plant.reset(VERTICAL)
    ctl.reset(VERTICAL)
    target = arm().forward_kinematics(VERTICAL)
    records = []
    for tick in range(ticks):
        q = plant.read().q
        if tick == tare:
            contact.tare()
        records.append(contact.update(q))
        command = ctl.step(q, target)
        plant.write(command.goal, command.torque_limit)
        plant.advance()
    return records


@pytest.mark.parametrize("force", [(0.0, 0.0, 8.0), (-6.0, 0.0, 0.0), (3.0, 2.0, -5.0)])
def test_a_push_is_felt_within_the_bound(force):
    last = push_estimates(pliant.ContactEstimator(controller(), **KNOWN), force)[-1]
    error = np.abs(last.force_base[:3] - force)
    assert (error <= last.uncertainty_base[:3]).all()
    assert error.max() < 1.5  # [N], measured 0.6
    assert last.uncertainty[:3].max() < 4.0  # [N], measured 2.5
    assert last.force.shape == last.touch.shape == (6,)
    assert last.torque_residual.shape == last.saturated.shape == (7,)


def test_events_come_with_their_thresholds_and_their_time():
    contact = pliant.ContactEstimator(controller(), touch={"xyz": 4.0}, stop={"z": 7.0}, **KNOWN)
    result = push_estimates(contact, (0.0, 0.0, 9.0))
    touches = [bool(estimate.touch[2]) for estimate in result]
    stops = [bool(estimate.stop[2]) for estimate in result]
    assert not any(touches[:50])
    assert 50 < touches.index(True) < stops.index(True) < 90
    assert contact.latency == pytest.approx(0.06)


def test_nothing_is_claimed_before_a_command_was_in_force():
    first = push_estimates(pliant.ContactEstimator(controller(), **KNOWN), ticks=1)[0]
    assert (first.force == 0.0).all()
    assert np.isinf(first.uncertainty).all()
    assert str(first) == "nothing known yet"


def test_saturated_joints_are_named_and_the_estimate_stands():
    contact = pliant.ContactEstimator(controller(), **KNOWN)
    last = push_estimates(contact, (0.0, 0.0, 40.0), ticks=120)
    saturated = [estimate for estimate in last if estimate.saturated.any()]
    assert saturated


def test_a_tare_takes_a_wrong_stiffness_out():
    contact = pliant.ContactEstimator(controller(), kp_error=0.2, gravity_error=0.0)
    gap = Mismatch(plant=Parameters(kp=1.15), assumed=Parameters())
    result = push_estimates(contact, (0.0, 0.0, 8.0), build=gap.build, tare=45)
    gap.check(contact.controller)
    assert contact.tared
    before, after, final = result[44], result[49], result[-1]
    assert np.abs(before.force[:3]).max() > 1.0  # [N], the estimate before the tare
    assert np.abs(after.force[:3]).max() < 0.3
    error = np.abs(final.force_base[:3] - (0.0, 0.0, 8.0))
    assert (error <= final.uncertainty_base[:3]).all()
    contact.clear_tare()
    assert not contact.tared


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"touch": {"z": 1.0}}, r"touch\.z \[N\] = 1 is outside \[\d"),
        ({"touch": {"y yaw": 30.0, "y": 20.0}}, "y is named twice"),
        ({"touch": {"w": 3.0}}, "'w' is not an axis"),
        ({"axes": "xy", "stop": {"z": 30.0}}, r"stop\.z: has a threshold but is not among"),
        ({"guard": 2.0}, "guard = 2"),
        ({"torque_constant": [1.0]}, r"torque_constant has shape \(1,\)"),
    ],
)
def test_invalid_arguments_are_refused_by_name(options, text):
    with pytest.raises(pliant.PliantError, match=text):
        pliant.ContactEstimator(controller(), **options)


def test_a_current_needs_a_constant_and_a_mapping_is_one():
    contact = pliant.ContactEstimator(controller())
    with pytest.raises(pliant.ConfigError, match="torque per ampere"):
        contact.update(VERTICAL, current=np.zeros(7))
    with pytest.raises(TypeError, match="mapping from axes"):
        pliant.ContactEstimator(controller(), touch=8.0)
    with pytest.raises(pliant.OutOfRangeError, match="load"):
        contact.update(VERTICAL, load=np.full(7, np.nan))


def test_few_joints_look_at_the_axes_of_their_task():
    ctl = pliant.Controller(pliant.robots.so101(), pliant.Settings(task="xyz"))
    contact = pliant.ContactEstimator(ctl)
    assert contact.axes == ("x", "y", "z")
    assert np.isinf(contact.uncertainty_at(np.array([0.2, -0.3, 0.3, 0.9, 0.0]))[3:]).all()


def test_events_of_the_experiment_are_those_of_the_core():
    result = push_estimates(
        pliant.ContactEstimator(controller(), touch={"z": 5.0}, accept_thresholds=True, **KNOWN),
        (0.0, 0.0, 9.0),
    )
    is_above = np.array([abs(estimate.force[2]) > 5.0 for estimate in result])
    assert table.events(is_above)[0] == [bool(estimate.touch[2]) for estimate in result].index(True)


def test_free_motion_stays_within_the_bound_and_strong_contacts_are_seen():
    bench = Bench(MAIN)
    random_values = Parameters(friction=RANDOM, damping=RANDOM)
    with Mismatch(plant=Parameters(), assumed=random_values):
        free = [bench.free(number, 20.0) for number in range(2)]
        contacts = [bench.contact(number) for number in range(12)]
    facts = table.estimate_errors(free, contacts)
    assert facts["free beyond"] < 0.001  # measured 0.0000 in an hour
    assert facts["free rms"] < 1.5  # [N], measured 0.77
    strength = table.STRONG_FORCE * bench.arm.median_capacity[0]
    guarded = table.evaluate("short", table.Rule("guarded", 0.6), strength, free, contacts)
    assert guarded.alarms == 0
    assert guarded.missed <= 0.2  # measured 0.045 of 581
    assert guarded.seen >= 0.6  # measured 0.80


def test_a_run_repeats():
    first, second = (Job(Case("short"), 3, 1.0).run() for _ in range(2))
    assert (first.wrench == second.wrench).all()


@pytest.mark.full
def test_contacts_in_full():
    rows, facts = measure(MAIN, 1000, 60)
    by_rule = {str(row.rule): row for row in rows}
    guarded = by_rule["force > 0.6 × bound"]
    assert guarded.alarms == 0
    assert guarded.missed < 0.06  # measured 0.045
    assert guarded.late[0] <= 0.08  # [s], measured 0.06
    assert facts["free beyond"] < 1e-4


def test_a_series_has_the_numbers_of_its_readings_one_by_one():
    single, several = (pliant.ContactEstimator(controller(), **KNOWN) for _ in range(2))
    rng = np.random.default_rng(2)
    for count in (1, 5, 30):
        q = VERTICAL + rng.uniform(-0.01, 0.01, (count, 7))
        sent = (q + rng.uniform(-0.05, 0.05, q.shape), rng.uniform(1.0, 8.0, q.shape))
        for reading, goal, limit in zip(q, *sent, strict=True):
            single.update(reading, sent=(goal, limit))
        # A list of lists is converted differently from an array.
        assert several.update_series(q if count > 1 else q.tolist(), sent=sent) == single.estimate
    with pytest.raises(pliant.ShapeError, match=r"Q has shape \(7,\), expected \(T, 7\)"):
        several.update_series(VERTICAL)
    with pytest.raises(pliant.ShapeError, match=r"goal has shape \(35,\), expected \(14,\)"):
        several.update_series(q[:2], sent=(sent[0][:5], sent[1][:2]))
    assert several.estimate == single.estimate


def test_several_arms_have_the_numbers_of_their_series():
    rng = np.random.default_rng(3)
    ctl = controller()
    alone, together = ([pliant.ContactEstimator(ctl, **KNOWN) for _ in range(4)] for _ in range(2))
    together[2] = None
    velocity, force, uncertainty = np.full((4, 7), 9.0), np.full((4, 6), 9.0), np.full((4, 6), 9.0)
    out = (velocity, force, uncertainty)
    for count in (1, 5):
        q = VERTICAL + rng.uniform(-0.01, 0.01, (4, count, 7))
        # One array is not contiguous.
        goal = (q + rng.uniform(-0.05, 0.05, q.shape)).transpose(1, 0, 2).copy().transpose(1, 0, 2)
        limit = rng.uniform(1.0, 8.0, q.shape)
        update_contacts(together, q, dt=0.01, sent=(goal, limit), out=out)
        for row, contact in enumerate(alone):
            felt = contact.update_series(q[row], dt=0.01, sent=(goal[row], limit[row]))
            if row != 2:
                assert together[row].estimate == felt
                assert (velocity[row] == felt.velocity).all()
                assert (force[row] == felt.force).all()
                assert (uncertainty[row] == felt.uncertainty).all()
    for array in out:
        assert (array[2] == 9.0).all(), "the row of a missing arm is not written"


def test_series_of_several_arms_need_equal_shapes_and_separate_memory():
    contacts = [pliant.ContactEstimator(controller()) for _ in range(2)]
    q, out = np.tile(VERTICAL, (2, 3, 1)), (np.zeros((2, 7)), np.zeros((2, 6)), np.zeros((2, 6)))
    limit = np.ones((2, 3, 7))
    with pytest.raises(pliant.ShapeError, match=r"torque_limit has shape \(1, 3, 7\)"):
        update_contacts(contacts, q, dt=0.01, sent=(q, limit[:1]), out=out)
    with pytest.raises(pliant.ShapeError, match=r"Q has shape \(2, 3, 7\), expected \(1, 3, 7\)"):
        update_contacts(contacts[:1], q, dt=0.01, sent=(q, limit), out=out)
    six, outs = np.ones((2, 3, 6)), tuple(np.zeros((3, 2, 6)))
    with pytest.raises(pliant.ShapeError, match=r"Q has shape \(2, 3, 6\), expected \(2, 3, 7\)"):
        update_contacts(contacts, six, dt=0.01, sent=(six, six), out=outs)
    with pytest.raises(ValueError, match="must not share memory"):
        update_contacts(contacts, q, dt=0.01, sent=(q, limit), out=(out[0], out[1], out[1]))
    with pytest.raises(RuntimeError, match="in use by another call"):
        update_contacts(contacts[:1] * 2, q, dt=0.01, sent=(q, limit), out=out)
    assert not out[0].any()
