"""`Page` without a browser: contents of its displays, and messages sent by its controls."""

from __future__ import annotations

import asyncio
import re
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import viser
import viser.transforms as tf
import websockets.asyncio.server
from msgspec import msgpack
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from pliant.view import html, messages
from pliant.view.page import Page
from pliant.view.panel import Panel
from pliant.view.scene_view import ARROW_LENGTH, SceneView
from pliant.view.session import Session
from pliant.view.snapshot import Ended
from pliant.view.source import Simulated


class Recording:
    """Description and snapshots of a simulated session in which a hand pushes the arm."""

    def __init__(self, script):
        push = messages.Push((0.0, 6.0, 0.0), (0.0, 0.0, 0.0), 1.0)
        link = script({5: push, 90: messages.Stop()})
        link.every = 10
        Session(Simulated("arm7", "wall", paced=False), link).run(1)
        self.info, self.snapshots, self.running = link.infos[0], link.snapshots, link.running


class ShownPage:
    """A page that has shown the running snapshots of a recording; `messages` gets its messages."""

    def __init__(self, server, recording):
        self.info, self.snapshots = recording.info, recording.snapshots
        self.running = recording.running
        self.messages = []
        self.server = server
        self.scene_view = SceneView(server, self.info, self.messages.append)
        self.panel = Panel(server, self.info, self.messages.append)
        for snapshot in self.running:
            self.scene_view.show(snapshot)
            self.panel.show(snapshot)
        self.messages.clear()


@pytest.fixture(scope="module")
def recording(script):
    return Recording(script)


