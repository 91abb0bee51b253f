"""The scene in three dimensions: arm, target gizmo, walls, the arrow of the hand, dragging."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import trimesh
import viser
import viser.transforms as tf
from mjviser.scene import ViserMujocoScene

from pliant.view import orders

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pliant.view.snapshot import Snapshot, Stage

    Array = NDArray[np.float64]
    Tell = Callable[[orders.Order], None]

#: Reach of an arm [m] for which lengths are given here; those of smaller ones shrink with them.
REACH = 0.71
#: Length of an arrow that stands for the largest push, thickness of its shaft and head, length of
#: its head [m].
LONGEST, SHAFT, HEAD, POINT = 0.25, 0.006, 0.016, 0.035
#: Colours: the hand's arrow, the line from tool to target, walls.
HAND, LEASH, WALL, POST = (235, 87, 60), (46, 125, 220), (150, 165, 180), (205, 211, 219)
#: Links, as shares of red, green, blue; drums of joints with no torque and with all of it; a change
#: of colour that is worth sending.
LINK = (0.42, 0.48, 0.56)
COOL, WARM, NOTICED = (52, 62, 78), (255, 106, 19), 6
#: Size of a wall that is drawn [m].
EXTENT = 0.5
#: Size of the arrows at the target, as drawn [m].
GIZMO = 0.16
#: Least share to which lengths shrink.
SMALLEST = 0.3
#: Angle of view from top to bottom [rad], least width over height of what the panels leave of the
#: window, and where the eye is from the middle of the arm.
FOV, ASPECT = 0.75, 0.75
SIDE = np.array((0.532, -0.745, 0.404))
#: A tool this near to its target needs no line [m].
NEAR = 0.002


class World:
    """What stands in the scene, until the stage changes.

    Attributes:
        gizmo: The target, to be dragged.
        held_by: Number of the tab that drags the arm; None: none does.
    """

    def __init__(self, server: viser.ViserServer, stage: Stage, tell: Tell) -> None:
        """Draw the stage; whoever drags something in it tells the arm."""
        self._server, self._tell, self._stage = server, tell, stage
        size = self._size = float(np.clip(stage.reach / REACH, SMALLEST, 1.0))
        scene = server.scene
        scene.reset()
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        self._data = mujoco.MjData(stage.figure)
        _paint(stage.figure)
        self._figure = ViserMujocoScene(server, stage.figure, num_envs=1)
        self._figure.camera_tracking_enabled = False
        scene.configure_environment_map(environment_intensity=0.35)
        self._hinges = Hinges(scene, stage)
        _ground(scene, stage)
        self._data.qpos[:] = stage.start
        mujoco.mj_kinematics(stage.figure, self._data)
        camera = server.initial_camera
        camera.look_at, camera.position = overlook(
            stage.figure, self._data, stage.home[:3, 3], GIZMO * size
        )
        camera.fov = FOV
        for number, (point, into) in enumerate(stage.walls):
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
        self._leash = scene.add_line_segments(
            "/leash",
            np.zeros((1, 2, 3)),
            LEASH,
            thickness=2.5,
            thickness_units="screen",
            visible=False,
        )
        self._dragging = False
        self.held_by: int | None = None
        self._turns = bool({"roll", "pitch", "yaw"} & set(stage.axes))
        self.gizmo = scene.add_transform_controls(
            "/target",
            scale=GIZMO * size,
            line_width=3.0,
            disable_sliders=True,
            disable_rotations=not self._turns,
            depth_test=False,
            wxyz=self._handles(stage.home),
            position=stage.home[:3, 3],
        )
        self.gizmo.on_update(self._led)
        if stage.strong is not None:
            for group in self._figure._mesh_groups:
                group.handle.on_drag("left")(self._pulled(group.body_ids))

    def show(self, now: Snapshot) -> None:
        """Move everything to where it is."""
        self._data.qpos[:] = now.qpos
        self._data.mocap_pos[:], self._data.mocap_quat[:] = now.mocap
        mujoco.mj_kinematics(self._stage.figure, self._data)
        self._figure.update_from_mjdata(self._data)
        self._hinges.show(self._data, now)
        self._show_hand(now)
        step = now.step
        if step is None:
            self._leash.visible = False
            return
        if not self._dragging:
            self.gizmo.position = step.target[:3, 3]
            self.gizmo.wxyz = self._handles(step.target)
        ends = np.stack((now.tool[:3, 3], step.target[:3, 3]))[None]
        self._leash.visible = bool(np.linalg.norm(ends[0, 1] - ends[0, 0]) > NEAR)
        self._leash.points = ends.astype(np.float32)

    def _show_hand(self, now: Snapshot) -> None:
        shown = False
        if now.pull is not None:
            point, force = now.pull
            way = force * (self._size * LONGEST / max(self._stage.force, 1e-9))
            shown = bool(np.linalg.norm(way) > 0.004)
            if shown:
                # Its head is at the point of attack: a hand pushes.
                self._arrow.points = np.stack((point - way, point))[None].astype(np.float32)
        self._arrow.visible = shown

    def _handles(self, target: Array) -> Array:
        """How the arrows of a target (4, 4) stand: as it, or along the axes if nothing turns."""
        turned = target[:3, :3] if self._turns else np.eye(3)
        return np.asarray(tf.SO3.from_matrix(turned).wxyz)

    async def _led(self, event: viser.TransformControlsEvent) -> None:
        """The gizmo: in order, hence on the server's own thread."""
        self._dragging = event.phase != "end"
        pose = self._stage.home.copy()
        if self._turns:
            pose[:3, :3] = tf.SO3(np.asarray(event.target.wxyz)).as_matrix()
        pose[:3, 3] = event.target.position
        self._tell(orders.Target(pose))

    def _pulled(self, bodies: Any) -> Callable[[Any], Any]:
        """What follows where a body of the arm is dragged."""

        async def pulled(event: Any) -> None:
            body = int(bodies[event.instance_index or 0])
            if event.phase == "end":
                self.held_by = None
                self._tell(orders.LetGo())
                return
            self.held_by = event.client_id
            first = event.start_position if event.phase == "start" else None
            self._tell(orders.Grab(body, first, event.end_position))

        return pulled


