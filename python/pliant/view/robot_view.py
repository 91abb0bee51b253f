"""The drawn arm: its MuJoCo model, its coordinates, and the visual geometry of its URDF."""

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


#: Default colour of a shape: red, green, blue, opacity, 0 to 1.
PLAIN = (0.42, 0.48, 0.56, 1.0)
#: Gamma of a screen.
GAMMA = 2.2
#: Largest drawn mesh file [bytes], and number of searched folders above a URDF.
LARGEST, ABOVE = 40_000_000, 4


@dataclass(frozen=True)
class Visual:
    """One shape on one body of the figure.

    Attributes:
        body: Number of the body.
        pose: Pose in the frame of the body (4, 4).
        kind: Kind of the shape.
        size: box: edges (3,) [m]; cylinder: radius and length [m]; sphere: radius [m]; mesh: scale
            (3,).
        path: Path of a mesh file.
        colour: Red, green, blue, opacity, 0 to 1.
    """

    body: int
    pose: Array
    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...]
    path: Path | None
    colour: tuple[float, ...]

    def mesh(self) -> trimesh.Trimesh:
        """Return the shape in the frame of the body, in its colour.

        Raises:
            ValueError: The mesh file holds nothing that can be drawn.
        """
        out: trimesh.Trimesh
        if self.kind == "box":
            out = trimesh.creation.box(extents=self.size)
        elif self.kind == "cylinder":
            out = trimesh.creation.cylinder(radius=self.size[0], height=self.size[1], sections=48)
        elif self.kind == "sphere":
            out = trimesh.creation.icosphere(subdivisions=2, radius=self.size[0])
        else:
            read = trimesh.load(self.path, force="mesh")
            if not isinstance(read, trimesh.Trimesh) or len(read.faces) == 0:
                raise ValueError(f"{self.path} has no faces")
            out = read
            out.apply_transform(np.diag((*self.size, 1.0)))
        out.apply_transform(self.pose)
        # Separate vertices per face, so that edges are drawn sharp.
        out.unmerge_vertices()
        # Vertex colours are linear, URDF colours are gamma-encoded.
        rgba = np.round(255 * np.asarray(self.colour) ** (GAMMA, GAMMA, GAMMA, 1.0)).astype(
            np.uint8
        )
        colours = np.tile(rgba, (len(out.vertices), 1))
        out.visual = trimesh.visual.ColorVisuals(out, vertex_colors=colours)
        return out


def visuals(model: Model, figure: mujoco.MjModel, urdf: Path | None = None) -> tuple[Visual, ...]:
    """Read the shapes of a model's URDF that can be drawn.

    A mesh is searched relative to the file; ``package://name/path`` in a folder `name`, or as
    `path`, beside the file and in the folders above it. If a mesh is missing, its link has no
    shapes.

    Args:
        model: The arm.
        figure: Its MuJoCo model; every link is a site of its own name.
        urdf: Its file; None for text without one.
    """
    root = ElementTree.fromstring(model.source[0])
    colours = {m.get("name", ""): c for m in root.findall("material") if (c := _colour(m))}
    sites = {figure.site(i).name: i for i in range(figure.nsite)}
    out: list[Visual] = []
    for link in root.findall("link"):
        site = sites.get(link.get("name", ""))
        if site is None:
            continue
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, figure.site_quat[site])
        at = _pose(turn.reshape(3, 3), figure.site_pos[site])
        body = int(figure.site_bodyid[site])
        try:
            made = [_visual(v, body, at, colours, urdf) for v in link.findall("visual")]
        except ValueError:
            continue
        if None not in made:
            out += [visual for visual in made if visual is not None]
    return tuple(out)


