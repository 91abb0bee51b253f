"""Conditions, actions and `ReactionMonitor`, tested tick by tick."""

import numpy as np
import pytest

import pliant
from experiments.poses import arm
from pliant import reactions as rx
from pliant.sim.postures import VERTICAL

TARGET = arm().forward_kinematics(VERTICAL)


class FakeWrench:
    """Stand-in for a `WrenchEstimate` with a given force."""

    def __init__(self, force=(0.0,) * 6, bound=(1.0,) * 6, evidence=0.0):
        self.force, self.uncertainty = np.array(force), np.array(bound)
        self.force_base, self.residual_ratio = self.force, evidence
        self.touch = self.stop = np.zeros(6, dtype=bool)
        self.saturated, self.velocity = np.zeros(7, dtype=bool), np.zeros(7)


def controller():
    ctl = pliant.Controller(arm(), pliant.Settings.soft("y"))
    ctl.reset(VERTICAL)
    return ctl


def moment(wrench=None, **extra):
    fields = {
        "controller": controller(),
        "time": 0.0,
        "dt": 0.01,
        "q": VERTICAL,
        "tool": TARGET,
        "target": TARGET,
        "wrench": wrench or FakeWrench(),
    }
    return rx.TickContext(**{**fields, **extra})


def push(z):
    return moment(FakeWrench((0.0, 0.0, z, 0.0, 0.0, 0.0)))


def test_force_counts_beyond_threshold_and_uncertainty():
    judge = rx.Force("z", above=8.0).evaluator()
    assert judge(push(-9.0))
    assert not judge(push(7.0))
    assert not judge(moment(FakeWrench((0, 0, 9.0, 0, 0, 0), bound=(10.0,) * 6)))
    assert rx.Force("z", above=8.0, accept_thresholds=True).evaluator()(
        moment(FakeWrench((0, 0, 9.0, 0, 0, 0), bound=(10.0,) * 6))
    )
    assert not rx.Force("z", above=8.0, toward="+").evaluator()(push(-9.0))
    assert rx.Force("xyz", below=2.0).evaluator()(push(1.0))


def test_conditions_join_and_print():
    first, second = rx.Force("z", above=8.0).for_seconds(0.05), ~rx.Deviation("xy", above=0.02)
    assert repr(first & second) == (
        "(Force('z', above=8).for_seconds(0.05) & ~Deviation('xy', above=0.02))"
    )
    assert eval(repr(first | second), vars(rx)) == (first | second)
    for condition in (rx.Saturated(), rx.Saturated(("elbow",)), rx.ContactEvent("z", "stop")):
        assert eval(repr(condition), vars(rx)) == condition
    assert (rx.After(0.0) | rx.ResidualAbove()).evaluator()(push(0.0))
    with pytest.raises(TypeError, match="join conditions with &"):
        _ = first and second


def test_lasting_needs_its_time_without_a_break():
    judge = rx.Force("z", above=8.0).for_seconds(0.02).evaluator()
    assert [judge(push(z)) for z in (9, 9, 0, 9, 9, 9, 9)] == [False] * 5 + [True] * 2


