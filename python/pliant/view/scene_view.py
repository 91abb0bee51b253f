"""3-D scene of the browser page: arm, draggable target, walls, force arrow, dragging of the arm."""

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

    Send = Callable[[messages.Message], None]

#: Smallest reach of an arm for which target, arrows and axes are drawn in nominal size [m]; for a
#: smaller arm, they are scaled down in proportion.
REFERENCE_REACH = 0.71
#: Length of the force arrow for the largest push, radius of its shaft, radius and length of its
#: head, all [m].
ARROW_LENGTH, SHAFT_RADIUS, HEAD_RADIUS, HEAD_LENGTH = 0.6, 0.006, 0.016, 0.035
#: RGB colours (0 to 255) of the force arrow, the line from tool to target, the walls, and the post
#: under a hanging arm.
ARROW_COLOUR, LINE_COLOUR, WALL_COLOUR, POST_COLOUR = (
    (235, 87, 60),
    (46, 125, 220),
    (150, 165, 180),
    (205, 211, 219),
)
#: RGB colour of the links (0 to 1).
LINK_COLOUR = (0.42, 0.48, 0.56)
#: RGB colours (0 to 255) of a joint with torque limit zero and with its maximum torque.
NO_TORQUE_COLOUR, FULL_TORQUE_COLOUR = (52, 62, 78), (255, 106, 19)
#: Change of a colour component above which the new colour is sent to the browser.
COLOUR_STEP = 6
#: Number of the MuJoCo geom group for shapes that are not drawn.
HIDDEN_GROUP = 5
#: Largest height of the base frame above the floor for which no post is drawn under the arm [m].
TABLE_TOLERANCE = 0.05
#: Length of the drawn base axes [m].
AXES_LENGTH = 0.32
#: Edge length of a drawn wall [m].
WALL_SIZE = 0.5
#: Size of the draggable arrows at the target [m].
GIZMO_SIZE = 0.16
#: Minimum factor by which the lengths of drawn objects are scaled for a small arm [1].
MIN_SCALE = 0.3
#: Vertical field of view of the camera [rad].
FOV = 0.75
#: Assumed ratio of width to height of the visible part of the scene, between the panels [1].
ASPECT = 0.75
#: Unit vector from the centre of the arm to the camera, base axes.
VIEW_DIRECTION = np.array((0.532, -0.745, 0.404))
#: No line from tool to target is drawn if their distance is below this [m].
MIN_LINE_LENGTH = 0.002


