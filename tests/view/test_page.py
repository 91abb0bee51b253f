"""`Page` without a browser: contents of its displays, and messages sent by its controls."""

from __future__ import annotations

import asyncio
import re
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import viser
import viser.transforms as tf

from pliant.view import html, messages
from pliant.view.page import Page
from pliant.view.panel import Panel
from pliant.view.scene_view import ARROW_LENGTH, SceneView
from pliant.view.session import Session
from pliant.view.source import Simulated


class Told:
    """Test data: description of a scene in which a hand pushes the arm, and its snapshots."""

    def __init__(self, script):
        push = messages.Push((0.0, 6.0, 0.0), (0.0, 0.0, 0.0), 1.0)
        link = script({5: push, 90: messages.Stop()})
        link.every = 10
        Session(Simulated("arm7", "wall", paced=False), link).run(1)
        self.info, self.snapshots, self.running = link.infos[0], link.snapshots, link.running


class Seen:
    """A page that shows the scene and snapshots of `Told`."""

    def __init__(self, server, told):
        self.info, self.snapshots, self.running = told.info, told.snapshots, told.running
        self.notice = []
        self.server = server
        self.scene_view = SceneView(server, self.info, self.notice.append)
        self.panel = Panel(server, self.info, self.notice.append)
        for snapshot in self.running:
            self.scene_view.show(snapshot)
            self.panel.show(snapshot)
        self.notice.clear()


@pytest.fixture(scope="module")
def told(script):
    return Told(script)


@pytest.fixture(scope="module")
def server():
    made = viser.ViserServer(host="127.0.0.1", port=8250, verbose=False)
    yield made
    made.stop()


@pytest.fixture
def seen(server, told):
    """Return a new page for each test, because tests change the controls."""
    server.scene.reset()
    server.gui.reset()
    return Seen(server, told)


def click(handle):
    for callback in handle._impl.update_cb:
        done = callback(SimpleNamespace(client="a browser", client_id=0, target=handle))
        if done is not None:
            asyncio.run(done)


def move(handle, value):
    """Change a control as a user does; an assigned value would count as set by the program."""
    handle._impl.value = value
    click(handle)


def drag(callback, **event):
    asyncio.run(callback(SimpleNamespace(**event)))


def test_a_snapshot_between_a_click_and_its_being_heard_does_not_undo_it(seen):
    controls = seen.panel.controls
    last = seen.running[-1]
    controls.firm._impl.value = True  # a click that viser has received, before its callback runs
    controls.show(last)
    assert controls.firm.value
    click(controls.firm)
    (message,) = seen.notice
    assert isinstance(message, messages.Firm)
    assert message.on
    controls.show(replace(last, edit=message.number))  # the loop has rejected the edit
    assert not controls.firm.value


def test_scene_has_arm_wall_target_and_floor(seen):
    names = set(seen.server.scene._handle_from_node_name)
    assert {"/target", "/walls/0", "/floor", "/hand"} <= names
    assert {"/axes/x", "/axes/y", "/axes/z"} <= names
    for joint in seen.info.joints:
        assert any(re.fullmatch(rf"/arm/\d+/{joint}", name) for name in names)


def test_drums_stand_on_the_axes_of_their_joints(seen):
    last = seen.running[-1]
    seen.scene_view.show(last)
    data, figure = seen.scene_view._data, seen.info.mj_model
    for drum, name in zip(seen.scene_view._drums._drums, seen.info.joints, strict=True):
        joint = figure.joint(name).id
        node = seen.scene_view._nodes[int(figure.jnt_bodyid[joint])]
        place = tf.SO3(np.asarray(node.wxyz)).apply(np.asarray(drum.position)) + node.position
        np.testing.assert_allclose(place, data.xanchor[joint], atol=1e-5)
        turn = tf.SO3(np.asarray(node.wxyz)) @ tf.SO3(np.asarray(drum.wxyz))
        np.testing.assert_allclose(turn.apply(np.eye(3)[2]), data.xaxis[joint], atol=1e-5)


def test_drawn_tool_is_where_the_simulation_has_it(seen):
    last = seen.running[-1]
    seen.scene_view.show(last)
    site = seen.info.mj_model.site("tool").id
    mujoco.mj_kinematics(seen.info.mj_model, seen.scene_view._data)
    np.testing.assert_allclose(seen.scene_view._data.site_xpos[site], last.tool[:3, 3], atol=1e-9)


