"""Force caps in random poses: a few poses always run; the others are marked `full`."""

import json

import numpy as np
import pytest

from experiments import campaign as table
from experiments.arms import load
from experiments.campaign import DISTURBANCES, UNDISTURBED, Bench, campaign_jobs, run_campaign

#: Indices of random poses of `arm7`: in pose 1 a joint is at its stop, in pose 2 none is.
POSES = range(1, 3)


def measure_caps(arm, disturbance, poses):
    bench = Bench(load(arm), disturbance)
    positions = bench.arm.poses(max(poses) + 1)
    return [promise for pose in poses for promise in bench.promises(pose, positions[pose])]


def not_refused(promises):
    return [promise for promise in promises if not promise.refused]


@pytest.fixture(scope="module")
def nominal():
    return measure_caps("arm7", UNDISTURBED, POSES)


def test_caps_of_arm7_are_those_of_the_protocol():
    arm = load("arm7")
    assert arm.caps(0) == (5.0, 10.0, 20.0)
    assert arm.caps(3) == (0.5, 1.0)
    assert len(arm.poses(200)) == 200


def test_a_refusal_is_proven_by_the_limits(nominal):
    arm, (heavy, *_) = load("arm7"), [promise for promise in nominal if promise.refused]
    q = arm.poses(heavy.pose + 1)[heavy.pose]
    row = ("x", "y", "z", "roll", "pitch", "yaw").index(heavy.axis)
    push = heavy.sign * heavy.cap * np.asarray(arm.model.jacobian(q)[row])
    excess = np.abs(arm.model.gravity(q) - push) - np.asarray(arm.servos.max_torque)
    assert excess.max() > 0.0
    assert np.mean([promise.refused for promise in nominal]) < 0.08  # measured 0.038


def test_every_cap_is_kept_where_joints_are_clear_of_their_stops(nominal):
    tested = [promise for promise in not_refused(nominal) if promise.room >= table.CLEAR]
    assert len(tested) > 30  # measured 56
    assert np.mean([promise.kept for promise in tested]) >= 0.97  # measured 1.0
    assert np.median([abs(promise.error) for promise in tested]) < 0.06


def test_caps_without_an_announced_stop_are_kept(nominal):
    with_stop = [promise for promise in not_refused(nominal) if promise.announced]
    without_stop = [promise for promise in not_refused(nominal) if not promise.announced]
    assert len(without_stop) > 60
    assert np.mean([promise.kept for promise in without_stop]) >= 0.97  # measured 1.0
    assert np.mean([not promise.kept for promise in with_stop]) > 0.1
    assert len(with_stop) < 0.5 * len(without_stop), "no blanket refusal"


@pytest.mark.parametrize(
    "disturbance",
    [
        promise
        for promise in DISTURBANCES
        if promise.name in {"moving at 0.05 m/s", "k_p × 1.25, identified", "a tick each way"}
    ],
    ids=lambda promise: promise.name.split(",")[0].replace("×", "x"),
)
def test_caps_hold_under_what_the_controller_knows_or_can_bear(disturbance):
    promises = [
        promise
        for promise in not_refused(measure_caps("arm7", disturbance, [2]))
        if promise.room >= table.CLEAR
    ]
    assert np.mean([promise.kept for promise in promises]) >= 0.95


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_small_arms_keep_their_caps(arm):
    tested = [
        promise
        for promise in not_refused(measure_caps(arm, UNDISTURBED, range(1)))
        if promise.room >= table.CLEAR
    ]
    assert np.mean([promise.kept for promise in tested]) >= 0.90


def test_campaign_is_one_table_one_file_one_picture(tmp_path):
    results = dict(run_campaign(campaign_jobs(["koch"], 1), 1))
    rows = [table.summary(*key, promises) for key, promises in results.items()]
    lines = table.text(rows).splitlines()
    assert lines[0].count("|") == lines[1].count("|") == lines[2].count("|")
    table.save_results(tmp_path, rows, results, {"poses": 1})
    assert json.loads((tmp_path / "results.json").read_text())["rows"][0]["arm"] == "koch"
    pytest.importorskip("matplotlib", reason="pictures need the extra plot")
    table.draw(tmp_path, rows, results)
    assert (tmp_path / "campaign.png").stat().st_size > 10_000


def test_a_promise_repeats():
    bench = Bench(load("koch"))
    q = bench.arm.poses(1)[0]
    first, _, again = (
        bench.keep(0, q, "z", direction, 0.5, guided=False) for direction in (1.0, -1.0, 1.0)
    )
    assert first == again


@pytest.mark.full
def test_nominal_campaign_in_full():
    promises = measure_caps("arm7", UNDISTURBED, range(200))
    row = table.summary("arm7", "nominal", promises)
    assert row.kept_rest >= 0.99  # measured 0.997
    assert row.announced < 0.06  # measured 0.040
    assert row.kept >= 0.97  # measured 0.976
    assert row.kept + row.stopped >= 0.985  # measured 0.993
    assert row.kept_clear >= 0.99  # measured 1.0
    assert row.refused < 0.08
