"""Data to draw an arm: MuJoCo model, generalised positions, and visual shapes of the URDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import unquote
from xml.etree import ElementTree

import mujoco
import numpy as np
import trimesh
import viser.transforms as tf

from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pliant._core import Model
    from pliant._typing import Array
    from pliant.arm import Arm


#: Default colour of a shape: red, green, blue and opacity, each 0 to 1.
DEFAULT_COLOUR = (0.42, 0.48, 0.56, 1.0)
#: Exponent that converts gamma-encoded colours (0 to 1) to linear colours.
SCREEN_GAMMA = 2.2
#: Maximum size of a mesh file [bytes].
MAX_MESH_SIZE = 40_000_000
#: Number of parent folders of the URDF's folder in which mesh files are searched.
PARENT_FOLDERS = 4


@dataclass(frozen=True)
class Visual:
    """One visual shape of the URDF.

    Attributes:
        body: Index of the MuJoCo body to which the shape is fixed.
        pose: Pose of the shape in the frame of the body (4, 4).
        kind: `box`, `cylinder`, `sphere` or `mesh`.
        size: box: edges (3,) [m]; cylinder: radius and length [m]; sphere: radius [m]; mesh: scale
            factors (3,).
        path: Path of the mesh file; None if the shape is not a mesh.
        colour: Red, green, blue, opacity, 0 to 1.
    """

    body: int
    pose: Array
    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...]
    path: Path | None
    colour: tuple[float, ...]

    def mesh(self) -> trimesh.Trimesh:
        """Return the coloured mesh of the shape in the frame of the body.

        Raises:
            ValueError: The mesh file has no faces.
        """
        out: trimesh.Trimesh
        if self.kind == "box":
            out = trimesh.creation.box(extents=self.size)
        elif self.kind == "cylinder":
            out = trimesh.creation.cylinder(radius=self.size[0], height=self.size[1], sections=48)
        elif self.kind == "sphere":
            out = trimesh.creation.icosphere(subdivisions=2, radius=self.size[0])
        else:
            loaded = trimesh.load(self.path, force="mesh")
            if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
                raise ValueError(f"{self.path} has no faces")
            out = loaded
            out.apply_transform(np.diag((*self.size, 1.0)))
        out.apply_transform(self.pose)
        # Give each face its own vertices: shared vertices would be shaded like rounded edges.
        out.unmerge_vertices()
        # Convert the gamma-encoded colours of the URDF, because vertex colours are linear.
        rgba = np.round(
            255 * np.asarray(self.colour) ** (SCREEN_GAMMA, SCREEN_GAMMA, SCREEN_GAMMA, 1.0)
        ).astype(np.uint8)
        colours = np.tile(rgba, (len(out.vertices), 1))
        out.visual = trimesh.visual.ColorVisuals(out, vertex_colors=colours)
        return out


def visuals(model: Model, mj_model: mujoco.MjModel, urdf: Path | None = None) -> tuple[Visual, ...]:
    """Return the visual shapes in the URDF of an arm.

    If a shape of a link is invalid, of an unknown kind, or lacks its mesh file, all shapes of the
    link are left out.

    Args:
        model: The arm.
        mj_model: MuJoCo model of the arm, with a site for every link.
        urdf: Path of the URDF, to which mesh paths are relative; None if there is no file.
    """
    root = ElementTree.fromstring(model.source[0])
    colours = {m.get("name", ""): c for m in root.findall("material") if (c := _colour(m))}
    sites = {mj_model.site(i).name: i for i in range(mj_model.nsite)}
    out: list[Visual] = []
    for link in root.findall("link"):
        site = sites.get(link.get("name", ""))
        if site is None:
            continue
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, mj_model.site_quat[site])
        site_pose = _pose(rotation.reshape(3, 3), mj_model.site_pos[site])
        body = int(mj_model.site_bodyid[site])
        try:
            shapes = [_visual(v, body, site_pose, colours, urdf) for v in link.findall("visual")]
        except ValueError:
            continue
        if None not in shapes:
            out += [shape for shape in shapes if shape is not None]
    return tuple(out)


def _visual(
    element: ElementTree.Element,
    body: int,
    site_pose: Array,
    colours: dict[str, tuple[float, ...]],
    urdf: Path | None,
) -> Visual | None:
    """Return the shape of one ``<visual>`` element; None if it cannot be drawn."""
    geometry = element.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        return None
    origin = element.find("origin")
    pose = site_pose.copy()
    if origin is not None:
        rotation = tf.SO3.from_rpy_radians(*_numbers(origin.get("rpy", "0 0 0")))
        pose = site_pose @ _pose(
            np.asarray(rotation.as_matrix(), np.float64), _numbers(origin.get("xyz", "0 0 0"))
        )
    material = element.find("material")
    colour: tuple[float, ...] = DEFAULT_COLOUR
    if material is not None:
        colour = _colour(material) or colours.get(material.get("name", "")) or DEFAULT_COLOUR
    match shape.tag:
        case "box":
            return Visual(body, pose, "box", _numbers(shape.get("size", "")), None, colour)
        case "cylinder":
            size = _numbers(f"{shape.get('radius')} {shape.get('length')}")
            return Visual(body, pose, "cylinder", size, None, colour)
        case "sphere":
            return Visual(body, pose, "sphere", _numbers(shape.get("radius", "")), None, colour)
        case "mesh":
            path = find_mesh(shape.get("filename", ""), urdf)
            scale = _numbers(shape.get("scale", "1 1 1"))
            return None if path is None else Visual(body, pose, "mesh", scale, path, colour)
    return None


def find_mesh(name: str, urdf: Path | None) -> Path | None:
    """Return the path of a mesh file of a URDF; None if it is missing or too large.

    A plain path is relative to the folder of the URDF. For ``package://name/path``, the files
    ``name/path`` and ``path`` are searched in the folder of the URDF and the folders above it.
    """
    if urdf is None or not name:
        return None
    scheme, _, rest = name.rpartition("://")
    rest = unquote(rest) if scheme else rest
    folders = [urdf.parent, *urdf.parent.parents][: PARENT_FOLDERS + 1]
    if scheme == "package":
        inner = rest.partition("/")[2]
        candidates = [folder / part for folder in folders for part in (rest, inner) if part]
    else:
        candidates = [urdf.parent / rest]
    for path in candidates:
        try:
            if path.is_file() and path.stat().st_size <= MAX_MESH_SIZE:
                return path.resolve()
        except OSError:
            continue
    return None


def _pose(rotation: Array, position: Sequence[float] | Array) -> Array:
    """Return a pose (4, 4) from a rotation matrix (3, 3) and a position (3,) [m]."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out


