"""Number of calls per tick, and command limits compared with a computation in NumPy."""

import importlib
import pickle
from pathlib import Path

import numpy as np
import pytest

import pliant
from pliant._core import SUPPORT, CommandLimiter, JointReadings, PositionFilter, torque_margin
from pliant.arm import Budget, State

BENCHES = Path(__file__).resolve().parents[2] / "benches"
#: Largest number of calls per tick, and of calls of functions written in Python among them. A count
#: needs no idle machine; versions of Python and NumPy differ by some calls.
CALLS = {"null": (42, 28), "so101": (34, 14)}


@pytest.fixture
def bench(monkeypatch):
    pytest.importorskip("rustypot", reason="servo buses need the extra servo")
    pytest.importorskip("mcap", reason="the bench writes logs: extra log")
    pytest.importorskip("mujoco", reason="the emulated arm needs the extra sim")
    monkeypatch.syspath_prepend(str(BENCHES))
    return importlib.import_module("tick")


@pytest.mark.parametrize("name", CALLS)
def test_a_tick_makes_no_more_calls_than_it_did(bench, name):
    with bench.opened(name) as rig:
        rig.count()
        rig.measure(rig.whole)
    assert 0 < rig.calls <= CALLS[name][0]
    assert 0 < rig.python_calls <= CALLS[name][1]
    assert rig.whole.ticks == bench.BLOCK
    assert rig.whole.thread > 0.0


@pytest.mark.parametrize("supply", [None, 3.0])
@pytest.mark.parametrize("lead", [False, True])
def test_limits_equal_their_formula(supply, lead):
    model = pliant.robots.so101()
    n, size = model.n, model.n + 1
    rng = np.random.default_rng(0)
    chain = [5, 0, 2, 3, 1]
    kp, max_torque = rng.uniform(5.0, 20.0, size), rng.uniform(1.0, 3.0, size)
    servos = model.servos
    thermal = Budget(supply=supply).thermal_model(max_torque, np.full(size, 2.0))
    limiter = CommandLimiter(
        model, servos, thermal, chain=chain, extra=("jaw",), kp=kp, max_torque=max_torque,
        max_jumps=3, max_heat=1.0,
    )  # fmt: skip
    heat = np.zeros(size)
    count = 0
    for _ in range(200):
        position = rng.normal(0.0, 1.0, size)
        # The position of the gripper, which is off the chain, may be unknown.
        position[4] = np.nan if rng.random() < 0.2 else position[4]
        positions = PositionFilter(np.ones(size))
        positions.update(position, np.ones(size, dtype=bool), 0.0)
        gravity = model.gravity(position[chain])
        # A goal much farther outside is refused.
        goal = np.clip(rng.normal(0.0, 2.0, n), model.lower - 1.0, model.upper + 1.0)
        speed = rng.uniform(0.0, 3.0, n)
        limit, other = rng.uniform(0.0, 4.0, n), rng.uniform(0.0, 3.0, (1, 2))
        ramp, ramp_start = rng.uniform(-0.5, 1.5), rng.uniform(0.0, 2.0, n)
        goals, limits, speeds, needed = limiter.limit(
            goal, limit, speed, positions, other.tolist(), ramp, ramp_start, lead=lead
        )
        assert speeds[chain].tolist() == speed.tolist()
        assert speeds[4] == np.inf
        assert needed is None if lead else needed.tolist() == gravity.tolist()
        # Goals are bounded by position limits and lead.
        required, largest = gravity / kp[chain], max_torque[chain] / kp[chain]
        lower_lead, upper_lead = (
            (largest, largest) if lead else (np.maximum(-required, 0.0), np.maximum(required, 0.0))
        )
        clipped_goal = np.clip(goal, model.lower - lower_lead, model.upper + upper_lead)
        assert goals[chain] == pytest.approx(clipped_goal, abs=1e-12)
        assert (goals[4], limits[4]) == (other[0, 0], min(other[0, 1], thermal.torque_ceiling()[4]))
        # The ramp after torque on, heat and supply current each bound the torque limits.
        support, top = SUPPORT * np.abs(gravity), max_torque[chain]
        holding = np.minimum(np.maximum(support + torque_margin(servos, gravity), ramp_start), top)
        bound = holding + np.clip(ramp, 0.0, 1.0) * (top - holding)
        bound = np.minimum(
            np.minimum(limit, bound), np.maximum(thermal.torque_ceiling()[chain], support)
        )
        before = np.empty(size)
        before[chain], before[4] = bound, limits[4]
        floor = np.zeros(size)
        floor[chain] = support
        pull = kp * np.nan_to_num(goals - position)
        expected = thermal.limit_current(pull, floor, before)
        assert limits[chain] == pytest.approx(expected[chain], abs=1e-12)
        count += bool((expected < before).any())
        # Heat follows from the measured load, or from the estimated torque where it is missing.
        load = rng.normal(0.0, 2.0, size)
        load[rng.random(size) < 0.5] = np.nan
        torque = np.minimum(np.abs(pull), limits)
        torque = np.where(np.isfinite(load), np.abs(load), torque)
        positions, ok = PositionFilter(np.ones(size)), np.ones(size, dtype=bool)
        limiter.update(
            positions, JointReadings(position, ok, 0.0, load=load),
            goals, limits, 2.0, 0.0,
        )  # fmt: skip
        heat += -np.expm1(-2.0 / 30.0) * ((torque / (0.4 * max_torque)) ** 2 - heat)
        assert thermal.heat == pytest.approx(heat, rel=1e-9)
    assert (count > 50) == (supply is not None)


