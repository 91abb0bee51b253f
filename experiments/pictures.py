"""Pictures of the simulated arm, rendered without a display, on a transparent background."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant.sim import Plant
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from experiments.poses import Array

    Pixels = NDArray[np.uint8]

#: Exceptions that MuJoCo raises if off-screen rendering is not possible.
CANNOT_DRAW = (mujoco.FatalError, OSError, RuntimeError)
#: Pictures are rendered this many times larger and then reduced, for smooth edges.
FINER = 3
BONE, JOINT, HAND = (0.80, 0.82, 0.85, 1.0), (0.20, 0.24, 0.30, 1.0), (0.90, 0.38, 0.0, 1.0)
LEAF = (0.62, 0.72, 0.80, 0.80)


class Studio:
    """Renders pictures of a simulated arm at given joint positions, without simulating motion.

    Args:
        plant: The simulated arm with its fixtures, after a reset.
        size: Width and height of a picture [pixel].
        look_at: Look-at point of the camera, base axes [m].
        distance: Distance of the camera from the look-at point [m].
        azimuth, elevation: Viewing angles of the camera [deg].
        handle: True draws a bar in the hand, along z of the tool.
        trail: Points (k, 3) of a line through the scene, base axes [m].

    Raises:
        RuntimeError: MuJoCo was loaded without a rendering backend.
        mujoco.FatalError: The rendering backend does not work on this machine.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        size: tuple[int, int] = (360, 300),
        look_at: Sequence[float] = (0.25, 0.0, -0.18),
        distance: float = 1.25,
        azimuth: float = 130.0,
        elevation: float = -18.0,
        handle: bool = False,
        trail: Array | None = None,
    ) -> None:
        self._plant, self._size = plant, size
        spec = plant.spec.copy()
        furnish(spec, plant, handle=handle)
        for start, end in pairwise(trail if trail is not None else ()):
            line = spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=(0.003, 0, 0),
                rgba=HAND,
                contype=0,
                conaffinity=0,
            )
            line.fromto = (*start, *end)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        width, height = size
        try:
            self._renderer = mujoco.Renderer(self._model, FINER * height, FINER * width)
        except AttributeError as error:
            raise RuntimeError("MuJoCo was loaded without a way to draw (MUJOCO_GL)") from error
        self._camera = mujoco.MjvCamera()
        self._camera.lookat[:] = look_at
        self._camera.distance, self._camera.azimuth, self._camera.elevation = (
            distance,
            azimuth,
            elevation,
        )

    def __enter__(self) -> Studio:
        """Return this object; the constructor has opened the drawing context."""
        return self

    def __exit__(self, *_: object) -> None:
        """Free the drawing context; without this, it prints a warning when the process ends."""
        self._renderer.close()

    def picture(
        self, q: Array, joints: dict[str, float] | None = None, moved: Array | None = None
    ) -> Pixels:
        """Render the arm at given joint positions.

        Args:
            q: Joint positions of the chain (n,) [rad].
            joints: Positions of other joints by name, for example of a door's hinge [rad].
            moved: Displacement of the fixtures (3,) [m].

        Returns:
            Pixels (height, width, 4) with a transparent background.
        """
        data, model = self._data, self._model
        data.qpos[:] = self._plant.mj_data.qpos
        data.mocap_pos[:] = self._plant.mj_data.mocap_pos
        data.mocap_quat[:] = self._plant.mj_data.mocap_quat
        for name, angle in zip(self._plant.model.joint_names, q, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = angle
        for name, angle in (joints or {}).items():
            data.qpos[model.joint(name).qposadr[0]] = angle
        if moved is not None:
            data.mocap_pos[:] += moved
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self._renderer.update_scene(data, self._camera)
        colours = self._renderer.render().astype(np.float64)
        self._renderer.enable_segmentation_rendering()
        solid = (self._renderer.render()[:, :, 0] >= 0).astype(np.float64)
        self._renderer.disable_segmentation_rendering()
        return _shrink(colours, solid)


def _shrink(colours: Array, solid: Array) -> Pixels:
    """Return a picture at its final size, with averages over blocks of `FINER`² pixels.

    Args:
        colours: Rendered picture (height, width, 3), 0 to 255.
        solid: 1 for pixels of an object, 0 for the background (height, width).

    Returns:
        Pixels (height, width, 4); the share of the background in a block becomes transparency.
    """
    height, width = solid.shape[0] // FINER, solid.shape[1] // FINER
    blocks = (height, FINER, width, FINER)
    cover = solid.reshape(blocks).mean(axis=(1, 3))
    colour_sums = (colours * solid[:, :, None]).reshape(*blocks, 3).mean(axis=(1, 3))
    out = np.zeros((height, width, 4))
    out[:, :, :3] = colour_sums / np.maximum(cover, 1e-6)[:, :, None]
    out[:, :, 3] = 255.0 * cover
    return np.clip(np.rint(out), 0, 255).astype(np.uint8)


def furnish(spec: Any, plant: Plant, *, handle: bool) -> None:
    """Add light, a large off-screen buffer, visible joints and fingers to a MuJoCo model.

    Args:
        spec: Specification of the model.
        plant: The simulated arm.
        handle: True adds a bar in the hand.
    """
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 4096, 4096
    spec.visual.headlight.ambient = (0.45, 0.45, 0.45)
    spec.visual.headlight.diffuse = (0.35, 0.35, 0.35)
    spec.visual.headlight.specular = (0.05, 0.05, 0.05)
    spec.visual.quality.shadowsize = 0
    spec.worldbody.add_light(
        pos=(1.0, -1.5, 2.0), dir=(-0.5, 0.7, -1.0), diffuse=(0.5, 0.5, 0.5), castshadow=False
    )
    capsule, ball = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE
    bones = [geom for geom in spec.geoms if geom.type == capsule]
    thick = {geom.parent.name: float(geom.size[0]) for geom in bones}
    usual = max(thick.values(), default=0.03)
    for geom in bones:
        geom.rgba = BONE
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
            geom.rgba = LEAF
    ink: dict[str, Any] = {"type": ball, "contype": 0, "conaffinity": 0, "mass": 0}
    names = set(plant.model.joint_names)
    for joint in spec.joints:
        if joint.name in names:
            radius = 1.25 * thick.get(joint.parent.name, 0.6 * usual)
            joint.parent.add_geom(size=(radius, 0, 0), rgba=JOINT, **ink)
    tip = next((site for site in spec.sites if site.name == plant.model.tip), None)
    if tip is not None:
        _add_hand(tip, usual, ink, handle=handle)


def _add_hand(tip: Any, usual: float, ink: dict[str, Any], *, handle: bool) -> None:
    """Add a palm and two fingers at the tool's frame `tip` and, with `handle`, a bar between them.

    `usual` is the radius of the links, which scales the hand [m]; `ink` has attributes of geoms.
    """
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(tip.quat))
    axes = rotation.reshape(3, 3)
    origin = np.asarray(tip.pos)
    box, bar = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
    shape = {**ink, "rgba": HAND, "quat": tip.quat}
    for side in (1.0, -1.0):
        position = origin + axes @ (np.array([-0.4, side, 0.0]) * usual)
        tip.parent.add_geom(
            **{**shape, "type": box}, size=(1.1 * usual, 0.2 * usual, 0.5 * usual), pos=position
        )
    palm = origin + axes @ (np.array([-1.5, 0.0, 0.0]) * usual)
    tip.parent.add_geom(
        **{**shape, "type": box}, size=(0.25 * usual, 1.2 * usual, 0.5 * usual), pos=palm
    )
    if handle:
        grey = {**shape, "type": bar, "rgba": JOINT}
        tip.parent.add_geom(**grey, size=(0.35 * usual, 2.6 * usual, 0.0), pos=origin)
