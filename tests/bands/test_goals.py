"""Table of the experiments' goals: each row has settings, a bound and a measured value."""

import dataclasses

import numpy as np
from mismatch import under

import pliant
from experiments import controllers, goals
from pliant.sim import DRAG_15N

#: Settings of the tested law.
GAIN = {"tracking": pliant.Tracking(gain=4.8)}


def test_table_measures_and_judges():
    rows = goals.table("hold the grasp pose")
    assert [row.figure for row in rows] == ["error [mm]"]
    assert rows[0].met
    assert not dataclasses.replace(rows[0], reached=0.6).met
    assert not dataclasses.replace(rows[0], reached_uncertain=np.nan).met
    printed = goals.text(rows).splitlines()
    assert len(printed) == 3
    assert printed[-1].endswith("| yes |")


def test_a_stiffer_hold_keeps_the_drift_with_overestimated_friction():
    rows = [
        row for row in goals.table("15 N hand, η 0.999") if row.preset == "cap(tracking.gain=4.8)"
    ]
    assert [row.figure for row in rows] == ["force [N]", "drift [mm]"]
    assert all(row.met for row in rows)  # measured 7.36 N of 7.5, 3.33 mm of 4.0
    (too_high,) = (condition for condition in goals.UNCERTAIN if condition.assumed_ratio > 1.0)
    with under(too_high):
        stiffer, default = (
            goals.measure_drag(controllers.cap(**options), DRAG_15N)(too_high)["drift [mm]"]
            for options in (GAIN, {})
        )
    assert stiffer == rows[1].reached_uncertain
    assert default > 4.0


def test_drag_and_door_run_at_every_rate_delay_and_assumption():
    conditions = goals.rate_conditions()
    assert len(conditions) == 12
    assert (
        len(
            {(condition.rate, condition.delay, condition.assumed_ratio) for condition in conditions}
        )
        == 12
    )
    lines = goals.rates_text("nothing of this name").splitlines()
    assert len(lines) == 2
    assert lines[0].count("|") == lines[1].count("|")


def test_goals_print_as_people_write_them():
    bounds = [
        goals.Goal(high=4.5),
        goals.Goal(low=67.0),
        goals.Goal(low=14.0, high=16.0),
        goals.Goal(),
    ]
    assert [str(goal) for goal in bounds] == ["≤ 4.5", "≥ 67", "14…16", "report"]


def test_presets_are_those_of_the_module():
    assert controllers.cap_tracking(soft="pitch") != controllers.cap(soft="pitch", eta=0.0)
    assert controllers.cap_tracking(soft="y") == controllers.cap(soft="y", eta=0.0)