class SceneView:
    """Drawing of one scene: the arm, its target and the objects around it.

    Attributes:
        gizmo: Arrows with which the user drags the target.
        held_by: viser's number of the client that drags the arm; None: no client drags it.
    """

    def __init__(self, server: viser.ViserServer, info: SceneInfo, send: Send) -> None:
        """Remove the last scene and draw a new one; `send` gets messages when a user drags."""
        self._server, self._send, self._info = server, send, info
        size = self._size = float(np.clip(info.reach / REFERENCE_REACH, MIN_SCALE, 1.0))
        scene = server.scene
        scene.reset()
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        self._data = mujoco.MjData(info.mj_model)
        shapes = _body_meshes(info)
        _paint(info.mj_model, set(shapes))
        self._mujoco_scene = ViserMujocoScene(server, info.mj_model, num_envs=1)
        self._mujoco_scene.camera_tracking_enabled = False
        scene.configure_environment_map(environment_intensity=0.35)
        # One node per body, as parent of the drawn joints, which then move with the body.
        jointed = {int(info.mj_model.jnt_bodyid[info.mj_model.joint(j).id]) for j in info.joints}
        self._nodes: dict[int, viser.SceneNodeHandle] = {
            body: scene.add_mesh_trimesh(f"/arm/{body}", shapes[body])
            if body in shapes
            else scene.add_frame(f"/arm/{body}", show_axes=False)
            for body in sorted(jointed | set(shapes))
        }
        self._drums = JointDrums(scene, info)
        self._data.qpos[:] = info.start
        mujoco.mj_kinematics(info.mj_model, self._data)
        self._place_nodes()
        _ground(scene, info, size)
        camera = server.initial_camera
        camera.look_at, camera.position = camera_view(
            info.mj_model, self._data, info.home[:3, 3], GIZMO_SIZE * size
        )
        camera.fov = FOV
        for number, (point, into) in enumerate(info.walls):
            _wall(scene, f"/walls/{number}", point, into)
        self._arrow = scene.add_arrows(
            "/hand",
            np.zeros((1, 2, 3)),
            ARROW_COLOUR,
            shaft_radius=SHAFT_RADIUS * size,
            head_radius=HEAD_RADIUS * size,
            head_length=HEAD_LENGTH * size,
            visible=False,
        )
        self._target_line = scene.add_line_segments(
            "/leash",
            np.zeros((1, 2, 3)),
            LINE_COLOUR,
            thickness=2.5,
            thickness_units="screen",
            visible=False,
        )
        self._dragging = False
        self.held_by: int | None = None
        self._has_rotations = bool({"roll", "pitch", "yaw"} & set(info.axes))
        self.gizmo = scene.add_transform_controls(
            "/target",
            scale=GIZMO_SIZE * size,
            line_width=3.0,
            disable_sliders=True,
            disable_rotations=not self._has_rotations,
            depth_test=False,
            wxyz=self._gizmo_orientation(info.home),
            position=info.home[:3, 3],
        )
        self.gizmo.on_update(self._on_gizmo)
        if info.max_push is not None:
            for group in self._mujoco_scene._mesh_groups:
                group.handle.on_drag("left")(self._drag_handler(group.body_ids))
            for body, node in self._nodes.items():
                if isinstance(node, viser.GlbHandle):
                    node.on_drag("left")(self._drag_handler((body,)))

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot of the arm in the scene."""
        self._data.qpos[:] = snapshot.qpos
        self._data.mocap_pos[:], self._data.mocap_quat[:] = snapshot.mocap
        mujoco.mj_kinematics(self._info.mj_model, self._data)
        self._mujoco_scene.update_from_mjdata(self._data)
        self._place_nodes()
        self._drums.show(snapshot)
        self._show_hand(snapshot)
        step = snapshot.step
        if step is None:
            self._target_line.visible = False
            return
        if not self._dragging:
            self.gizmo.position = step.target[:3, 3]
            self.gizmo.wxyz = self._gizmo_orientation(step.target)
        ends = np.stack((snapshot.tool[:3, 3], step.target[:3, 3]))[None]
        self._target_line.visible = bool(np.linalg.norm(ends[0, 1] - ends[0, 0]) > MIN_LINE_LENGTH)
        self._target_line.points = ends.astype(np.float32)

    def _place_nodes(self) -> None:
        """Move the nodes of the arm's bodies to their poses in the MuJoCo data."""
        for body, node in self._nodes.items():
            node.position, node.wxyz = self._data.xpos[body], self._data.xquat[body]

    def _show_hand(self, snapshot: Snapshot) -> None:
        shown = False
        if snapshot.hand_force is not None:
            point, force = snapshot.hand_force
            arrow = force * (self._size * ARROW_LENGTH / max(self._info.force, 1e-9))
            shown = bool(np.linalg.norm(arrow) > 0.004)
            if shown:
                # Let the arrow end at the point of application, like a push from outside.
                self._arrow.points = np.stack((point - arrow, point))[None].astype(np.float32)
        self._arrow.visible = shown

    def _gizmo_orientation(self, target: Array) -> Array:
        """Return the quaternion wxyz at which the gizmo is drawn.

        It is the orientation of the target (4, 4), or the identity if the task has no rotation
        axes.
        """
        rotation = target[:3, :3] if self._has_rotations else np.eye(3)
        return np.asarray(tf.SO3.from_matrix(rotation).wxyz)

    async def _on_gizmo(self, event: viser.TransformControlsEvent) -> None:
        """Send the pose of the gizmo as new target; a coroutine, so that viser keeps the order."""
        self._dragging = event.phase != "end"
        pose = self._info.home.copy()
        if self._has_rotations:
            pose[:3, :3] = tf.SO3(np.asarray(event.target.wxyz)).as_matrix()
        pose[:3, 3] = event.target.position
        self._send(messages.Target(pose))

    def _drag_handler(self, bodies: Any) -> Callable[[Any], Any]:
        """Return a handler of viser's drag events on drawn bodies; it sends `Grab` and `LetGo`.

        `bodies` holds the index of the MuJoCo body of each instance in the drawn object.
        """

        async def on_drag_event(event: Any) -> None:
            body = int(bodies[event.instance_index or 0])
            if event.phase == "end":
                self.held_by = None
                self._send(messages.LetGo())
                return
            self.held_by = event.client_id
            first = event.start_position if event.phase == "start" else None
            self._send(messages.Grab(body, first, event.end_position))

        return on_drag_event


