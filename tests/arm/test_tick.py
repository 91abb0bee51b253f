"""Cost of a tick by number of calls, and the limits of commands against a computation in NumPy."""

import importlib
from pathlib import Path

import numpy as np
import pytest

import pliant
from pliant._core import SUPPORT, CommandLimiter, PositionFilter, torque_margin
from pliant.arm import Budget

BENCHES = Path(__file__).resolve().parents[2] / "benches"
#: Largest number of calls per tick, and of those of functions written in Python. A count needs no
#: idle machine; Python versions and NumPy differ by some calls.
CALLS = {"null": (120, 65), "so101": (320, 140)}


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
    kp, usable = rng.uniform(5.0, 20.0, size), rng.uniform(1.0, 3.0, size)
    servos = model.servos
    thermal = Budget(supply=supply).thermal_model(usable, np.full(size, 2.0))
    limiter = CommandLimiter(model, servos, thermal, chain=chain, kp=kp, max_torque=usable)
    heat = np.zeros(size)
    reduced = 0
    for _ in range(200):
        position = rng.normal(0.0, 1.0, size)
        position[rng.random(size) < 0.1] = np.nan
        goal, gravity = rng.normal(0.0, 2.0, n), rng.normal(0.0, 1.0, n)
        limit, other = rng.uniform(0.0, 4.0, n), rng.uniform(0.0, 3.0, (1, 2))
        ramp, ramp_start = rng.uniform(-0.5, 1.5), rng.uniform(0.0, 2.0, n)
        goals, limits = limiter.limit(
            goal, limit, gravity, position, other, ramp=ramp, ramp_start=ramp_start, lead=lead
        )
        # Goals are bounded by position limits and lead.
        need, most = gravity / kp[chain], usable[chain] / kp[chain]
        below, above = (most, most) if lead else (np.maximum(-need, 0.0), np.maximum(need, 0.0))
        clipped = np.clip(goal, model.lower - below, model.upper + above)
        assert goals[chain] == pytest.approx(clipped, abs=1e-12)
        assert (goals[4], limits[4]) == (other[0, 0], min(other[0, 1], thermal.torque_ceiling()[4]))
        # Torque limits are bounded by the ramp after torque on, heat and supply current.
        support, top = SUPPORT * np.abs(gravity), usable[chain]
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
        reduced += bool((expected < before).any())
        # Heat follows from the measured load, or from the estimated torque where it is missing.
        load = rng.normal(0.0, 2.0, size)
        load[rng.random(size) < 0.5] = np.nan
        torque = np.minimum(np.abs(pull), limits)
        torque = np.where(np.isfinite(load), np.abs(load), torque)
        limiter.update_heat(goals, limits, position, load, 2.0)
        heat += -np.expm1(-2.0 / 30.0) * ((torque / (0.4 * usable)) ** 2 - heat)
        assert thermal.heat == pytest.approx(heat, rel=1e-9)
    assert (reduced > 50) == (supply is not None)


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