def test_one_condition_serves_two_reactions():
    lasting = rx.Force("z", above=8.0).for_seconds(0.02)
    first, second = lasting.evaluator(), lasting.evaluator()
    assert [first(push(9.0)) or second(push(9.0)) for _ in range(2)] == [False, False]


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: rx.Force("z"), "either above or below"),
        (lambda: rx.Force("w", above=1.0), "'w' is not an axis"),
        (lambda: rx.Force("z", above=1.0, toward="up"), "toward"),
        (lambda: rx.ResidualAbove(above=-1.0), r"ResidualAbove\.above"),
        (lambda: rx.Retract(0.0), r"Retract\.distance"),
        (lambda: rx.Follow("x", float("nan")), r"Follow\.max_deviation"),
        (
            lambda: rx.ResidualAbove(above="1"),
            r"ResidualAbove\.above must be a number, got '1' \(str\)",
        ),
        (lambda: rx.After(float("nan")), r"After\.seconds"),
        (lambda: rx.Saturated("elbow_pitch"), r"must be names, as in \('elbow_pitch',\)"),
        (lambda: rx.Yield("z", {"sofft": 1.0}), "did you mean 'soft'"),
        (lambda: rx.Call(None), "function of a TickContext, got None"),
        (lambda: rx.ResidualAbove() & 3, "what follows & must be a condition, as .* got 3"),
        (lambda: rx.Reaction(3, rx.Hold()), r"Reaction\.when must be a condition"),
        (lambda: rx.Reaction(rx.ResidualAbove(), ()), r"an action, as Hold\(\)"),
        (lambda: rx.ReactionMonitor("arm7", []), "controller must be a Controller, got 'arm7'"),
        (lambda: rx.Reaction(rx.ResidualAbove(), rx.Stop(), until=rx.After(1.0)), "resume"),
    ],
)
def test_invalid_values_are_refused(make, text):
    with pytest.raises((pliant.PliantError, TypeError), match=text):
        make()


def test_conditions_and_actions_that_the_arm_lacks_are_refused():
    ctl = controller()
    with pytest.raises(pliant.OutOfRangeError, match="cannot tell a contact from friction"):
        rx.ReactionMonitor(ctl, [rx.Reaction(rx.Force("z", above=1.0), rx.Hold())])
    with pytest.raises(pliant.ConfigError, match="no joint elbow"):
        rx.ReactionMonitor(ctl, [rx.Reaction(rx.Saturated(("elbow",)), rx.Hold())])
    with pytest.raises(pliant.PliantError, match="soft"):
        rx.ReactionMonitor(ctl, [rx.Reaction(rx.ResidualAbove(), rx.Yield("z", {"soft": -1.0}))])
    controller_xyz = pliant.Controller(arm(), pliant.Settings(task="xyz"))
    with pytest.raises(pliant.ConfigError, match="axes yaw are not of this task"):
        rx.ReactionMonitor(controller_xyz, [rx.Reaction(rx.Deviation("yaw", above=0.1), rx.Hold())])


def run_monitor(action, condition=None, **extra):
    """Return a monitor with one reaction; by default its condition is true from 0.1 to 0.3 s."""
    if condition is None:
        condition = rx.After(0.1) & ~rx.After(0.3)
    return rx.ReactionMonitor(controller(), [rx.Reaction(condition, action, **extra)])


def targets(watch, ticks, expected=TARGET):
    out = []
    for _ in range(ticks):
        out.append(watch.update(VERTICAL, expected))
        watch.controller.step(VERTICAL, out[-1])
    return out


def away(x):
    pose = TARGET.copy()
    pose[0, 3] += x
    return pose


def test_hold_freezes_the_target_and_gives_it_back_slowly():
    watch, expected = run_monitor(rx.Hold(), clear=0.2), away(0.05)
    sent_targets = targets(watch, 150, expected)
    assert sent_targets[5] is expected
    np.testing.assert_array_equal(sent_targets[15], TARGET)
    assert [line.what for line in watch.log] == ["began", "ended"]
    assert watch.log[1].time == pytest.approx(0.50, abs=0.011)
    back = np.diff([pose[0, 3] for pose in sent_targets[52:100]])
    assert back.max() <= 0.1 * 0.01 + 1e-12
    assert back.min() >= 0.0
    assert sent_targets[-1] is expected


def test_stop_stays_until_it_is_resumed():
    watch, expected = run_monitor(rx.Stop()), away(0.05)
    targets(watch, 100, expected)
    assert watch.stopped
    watch.resume()
    targets(watch, 1, expected)
    assert not watch.stopped
    assert watch.resuming


def test_retract_leaves_along_its_direction_and_stays():
    watch = run_monitor(rx.Retract(0.04, speed=0.2, along=(0.0, 0.0, 2.0)))
    sent_targets = targets(watch, 60)
    assert np.diff([pose[2, 3] for pose in sent_targets]).max() <= 0.2 * 0.01 + 1e-12
    assert sent_targets[-1][2, 3] - TARGET[2, 3] == pytest.approx(0.04)
    np.testing.assert_array_equal(sent_targets[-1][:3, :3], TARGET[:3, :3])


