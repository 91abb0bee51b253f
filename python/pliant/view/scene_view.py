"""The 3-D scene: arm, target gizmo, walls, arrow of the hand, dragging."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import trimesh
import viser
import viser.transforms as tf
from mjviser.scene import ViserMujocoScene

from pliant.view import messages

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant._typing import Array
    from pliant.view.snapshot import SceneInfo, Snapshot

    Tell = Callable[[messages.Message], None]

#: Reach of an arm [m] for the lengths given here; smaller arms scale them down.
REACH = 0.71
#: Length of the arrow of the largest push, thickness of its shaft and head, length of its head
#: [m].
LONGEST, SHAFT, HEAD, POINT = 0.6, 0.006, 0.016, 0.035
#: Colours: the hand's arrow, the line from tool to target, walls.
HAND, TARGET_LINE, WALL, POST = (235, 87, 60), (46, 125, 220), (150, 165, 180), (205, 211, 219)
#: Links, as shares of red, green, blue; drums of joints with no torque and with all of it; a change
#: of colour that is worth sending.
LINK = (0.42, 0.48, 0.56)
COOL, WARM, NOTICED = (52, 62, 78), (255, 106, 19), 6
#: Group of hidden shapes.
HIDDEN = 5
#: Depth below the base from which an arm counts as hanging, not standing on a table [m].
STANDS = 0.05
#: Length of the axes on the floor [m].
AXES = 0.32
#: Size of a drawn wall [m].
EXTENT = 0.5
#: Drawn size of the arrows at the target [m].
GIZMO = 0.16
#: Smallest scale of the lengths.
SMALLEST = 0.3
#: Angle of view from top to bottom [rad], least width over height of what the panels leave of the
#: window, and where the eye is from the middle of the arm.
FOV, ASPECT = 0.75, 0.75
SIDE = np.array((0.532, -0.745, 0.404))
#: Distance to the target below which no line is drawn [m].
NEAR = 0.002


class SceneView:
    """The 3-D scene, until the scene changes.

    Attributes:
        gizmo: The draggable target.
        held_by: Number of the browser tab that drags the arm; None: no tab.
    """

    def __init__(self, server: viser.ViserServer, info: SceneInfo, send: Tell) -> None:
        """Draw the scene; dragging sends messages by `send`."""
        self._server, self._send, self._info = server, send, info
        size = self._size = float(np.clip(info.reach / REACH, SMALLEST, 1.0))
        scene = server.scene
        scene.reset()
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        self._data = mujoco.MjData(info.figure)
        shapes = _shapes(info)
        _paint(info.figure, set(shapes))
        self._figure = ViserMujocoScene(server, info.figure, num_envs=1)
        self._figure.camera_tracking_enabled = False
        scene.configure_environment_map(environment_intensity=0.35)
        # Child nodes of a body's node cannot lag behind it.
        moved = {int(info.figure.jnt_bodyid[info.figure.joint(j).id]) for j in info.joints}
        self._nodes: dict[int, viser.SceneNodeHandle] = {
            body: scene.add_mesh_trimesh(f"/arm/{body}", shapes[body])
            if body in shapes
            else scene.add_frame(f"/arm/{body}", show_axes=False)
            for body in sorted(moved | set(shapes))
        }
        self._hinges = Hinges(scene, info)
        self._data.qpos[:] = info.start
        mujoco.mj_kinematics(info.figure, self._data)
        self._place_nodes()
        _ground(scene, info, size)
        camera = server.initial_camera
        camera.look_at, camera.position = overlook(
            info.figure, self._data, info.home[:3, 3], GIZMO * size
        )
        camera.fov = FOV
        for number, (point, into) in enumerate(info.walls):
            _wall(scene, f"/walls/{number}", point, into)
        self._arrow = scene.add_arrows(
            "/hand",
            np.zeros((1, 2, 3)),
            HAND,
            shaft_radius=SHAFT * size,
            head_radius=HEAD * size,
            head_length=POINT * size,
            visible=False,
        )
        self._target_line = scene.add_line_segments(
            "/leash",
            np.zeros((1, 2, 3)),
            TARGET_LINE,
            thickness=2.5,
            thickness_units="screen",
            visible=False,
        )
        self._dragging = False
        self.held_by: int | None = None
        self._turns = bool({"roll", "pitch", "yaw"} & set(info.axes))
        self.gizmo = scene.add_transform_controls(
            "/target",
            scale=GIZMO * size,
            line_width=3.0,
            disable_sliders=True,
            disable_rotations=not self._turns,
            depth_test=False,
            wxyz=self._handles(info.home),
            position=info.home[:3, 3],
        )
        self.gizmo.on_update(self._on_gizmo)
        if info.max_push is not None:
            for group in self._figure._mesh_groups:
                group.handle.on_drag("left")(self._drag_handler(group.body_ids))
            for body, node in self._nodes.items():
                if isinstance(node, viser.GlbHandle):
                    node.on_drag("left")(self._drag_handler((body,)))

    def show(self, now: Snapshot) -> None:
        """Update the scene to a snapshot."""
        self._data.qpos[:] = now.qpos
        self._data.mocap_pos[:], self._data.mocap_quat[:] = now.mocap
        mujoco.mj_kinematics(self._info.figure, self._data)
        self._figure.update_from_mjdata(self._data)
        self._place_nodes()
        self._hinges.show(now)
        self._show_hand(now)
        step = now.step
        if step is None:
            self._target_line.visible = False
            return
        if not self._dragging:
            self.gizmo.position = step.target[:3, 3]
            self.gizmo.wxyz = self._handles(step.target)
        ends = np.stack((now.tool[:3, 3], step.target[:3, 3]))[None]
        self._target_line.visible = bool(np.linalg.norm(ends[0, 1] - ends[0, 0]) > NEAR)
        self._target_line.points = ends.astype(np.float32)

    def _place_nodes(self) -> None:
        """Update the nodes of the arm's bodies."""
        for body, node in self._nodes.items():
            node.position, node.wxyz = self._data.xpos[body], self._data.xquat[body]

    def _show_hand(self, now: Snapshot) -> None:
        shown = False
        if now.pull is not None:
            point, force = now.pull
            way = force * (self._size * LONGEST / max(self._info.force, 1e-9))
            shown = bool(np.linalg.norm(way) > 0.004)
            if shown:
                # Its head is at the point of application, as for a push.
                self._arrow.points = np.stack((point - way, point))[None].astype(np.float32)
        self._arrow.visible = shown

    def _handles(self, target: Array) -> Array:
        """Return the gizmo's orientation: the target's, or the base's if it cannot turn."""
        turned = target[:3, :3] if self._turns else np.eye(3)
        return np.asarray(tf.SO3.from_matrix(turned).wxyz)

    async def _on_gizmo(self, event: viser.TransformControlsEvent) -> None:
        """Send the gizmo's pose: in order, hence in the server's own thread."""
        self._dragging = event.phase != "end"
        pose = self._info.home.copy()
        if self._turns:
            pose[:3, :3] = tf.SO3(np.asarray(event.target.wxyz)).as_matrix()
        pose[:3, 3] = event.target.position
        self._send(messages.Target(pose))

    def _drag_handler(self, bodies: Any) -> Callable[[Any], Any]:
        """Return the handler for dragging a body of the arm."""

        async def pulled(event: Any) -> None:
            body = int(bodies[event.instance_index or 0])
            if event.phase == "end":
                self.held_by = None
                self._send(messages.LetGo())
                return
            self.held_by = event.client_id
            first = event.start_position if event.phase == "start" else None
            self._send(messages.Grab(body, first, event.end_position))

        return pulled


