"""Fig. 3: activation matrices as annotated heat maps, each beside its posture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from experiments.figures.pictures import CANNOT_DRAW, Studio
from experiments.setups import arm
from pliant._report.style import BLUE, MUTED, WIDE, canvas, save
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Colour scale up to the blue of the common style. Text on it has colours of its own, which no
#: theme changes.
SHADES = LinearSegmentedColormap.from_list("shares", ["#f3f7fb", "#9ecae1", BLUE, "#08306b"])
DARK, PALE = "#1b1f25", "#fefefe"
#: Share with the full shade.
FULL = 0.55
#: Camera of the postures; a bar in the hand distinguishes the grasps.
VIEW: dict[str, Any] = {
    "look_at": (0.19, 0.0, -0.17),
    "distance": 0.82,
    "azimuth": 140.0,
    "elevation": -20.0,
    "handle": True,
}
#: Gap before the column of the null space, in columns.
GAP = 0.25


def draw(
    matrices: Mapping[str, Array],
    poses: Mapping[str, Array],
    joints: Sequence[str],
    columns: Sequence[str],
    folder: Path,
) -> None:
    """Draw `1-activation`.

    Args:
        matrices: Activation matrix (n, k + 1) per pose.
        poses: Joint positions (n,) [rad] per pose.
        joints: Names of the rows.
        columns: Names of the columns.
        folder: Target folder.
    """
    with canvas(2, 2, size=(WIDE, 7.2), width_ratios=[1.0, 1.75]) as (figure, axes):
        for row, (pose, q) in enumerate(poses.items()):
            show(axes[row, 0], posture(arm(), q, **VIEW), f"{pose} grasp")
            heat(axes[row, 1], matrices[pose], joints, columns)
        save(figure, folder, "1-activation")


def posture(
    model: Any, q: Array, *, servos: Any | None = None, **view: Any
) -> NDArray[np.uint8] | None:
    """Return a picture of a posture, None without a drawing backend; `view` is optional."""
    plant = Plant(model, servos)
    plant.reset(q)
    view = view or beside(plant)
    try:
        with Studio(plant, size=(420, 360), **view) as studio:
            return studio.picture(q)
    except CANNOT_DRAW:
        return None


def beside(plant: Plant) -> dict[str, Any]:
    """Return a camera position that sees the whole arm from its side."""
    places = plant.mj_data.site_xpos
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    radius = float(np.linalg.norm(places - middle, axis=1).max())
    out = plant.tool[:2, 3] - places[0, :2]
    heading = float(np.rad2deg(np.arctan2(out[1], out[0])))
    return {
        "look_at": middle,
        "distance": 3.0 * radius,
        "azimuth": heading + 125.0,
        "elevation": -18.0,
    }


def show(ax: Axes, picture: NDArray[np.uint8] | None, title: str) -> None:
    """Put a picture into axes without frame."""
    ax.set_axis_off()
    ax.set_title(title)
    if picture is None:
        ax.text(0.5, 0.5, "no picture: nothing here can draw off screen", ha="center", color=MUTED)
    else:
        ax.imshow(picture, interpolation="antialiased")


def heat(ax: Axes, matrix: Array, joints: Sequence[str], columns: Sequence[str]) -> None:
    """Draw a matrix with its numbers; the last column stands apart."""
    rows, count = matrix.shape
    left = np.arange(count, dtype=np.float64)
    left[-1] += GAP
    for k in range(count):
        for i in range(rows):
            value = float(matrix[i, k])
            shade = SHADES(min(max(value, 0.0) / FULL, 1.0))
            ax.add_patch(_cell(left[k], i, shade))
            if value >= 0.005:
                ink = PALE if value > 0.45 * FULL else DARK
                text = f"{value:.2f}".lstrip("0")
                ax.text(
                    left[k] + 0.5, i + 0.5, text, ha="center", va="center", color=ink, fontsize=8.5
                )
    ax.set_xlim(0.0, left[-1] + 1.0)
    ax.set_ylim(rows, 0.0)
    ax.set_xticks(left + 0.5, columns)
    ax.set_yticks(np.arange(rows) + 0.5, joints)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.grid(visible=False)
    for spine in ax.spines.values():
        spine.set_visible(False)


def _cell(x: float, y: float, shade: tuple[float, float, float, float]) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x + 0.02, y + 0.02), 0.96, 0.96, facecolor=shade, edgecolor="none")