class Hinges:
    """The joints as drums, the warmer the more of its torque a servo may use."""

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        """Find the joints of the chain."""
        figure = stage.figure
        self._usable = stage.usable
        self._ids = [figure.joint(name).id for name in stage.joints]
        arm = [figure.body(int(b)).name.startswith("body:") for b in figure.geom_bodyid]
        thick = float(figure.geom_size[arm, 0].max(initial=0.008))
        drum = trimesh.creation.cylinder(radius=1.2 * thick, height=2.5 * thick, sections=40)
        count = len(self._ids)
        self._colours = np.tile(np.array(COOL, dtype=np.uint8), (count, 1))
        self._drums = scene.add_batched_meshes_simple(
            "/hinges",
            vertices=drum.vertices,
            faces=drum.faces,
            batched_wxyzs=np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)),
            batched_positions=np.zeros((count, 3)),
            batched_colors=self._colours,
            flat_shading=False,
            lod="off",
        )

    def show(self, data: mujoco.MjData, now: Snapshot) -> None:
        """Put every drum on its axis, and colour it by the limit."""
        self._drums.batched_positions = data.xanchor[self._ids].astype(np.float32)
        self._drums.batched_wxyzs = _upright_to(data.xaxis[self._ids]).astype(np.float32)
        share = np.zeros(len(self._ids))
        if now.step is not None:
            share = np.clip(now.step.limit / np.maximum(self._usable, 1e-9), 0.0, 1.0)
        mixed = np.array(COOL) + share[:, None] ** 2 * (np.array(WARM) - np.array(COOL))
        colours = mixed.round().astype(np.uint8)
        if np.abs(colours.astype(int) - self._colours.astype(int)).max() > NOTICED:
            self._drums.batched_colors = self._colours = colours


def _upright_to(axes: Array) -> Array:
    """Quaternions wxyz (n, 4) that turn z into unit vectors (n, 3)."""
    quats = np.stack((1.0 + axes[:, 2], -axes[:, 1], axes[:, 0], np.zeros(len(axes))), axis=1)
    quats[axes[:, 2] < -1.0 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    out: Array = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    return out


def _paint(figure: mujoco.MjModel) -> None:
    """Links darker than the page."""
    for i in range(figure.ngeom):
        if figure.body(int(figure.geom_bodyid[i])).name.startswith("body:"):
            figure.geom_rgba[i] = (*LINK, 1.0)


def _ground(scene: viser.SceneApi, stage: Stage) -> None:
    """A floor that the arm does not reach, and a post that carries an arm high above it."""
    height = float(stage.home[2, 3])
    low = 0.0 if height > 0.0 else height - 0.3
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
    if low < 0.0:
        scene.add_box(
            "/post",
            color=POST,
            dimensions=(0.06, 0.16, 0.05 - low),
            position=(-0.075, 0.0, 0.5 * (low + 0.05)),
        )


def overlook(
    figure: mujoco.MjModel, data: mujoco.MjData, tool: Array, room: float
) -> tuple[Array, Array]:
    """Where to look (3,), and from where (3,) [m]: front and side, so far that all is seen.

    All is the sphere around the links, as the data have them, and `room` [m] around the tool (3,).
    """
    arm = [figure.body(int(b)).name.startswith("body:") for b in figure.geom_bodyid]
    points = np.vstack((data.geom_xpos[arm], tool))
    sizes = np.append(figure.geom_rbound[arm], room)
    middle = 0.5 * ((points - sizes[:, None]).min(axis=0) + (points + sizes[:, None]).max(axis=0))
    around = float((np.linalg.norm(points - middle, axis=1) + sizes).max())
    # Panels leave less of the width than of the height.
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
