"""`Session` without a page: scripted messages and recorded snapshots, in simulated time."""

from __future__ import annotations

import numpy as np
import pytest

from pliant import ConfigError, ServoError, ServoFaultError, robots
from pliant.sim import Tabletop
from pliant.view import messages
from pliant.view.ipc import PageGone
from pliant.view.scene_view import _floor_height
from pliant.view.session import Session
from pliant.view.source import Simulated

#: Message that ends a run without lowering the arm: the user changes the scene.
END = messages.Scene("free")


def run_session(script, robot_script, *, scene="free", robot="arm7", max_sessions=1):
    link = script(robot_script)
    session = Session(Simulated(robot, scene, paced=False), link)
    session.run(max_sessions)
    return session, link


def deviation(snapshot, info, axis):
    return float(snapshot.step.deviation[info.axes.index(axis)])


def test_the_stage_comes_first_and_describes_the_scene(script):
    _, link = run_session(script, {5: END})
    info = link.infos[0]
    assert info.arm == "arm7"
    assert info.scenes.keys() == {"free", "door", "drawer", "wall", "hand-over"}
    assert info.axes == ("x", "y", "z", "roll", "pitch", "yaw")
    assert info.max_push == (40.0, 4.0)
    assert link.snapshots[0].qpos.size == info.mj_model.nq


def test_arm_comes_down_after_stop_and_the_page_sees_it(script):
    _, link = run_session(script, {30: messages.Stop()})
    assert {s.phase for s in link.snapshots} >= {"running", "lowering"}
    # Snapshots of the descent are sent as often as the link accepts them.
    descent = [s for s in link.snapshots if s.phase == "lowering"]
    heights = [s.tool[2, 3] for s in descent]
    assert heights[-1] < heights[0] - 0.2
    assert all(s.step is None for s in descent)


@pytest.mark.parametrize("ending", [KeyboardInterrupt(), SystemExit(143)])
def test_the_page_gets_the_final_state_after_a_signal(script, ending):
    link = script({})

    def interrupt(number):
        if number == 30:
            raise ending
        return []

    link.messages = by_call_number(link, interrupt)
    session = Session(Simulated("arm7", paced=False), link)
    with pytest.raises(type(ending)):
        session.run()
    (end,) = link.ends
    assert end.is_off
    assert "was lowered: torque OFF" in end.text


def test_the_page_gets_the_torque_that_stays_on(script, monkeypatch):
    def fail(*_, **__):
        raise ServoFaultError("the bus is silent")

    monkeypatch.setattr("pliant.arm.arm.descend", fail)
    link = script({20: messages.Stop()})
    session = Session(Simulated("arm7", paced=False), link)
    session.run(1)
    (end,) = link.ends
    assert not end.is_off
    assert "was not lowered" in end.text


def test_target_moves_the_tool(script):
    link = script({})
    session = Session(Simulated("arm7", paced=False), link)
    displacements = {}

    def messages_of_call(number):
        if number == 10:
            pose = session.home.copy()
            pose[:3, 3] += (0.0, 0.0, 0.05)
            displacements["to"] = pose
            return [messages.Target(pose)]
        return [END] if number == 400 else []

    link.messages = by_call_number(link, messages_of_call)
    session.run(1)
    snapshot = link.running[-1]
    assert np.linalg.norm(snapshot.tool[:3, 3] - displacements["to"][:3, 3]) < 0.004
    np.testing.assert_allclose(snapshot.step.target, displacements["to"])


def by_call_number(link, messages_of_call):
    def orders_of_this_tick():
        link.calls += 1
        return messages_of_call(link.calls)

    return orders_of_this_tick