@pytest.fixture(scope="module")
def server():
    server = viser.ViserServer(host="127.0.0.1", port=8250, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def page(server, recording):
    """Return a new page for each test, because tests change the controls."""
    server.scene.reset()
    server.gui.reset()
    return ShownPage(server, recording)


def click(handle):
    """Call the callbacks of a control, as viser does after a click."""
    for callback in handle._impl.update_cb:
        coroutine = callback(SimpleNamespace(client="a browser", client_id=0, target=handle))
        if coroutine is not None:
            asyncio.run(coroutine)


def move(handle, value):
    """Change a control as a user does: viser treats an assignment to `value` as the program's."""
    handle._impl.value = value
    click(handle)


def drag(callback, **event):
    asyncio.run(callback(SimpleNamespace(**event)))


def test_a_snapshot_between_a_click_and_its_being_heard_does_not_undo_it(page):
    controls = page.panel.controls
    last = page.running[-1]
    controls.firm._impl.value = True  # a click that viser has received, before its callback runs
    controls.show(last)
    assert controls.firm.value
    click(controls.firm)
    (message,) = page.messages
    assert isinstance(message, messages.Firm)
    assert message.on
    controls.show(replace(last, edit=message.number))  # the loop has rejected the edit
    assert not controls.firm.value


def test_scene_has_arm_wall_target_and_floor(page):
    names = set(page.server.scene._handle_from_node_name)
    assert {"/target", "/walls/0", "/floor", "/hand"} <= names
    assert {"/axes/x", "/axes/y", "/axes/z"} <= names
    for joint in page.info.joints:
        assert any(re.fullmatch(rf"/arm/\d+/{joint}", name) for name in names)


def test_drums_stand_on_the_axes_of_their_joints(page):
    last = page.running[-1]
    page.scene_view.show(last)
    data, figure = page.scene_view._data, page.info.mj_model
    for drum, name in zip(page.scene_view._drums._drums, page.info.joints, strict=True):
        joint = figure.joint(name).id
        node = page.scene_view._nodes[int(figure.jnt_bodyid[joint])]
        position = tf.SO3(np.asarray(node.wxyz)).apply(np.asarray(drum.position)) + node.position
        np.testing.assert_allclose(position, data.xanchor[joint], atol=1e-5)
        rotation = tf.SO3(np.asarray(node.wxyz)) @ tf.SO3(np.asarray(drum.wxyz))
        np.testing.assert_allclose(rotation.apply(np.eye(3)[2]), data.xaxis[joint], atol=1e-5)


def test_drawn_tool_is_where_the_simulation_has_it(page):
    last = page.running[-1]
    page.scene_view.show(last)
    site = page.info.mj_model.site("tool").id
    mujoco.mj_kinematics(page.info.mj_model, page.scene_view._data)
    np.testing.assert_allclose(page.scene_view._data.site_xpos[site], last.tool[:3, 3], atol=1e-9)


def test_arrow_shows_the_push_and_hides_without_one(page):
    snapshot = next(
        s for s in page.running if s.hand_force is not None and abs(s.hand_force[1][1]) > 5.0
    )
    page.scene_view.show(snapshot)
    assert page.scene_view._arrow.visible
    start, end = page.scene_view._arrow.points[0]
    np.testing.assert_allclose(end, snapshot.hand_force[0], atol=1e-5)
    assert (end - start)[1] == pytest.approx(ARROW_LENGTH * 6.0 / 40.0, rel=0.1)
    page.scene_view.show(replace(snapshot, hand_force=None))
    assert not page.scene_view._arrow.visible


def test_meters_show_the_values_of_the_step(page):
    page.panel._drawn = -np.inf
    page.panel.show(page.running[-1])
    assert "shoulder_pitch" in page.panel._joints.content
    assert "push-back" in page.panel._axes.content
    assert "100 Hz" in page.panel._health.content
    assert "gives way at" in page.panel._sentences.content
    assert page.panel._matrix.content.count("<tr>") == 8


def row(page, snapshot, scaling=None, full=None):
    """Return the HTML rows of the table of task axes, by axis."""
    info, scaling = page.info, scaling or snapshot.shown
    full = full or html.ranges(info, scaling, snapshot.step, {})
    rows = html.axes(info, scaling, snapshot.step, full).split("<tr>")[2:]
    return dict(zip(info.axes, rows, strict=True)), full


def widths(rows):
    matches = {name: re.search(r"width:([\d.]+)%;height", text) for name, text in rows.items()}
    return {name: float(match[1]) for name, match in matches.items()}


def test_bars_of_one_unit_have_one_scale(page):
    snapshot = page.running[-1]
    deviation = np.array((0.016, -0.071, 0.033, 0.02, -0.1, 0.3))
    rows, full = row(page, replace(snapshot, step=replace(snapshot.step, deviation=deviation)))
    bar_widths = widths(rows)
    for names, unit, scale in (("xyz", "mm", 1e3), (("roll", "pitch", "yaw"), "°", 57.2958)):
        for name in names:
            size = abs(deviation[page.info.axes.index(name)]) * scale / full[unit]
            assert bar_widths[name] == pytest.approx(50.0 * size, abs=0.06)
    assert "-16 mm" in rows["x"]
    assert "+71 mm" in rows["y"]
    assert "left:50.0%" in rows["y"]


def test_scale_holds_thresholds_and_does_not_flicker(page):
    snapshot = page.running[-1]

    def scale(size, before):
        deviation = np.full(6, size)
        step = replace(snapshot.step, deviation=deviation)
        return html.ranges(page.info, snapshot.shown, step, before)

    soft = snapshot.shown.thresholds[page.info.axes.index("x"), 0]
    first = scale(0.0, {})
    assert first["mm"] >= 1e3 * soft
    grown = scale(0.3, first)
    assert grown["mm"] >= 300.0
    assert scale(0.25, grown) == grown
    assert scale(0.0, grown)["mm"] < grown["mm"]


def test_text_from_errors_is_escaped(page):
    assert "<script>" not in html.notice("<script>alert(1)</script>", is_error=True)
    assert "<b>" not in html.summary(["<b>"])


def test_stop_and_torque_on(page):
    click(page.panel.stop.stop)
    click(page.panel.stop.start)
    assert page.messages == [messages.Stop(), messages.Start()]


def test_buttons_follow_the_life_of_the_arm(page):
    stop = page.panel.stop
    lowering = next(s for s in page.snapshots if s.phase == "lowering")
    stop.show(lowering)
    assert stop.stop.disabled
    stop.show(replace(lowering, phase="down"))
    assert (stop.stop.visible, stop.start.visible) == (False, True)
    stop.show(page.running[0])
    assert (stop.stop.visible, stop.stop.disabled, stop.start.visible) == (True, False, False)


def test_the_final_state_stays_on_the_page_once_the_loop_has_gone(page):
    stop = page.panel.stop
    stop.show_end(Ended("arm7 was lowered: torque OFF, tool 12 cm lower, 3.0 s", is_off=True))
    stop.show_disconnected()
    assert "torque is off" in stop._status.content
    assert "was lowered: torque OFF" in stop._notice.content
    assert html.ALERT not in stop._notice.content
    assert (stop.stop.visible, stop.start.visible) == (False, False)


def test_torque_that_stays_on_is_an_error_on_the_page(page):
    stop = page.panel.stop
    stop.show_end(Ended("so101 stays where it is, torque ON: elbow carries it", is_off=False))
    assert "torque is ON" in stop._status.content
    assert html.ALERT in stop._notice.content


@pytest.mark.parametrize(
    ("where", "phase", "text"),
    [
        ("serial", "running", "until a guardian lowers the arm"),
        ("simulated", "running", "and the simulated arm with it"),
        ("serial", "down", "Torque was off before"),
    ],
)
def test_a_killed_loop_is_told_by_what_it_leaves(page, where, phase, text):
    stop = page.panel.stop
    stop._info = replace(page.info, where=where)
    stop.show(replace(page.running[-1], phase=phase))
    stop.show_disconnected()
    assert "The loop has ended" in stop._notice.content
    assert text in stop._notice.content
    assert not stop.start.visible


def test_controls_send_changes_with_rising_numbers(page):
    controls = page.panel.controls
    move(controls.eta, 0.5)
    move(controls.law, "impedance")
    move(controls.firm, True)
    move(controls.preset, "firm")
    move(controls.yields["x"], "holds")
    move(controls.yields["z"], "gives way to −")
    move(controls.strength["y", "soft"], (2.0, 3.0))
    eta, law, firm, preset, holds, sides, soft = page.messages
    assert (type(eta), eta.value) == (messages.Adaptation, 0.5)
    assert (type(law), law.law) == (messages.Law, "impedance")
    assert firm.on is True
    assert preset.name == "firm"
    assert holds.fields == {"yields": "none"}
    assert sides.fields == {"yields": "-", "adaptation": 0.5}
    assert soft.fields == {"soft": (2.0, 3.0)}
    numbers = [message.number for message in page.messages]
    assert numbers == sorted(set(numbers))


def test_controls_show_what_is_in_force_once_the_edit_is_answered(page):
    controls = page.panel.controls
    move(controls.eta, 0.3)
    snapshot, last = page.running[-1], controls._last_edit
    controls.show(replace(snapshot, edit=last - 1))
    assert controls.eta.value == 0.3
    controls.show(replace(snapshot, edit=last))
    assert controls.eta.value == snapshot.shown.axes["x"]["adaptation"]
    assert controls.yields["x"].value == "gives way"


def test_page_that_sets_a_control_says_nothing(page):
    controls = page.panel.controls
    controls.eta.value = 0.123
    controls.firm.value = not controls.firm.value
    assert page.messages == []


def test_push_buttons_say_force_or_torque(page):
    controls = page.panel.controls
    controls.side.value = "−y"
    controls.force.value = 7.0
    assert controls._push_message(2.0) == messages.Push((0.0, -7.0, 0.0), (0.0, 0.0, 0.0), 2.0)
    controls.side.value = "+yaw"
    assert controls.force.label == "Torque [N·m]"
    assert controls.force.max == 4.0
    controls.force.value = 1.5
    assert controls._push_message(0.4) == messages.Push((0.0, 0.0, 0.0), (0.0, 0.0, 1.5), 0.4)


def test_a_typed_number_outside_its_range_becomes_the_bound_and_is_shown(page):
    controls = page.panel.controls
    for typed, shown in ((100.0, 40.0), (-3.0, 0.0), (7.0, 7.0)):
        move(controls.force, typed)
        assert controls.force.value == shown
        assert controls._push_message(2.0).force == (0.0, shown, 0.0)
    move(controls.eta, -3.0)
    move(controls.strength["y", "soft"], (-2.0, 3.0))
    eta, soft = page.messages
    assert eta.value == controls.eta.value == 0.0
    assert soft.fields["soft"] == controls.strength["y", "soft"].value == (0.0, 3.0)


@pytest.mark.parametrize(("width", "count"), [(1000, 1), (1060, 0)])
def test_the_left_panel_is_minimized_in_a_narrow_window(page, width, count):
    queue = []
    client = SimpleNamespace(
        camera=SimpleNamespace(image_width=width),
        _websock_connection=SimpleNamespace(queue_message=queue.append),
    )
    page.panel.fit(client)
    assert [message.collapsed for message in queue] == [True] * count


def test_gizmo_says_a_target_and_is_left_alone_while_it_is_dragged(page):
    gizmo = page.scene_view.gizmo
    gizmo.position, gizmo.wxyz = (0.3, 0.1, -0.2), (1.0, 0.0, 0.0, 0.0)
    drag(page.scene_view._on_gizmo, target=gizmo, phase="start")
    np.testing.assert_allclose(page.messages[0].pose[:3, 3], (0.3, 0.1, -0.2))
    page.scene_view.show(page.running[-1])
    np.testing.assert_allclose(gizmo.position, (0.3, 0.1, -0.2))
    drag(page.scene_view._on_gizmo, target=gizmo, phase="end")
    page.scene_view.show(page.running[-1])
    np.testing.assert_allclose(gizmo.position, page.running[-1].step.target[:3, 3])


def test_dragging_the_arm_grabs_pulls_and_lets_go(page):
    handler = page.scene_view._drag_handler(np.array([3]))
    fields = {"instance_index": 0, "start_position": (0.1, 0.0, 0.0), "end_position": (0.2, 0, 0)}
    for phase in ("start", "update", "end"):
        drag(handler, phase=phase, client_id=7, **fields)
    first, second, last = page.messages
    assert (first.body, first.point, first.toward) == (3, (0.1, 0.0, 0.0), (0.2, 0, 0))
    assert second.point is None
    assert last == messages.LetGo()


def test_every_part_of_the_arm_can_be_dragged(page):
    for group in page.scene_view._mujoco_scene._mesh_groups:
        assert group.handle._impl.drag_cb
    shaped = {visual.body for visual in page.info.visuals}
    assert shaped
    for body in shaped:
        assert page.scene_view._nodes[body]._impl.drag_cb


def test_only_the_tab_that_holds_the_arm_lets_go_when_it_closes(page):
    closing = Page.__new__(Page)
    closing.scene_view, closing._send = page.scene_view, page.messages.append
    for held_by, closed_tab, notice in ((None, 3, []), (7, 3, []), (7, 7, [messages.LetGo()])):
        page.scene_view.held_by = held_by
        closing._on_disconnect(SimpleNamespace(client_id=closed_tab))
        assert page.messages == notice
    page.scene_view.held_by = None


@pytest.fixture
def served(monkeypatch, recording):
    """Return a page with a scene, and its messages."""
    serve = websockets.asyncio.server.serve
    monkeypatch.setattr(websockets.asyncio.server, "serve", serve)  # `Page` replaces it
    sent = []
    page = Page(sent.append, "127.0.0.1", 8260)
    page.receive(recording.info)
    yield page, sent
    page.server.stop()


#: First message of a browser, after which viser counts it as connected.
CAMERA = {
    "type": "ViewerCameraMessage",
    **dict.fromkeys(("fov", "near", "far"), 1.0),
    **dict.fromkeys(("image_height", "image_width"), 9),
    **dict.fromkeys(("position", "look_at", "up_direction"), (0.0, 0.0, 1.0)),
    "wxyz": (1.0, 0.0, 0.0, 0.0),
}


def test_a_browser_sets_values_of_controls_only(served):
    page, sent = served
    origin, _, token = page.link.partition("/#token=")
    protocol = f"viser-v{viser.__version__}"
    with connect(
        f"{origin.replace('http', 'ws')}/?token={token}", origin=origin, subprotocols=[protocol]
    ) as browser:
        stop = page.panel.stop.stop
        browser.send(msgpack.encode(CAMERA))
        for updates in ({"removed": True}, {"disabled": True, "value": True}, {"value": True}):
            message = {"type": "GuiUpdateMessage", "uuid": stop._impl.uuid, "updates": updates}
            browser.send(msgpack.encode(message))
        deadline = time.monotonic() + 20.0
        while not sent and time.monotonic() < deadline:
            time.sleep(0.01)
        assert sent == [messages.Stop()]
        assert [stop._impl.removed, stop.disabled] == [False, False]
        browser.send(bytes(100_000))
        with pytest.raises(ConnectionClosed, match="1009"):
            list(browser)


def test_the_page_is_shown_in_the_thread_that_wakes_its_connections(served, recording, monkeypatch):
    page, _ = served
    threads = []
    monkeypatch.setattr(page.panel, "show", lambda _: threads.append(threading.get_ident()))
    asyncio.run_coroutine_threadsafe(
        asyncio.to_thread(page.receive, recording.running[0]), page.server.get_event_loop()
    ).result()
    page.receive(recording.running[0])
    loop = asyncio.run_coroutine_threadsafe(ident(), page.server.get_event_loop()).result()
    assert threads == [loop] * 2


async def ident():
    return threading.get_ident()
