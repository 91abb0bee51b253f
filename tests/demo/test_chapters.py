"""Chapters of the demo: measured numbers are finite and determine the verdicts."""

import copy
import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from experiments import demonstration
from experiments.chapters import generic_arm
from experiments.chapters.common import Options
from experiments.report import Verdict
from pliant import ConfigError
from pliant.sim.postures import task_axes


@pytest.fixture
def measured(quick_demo):
    """Return a function that returns a copy of a chapter's numbers in the quick demo."""

    def numbers(number):
        saved = copy.deepcopy(quick_demo[2]["experiments"][str(number)]["numbers"])
        saved.pop("back_below", None)  # a bound, which the second chapter saves too
        return saved

    return numbers


def statement(chapter, beginning):
    matches = [s for s in chapter.statements() if s.claim.startswith(beginning)]
    assert len(matches) == 1, [s.claim for s in chapter.statements()]
    return matches[0]


@pytest.mark.parametrize("number", demonstration.EXPERIMENTS)
def test_quick_numbers_carry_every_statement(number, measured):
    chapter = demonstration.EXPERIMENTS[number].chapter(measured(number))
    assert chapter.number == number
    assert chapter.statements()
    assert chapter.headline
    for s in chapter.statements():
        assert s.checks, s.claim
        assert all(math.isfinite(test.value) for test in s.checks), s
        assert s.outcome.endswith("."), s.outcome
        assert "nan" not in s.outcome
        assert s.verdict is not Verdict.DISAGREES, s


@pytest.mark.parametrize("number", demonstration.EXPERIMENTS)
def test_full_runs_have_names_of_their_own(number):
    module = demonstration.EXPERIMENTS[number]
    full, quick = (
        [job.key for job in module.jobs(Options(quick=q, figures=Path("unused")))]
        for q in (False, True)
    )
    assert len(set(full)) == len(full)
    assert set(quick) <= set(full)


def put(numbers, path, value):
    *parents, last = path
    for key in parents:
        numbers = numbers[key]
    assert last in numbers
    numbers[last] = value


FLIPS = [
    (2, "Law cap, η = 0.999", ("y", "cap", "0.999", "toward +", "force"), 50.0),
    (2, "Law cap, η = 0.999", ("y", "cap", "0.999", "toward +", "crept"), 0.2),
    (2, "η = 0: the tool gives way", ("y", "paper", "0", "toward +", "moved"), 0.3),
    (2, "η = 0.999: the tool follows", ("y", "paper", "0.999", "toward +", "moved"), 0.05),
    (3, "y: follows very well", ("y", "paper", "share"), 0.5),
    (3, "Far forward, z is lost", ("x", "literal", "sunk"), 0.001),
    (3, "Compliance in x drops", ("x", "literal", "least_c"), 1.0),
    (4, "Compliant in lateral", ("opening", "door", "rigid", "cap", "angle"), 10.0),
    (4, "Compliant in lateral", ("opening", "door", "rigid", "stiff", "angle"), 66.0),
    (4, "Against all axes stiff", ("opening", "door", "rigid", "cap", "force"), 80.0),
    (4, "The end of both", ("opening_and_closing", "door", "rigid", "cap", "ends"), [45.0]),
    (5, "A position-controlled", ("cap 0.999", "force"), 30.0),
    (5, "Law cap keeps", ("cap 0", "held"), 30.0),
    (6, "With no joint near", ("arm7", "kept_clear"), 0.9),
    (6, "Forces outside", ("arm7", "kept"), 0.5),
]


@pytest.mark.parametrize(("number", "claim", "path", "value"), FLIPS)
def test_a_wrong_number_flips_its_verdict(number, claim, path, value, measured):
    module, numbers = demonstration.EXPERIMENTS[number], measured(number)
    before = statement(module.chapter(copy.deepcopy(numbers)), claim)
    put(numbers, path, value)
    after = statement(module.chapter(numbers), claim)
    assert before.verdict is Verdict.AGREES
    assert after.verdict is not Verdict.AGREES
    assert after.outcome != before.outcome


def test_a_wrong_matrix_flips_the_verdicts_of_the_first_chapter(measured):
    module, numbers = demonstration.EXPERIMENTS[1], measured(1)
    share = np.array(numbers["activation"]["vertical"])
    numbers["activation"]["vertical"] = np.roll(share, 1, axis=0).tolist()
    numbers["largest_difference"]["vertical"] = 0.2
    chapter = module.chapter(numbers)
    assert statement(chapter, "In both poses").verdict is Verdict.DISAGREES
    assert statement(chapter, "An independent").verdict is Verdict.DISAGREES


def test_reasons_follow_the_numbers(measured):
    module, numbers = demonstration.EXPERIMENTS[2], measured(2)
    claim = "Let go, the tool moves back"
    assert statement(module.chapter(numbers), claim).verdict is Verdict.DIFFERS
    for eta in ("0", "0.9"):
        for entry in numbers["y"]["paper"][eta].values():
            entry.update(left=0.001, return_speed=0.05, returned=2.0)
    assert statement(module.chapter(numbers), claim).verdict is Verdict.AGREES


def test_an_experiment_that_does_not_exist_is_named_with_those_that_do():
    with pytest.raises(ConfigError, match=r"no experiment 9; choose from 1 \(Share of each joint"):
        demonstration.choose(demonstration.EXPERIMENTS, (1, 9))
    assert list(demonstration.choose(demonstration.EXPERIMENTS, (5, 2))) == [2, 5]
    assert list(demonstration.choose(demonstration.EXPERIMENTS, ())) == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("joints", "axes"),
    [(7, "x y z roll pitch yaw"), (6, "x y z roll pitch yaw"), (5, "x y z"), (4, "x z pitch")],
)
def test_task_axes_follow_the_number_of_joints(joints, axes):
    assert " ".join(task_axes(joints)) == axes


def test_the_pose_of_an_arm_is_inside_its_limits_and_can_hold_itself():
    arm = generic_arm.load(generic_arm.Source(name="so101"))
    assert np.all(arm.pose > arm.model.lower)
    assert np.all(arm.pose < arm.model.upper)
    assert np.all(np.abs(arm.model.gravity(arm.pose)) < arm.servos.max_torque)
    assert arm.way > 0.0
