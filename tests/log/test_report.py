"""`pliant log report`: the HTML page describes the run and is self-contained."""

import re
from html import unescape

import numpy as np
import pytest
from bare_arm import bare_arm
from demo.test_report import check_page

import pliant
import pliant.sim
from pliant.cli import main
from pliant.log import Recorder, findings, read
from pliant.log import forces as force_estimates

pytest.importorskip("mcap_ros2")
pytest.importorskip("matplotlib")

START = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]
#: Sideways pull of the hand: start and end [s], and distance [m].
PULL_START, PULL_END, PULL_DISTANCE = 0.5, 2.5, 0.15


def record(path, settings, duration=3.0, **options):
    """Record a run in which a hand pulls the tool toward +y; return its force (N, 3) [N]."""
    course = pliant.sim.ForceProfile(start=PULL_START, rise=0.5, end=PULL_END)
    hand = pliant.sim.Drag(
        axis="y", distance=PULL_DISTANCE, stiffness=3000.0, limit=80.0, at="tool", course=course
    )
    forces = []
    with bare_arm("arm7", q=START, scene=[hand]) as arm:
        controller = (
            None if settings is None else pliant.Controller(arm.model, settings, arm.servos)
        )
        pose = arm.model.forward_kinematics(arm.read().q)
        recorder = Recorder(path, **options)
        for tick in pliant.Loop(arm, controller, duration=duration, recorder=recorder):
            if controller is None:
                tick.skip()
            else:
                tick.step(pose)
            forces.append(arm.drive.plant.hands[0].force.copy())
    return read(path), np.array(forces)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "pull.mcap"
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})
    return (path, *record(path, settings))


def test_the_force_of_the_hand_is_found_in_the_log(run):
    _, log, forces = run
    estimates = force_estimates.estimate_forces(log)
    is_settled = (findings.elapsed_time(log) > 1.8) & (findings.elapsed_time(log) < PULL_END - 0.6)
    error = np.abs(estimates.force[is_settled, 1] - forces[is_settled, 1])
    assert is_settled.sum() > 5
    assert (error <= estimates.bound[is_settled, 1]).all()
    assert forces[is_settled, 1].min() > 10.0
    assert findings.exceeded_share(log, estimates, 1) == 0.0
    assert estimates.strengths["y"].firm == (15.0, 15.0)


def test_a_sentence_names_the_cap_of_a_firm_axis(run):
    log = read(run[0])
    sentence = findings.sentence(log, force_estimates.estimate_forces(log), 1)
    assert re.search("y: .* firm: .* the cap was 15 N", sentence)


def test_forces_do_not_depend_on_where_the_loop_started_anew(run):
    _, log, _ = run
    priming_steps = force_estimates._priming_steps(log)
    assert len(priming_steps) == 1
    steps = [call for call in log.calls if call.what == "step"]
    assert len(steps) - len(priming_steps) == len(log)


@pytest.mark.parametrize(("arm", "rate"), [("arm7", 10.0), ("so101", 100.0), ("koch", 10.0)])
def test_forces_are_shown_where_a_loop_starts_with_several_steps(tmp_path, arm, rate):
    """With an unknown stiffness, a loop repeats its step before the first tick."""
    path, settings = tmp_path / "run.mcap", pliant.Settings(task="xyz", rate=rate)
    # In this pose so101 needs more than the lead of one such step.
    options = {"q": [0.0, 0.5, -0.5, 0.0, 0.0]} if arm == "so101" else {}
    with pliant.connect(arm, backend="sim", rate=rate, **options) as live:
        controller = pliant.Controller(live.model, settings, live.servos)
        pose = live.model.forward_kinematics(live.read().q)
        for tick in pliant.Loop(live, controller, duration=1.0, recorder=Recorder(path)):
            tick.step(pose)
    log = read(path)
    priming_steps = force_estimates._priming_steps(log)
    assert len(priming_steps) > 1 or arm == "arm7"
    assert sum(call.what == "step" for call in log.calls) - len(priming_steps) == len(log) > 5
    assert np.isfinite(force_estimates.estimate_forces(log).force).all()