class JointDrums:
    """Joints drawn as cylinders around their axes; the colour shows the torque limit."""

    def __init__(self, scene: viser.SceneApi, info: SceneInfo) -> None:
        """Add a cylinder on the axis of every joint of the chain, fixed to the body it moves."""
        mj_model = info.mj_model
        self._max_torque = info.max_torque
        is_link = [mj_model.body(int(b)).name.startswith("body:") for b in mj_model.geom_bodyid]
        link_radius = float(mj_model.geom_size[is_link, 0].max(initial=0.008))
        # With URDF shapes, which cover the joints, make the cylinders thinner and longer.
        radius, height = (0.7, 3.2) if info.visuals else (1.2, 2.5)
        drum = trimesh.creation.cylinder(
            radius=radius * link_radius, height=height * link_radius, sections=40
        )
        drum.unmerge_vertices()
        self._colours = np.tile(np.array(NO_TORQUE_COLOUR), (len(info.joints), 1))
        self._drums = []
        for name in info.joints:
            joint = mj_model.joint(name).id
            body = int(mj_model.jnt_bodyid[joint])
            self._drums.append(
                scene.add_mesh_simple(
                    f"/arm/{body}/{name}",
                    vertices=drum.vertices,
                    faces=drum.faces,
                    color=NO_TORQUE_COLOUR,
                    position=mj_model.jnt_pos[joint],
                    wxyz=_upright_to(mj_model.jnt_axis[joint][None])[0],
                )
            )

    def show(self, snapshot: Snapshot) -> None:
        """Colour the cylinder of every joint by the ratio of torque limit to maximum torque."""
        share = np.zeros(len(self._drums))
        if snapshot.step is not None:
            share = np.clip(snapshot.step.limit / np.maximum(self._max_torque, 1e-9), 0.0, 1.0)
        mixed = np.array(NO_TORQUE_COLOUR) + share[:, None] ** 2 * (
            np.array(FULL_TORQUE_COLOUR) - np.array(NO_TORQUE_COLOUR)
        )
        for i, colour in enumerate(mixed.round().astype(int)):
            if np.abs(colour - self._colours[i]).max() > COLOUR_STEP:
                self._colours[i] = colour
                red, green, blue = colour.tolist()
                self._drums[i].color = (red, green, blue)