class Hinges:
    """Joints drawn as drums on the bodies that they move; the colour shows the torque limit."""

    def __init__(self, scene: viser.SceneApi, info: SceneInfo) -> None:
        """Place a drum on the axis of every joint of the chain."""
        figure = info.figure
        self._usable = info.usable
        arm = [figure.body(int(b)).name.startswith("body:") for b in figure.geom_bodyid]
        thick = float(figure.geom_size[arm, 0].max(initial=0.008))
        # With URDF shapes, only the ends of the drums are visible.
        radius, height = (0.7, 3.2) if info.visuals else (1.2, 2.5)
        drum = trimesh.creation.cylinder(radius=radius * thick, height=height * thick, sections=40)
        drum.unmerge_vertices()
        self._colours = np.tile(np.array(COOL), (len(info.joints), 1))
        self._drums = []
        for name in info.joints:
            joint = figure.joint(name).id
            body = int(figure.jnt_bodyid[joint])
            self._drums.append(
                scene.add_mesh_simple(
                    f"/arm/{body}/{name}",
                    vertices=drum.vertices,
                    faces=drum.faces,
                    color=COOL,
                    position=figure.jnt_pos[joint],
                    wxyz=_upright_to(figure.jnt_axis[joint][None])[0],
                )
            )

    def show(self, now: Snapshot) -> None:
        """Colour every drum by the limit of its joint."""
        share = np.zeros(len(self._drums))
        if now.step is not None:
            share = np.clip(now.step.limit / np.maximum(self._usable, 1e-9), 0.0, 1.0)
        mixed = np.array(COOL) + share[:, None] ** 2 * (np.array(WARM) - np.array(COOL))
        for i, colour in enumerate(mixed.round().astype(int)):
            if np.abs(colour - self._colours[i]).max() > NOTICED:
                self._colours[i] = colour
                red, green, blue = colour.tolist()
                self._drums[i].color = (red, green, blue)


