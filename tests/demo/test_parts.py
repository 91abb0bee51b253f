"""Parts of the demo: verdicts, jobs, return times, and pictures of the report."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.chapters import common
from experiments.report import Check, Statement, Verdict, at_least, at_most, between, mm, near
from experiments.runner import Job, run_by_key
from pliant._report import listed


def test_a_check_includes_its_bounds_and_fails_for_non_finite_numbers():
    assert Check(name="a", value=1.0, low=1.0, high=1.0).passed
    assert not at_most("a", 1.1, 1.0).passed
    assert not at_least("a", 0.9, 1.0).passed
    assert between("a", 0.5, 0.0, 1.0).passed
    assert near("a", 1.2, 1.0, rel=0.1, plus=0.1).passed
    assert not near("a", 1.21, 1.0, rel=0.1, plus=0.1).passed
    for value in (math.nan, math.inf, -math.inf):
        assert not Check(name="a", value=value).passed


def test_the_verdict_is_that_of_the_worst_test():
    passed, failed = at_most("a", 1.0, 2.0), at_most("b", 3.0, 2.0)
    texts = {"claim": "It does.", "outcome": "It did."}
    assert Statement(**texts, checks=(passed,)).verdict is Verdict.AGREES
    assert Statement(**texts, checks=(passed,), because="never shown").verdict is Verdict.AGREES
    assert Statement(**texts, checks=(passed, failed)).verdict is Verdict.DISAGREES
    assert Statement(**texts, checks=(passed, failed), because="gravity").verdict is Verdict.DIFFERS
    assert Statement(**texts, checks=()).verdict is Verdict.DISAGREES


@pytest.mark.parametrize(
    ("length", "text"),
    [(0.25, "250 mm"), (0.00234, "2.3 mm"), (0.00003, "0.03 mm"), (0.0, "0.00 mm")],
)
def test_lengths_get_the_digits_they_deserve(length, text):
    assert mm(length) == text


def test_lists_read_well():
    assert listed([]) == ""
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"


@pytest.mark.parametrize("count", [1, 2])
def test_outcomes_keep_the_order_of_the_jobs(count):
    records = []
    jobs = [Job(str(k), pow, (k, 2)) for k in range(6)]
    outcomes = run_by_key(jobs, count, progress=records.append)
    assert list(outcomes.items()) == [(str(k), k * k) for k in range(6)]
    assert sorted(records) == sorted(outcomes)


@pytest.mark.parametrize("count", [1, 2])
def test_the_error_of_a_job_is_raised(count):
    with pytest.raises(ZeroDivisionError):
        run_by_key([Job("good", pow, (2, 2)), Job("bad", divmod, (1, 0))], count)


def test_two_jobs_with_one_name_are_refused():
    jobs = [Job("a", pow, (2, 2)), Job("a", pow, (2, 3))]
    with pytest.raises(ValueError, match="twice: a"):
        run_by_key(jobs, 1)


def trace(y):
    """Return a trace at 10 Hz in which only y moves."""
    t = 0.1 * np.arange(1, y.size + 1)
    error = np.zeros((y.size, 6))
    error[:, 1] = -y
    return SimpleNamespace(t=t, error=error, moved=-error)


def test_return_time_counts_from_the_release_to_the_last_time_away():
    y = np.where(np.arange(1, 101) <= 50, 0.1, 0.0)
    assert common.return_time(trace(y), 1) == 0.0
    y[50:57] = 0.1
    assert common.return_time(trace(y), 1) == pytest.approx(0.8)
    y[69] = 0.02
    assert common.return_time(trace(y), 1) == pytest.approx(2.1)
    assert common.return_time(trace(np.full(100, 0.1)), 1) is None


def test_return_speed_is_that_after_the_release():
    y = np.concatenate((np.zeros(45), np.full(8, 0.1), np.full(47, 0.05)))
    assert common.return_speed(trace(y), 1) == pytest.approx(0.5)