def test_forces_are_not_shown_where_a_tick_has_two_steps(tmp_path):
    path = tmp_path / "run.mcap"
    with pliant.connect("so101", backend="sim") as live:
        controller = pliant.Controller(live.model, pliant.Settings(task="xyz"), live.servos)
        pose = live.model.forward_kinematics(live.read().q)
        loop = pliant.Loop(live, controller, duration=0.2, recorder=Recorder(path))
        for tick in loop:
            loop.controller.step(tick.q, pose, dt=tick.dt)
            tick.step(pose)
    assert force_estimates.estimate_forces(read(path)) is None


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (
            {"y": pliant.Axis(soft=4.0, firm=15.0, soft_until=0.3, firm_from=0.5)},
            "y: .* soft: .* 4 N",
        ),
        ({"y": pliant.Axis(soft=4.0, firm=15.0, firm_from=0.25)}, r"y: .*\(compliance 0\.[3-6]"),
        ({"y": pliant.Axis(soft=4.0, yields="-")}, "y: .* it yields toward - only"),
        ({}, r"y: .* it holds with up to 40 N.*; no torque was left in"),
    ],
)
def test_sentences_name_the_reason(tmp_path, settings, says):
    log, _ = record(tmp_path / "run.mcap", pliant.Settings(axes=settings), duration=1.6)
    assert re.search(says, findings.sentence(log, force_estimates.estimate_forces(log), 1))


def test_time_spans_are_those_of_the_log(tmp_path):
    log, _ = record(tmp_path / "run.mcap", pliant.Settings(), duration=2.0)
    spans = findings.spans(log)
    assert spans
    total = {name: 0.0 for name in log.run["joints"]}
    for span in spans:
        total[span.joint] += span.end - span.start
    flagged = 0.01 * (log.saturated.sum(axis=0) + log.locked.sum(axis=0))
    for name, share in zip(log.run["joints"], flagged, strict=True):
        # A span may contain gaps of up to MAX_GAP.
        assert share - 1e-9 <= total[name] <= share + findings.MAX_GAP * len(spans)


def test_health_counts_what_came_late(run):
    _, log, _ = run
    log.columns["time"] = log.time.copy()
    assert findings.health(log).late == 0
    log.columns["time"][100:] += 0.02
    of = findings.health(log)
    assert of.late == 1
    assert of.counters["lost reads"] == 0
    assert of.counters["writes"] >= len(log)


def test_command_leaves_a_page_that_needs_nothing(run, tmp_path, capsys):
    path, log, _ = run
    assert main(["log", "report", str(path), "--output", str(tmp_path / "here")]) == 0
    page = tmp_path / "here" / "report.html"
    assert capsys.readouterr().out.strip() == str(page)
    text = unescape(check_page(page)).replace("−", "-")
    for name in ("softness", "strength", "loop"):
        assert (tmp_path / "here" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    again = read(path)
    estimates = force_estimates.estimate_forces(again)
    for k in range(6):
        assert findings.sentence(again, estimates, k) in text
    assert repr(log.settings) in text


def test_a_log_without_a_controller_cannot_be_reported(tmp_path, capsys):
    path = tmp_path / "led.mcap"
    record(path, None, duration=0.2)
    assert main(["log", "report", str(path)]) == 2
    assert "without a controller" in capsys.readouterr().err
    assert not (tmp_path / "led_report").exists()


def test_a_log_of_another_version_is_reported_without_forces(run, tmp_path):
    from pliant.log.report import report

    log = read(run[0])
    log.run["pliant"] = "0.0.9"
    text = unescape(report(log, tmp_path / "old").read_text(encoding="utf-8"))
    assert "Forces are not shown: the log was made by pliant 0.0.9" in text
    assert "y: farthest off" in text