def _visual(
    element: ElementTree.Element,
    body: int,
    at: Array,
    colours: dict[str, tuple[float, ...]],
    urdf: Path | None,
) -> Visual | None:
    """Read one element; None if it cannot be drawn."""
    geometry = element.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        return None
    origin = element.find("origin")
    pose = at.copy()
    if origin is not None:
        turn = tf.SO3.from_rpy_radians(*_numbers(origin.get("rpy", "0 0 0")))
        pose = at @ _pose(
            np.asarray(turn.as_matrix(), np.float64), _numbers(origin.get("xyz", "0 0 0"))
        )
    material = element.find("material")
    colour: tuple[float, ...] = PLAIN
    if material is not None:
        colour = _colour(material) or colours.get(material.get("name", "")) or PLAIN
    match shape.tag:
        case "box":
            return Visual(body, pose, "box", _numbers(shape.get("size", "")), None, colour)
        case "cylinder":
            size = _numbers(f"{shape.get('radius')} {shape.get('length')}")
            return Visual(body, pose, "cylinder", size, None, colour)
        case "sphere":
            return Visual(body, pose, "sphere", _numbers(shape.get("radius", "")), None, colour)
        case "mesh":
            path = find(shape.get("filename", ""), urdf)
            scale = _numbers(shape.get("scale", "1 1 1"))
            return None if path is None else Visual(body, pose, "mesh", scale, path, colour)
    return None


def find(name: str, urdf: Path | None) -> Path | None:
    """Return the path of a mesh file of a URDF; None if it does not exist."""
    if urdf is None or not name:
        return None
    scheme, _, rest = name.rpartition("://")
    rest = unquote(rest) if scheme else rest
    folders = [urdf.parent, *urdf.parent.parents][: ABOVE + 1]
    if scheme == "package":
        inner = rest.partition("/")[2]
        wanted = [folder / part for folder in folders for part in (rest, inner) if part]
    else:
        wanted = [urdf.parent / rest]
    for path in wanted:
        try:
            if path.is_file() and path.stat().st_size <= LARGEST:
                return path.resolve()
        except OSError:
            continue
    return None


def _pose(rotation: Array, position: Sequence[float] | Array) -> Array:
    """Return a pose (4, 4)."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out


def _colour(material: ElementTree.Element) -> tuple[float, ...] | None:
    """Return the colour of a material, None for a reference to another."""
    colour = material.find("color")
    rgba = () if colour is None else _numbers(colour.get("rgba", ""))
    return tuple(np.clip(rgba, 0.0, 1.0).tolist()) if len(rgba) == 4 else None


def _numbers(text: str) -> tuple[float, ...]:
    """Return the numbers of an attribute."""
    return tuple(map(float, text.split()))


class RobotView:
    """The drawn figure of an arm, real or simulated.

    A simulated arm is drawn in its true state with its scene, a real one by its joint readings.

    Attributes:
        plant: The simulation; for a real arm, a simulation that never runs.
        simulated: True if the arm is simulated.
        visuals: Shapes of the arm's URDF that can be drawn.
    """

    def __init__(self, arm: Arm, urdf: Path | None = None) -> None:
        """Find the simulation, or build one for drawing; `urdf` is the arm's file, if any."""
        plant = getattr(arm.drive, "plant", None)
        self.simulated = plant is not None
        self.plant: Plant = plant if plant is not None else Plant(arm.model)
        self._model = arm.model
        mj = self.plant.mj_model
        self.visuals = visuals(arm.model, mj, urdf)
        self._at = {mj.joint(i).name: int(mj.jnt_qposadr[i]) for i in range(mj.njnt)}

    def pose(self, q: Array, extra: Mapping[str, float]) -> Array:
        """Return the figure's coordinates; joints (n,) and off-chain joints [rad] of a real arm."""
        if self.simulated:
            return np.array(self.plant.mj_data.qpos)
        out: Array = self.plant.mj_model.qpos0.copy()
        known = {**dict(zip(self._model.joint_names, q.tolist(), strict=True)), **extra}
        for name, angle in {**known, **_followers(self._model, known)}.items():
            if name in self._at:
                out[self._at[name]] = angle
        return out

    def mocap(self) -> tuple[Array, Array]:
        """Return positions (m, 3) [m] and quaternions wxyz (m, 4) of the mocap bodies."""
        data = self.plant.mj_data
        return data.mocap_pos.copy(), data.mocap_quat.copy()


def _followers(model: Model, known: Mapping[str, float]) -> dict[str, float]:
    """Return the angles of mimic joints whose drivers are known."""
    out = {}
    for joint in model.joints:
        rule = joint.mimic
        if rule is not None and (driver := model.joints[rule.joint].name) in known:
            out[joint.name] = rule.multiplier * known[driver] + rule.offset
    return out