def test_arrow_shows_the_push_and_hides_without_one(seen):
    pushed = next(
        s for s in seen.running if s.hand_force is not None and abs(s.hand_force[1][1]) > 5.0
    )
    seen.scene_view.show(pushed)
    assert seen.scene_view._arrow.visible
    start, end = seen.scene_view._arrow.points[0]
    np.testing.assert_allclose(end, pushed.hand_force[0], atol=1e-5)
    assert (end - start)[1] == pytest.approx(ARROW_LENGTH * 6.0 / 40.0, rel=0.1)
    seen.scene_view.show(replace(pushed, hand_force=None))
    assert not seen.scene_view._arrow.visible


def test_meters_show_the_values_of_the_step(seen):
    seen.panel._drawn = -np.inf
    seen.panel.show(seen.running[-1])
    assert "shoulder_pitch" in seen.panel._joints.content
    assert "push-back" in seen.panel._axes.content
    assert "100 Hz" in seen.panel._health.content
    assert "gives way at" in seen.panel._sentences.content
    assert seen.panel._matrix.content.count("<tr>") == 8


def row(seen, now, shown=None, full=None):
    """Return the HTML rows of the table of task axes, by axis."""
    info, shown = seen.info, shown or now.shown
    full = full or html.ranges(info, shown, now.step, {})
    rows = html.axes(info, shown, now.step, full).split("<tr>")[2:]
    return dict(zip(info.axes, rows, strict=True)), full


def widths(rows):
    found = {name: re.search(r"width:([\d.]+)%;height", text) for name, text in rows.items()}
    return {name: float(match[1]) for name, match in found.items()}


def test_bars_of_one_unit_have_one_scale(seen):
    now = seen.running[-1]
    off = np.array((0.016, -0.071, 0.033, 0.02, -0.1, 0.3))
    rows, full = row(seen, replace(now, step=replace(now.step, deviation=off)))
    drawn = widths(rows)
    for names, unit, scale in (("xyz", "mm", 1e3), (("roll", "pitch", "yaw"), "°", 57.2958)):
        for name in names:
            size = abs(off[seen.info.axes.index(name)]) * scale / full[unit]
            assert drawn[name] == pytest.approx(50.0 * size, abs=0.06)
    assert "-16 mm" in rows["x"]
    assert "+71 mm" in rows["y"]
    assert "left:50.0%" in rows["y"]


def test_scale_holds_thresholds_and_does_not_flicker(seen):
    now = seen.running[-1]

    def scale(size, before):
        off = np.full(6, size)
        step = replace(now.step, deviation=off)
        return html.ranges(seen.info, now.shown, step, before)

    soft = now.shown.thresholds[seen.info.axes.index("x"), 0]
    first = scale(0.0, {})
    assert first["mm"] >= 1e3 * soft
    grown = scale(0.3, first)
    assert grown["mm"] >= 300.0
    assert scale(0.25, grown) == grown
    assert scale(0.0, grown)["mm"] < grown["mm"]


def test_text_from_errors_is_no_markup(seen):
    assert "<script>" not in html.notice("<script>alert(1)</script>", is_error=True)
    assert "<b>" not in html.summary(["<b>"])


def test_stop_and_torque_on(seen):
    click(seen.panel.stop.stop)
    click(seen.panel.stop.start)
    assert seen.notice == [messages.Stop(), messages.Start()]


def test_buttons_follow_the_life_of_the_arm(seen):
    stop = seen.panel.stop
    lowering = next(s for s in seen.snapshots if s.phase == "lowering")
    stop.show(lowering)
    assert stop.stop.disabled
    stop.show(replace(lowering, phase="down"))
    assert (stop.stop.visible, stop.start.visible) == (False, True)
    stop.show(seen.running[0])
    assert (stop.stop.visible, stop.stop.disabled, stop.start.visible) == (True, False, False)