def test_push_moves_the_soft_axis_and_ends_by_itself(script):
    push = messages.Push((0.0, 6.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    _, link = run_session(script, {10: push, 400: END})
    info = link.infos[0]
    snapshot = next(s for s in link.running if s.time > link.running[0].time + 0.9)
    assert deviation(snapshot, info, "y") < -0.05
    assert snapshot.hand_force is not None
    np.testing.assert_allclose(snapshot.hand_force[1], (0.0, 6.0, 0.0), atol=0.1)
    assert link.running[-1].hand_force is None
    assert abs(deviation(link.running[-1], info, "y")) < 0.02


def test_firm_switch_holds_against_the_same_push_and_gives_back(script):
    push = messages.Push((0.0, 6.0, 0.0), (0.0, 0.0, 0.0), 1.5)
    _, link = run_session(script, {5: messages.Firm(1, True), 20: push, 170: END})
    info = link.infos[0]
    assert max(abs(deviation(s, info, "y")) for s in link.running) < 0.02
    last = link.running[-1]
    assert last.shown.firm
    assert last.shown.axes["y"]["yields"] == "both"
    assert last.edit == 1


def test_grab_pulls_a_point_of_the_arm_and_lets_go(script):
    link = script({})
    session = Session(Simulated("arm7", paced=False), link)

    def messages_of_call(number):
        if number == 10:
            body = session._robot.plant.mj_model.site("tool").bodyid[0]
            position = session._robot.plant.tool[:3, 3]
            toward = position + np.array((0.0, 0.03, 0.0))
            return [messages.Grab(int(body), tuple(position), tuple(toward))]
        if number == 100:
            return [messages.LetGo()]
        return [END] if number == 200 else []

    link.messages = by_call_number(link, messages_of_call)
    session.run(1)
    snapshots = [s for s in link.running if s.hand_force is not None]
    assert snapshots
    assert snapshots[-1].step.deviation[1] < -0.01
    assert link.running[-1].hand_force is None


def test_grabbing_outside_the_arm_does_nothing(script):
    grab = messages.Grab(0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    door = messages.Grab(10_000, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    _, link = run_session(script, {5: [grab, door, messages.Grab(3, None, (1.0, 0, 0))], 40: END})
    assert all(s.hand_force is None for s in link.running)


@pytest.mark.parametrize(
    ("message", "error_text"),
    [
        (messages.Change(1, "y", {"soft": (30.0, 30.0)}), "axes.y.soft = 30"),
        (messages.Change(1, "y", {"soft": (float("nan"), 1.0)}), "axes.y.soft"),
        (messages.Change(1, "w", {"soft": (1.0, 1.0)}), "no axis 'w'"),
        (messages.Change(1, "y", {"softness": 1.0}), "softness"),
        (messages.Adaptation(1, 1.5), "η = 1.5"),
        (messages.Change(1, "y", {"adaptation": 1.5}), "η of y = 1.5"),
        (messages.Preset(1, "softest"), "no preset 'softest'"),
        (messages.Law(1, "gravity"), "gravity"),
    ],
)
def test_invalid_settings_are_reported_and_the_old_ones_kept(script, message, error_text):
    _, link = run_session(script, {4: message, 12: END})
    before, after = link.running[0], link.running[-1]
    count, text, is_error = after.notice
    assert count == 1
    assert is_error
    assert error_text in text
    assert after.edit == 1
    assert after.shown.axes == before.shown.axes
    assert (after.shown.law, after.shown.preset) == (before.shown.law, before.shown.preset)


def moved(pose, *offset):
    out = pose.copy()
    out[:3, 3] += offset
    return out


@pytest.mark.parametrize("unreachable", [(0.0, 0.0, 150.0), (50.0, 0.0, 0.0), (0.0, np.nan, 0.0)])
def test_target_out_of_reach_is_reported_and_the_old_one_kept(script, unreachable):
    link = script({})
    session = Session(Simulated("so101", paced=False), link)
    reachable = (0.0, 0.0, -0.02)
    schedule = {10: reachable, 40: unreachable, 80: (0.0, 0.0, 0.01)}

    def messages_of_call(number):
        if number in schedule:
            return [messages.Target(moved(session.home, *schedule[number]))]
        return [END] if number == 120 else []

    link.messages = by_call_number(link, messages_of_call)
    session.run(1)
    notified = [s for s in link.running if s.notice[1]]
    assert notified
    assert "target" in notified[0].notice[1]
    assert notified[0].notice[2]
    for snapshot in notified:
        np.testing.assert_allclose(snapshot.step.target, moved(session.home, *reachable))
    # A valid target removes the message.
    assert link.running[-1].notice[1:] == ("", False)


def test_target_that_only_the_core_refuses_does_not_end_the_life(script, monkeypatch):
    link = script({})
    session = Session(Simulated("so101", paced=False), link)
    monkeypatch.setattr("pliant.view.messages.check_target", lambda message, _: message.pose)

    def messages_of_call(number):
        if number == 20:
            return [messages.Target(moved(session.home, 150.0, 0.0, 0.0))]
        return [END] if number == 60 else []

    link.messages = by_call_number(link, messages_of_call)
    session.run(1)
    assert "target" in link.running[-1].notice[1]
    np.testing.assert_array_equal(link.running[-1].step.target, session.home)


def test_message_of_a_rejected_setting_ends_with_a_valid_one(script):
    invalid, valid = messages.Adaptation(1, 1.5), messages.Adaptation(2, 0.5)
    _, link = run_session(script, {4: invalid, 16: valid, 30: END})
    assert any("η = 1.5" in s.notice[1] for s in link.running)
    assert link.running[-1].notice[1:] == ("", False)


def test_message_of_a_rejected_setting_expires(script, monkeypatch):
    monkeypatch.setattr("pliant.view.publisher.MAX_NOTICE_TIME", 0.0)
    _, link = run_session(script, {4: messages.Adaptation(1, 1.5), 16: END})
    assert link.running[-1].notice == (2, "", False)


def test_stop_is_not_undone_by_messages_of_the_same_tick(script):
    together = [messages.Stop(), messages.Scene("door"), messages.Start(), messages.Play()]
    _, link = run_session(script, {21: together})
    assert len(link.infos) == 1
    assert link.snapshots[-1].phase == "lowering"


def test_torque_on_while_it_is_on_changes_nothing(script):
    _, link = run_session(script, {10: messages.Start(), 40: END})
    assert link.calls == 40


def test_all_firm_and_laws_on_a_small_arm(script):
    schedule = {
        5: messages.Firm(1, True),
        15: messages.Firm(2, False),
        20: messages.Law(3, "impedance"),
        30: messages.Law(4, "paper"),
        40: END,
    }
    _, link = run_session(script, schedule, robot="koch")
    assert {s.notice[1] for s in link.running} == {""}
    assert {s.shown.law for s in link.running} == {"cap", "impedance", "paper"}
    assert {s.shown.firm for s in link.running} == {True, False}


@pytest.mark.parametrize("law", ["impedance", "paper", "cap"])
def test_laws_change_while_it_runs(script, law):
    _, link = run_session(script, {4: messages.Law(1, law), 60: END})
    last = link.running[-1]
    assert last.notice[1] == ""
    assert last.shown.law == law
    assert last.shown.axes["y"]["yields"] == "both"


def test_every_preset_can_be_chosen(script):
    first, link = run_session(script, {4: END})
    names = link.infos[0].presets
    schedule = {10 + 6 * i: messages.Preset(i + 1, name) for i, name in enumerate(names)}
    _, link = run_session(script, {**schedule, 10 + 6 * len(names): END})
    assert [s.notice[1] for s in link.running if s.notice[1]] == []
    assert {s.shown.preset for s in link.running} >= set(names)
    assert first.editor.presets == names


def test_scene_changes_without_lowering_and_takes_its_preset(script):
    link = script({10: messages.Scene("door"), 40: messages.Scene("nowhere"), 60: END})
    session = Session(Simulated("arm7", paced=False), link)
    session.run(2)
    assert [info.scene for info in link.infos] == ["free", "door"]
    assert link.running[-1].shown.preset == "door"
    assert link.infos[1].play


def test_torque_on_again_keeps_the_settings(script):
    change = messages.Change(1, "y", {"soft": (2.0, 3.0)})
    link = script({5: change, 20: messages.Stop(), 30: messages.Start(), 60: END})
    Session(Simulated("arm7", paced=False), link).run(2)
    assert len(link.infos) == 2
    assert link.running[-1].shown.axes["y"]["soft"] == (2.0, 3.0)
    assert any(s.phase == "down" for s in link.snapshots)


def test_door_opens_when_played(script):
    session, link = run_session(script, {10: messages.Play(), 520: END}, scene="door")
    assert np.rad2deg(session._robot.plant.fixtures[0].widest) > 45.0
    assert link.running[-1].step is not None


def test_person_takes_the_object_when_asked(script):
    session, _ = run_session(script, {10: messages.Play(), 300: END}, scene="hand-over")
    handover_object = session._robot.plant.fixtures[0]
    assert handover_object.released is not None


def test_wall_meets_little_more_than_the_cap(script):
    session, link = run_session(script, {10: messages.Play(), 330: END}, scene="wall")
    assert len(link.infos[0].walls) == 1
    wall = session._robot.plant.hands[0]
    assert 4.0 < wall.peak_force < 20.0


def test_arm_without_a_start_posture_starts_halfway_between_its_limits(script, monkeypatch):
    monkeypatch.setitem(robots._ARMS, "other", robots.so101)
    source = Simulated("other", "wall", paced=False)
    middle = 0.5 * (source.model.lower + source.model.upper)
    np.testing.assert_allclose(source.scenes["wall"].q, middle)
    _, link = run_session(script, {10: END}, robot="other")
    assert link.running


def test_other_arms_have_scenes_of_their_own(script):
    _, link = run_session(script, {30: END}, robot="so101")
    assert link.infos[0].axes == ("x", "y", "z")
    assert "door" not in link.infos[0].presets
    assert link.running[-1].notice == (0, "", False)
    with pytest.raises(ConfigError, match="so101 has no scene 'door'; it has free, wall"):
        Simulated("so101", "door")


@pytest.mark.parametrize("robot", ["so101", "koch"])
def test_small_arms_come_to_rest_on_the_table_that_is_drawn(script, robot):
    session, link = run_session(script, {30: messages.Stop()}, robot=robot)
    info, plant = link.infos[0], session._robot.plant
    assert info.table == 0.0
    assert _floor_height(info) == 0.0
    (top,) = (fixture for fixture in plant.fixtures if isinstance(fixture, Tabletop))
    assert top.peak_force > 0.0
    assert top.clearance() > -0.005
    assert plant.tool[2, 3] > -0.01


def test_arm_is_lowered_when_the_page_is_gone(script):
    link = script({})

    def gone(number):
        if number == 30:
            raise PageGone("the page's process has ended")
        return []

    link.messages = by_call_number(link, gone)
    session = Session(Simulated("arm7", paced=False), link)
    with pytest.raises(PageGone):
        session.run(1)
    assert not session._arm.enabled
    assert session._robot.plant.tool[2, 3] < session.home[2, 3] - 0.2


def test_a_bus_error_is_reported_and_torque_can_come_on_again(script):
    link = script({40: messages.Start(), 70: END})
    session = Session(Simulated("arm7", paced=False), link)
    inner = link.messages
    failures = []

    def trip():
        sample = inner()
        if link.calls == 20 and not failures:
            failures.append(True)
            raise ServoError("shoulder: it is too hot")
        return sample

    link.messages = trip
    session.run(2)
    notice = [s for s in link.snapshots if s.notice[1] == "shoulder: it is too hot"]
    assert notice
    assert notice[-1].phase == "down"
    assert link.running[-1].notice[1] == ""
    assert notice[0].notice[2]
    assert len(link.infos) == 2


def test_page_that_goes_during_the_descent_does_not_stop_it(script):
    link = script({20: messages.Stop()})
    session = Session(Simulated("arm7", paced=False), link)
    inner = link.send

    def send(message):
        if getattr(message, "phase", "") == "lowering":
            raise PageGone("the page's process has ended")
        inner(message)

    link.send = send
    session.run(1)
    assert not session._arm.enabled
    assert session._robot.plant.tool[2, 3] < session.home[2, 3] - 0.2


@pytest.mark.parametrize("robot", robots.names())
def test_every_built_in_arm_stands_inside_its_limits(robot):
    source = Simulated(robot)
    q = source.scenes["free"].q
    assert q.shape == (source.model.n,)
    assert (q > source.model.lower).all()
    assert (q < source.model.upper).all()