def test_a_reading_updates_filter_and_heat_as_single_calls_do():
    model = pliant.robots.so101()
    n, size, chain = model.n, model.n + 1, [5, 0, 2, 3, 1]
    rng = np.random.default_rng(1)
    kp, max_torque = rng.uniform(5.0, 20.0, size), rng.uniform(1.0, 3.0, size)

    def made():
        thermal = Budget().thermal_model(max_torque, None)
        limiter = CommandLimiter(
            model,
            model.servos,
            thermal,
            chain=chain,
            extra=("jaw",),
            kp=kp,
            max_torque=max_torque,
            max_jumps=2,
            max_heat=0.9,
        )
        return limiter, PositionFilter(np.full(size, 0.5)), thermal

    limiter, positions, thermal = made()
    expected = PositionFilter(np.full(size, 0.5))
    suspects, freshness, heat = set(), set(), np.zeros(size)
    for cycle in range(300):
        reading_time, dt = 0.01 * cycle + 0.003, 0.5 * (cycle % 4)
        position = 0.1 * rng.random(size) + 2.0 * (rng.random(size) < 0.05)
        ok = rng.random(size) > 0.2
        time = 0.01 * cycle + 0.001 * rng.random(size)
        goal, limit = rng.normal(0.0, 1.0, size), max_torque * (1.5 if cycle > 200 else 0.1)
        velocity, load, current = (
            None if (cycle + i) % 3 else rng.normal(0.0, 0.1, size) for i in range(3)
        )
        state, is_suspect = limiter.update(
            positions, JointReadings(position, ok, time, velocity, load, current),
            goal, limit, dt, reading_time,
        )  # fmt: skip
        is_accepted = expected.update(position, ok, time)
        assert positions.accepted.tolist() == is_accepted.tolist()
        assert state.fresh == is_accepted[chain].all()
        freshness.add(state.fresh)
        measured = (getattr(state, name) for name in ("dq", "load", "current"))
        for result, value in zip(measured, (velocity, load, current), strict=True):
            assert (result is None) == (value is None)
            assert value is None or result.tolist() == value[chain].tolist()
        np.testing.assert_array_equal(state.q, expected.position[chain])
        np.testing.assert_array_equal(state.age, reading_time - expected.time[chain])
        assert state.time == expected.time[chain].min()
        np.testing.assert_equal(state.extra, {"jaw": expected.position[4]})
        torque = np.minimum(np.abs(np.nan_to_num(kp * (goal - expected.position))), limit)
        torque = torque if load is None else np.abs(load)
        heat += -np.expm1(-dt / 30.0) * ((torque / (0.4 * max_torque)) ** 2 - heat)
        assert thermal.heat == pytest.approx(heat, rel=1e-9)
        is_hot = bool((heat > 0.9).any())
        assert is_suspect == (bool(expected.implausible(2)) or is_hot)
        suspects.add((bool(expected.implausible(2)), is_hot))
    assert freshness == {True, False}
    assert {(False, False), (True, False)} <= suspects
    assert (False, True) in suspects or (True, True) in suspects
    with pytest.raises(pliant.ShapeError, match="position has shape"):
        limiter.update(
            PositionFilter([1.0]), JointReadings(np.zeros(1), np.ones(1, dtype=bool), 0.0),
            goal, limit, 0.0, 0.0,
        )  # fmt: skip
    assert n == len(chain)


