"""Messages from the page: bounded queue, precedence of `Stop`, errors for invalid values."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

import pliant
from pliant import ConfigError
from pliant.view import messages

MODEL = pliant.robots.so101()


def pose(*position):
    out = np.eye(4)
    out[:3, 3] = position
    return out


def flood(seed, count=2000):
    """Return messages of every kind in random order, as if several tabs sent too many."""
    draw = random.Random(seed)
    makers = (
        lambda i: messages.Target(pose(0.2, 0.0, 1e-4 * i)),
        lambda i: messages.Push((float(i), 0.0, 0.0)),
        lambda i: messages.Grab(2, (0.0, 0.0, 0.0), (float(i), 0.0, 0.0)),
        lambda i: messages.Grab(2, None, (float(i), 0.0, 0.0)),
        lambda i: messages.LetGo(),
        lambda i: messages.Preset(i, "firm"),
        lambda i: messages.Law(i, draw.choice(("cap", "paper"))),
        lambda i: messages.Change(i, draw.choice("xyz"), {draw.choice(("soft", "hold")): i}),
        lambda i: messages.Change(i, f"axis {i}", {"hold": i}),
        lambda i: messages.Adaptation(i, 0.5),
        lambda i: messages.Firm(i, True),
        lambda i: messages.Home(),
        lambda i: messages.Play(),
        lambda i: messages.Start(),
    )
    return [draw.choice(makers)(i) for i in range(count)]


@pytest.mark.parametrize("seed", range(10))
def test_flood_is_bounded_and_the_stop_comes_first(seed):
    queue = messages.Queue()
    flooded = flood(seed)
    for number, message in enumerate(flooded):
        queue.put(message)
        assert len(queue) <= messages.MAX_QUEUED
        if number == len(flooded) // 2:
            queue.put(messages.Stop())
    first = queue.take()
    assert first[0] == messages.Stop()
    rounds = [first]
    while len(queue):
        rounds.append(queue.take())
        assert rounds[-1]
    assert all(len(batch) <= messages.PER_TICK for batch in rounds)
    assert all(sum(isinstance(o, messages.Edit) for o in batch) <= 1 for batch in rounds)


@pytest.mark.parametrize("seed", range(10))
def test_last_edit_and_last_target_are_never_lost(seed):
    queue = messages.Queue()
    flooded = flood(seed)
    for message in flooded:
        queue.put(message)
    received = []
    while len(queue):
        received += queue.take()
    for kind in (messages.Edit, (messages.Target, messages.Home), messages.Play):
        assert [o for o in received if isinstance(o, kind)][-1] is [
            o for o in flooded if isinstance(o, kind)
        ][-1]


def test_edits_wait_while_they_may_not_be_taken():
    queue = messages.Queue()
    for message in (messages.Adaptation(1, 0.5), messages.Home(), messages.Firm(2, True)):
        queue.put(message)
    assert queue.take(edit=False) == [messages.Home()]
    assert queue.take() == [messages.Adaptation(1, 0.5)]
    assert queue.take() == [messages.Firm(2, True)]


def test_later_edits_replace_earlier_ones_without_changing_what_they_mean():
    soft = messages.Change(1, "y", {"soft": (1.0, 1.0)})
    eta = messages.Change(2, "y", {"yields": "both", "adaptation": 0.5})
    law, preset = messages.Law(3, "paper"), messages.Preset(4, "firm")
    cases = (
        ([soft, eta], [soft, eta]),
        ([soft, messages.Change(5, "y", {"soft": (2.0, 2.0)})], None),
        ([soft, eta, law], [eta, law]),
        ([law, soft], [law, soft]),
        ([soft, eta, law, preset], [preset]),
        ([preset, soft], [preset, soft]),
        ([messages.Grab(2, (0, 0, 0), (1, 0, 0)), messages.Grab(2, None, (2, 0, 0))], ...),
    )
    for edits, expected in cases:
        queue = messages.Queue()
        for message in edits:
            queue.put(message)
        received = []
        while len(queue):
            received += queue.take()
        assert received == (
            edits[-1:] if expected is None else edits if expected is ... else expected
        )


INVALID_NUMBERS = (math.nan, math.inf, -math.inf, 1e300, 150.0, 100.1, 1.0)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("value", [*INVALID_NUMBERS, -1.0])
def test_target_out_of_reach_is_refused(axis, value):
    position = [0.2, 0.0, 0.1]
    position[axis] = value
    with pytest.raises(ConfigError, match=r"the arm reaches 0\.\d+ m|not finite|e\+300 m"):
        messages.check_target(messages.Target(pose(*position)), MODEL)


@pytest.mark.parametrize(
    "matrix",
    [np.eye(3), np.zeros((4, 4)), 2.0 * np.eye(4), np.diag((1.0, 1.0, -1.0, 1.0)), "there", None],
)
def test_target_that_is_not_a_pose_is_refused(matrix):
    with pytest.raises(ConfigError, match="target"):
        messages.check_target(messages.Target(matrix), MODEL)


def test_target_in_reach_is_taken():
    np.testing.assert_array_equal(
        messages.check_target(messages.Target(pose(0.2, 0.1, 0.1)), MODEL), pose(0.2, 0.1, 0.1)
    )


@pytest.mark.parametrize("value", INVALID_NUMBERS)
def test_pushes_and_hands_are_bounded(value):
    max_push = (0.9, 0.5)
    for message in (
        messages.Push((0.0, value, 0.0)),
        messages.Push((0.0, 0.0, 0.0), (value, 0.0, 0.0)),
        messages.Push((0.1, 0.0, 0.0), seconds=value if value != 1.0 else 0.0),
    ):
        with pytest.raises(ConfigError, match="push: "):
            messages.check_push(message, max_push)
    for position in ((150.0 if value == 1.0 else value, 0.0, 0.0), (0.0, 0.0)):
        with pytest.raises(ConfigError, match="hand: "):
            messages.check_grab(messages.Grab(1, None, position))
    messages.check_push(messages.Push((0.9, -0.9, 0.0), (0.5, 0.0, 0.0), 2.0), max_push)