def test_follow_keeps_the_target_on_a_leash():
    condition = rx.After(0.05)
    watch = run_monitor(rx.Follow("x", 0.02), condition)
    sent_targets = targets(watch, 20, away(0.1))
    assert sent_targets[-1][0, 3] - TARGET[0, 3] == pytest.approx(0.02)
    targets(watch, 2, away(0.01))
    assert watch.active is None


def test_yield_changes_settings_and_restores_them():
    watch = run_monitor(rx.Yield("z", {"soft": 2.0}), clear=0.1)
    before = watch.controller.settings
    targets(watch, 20)
    assert watch.controller.settings.axes["z"].soft == (2.0, 2.0)
    targets(watch, 50)
    assert watch.controller.settings == before


def test_calls_come_once_and_the_first_reaction_matters_most():
    moments = []
    watch = rx.ReactionMonitor(
        controller(),
        [
            rx.Reaction(rx.After(0.2), rx.Stop()),
            rx.Reaction(rx.After(0.1), rx.Hold()),
            rx.Reaction(rx.After(0.1), rx.Call(moments.append)),
        ],
    )
    targets(watch, 15)
    assert not watch.stopped
    assert watch.active is watch.reactions[1]
    targets(watch, 15)
    assert watch.stopped
    assert [entry.time for entry in moments] == pytest.approx([0.1])
    watch.reset()
    assert watch.active is None
    assert len(watch.log) == 0


def test_an_action_that_raises_undoes_those_before_it():
    watch = rx.ReactionMonitor(
        controller(),
        [
            rx.Reaction(rx.After(0.3), [rx.Yield("z", {"soft": 2.0}), rx.Call(lambda _: 1 / 0)]),
            rx.Reaction(rx.After(0.1), rx.Hold()),
        ],
    )
    before, expected = watch.controller.settings, away(0.05)
    targets(watch, 30, expected)
    assert watch.active is watch.reactions[1]
    with pytest.raises(ZeroDivisionError):
        watch.update(VERTICAL, expected)
    assert watch.controller.settings == before
    # The reaction that was in force has ended, and the target returns without a jump.
    assert watch.active is None
    sent_targets = targets(watch, 60, expected)
    back = np.diff([TARGET[0, 3], *(pose[0, 3] for pose in sent_targets)])
    assert back.max() <= 0.1 * 0.01 + 1e-12
    assert sent_targets[-1] is expected


def test_a_position_as_target_is_given_back_as_soon_as_a_pose():
    q = np.array(VERTICAL) + 0.3  # the tool is turned
    ctl = pliant.Controller(arm(), pliant.Settings(task="xyz"))
    ctl.reset(q)
    pose, is_back = arm().forward_kinematics(q), []
    pose[0, 3] += 0.02
    watch = rx.ReactionMonitor(ctl, [rx.Reaction(rx.After(0.1) & ~rx.After(0.2), rx.Hold())])
    for target in (pose, pose[:3, 3]):
        watch.reset()
        is_back.append([watch.update(q, target) is target for _ in range(120)])
    assert True in is_back[0][60:]
    assert is_back[0] == is_back[1]


def test_bad_readings_change_nothing():
    watch = run_monitor(rx.Hold(), rx.ResidualAbove())
    targets(watch, 5)
    wrench = watch.wrench
    for invalid_q in (np.full(7, np.nan), np.zeros(3)):
        with pytest.raises(pliant.PliantError):
            watch.update(invalid_q, TARGET)
    with pytest.raises(pliant.PliantError):
        watch.update(VERTICAL, np.full((4, 4), np.nan))
    assert watch.wrench == wrench


def test_names_at_the_top():
    assert pliant.ReactionMonitor is rx.ReactionMonitor
    assert pliant.Reaction is rx.Reaction