def _upright_to(axes: Array) -> Array:
    """Return quaternions wxyz (n, 4) that rotate the z axis onto unit vectors (n, 3)."""
    quats = np.stack((1.0 + axes[:, 2], -axes[:, 1], axes[:, 0], np.zeros(len(axes))), axis=1)
    quats[axes[:, 2] < -1.0 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    out: Array = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    return out


def _paint(mj_model: mujoco.MjModel, bodies_with_meshes: set[int]) -> None:
    """Colour the links of the arm; hide planes, and simulated shapes of bodies with URDF shapes."""
    for i in range(mj_model.ngeom):
        body = int(mj_model.geom_bodyid[i])
        if mj_model.body(body).name.startswith("body:"):
            mj_model.geom_rgba[i] = (*LINK_COLOUR, 1.0)
        if body in bodies_with_meshes or mj_model.geom_type[i] == mujoco.mjtGeom.mjGEOM_PLANE:
            mj_model.geom_group[i] = HIDDEN_GROUP


def _body_meshes(info: SceneInfo) -> dict[int, trimesh.Trimesh]:
    """Return one mesh per MuJoCo body, in the frame of the body, from the shapes of the URDF.

    Bodies with an invalid mesh file are left out.
    """
    parts: dict[int, list[trimesh.Trimesh]] = {}
    broken: set[int] = set()
    for visual in info.visuals:
        try:
            parts.setdefault(visual.body, []).append(visual.mesh())
        except Exception:
            # Ignore errors in mesh files, which users supply; any other error is a defect.
            if visual.kind != "mesh":
                raise
            broken.add(visual.body)
    out: dict[int, Any] = {b: trimesh.util.concatenate(meshes) for b, meshes in parts.items()}
    return {body: mesh for body, mesh in out.items() if body not in broken}


def _floor_height(info: SceneInfo) -> float:
    """Return the height of the floor in base axes [m]."""
    mj_model = info.mj_model
    planes = np.flatnonzero(mj_model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    if planes.size:
        return float(mj_model.geom_pos[planes[0], 2])
    if info.table is not None:
        return info.table
    # Without a known table, assume that the base stands on the floor if its lowest point is near
    # the base frame.
    standing = [v for v in info.visuals if mj_model.body(v.body).parentid[0] == 0]
    lows = [v.mesh().bounds[0, 2] for v in standing if v.kind != "mesh"]
    if lows and abs(min(lows)) < TABLE_TOLERANCE:
        return float(min(lows))
    height = float(info.home[2, 3])
    return 0.0 if height > -TABLE_TOLERANCE else height - 0.3


def _ground(scene: viser.SceneApi, info: SceneInfo, size: float) -> None:
    """Draw the floor with the base axes, and a post under an arm that hangs above the floor."""
    floor = _floor_height(info)
    scene.add_grid(
        "/floor",
        width=2.4,
        height=2.4,
        position=(0.0, 0.0, floor),
        cell_size=0.1,
        section_size=0.4,
        cell_color=(222, 227, 233),
        section_color=(198, 206, 216),
        shadow_opacity=0.0,
    )
    if floor < -TABLE_TOLERANCE:
        scene.add_box(
            "/post",
            color=POST_COLOUR,
            dimensions=(0.03, 0.03, -floor),
            position=(-0.02, 0.0, 0.5 * floor),
        )
    length = AXES_LENGTH * size
    scene.add_frame(
        "/axes",
        axes_length=length,
        axes_radius=0.012 * length,
        origin_radius=0.02 * length,
        position=(0.0, 0.0, floor),
    )
    for name, axis in zip("xyz", np.eye(3), strict=True):
        scene.add_label(f"/axes/{name}", name, position=1.08 * length * axis)


def camera_view(
    mj_model: mujoco.MjModel, data: mujoco.MjData, tool: Array, room: float
) -> tuple[Array, Array]:
    """Return the point at which the camera looks and the camera position, (3,) [m] each.

    The camera sees all links in the state `data`, and a sphere of radius `room` [m] around the tool
    position `tool` (3,) [m].
    """
    is_link = [mj_model.body(int(b)).name.startswith("body:") for b in mj_model.geom_bodyid]
    points = np.vstack((data.geom_xpos[is_link], tool))
    sizes = np.append(mj_model.geom_rbound[is_link], room)
    centre = 0.5 * ((points - sizes[:, None]).min(axis=0) + (points + sizes[:, None]).max(axis=0))
    radius = float((np.linalg.norm(points - centre, axis=1) + sizes).max())
    # Use the horizontal field of view: the part of the window between the panels is narrower than
    # it is high.
    half = np.arctan(np.tan(0.5 * FOV) * ASPECT)
    return centre, centre + radius / np.sin(half) * VIEW_DIRECTION


def _wall(scene: viser.SceneApi, name: str, point: Array, into: Array) -> None:
    side = np.cross(into, (0.0, 0.0, 1.0) if abs(into[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    rotation = np.stack([into, side, np.cross(into, side)], axis=1)
    scene.add_box(
        name,
        color=WALL_COLOUR,
        dimensions=(0.02, WALL_SIZE, WALL_SIZE),
        opacity=0.55,
        position=point + 0.01 * into,
        wxyz=tf.SO3.from_matrix(rotation).wxyz,
    )
