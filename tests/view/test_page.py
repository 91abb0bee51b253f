"""The page on its server, without a browser: its display, and the orders of its handlers."""

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

from pliant.view import meters, orders
from pliant.view.page import Page
from pliant.view.panel import Panel
from pliant.view.session import Session
from pliant.view.source import Simulated
from pliant.view.world import LONGEST, World


class Told:
    """Data of a push: a stage and its snapshots."""

    def __init__(self, script):
        push = orders.Push((0.0, 6.0, 0.0), (0.0, 0.0, 0.0), 1.0)
        link = script({5: push, 90: orders.Stop()})
        link.every = 10
        Session(Simulated("arm7", "wall", paced=False), link).run(1)
        self.stage, self.snapshots, self.running = link.stages[0], link.snapshots, link.running


class Seen:
    """A page that shows them."""

    def __init__(self, server, told):
        self.stage, self.snapshots, self.running = told.stage, told.snapshots, told.running
        self.said = []
        self.server = server
        self.world = World(server, self.stage, self.said.append)
        self.panel = Panel(server, self.stage, self.said.append)
        for snapshot in self.running:
            self.world.show(snapshot)
            self.panel.show(snapshot)
        self.said.clear()


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
    """Make a page for each test: workers run tests in any order, and tests move controls."""
    server.scene.reset()
    server.gui.reset()
    return Seen(server, told)


def click(handle):
    for callback in handle._impl.update_cb:
        done = callback(SimpleNamespace(client="a browser", client_id=0, target=handle))
        if done is not None:
            asyncio.run(done)


def move(handle, value):
    """Move a control as a visitor does; setting a value here would be the page's own change."""
    handle._impl.value = value
    click(handle)


def drag(callback, **event):
    asyncio.run(callback(SimpleNamespace(**event)))


def test_a_snapshot_between_a_click_and_its_being_heard_does_not_undo_it(seen):
    controls = seen.panel.controls
    last = seen.running[-1]
    controls.firm._impl.value = True  # viser has the click, its callback is still to come
    controls.show(last)
    assert controls.firm.value
    click(controls.firm)
    (order,) = seen.said
    assert isinstance(order, orders.Firm)
    assert order.on
    controls.show(replace(last, edit=order.number))  # the arm has received and rejected it
    assert not controls.firm.value


def test_scene_has_arm_wall_target_and_floor(seen):
    names = set(seen.server.scene._handle_from_node_name)
    assert {"/target", "/walls/0", "/floor", "/hand"} <= names
    assert {"/axes/x", "/axes/y", "/axes/z"} <= names
    for joint in seen.stage.joints:
        assert any(re.fullmatch(rf"/arm/\d+/{joint}", name) for name in names)


def test_drums_stand_on_the_axes_of_their_joints(seen):
    last = seen.running[-1]
    seen.world.show(last)
    data, figure = seen.world._data, seen.stage.figure
    for drum, name in zip(seen.world._hinges._drums, seen.stage.joints, strict=True):
        joint = figure.joint(name).id
        node = seen.world._nodes[int(figure.jnt_bodyid[joint])]
        place = tf.SO3(np.asarray(node.wxyz)).apply(np.asarray(drum.position)) + node.position
        np.testing.assert_allclose(place, data.xanchor[joint], atol=1e-5)
        turn = tf.SO3(np.asarray(node.wxyz)) @ tf.SO3(np.asarray(drum.wxyz))
        np.testing.assert_allclose(turn.apply(np.eye(3)[2]), data.xaxis[joint], atol=1e-5)


def test_drawn_tool_is_where_the_simulation_has_it(seen):
    last = seen.running[-1]
    seen.world.show(last)
    site = seen.stage.figure.site("tool").id
    mujoco.mj_kinematics(seen.stage.figure, seen.world._data)
    np.testing.assert_allclose(seen.world._data.site_xpos[site], last.tool[:3, 3], atol=1e-9)


def test_arrow_shows_the_push_and_hides_without_one(seen):
    pushed = next(s for s in seen.running if s.pull is not None and abs(s.pull[1][1]) > 5.0)
    seen.world.show(pushed)
    assert seen.world._arrow.visible
    start, end = seen.world._arrow.points[0]
    np.testing.assert_allclose(end, pushed.pull[0], atol=1e-5)
    assert (end - start)[1] == pytest.approx(LONGEST * 6.0 / 40.0, rel=0.1)
    seen.world.show(replace(pushed, pull=None))
    assert not seen.world._arrow.visible


def test_meters_show_the_values_of_the_step(seen):
    seen.panel._drawn = -np.inf
    seen.panel.show(seen.running[-1])
    assert "shoulder_pitch" in seen.panel._joints.content
    assert "push-back" in seen.panel._axes.content
    assert "100 Hz" in seen.panel._health.content
    assert "gives way at" in seen.panel._sentences.content
    assert seen.panel._matrix.content.count("<tr>") == 8