def test_a_filter_takes_times_of_joints_or_of_the_reading():
    positions = PositionFilter([1.0, 1.0])
    ok = np.array([True, True])
    assert positions.update(np.zeros(2), ok, 1.0).tolist() == [True, True]
    assert positions.update(np.array([0.25, 0.25]), ok, np.array([1.02, 1.03])).tolist() == [
        False,
        True,
    ]
    assert positions.time.tolist() == [1.0, 1.03]
    assert positions.implausible(1) == [(0, 0.25)]
    assert positions.jumps == 1
    with pytest.raises(pliant.ShapeError, match=r"ok has shape \(3,\)"):
        positions.update(np.zeros(2), np.ones(3, dtype=bool), 1.0)
    with pytest.raises(pliant.OutOfRangeError, match=r"max_speed\[1\]"):
        PositionFilter([1.0, -1.0])


def test_arrays_of_a_state_that_is_kept_do_not_change():
    model = pliant.robots.so101()
    size, chain = model.n + 1, list(range(model.n))
    thermal = Budget().thermal_model(np.ones(size), None)
    limiter = CommandLimiter(
        model, model.servos, thermal, chain=chain, extra=("jaw",), kp=np.ones(size),
        max_torque=np.ones(size), max_jumps=3, max_heat=1.0,
    )  # fmt: skip
    positions = PositionFilter(np.full(size, 100.0))
    ok, zeros = np.ones(size, dtype=bool), np.zeros(size)

    def state(cycle):
        values = np.full(size, 0.001 * cycle)
        readings = JointReadings(values, ok, 0.01 * cycle, values, values, values)
        return limiter.update(positions, readings, zeros, zeros, 0.01, 0.01 * cycle)[0]

    def arrays(state):
        return [state.q, state.dq, state.load, state.current, state.age]

    kept = [state(cycle) for cycle in range(5)]
    views = [state(cycle).q[1:] for cycle in range(5, 10)]
    for cycle in range(10, 20):
        state(cycle)
    for cycle, state_of_then in enumerate(kept):
        for array in arrays(state_of_then)[:4]:
            assert array.tolist() == [0.001 * cycle] * model.n
    for cycle, view in enumerate(views, 5):
        assert view.tolist() == [0.001 * cycle] * (model.n - 1)
    # Arrays of states that are no longer referenced are used again: three suffice.
    assert len({id(state(cycle).q) for cycle in range(20, 40)}) == 3


def test_states_and_readings_can_be_copied_with_changes():
    q = np.array([0.1, 0.2])
    state = State(q, time=3.0, extra={"jaw": 0.5}, voltage=np.array([7.0, 7.1]))
    assert state.q is q
    assert (state.dq, state.time, state.fresh, state.faults) == (None, 3.0, True, ())
    assert state.age.tolist() == [0.0, 0.0]
    assert State(q).extra == {}
    hot = state.replace(faults=("hot",), fresh=False)
    assert (hot.faults, hot.fresh, hot.extra) == (("hot",), False, {"jaw": 0.5})
    assert (state.faults, state.fresh) == ((), True)
    copy = pickle.loads(pickle.dumps(hot))
    assert repr(copy) == repr(hot)
    assert "faults=('hot',)" in repr(hot)
    with pytest.raises(AttributeError):
        state.time = 1.0
    with pytest.raises(TypeError, match="speed"):
        state.replace(speed=1.0)
    readings = JointReadings(q, np.array([True, False]), 1.0, current=2.0 * q)
    copy = pickle.loads(pickle.dumps(readings))
    assert copy.position.tolist() == q.tolist()
    assert (copy.ok.tolist(), copy.time, copy.velocity) == ([True, False], 1.0, None)
    assert copy.current.tolist() == [0.2, 0.4]