def test_controls_send_changes_with_rising_numbers(seen):
    controls = seen.panel.controls
    move(controls.eta, 0.5)
    move(controls.law, "impedance")
    move(controls.firm, True)
    move(controls.preset, "firm")
    move(controls.yields["x"], "holds")
    move(controls.yields["z"], "gives way to −")
    move(controls.strength["y", "soft"], (2.0, 3.0))
    eta, law, firm, preset, holds, way, soft = seen.notice
    assert (type(eta), eta.value) == (messages.Adaptation, 0.5)
    assert (type(law), law.law) == (messages.Law, "impedance")
    assert firm.on is True
    assert preset.name == "firm"
    assert holds.fields == {"yields": "none"}
    assert way.fields == {"yields": "-", "adaptation": 0.5}
    assert soft.fields == {"soft": (2.0, 3.0)}
    numbers = [message.number for message in seen.notice]
    assert numbers == sorted(set(numbers))


def test_controls_show_what_is_in_force_once_the_edit_is_answered(seen):
    controls = seen.panel.controls
    move(controls.eta, 0.3)
    late, last = seen.running[-1], controls._last_edit
    controls.show(replace(late, edit=last - 1))
    assert controls.eta.value == 0.3
    controls.show(replace(late, edit=last))
    assert controls.eta.value == late.shown.axes["x"]["adaptation"]
    assert controls.yields["x"].value == "gives way"


def test_page_that_sets_a_control_says_nothing(seen):
    controls = seen.panel.controls
    controls.eta.value = 0.123
    controls.firm.value = not controls.firm.value
    assert seen.notice == []


def test_push_buttons_say_force_or_torque(seen):
    controls = seen.panel.controls
    controls.side.value = "−y"
    controls.force.value = 7.0
    assert controls._push_message(2.0) == messages.Push((0.0, -7.0, 0.0), (0.0, 0.0, 0.0), 2.0)
    controls.side.value = "+yaw"
    assert controls.force.label == "Torque [N·m]"
    assert controls.force.max == 4.0
    controls.force.value = 1.5
    assert controls._push_message(0.4) == messages.Push((0.0, 0.0, 0.0), (0.0, 0.0, 1.5), 0.4)


def test_gizmo_says_a_target_and_is_left_alone_while_it_is_dragged(seen):
    gizmo = seen.scene_view.gizmo
    gizmo.position, gizmo.wxyz = (0.3, 0.1, -0.2), (1.0, 0.0, 0.0, 0.0)
    drag(seen.scene_view._on_gizmo, target=gizmo, phase="start")
    np.testing.assert_allclose(seen.notice[0].pose[:3, 3], (0.3, 0.1, -0.2))
    seen.scene_view.show(seen.running[-1])
    np.testing.assert_allclose(gizmo.position, (0.3, 0.1, -0.2))
    drag(seen.scene_view._on_gizmo, target=gizmo, phase="end")
    seen.scene_view.show(seen.running[-1])
    np.testing.assert_allclose(gizmo.position, seen.running[-1].step.target[:3, 3])


def test_dragging_the_arm_grabs_pulls_and_lets_go(seen):
    pulled = seen.scene_view._drag_handler(np.array([3]))
    place = {"instance_index": 0, "start_position": (0.1, 0.0, 0.0), "end_position": (0.2, 0, 0)}
    for phase in ("start", "update", "end"):
        drag(pulled, phase=phase, client_id=7, **place)
    first, second, last = seen.notice
    assert (first.body, first.point, first.toward) == (3, (0.1, 0.0, 0.0), (0.2, 0, 0))
    assert second.point is None
    assert last == messages.LetGo()


def test_every_part_of_the_arm_can_be_dragged(seen):
    for group in seen.scene_view._mujoco_scene._mesh_groups:
        assert group.handle._impl.drag_cb
    shaped = {visual.body for visual in seen.info.visuals}
    assert shaped
    for body in shaped:
        assert seen.scene_view._nodes[body]._impl.drag_cb


def test_only_the_tab_that_holds_the_arm_lets_go_when_it_closes(seen):
    page = Page.__new__(Page)
    page.scene_view, page._send = seen.scene_view, seen.notice.append
    for held_by, closed, notice in ((None, 3, []), (7, 3, []), (7, 7, [messages.LetGo()])):
        seen.scene_view.held_by = held_by
        page._on_disconnect(SimpleNamespace(client_id=closed))
        assert seen.notice == notice
    seen.scene_view.held_by = None