def row(seen, now, shown=None, full=None):
    """Return the rows of the table of axes, by axis."""
    stage, shown = seen.stage, shown or now.shown
    full = full or meters.ranges(stage, shown, now.step, {})
    rows = meters.axes(stage, shown, now.step, full).split("<tr>")[2:]
    return dict(zip(stage.axes, rows, strict=True)), full


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
            size = abs(off[seen.stage.axes.index(name)]) * scale / full[unit]
            assert drawn[name] == pytest.approx(50.0 * size, abs=0.06)
    assert "-16 mm" in rows["x"]
    assert "+71 mm" in rows["y"]
    assert "left:50.0%" in rows["y"]


def test_scale_holds_thresholds_and_does_not_flicker(seen):
    now = seen.running[-1]

    def scale(size, before):
        off = np.full(6, size)
        step = replace(now.step, deviation=off)
        return meters.ranges(seen.stage, now.shown, step, before)

    soft = now.shown.thresholds[seen.stage.axes.index("x"), 0]
    first = scale(0.0, {})
    assert first["mm"] >= 1e3 * soft
    grown = scale(0.3, first)
    assert grown["mm"] >= 300.0
    assert scale(0.25, grown) == grown
    assert scale(0.0, grown)["mm"] < grown["mm"]


def test_text_from_errors_is_no_markup(seen):
    assert "<script>" not in meters.notice("<script>alert(1)</script>", wrong=True)
    assert "<b>" not in meters.summary(["<b>"])


def test_stop_and_torque_on(seen):
    click(seen.panel.stop.stop)
    click(seen.panel.stop.start)
    assert seen.said == [orders.Stop(), orders.Start()]


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
    eta, law, firm, preset, holds, way, soft = seen.said
    assert (type(eta), eta.value) == (orders.Eta, 0.5)
    assert (type(law), law.law) == (orders.Law, "impedance")
    assert firm.on is True
    assert preset.name == "firm"
    assert holds.fields == {"yields": "none"}
    assert way.fields == {"yields": "-", "adaptation": 0.5}
    assert soft.fields == {"soft": (2.0, 3.0)}
    numbers = [order.number for order in seen.said]
    assert numbers == sorted(set(numbers))


def test_controls_show_what_is_in_force_once_the_edit_is_answered(seen):
    controls = seen.panel.controls
    move(controls.eta, 0.3)
    late, last = seen.running[-1], controls._said
    controls.show(replace(late, edit=last - 1))
    assert controls.eta.value == 0.3
    controls.show(replace(late, edit=last))
    assert controls.eta.value == late.shown.axes["x"]["adaptation"]
    assert controls.yields["x"].value == "gives way"


def test_page_that_sets_a_control_says_nothing(seen):
    controls = seen.panel.controls
    controls.eta.value = 0.123
    controls.firm.value = not controls.firm.value
    assert seen.said == []


def test_push_buttons_say_force_or_torque(seen):
    controls = seen.panel.controls
    controls.side.value = "−y"
    controls.force.value = 7.0
    assert controls._pushing(2.0) == orders.Push((0.0, -7.0, 0.0), (0.0, 0.0, 0.0), 2.0)
    controls.side.value = "+yaw"
    assert controls.force.label == "Torque [N·m]"
    assert controls.force.max == 4.0
    controls.force.value = 1.5
    assert controls._pushing(0.4) == orders.Push((0.0, 0.0, 0.0), (0.0, 0.0, 1.5), 0.4)


def test_gizmo_says_a_target_and_is_left_alone_while_it_is_dragged(seen):
    gizmo = seen.world.gizmo
    gizmo.position, gizmo.wxyz = (0.3, 0.1, -0.2), (1.0, 0.0, 0.0, 0.0)
    drag(seen.world._led, target=gizmo, phase="start")
    np.testing.assert_allclose(seen.said[0].pose[:3, 3], (0.3, 0.1, -0.2))
    seen.world.show(seen.running[-1])
    np.testing.assert_allclose(gizmo.position, (0.3, 0.1, -0.2))
    drag(seen.world._led, target=gizmo, phase="end")
    seen.world.show(seen.running[-1])
    np.testing.assert_allclose(gizmo.position, seen.running[-1].step.target[:3, 3])


def test_dragging_the_arm_grabs_pulls_and_lets_go(seen):
    pulled = seen.world._pulled(np.array([3]))
    place = {"instance_index": 0, "start_position": (0.1, 0.0, 0.0), "end_position": (0.2, 0, 0)}
    for phase in ("start", "update", "end"):
        drag(pulled, phase=phase, client_id=7, **place)
    first, second, last = seen.said
    assert (first.body, first.point, first.toward) == (3, (0.1, 0.0, 0.0), (0.2, 0, 0))
    assert second.point is None
    assert last == orders.LetGo()


def test_every_part_of_the_arm_can_be_dragged(seen):
    for group in seen.world._figure._mesh_groups:
        assert group.handle._impl.drag_cb
    shaped = {visual.body for visual in seen.stage.visuals}
    assert shaped
    for body in shaped:
        assert seen.world._nodes[body]._impl.drag_cb


def test_only_the_tab_that_holds_the_arm_lets_go_when_it_closes(seen):
    page = Page.__new__(Page)
    page.world, page._tell = seen.world, seen.said.append
    for held_by, closed, said in ((None, 3, []), (7, 3, []), (7, 7, [orders.LetGo()])):
        seen.world.held_by = held_by
        page._left(SimpleNamespace(client_id=closed))
        assert seen.said == said
    seen.world.held_by = None
