"""Orders of a page: bounded queue, precedence, rejections."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

import pliant
from pliant import ConfigError
from pliant.view import checks, orders

MODEL = pliant.robots.so101()


def pose(*place):
    out = np.eye(4)
    out[:3, 3] = place
    return out


def flood(seed, count=2000):
    """Return orders of every kind in random order, as from several flooding tabs."""
    draw = random.Random(seed)
    makers = (
        lambda i: orders.Target(pose(0.2, 0.0, 1e-4 * i)),
        lambda i: orders.Push((float(i), 0.0, 0.0)),
        lambda i: orders.Grab(2, (0.0, 0.0, 0.0), (float(i), 0.0, 0.0)),
        lambda i: orders.Grab(2, None, (float(i), 0.0, 0.0)),
        lambda i: orders.LetGo(),
        lambda i: orders.Preset(i, "firm"),
        lambda i: orders.Law(i, draw.choice(("cap", "paper"))),
        lambda i: orders.Change(i, draw.choice("xyz"), {draw.choice(("soft", "hold")): i}),
        lambda i: orders.Change(i, f"axis {i}", {"hold": i}),
        lambda i: orders.Eta(i, 0.5),
        lambda i: orders.Firm(i, True),
        lambda i: orders.Home(),
        lambda i: orders.Play(),
        lambda i: orders.Start(),
    )
    return [draw.choice(makers)(i) for i in range(count)]


@pytest.mark.parametrize("seed", range(10))
def test_flood_is_bounded_and_the_stop_comes_first(seed):
    queue = orders.Queue()
    sent = flood(seed)
    for number, order in enumerate(sent):
        queue.put(order)
        assert len(queue) <= orders.MOST
        if number == len(sent) // 2:
            queue.put(orders.Stop())
    first = queue.take()
    assert first[0] == orders.Stop()
    rounds = [first]
    while len(queue):
        rounds.append(queue.take())
        assert rounds[-1]
    assert all(len(taken) <= orders.PER_TICK for taken in rounds)
    assert all(sum(isinstance(o, orders.Edit) for o in taken) <= 1 for taken in rounds)


@pytest.mark.parametrize("seed", range(10))
def test_last_edit_and_last_target_are_never_lost(seed):
    queue = orders.Queue()
    sent = flood(seed)
    for order in sent:
        queue.put(order)
    taken = []
    while len(queue):
        taken += queue.take()
    for kind in (orders.Edit, (orders.Target, orders.Home), orders.Play):
        assert [o for o in taken if isinstance(o, kind)][-1] is [
            o for o in sent if isinstance(o, kind)
        ][-1]


def test_edits_wait_while_they_may_not_be_taken():
    queue = orders.Queue()
    for order in (orders.Eta(1, 0.5), orders.Home(), orders.Firm(2, True)):
        queue.put(order)
    assert queue.take(edit=False) == [orders.Home()]
    assert queue.take() == [orders.Eta(1, 0.5)]
    assert queue.take() == [orders.Firm(2, True)]


def test_later_edits_replace_earlier_ones_without_changing_what_they_mean():
    soft = orders.Change(1, "y", {"soft": (1.0, 1.0)})
    eta = orders.Change(2, "y", {"yields": "both", "adaptation": 0.5})
    law, preset = orders.Law(3, "paper"), orders.Preset(4, "firm")
    cases = (
        ([soft, eta], [soft, eta]),
        ([soft, orders.Change(5, "y", {"soft": (2.0, 2.0)})], None),
        ([soft, eta, law], [eta, law]),
        ([law, soft], [law, soft]),
        ([soft, eta, law, preset], [preset]),
        ([preset, soft], [preset, soft]),
        ([orders.Grab(2, (0, 0, 0), (1, 0, 0)), orders.Grab(2, None, (2, 0, 0))], ...),
    )
    for put, left in cases:
        queue = orders.Queue()
        for order in put:
            queue.put(order)
        taken = []
        while len(queue):
            taken += queue.take()
        assert taken == (put[-1:] if left is None else put if left is ... else left)


BAD = (math.nan, math.inf, -math.inf, 1e300, 150.0, 100.1, 1.0)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("far", [*BAD, -1.0])
def test_target_out_of_reach_is_refused(axis, far):
    place = [0.2, 0.0, 0.1]
    place[axis] = far
    with pytest.raises(ConfigError, match=r"the arm reaches 0\.\d+ m|not finite|e\+300 m"):
        checks.target(orders.Target(pose(*place)), MODEL)


@pytest.mark.parametrize(
    "wrong",
    [np.eye(3), np.zeros((4, 4)), 2.0 * np.eye(4), np.diag((1.0, 1.0, -1.0, 1.0)), "there", None],
)
def test_target_that_is_no_pose_is_refused(wrong):
    with pytest.raises(ConfigError, match="target"):
        checks.target(orders.Target(wrong), MODEL)


def test_target_in_reach_is_taken():
    np.testing.assert_array_equal(
        checks.target(orders.Target(pose(0.2, 0.1, 0.1)), MODEL), pose(0.2, 0.1, 0.1)
    )


@pytest.mark.parametrize("bad", BAD)
def test_pushes_and_hands_are_bounded(bad):
    strong = (0.9, 0.5)
    for order in (
        orders.Push((0.0, bad, 0.0)),
        orders.Push((0.0, 0.0, 0.0), (bad, 0.0, 0.0)),
        orders.Push((0.1, 0.0, 0.0), seconds=bad if bad != 1.0 else 0.0),
    ):
        with pytest.raises(ConfigError, match="push: "):
            checks.push(order, strong)
    for place in ((150.0 if bad == 1.0 else bad, 0.0, 0.0), (0.0, 0.0)):
        with pytest.raises(ConfigError, match="hand: "):
            checks.grab(orders.Grab(1, None, place))
    checks.push(orders.Push((0.9, -0.9, 0.0), (0.5, 0.0, 0.0), 2.0), strong)