def _upright_to(axes: Array) -> Array:
    """Return quaternions wxyz (n, 4) that turn z into unit vectors (n, 3)."""
    quats = np.stack((1.0 + axes[:, 2], -axes[:, 1], axes[:, 0], np.zeros(len(axes))), axis=1)
    quats[axes[:, 2] < -1.0 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    out: Array = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    return out


def _paint(figure: mujoco.MjModel, shaped: set[int]) -> None:
    """Draw links darker than the page; hide planes, and capsules of bodies with other shapes."""
    for i in range(figure.ngeom):
        body = int(figure.geom_bodyid[i])
        if figure.body(body).name.startswith("body:"):
            figure.geom_rgba[i] = (*LINK, 1.0)
        if body in shaped or figure.geom_type[i] == mujoco.mjtGeom.mjGEOM_PLANE:
            figure.geom_group[i] = HIDDEN


def _shapes(info: SceneInfo) -> dict[int, trimesh.Trimesh]:
    """Return one mesh per body of the arm whose shapes can be drawn, in the frame of the body."""
    parts: dict[int, list[trimesh.Trimesh]] = {}
    broken: set[int] = set()
    for visual in info.visuals:
        try:
            parts.setdefault(visual.body, []).append(visual.mesh())
        except Exception:
            # Only mesh files of users may be invalid.
            if visual.kind != "mesh":
                raise
            broken.add(visual.body)
    out: dict[int, Any] = {b: trimesh.util.concatenate(meshes) for b, meshes in parts.items()}
    return {body: mesh for body, mesh in out.items() if body not in broken}


def _height(info: SceneInfo) -> float:
    """Return the height of the floor under the arm [m]."""
    figure = info.figure
    planes = np.flatnonzero(figure.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    if planes.size:
        return float(figure.geom_pos[planes[0], 2])
    if info.table is not None:
        return info.table
    # A base drawn down to its frame stands on a table.
    standing = [v for v in info.visuals if figure.body(v.body).parentid[0] == 0]
    lows = [v.mesh().bounds[0, 2] for v in standing if v.kind != "mesh"]
    if lows and abs(min(lows)) < STANDS:
        return float(min(lows))
    height = float(info.home[2, 3])
    return 0.0 if height > -STANDS else height - 0.3


def _ground(scene: viser.SceneApi, info: SceneInfo, size: float) -> None:
    """Draw a floor with the base axes, and a post for an arm that hangs above it."""
    low = _height(info)
    scene.add_grid(
        "/floor",
        width=2.4,
        height=2.4,
        position=(0.0, 0.0, low),
        cell_size=0.1,
        section_size=0.4,
        cell_color=(222, 227, 233),
        section_color=(198, 206, 216),
        shadow_opacity=0.0,
    )
    if low < -STANDS:
        scene.add_box(
            "/post",
            color=POST,
            dimensions=(0.03, 0.03, -low),
            position=(-0.02, 0.0, 0.5 * low),
        )
    length = AXES * size
    scene.add_frame(
        "/axes",
        axes_length=length,
        axes_radius=0.012 * length,
        origin_radius=0.02 * length,
        position=(0.0, 0.0, low),
    )
    for name, way in zip("xyz", np.eye(3), strict=True):
        scene.add_label(f"/axes/{name}", name, position=1.08 * length * way)


def overlook(
    figure: mujoco.MjModel, data: mujoco.MjData, tool: Array, room: float
) -> tuple[Array, Array]:
    """Return look-at point (3,) and camera position (3,) [m], in front and to the side.

    The camera sees the sphere around the links at the data's positions, and `room` [m] around the
    tool (3,).
    """
    arm = [figure.body(int(b)).name.startswith("body:") for b in figure.geom_bodyid]
    points = np.vstack((data.geom_xpos[arm], tool))
    sizes = np.append(figure.geom_rbound[arm], room)
    middle = 0.5 * ((points - sizes[:, None]).min(axis=0) + (points + sizes[:, None]).max(axis=0))
    around = float((np.linalg.norm(points - middle, axis=1) + sizes).max())
    # Panels take more of the width than of the height.
    half = np.arctan(np.tan(0.5 * FOV) * ASPECT)
    return middle, middle + around / np.sin(half) * SIDE


def _wall(scene: viser.SceneApi, name: str, point: Array, into: Array) -> None:
    side = np.cross(into, (0.0, 0.0, 1.0) if abs(into[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    turn = np.stack([into, side, np.cross(into, side)], axis=1)
    scene.add_box(
        name,
        color=WALL,
        dimensions=(0.02, EXTENT, EXTENT),
        opacity=0.55,
        position=point + 0.01 * into,
        wxyz=tf.SO3.from_matrix(turn).wxyz,
    )