def _colour(material: ElementTree.Element) -> tuple[float, ...] | None:
    """Return the RGBA colour (0 to 1) of a URDF material; None if it has no valid colour."""
    colour = material.find("color")
    rgba = () if colour is None else _numbers(colour.get("rgba", ""))
    return tuple(np.clip(rgba, 0.0, 1.0).tolist()) if len(rgba) == 4 else None


def _numbers(text: str) -> tuple[float, ...]:
    """Return the numbers in the text of a URDF attribute."""
    return tuple(map(float, text.split()))


class RobotView:
    """Data to draw an arm and its scene.

    A simulated arm is drawn in the state of the simulation, a real arm at its measured positions.

    Attributes:
        plant: The simulation; for a real arm, a simulation that is only used for drawing.
        simulated: True if the arm is simulated by `plant`.
        visuals: Shapes of the arm's URDF that can be drawn.
    """

    def __init__(self, arm: Arm, urdf: Path | None = None) -> None:
        """Use the arm's own simulation, or create one for a real arm; `urdf`: path of its URDF."""
        plant = getattr(arm.drive, "plant", None)
        self.simulated = plant is not None
        self.plant: Plant = plant if plant is not None else Plant(arm.model)
        self._model = arm.model
        mj = self.plant.mj_model
        self.visuals = visuals(arm.model, mj, urdf)
        self._qpos_index = {mj.joint(i).name: int(mj.jnt_qposadr[i]) for i in range(mj.njnt)}

    def qpos(self, q: Array, extra: Mapping[str, float]) -> Array:
        """Return the generalised positions (`qpos`) of the MuJoCo model.

        Args:
            q: Joint positions (n,) [rad] of a real arm; ignored for a simulated arm.
            extra: Positions of joints outside the chain [rad] by name, for example a gripper.
        """
        if self.simulated:
            return np.array(self.plant.mj_data.qpos)
        out: Array = self.plant.mj_model.qpos0.copy()
        known = {**dict(zip(self._model.joint_names, q.tolist(), strict=True)), **extra}
        for name, angle in {**known, **_mimic_positions(self._model, known)}.items():
            if name in self._qpos_index:
                out[self._qpos_index[name]] = angle
        return out

    def mocap(self) -> tuple[Array, Array]:
        """Return positions (m, 3) [m] and quaternions wxyz (m, 4) of the m MuJoCo mocap bodies."""
        data = self.plant.mj_data
        return data.mocap_pos.copy(), data.mocap_quat.copy()


def _mimic_positions(model: Model, known: Mapping[str, float]) -> dict[str, float]:
    """Return the positions [rad] of mimic joints by name, if `known` has the joints they follow."""
    out = {}
    for joint in model.joints:
        rule = joint.mimic
        if rule is not None and (driver := model.joints[rule.joint].name) in known:
            out[joint.name] = rule.multiplier * known[driver] + rule.offset
    return out
