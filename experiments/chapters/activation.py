"""Chapter 1 of the report: activation matrices of the two grasp poses (Fig. 3 of the paper)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

import pliant
from experiments import controllers
from experiments.pictures import CANNOT_DRAW, Studio
from experiments.poses import AXES, arm, tool
from experiments.report import Chapter, Figure, Numbers, Statement, at_least, at_most, band
from experiments.runner import Job
from pliant._report import listed
from pliant._report.style import BLUE, MUTED, WIDE, canvas, save
from pliant.sim import Plant
from pliant.sim.postures import HORIZONTAL, VERTICAL

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from experiments.chapters.common import Options
    from experiments.poses import Array


NUMBER = 1
TITLE = "Share of each joint in each axis"
JOINTS = (
    "shoulder pitch",
    "shoulder roll",
    "shoulder yaw",
    "elbow pitch",
    "wrist yaw",
    "wrist pitch",
    "wrist roll",
)
POSES: Mapping[str, Array] = {"vertical": VERTICAL, "horizontal": HORIZONTAL}
COLUMNS = (*AXES, "null")
#: Activation matrices from an independent implementation (NumPy and Pinocchio), rounded to three
#: digits.
REFERENCE: Mapping[str, tuple[tuple[float, ...], ...]] = {
    "vertical": (
        (0.295, 0.103, 0.075, 0.098, 0.073, 0.000, 0.131),
        (0.126, 0.202, 0.129, 0.093, 0.100, 0.212, 0.124),
        (0.001, 0.181, 0.006, 0.174, 0.064, 0.000, 0.232),
        (0.309, 0.000, 0.310, 0.000, 0.162, 0.000, 0.000),
        (0.044, 0.191, 0.039, 0.286, 0.038, 0.161, 0.225),
        (0.149, 0.202, 0.152, 0.169, 0.118, 0.525, 0.146),
        (0.076, 0.120, 0.289, 0.179, 0.444, 0.101, 0.141),
    ),
    "horizontal": (
        (0.317, 0.080, 0.028, 0.059, 0.016, 0.012, 0.119),
        (0.112, 0.247, 0.079, 0.087, 0.043, 0.224, 0.174),
        (0.002, 0.169, 0.065, 0.125, 0.031, 0.024, 0.251),
        (0.311, 0.000, 0.341, 0.000, 0.176, 0.000, 0.000),
        (0.080, 0.205, 0.088, 0.370, 0.237, 0.191, 0.155),
        (0.046, 0.127, 0.318, 0.230, 0.466, 0.119, 0.097),
        (0.131, 0.172, 0.080, 0.129, 0.032, 0.430, 0.204),
    ),
}


def matrix(pose: str, *, damped: bool = False) -> Array:
    """Return the activation matrix (7, 7) of a grasp pose, from the controller's diagnostics.

    Args:
        pose: `vertical` or `horizontal`.
        damped: True uses the singularity damping of the other chapters; False uses none, like
            `REFERENCE`.

    Returns:
        Share of each joint (row) in each task axis and in the null space (columns).
    """
    q = POSES[pose]
    settings = (
        controllers.paper(soft="")
        if damped
        else controllers.paper(soft="", tracking=pliant.Tracking(damping=0.0))
    )
    controller = pliant.Controller(arm(), settings)
    controller.reset(q)
    controller.step(q, tool(q))
    return np.asarray(controller.diagnostics.activation)


def jobs(options: Options) -> list[Job]:
    """Return two jobs per pose, without and with singularity damping."""
    return [
        *(Job(pose, matrix, (pose,)) for pose in POSES),
        *(Job(f"{pose} damped", matrix, (pose,), {"damped": True}) for pose in POSES),
    ]


def measure(outcomes: Mapping[str, Array]) -> Numbers:
    """Return the activation matrices by pose, and how much they differ.

    The differences are those from `REFERENCE`, and those between runs with and without damping.
    """
    return {
        "joints": list(JOINTS),
        "columns": list(COLUMNS),
        "activation": {pose: outcomes[pose].tolist() for pose in POSES},
        "largest_difference": {
            pose: float(np.abs(outcomes[pose] - np.array(REFERENCE[pose])).max()) for pose in POSES
        },
        "change_by_damping": {
            pose: float(np.abs(outcomes[f"{pose} damped"] - outcomes[pose]).max()) for pose in POSES
        },
    }


def chapter(numbers: Numbers) -> Chapter:
    """Return the chapter with the paper's statements about Fig. 3."""
    share = {pose: np.array(numbers["activation"][pose]) for pose in POSES}
    worst = max(numbers["largest_difference"].values())
    figure = Figure(
        file="1-activation",
        title="Activation matrices of the two grasp poses (Fig. 3)",
        done="The arm holds the tool at (0.38, 0, −0.28) m, once with its axes along those of the "
        "base to grasp a vertical handle, once turned by 90° about x for a horizontal one. Each "
        "column tells how a torque budget for one task axis is shared among the joints, equation "
        "(10); the column of the null space stands apart. The inverse is taken without damping, as "
        "in the reference; the damping of the other experiments changes no entry by more than "
        f"{max(numbers['change_by_damping'].values()):.4f}.",
        paper="Cosero's matrices are printed without numbers; the text says which joints stand "
        "out. Link lengths here are ours, so the pattern is compared, not the shade.",
        caption="Columns sum to one. Left: the posture, seen from the front right.",
        statements=(*_paper(share), _study(worst)),
    )
    return Chapter(
        number=NUMBER,
        title=TITLE,
        lead="A torque budget for a direction in space has to be shared among joints. The paper "
        "shares it by how much each joint contributes to a motion in that direction.",
        figures=(figure,),
        numbers=numbers,
        headline=(("activation, largest difference to the reference", f"{worst:.1e}"),),
    )


def _top(column: Array, count: int) -> str:
    """Return the `count` joints with the largest shares in a column, with the shares, as text."""
    order = np.argsort(-column)[:count]
    return listed([f"{JOINTS[i]} {column[i]:.2f}" for i in order])


def _margin(column: Array, joints: tuple[int, ...], ignored: tuple[int, ...] = ()) -> float:
    """Return the smallest share of the wanted joints minus the largest share of the others.

    Args:
        column: Shares of the joints (7,) in one task axis.
        joints: Indices of the joints whose shares should be the largest.
        ignored: Indices of joints that count neither as wanted nor as others.
    """
    others = [i for i in range(7) if i not in {*joints, *ignored}]
    return float(column[list(joints)].min() - column[others].max())


def _paper(share: Mapping[str, Array]) -> tuple[Statement, ...]:
    x = {pose: share[pose][:, 0] for pose in POSES}
    y = {pose: share[pose][:, 1] for pose in POSES}
    yaw = {pose: share[pose][:, 5] for pose in POSES}
    unit = "lead over the next joint"
    small = max(np.delete(column, [0, 3]).max() for column in x.values())
    return (
        Statement(
            claim="In both poses, motion in x is the work of elbow and shoulder pitch.",
            outcome=f"Largest in x: {_top(x['vertical'], 2)} (vertical); "
            f"{_top(x['horizontal'], 2)} (horizontal).",
            checks=tuple(
                at_least(f"{unit}, {pose}", _margin(x[pose], (0, 3)), 0.0) for pose in POSES
            ),
        ),
        Statement(
            claim="Vertical grasp: the wrist pitch takes part in x.",
            outcome=f"It comes third: {_top(x['vertical'], 3)}.",
            checks=(at_least(unit, _margin(x["vertical"], (5,), (0, 3)), 0.0),),
        ),
        Statement(
            claim="Horizontal grasp: the wrist roll takes that part.",
            outcome=f"{_top(x['horizontal'], 3).capitalize()}; the wrist pitch has "
            f"{x['horizontal'][5]:.2f}.",
            checks=(at_least(unit, _margin(x["horizontal"], (6,), (0, 3)), 0.0),),
        ),
        Statement(
            claim="Other joints of shoulder and wrist contribute less to x.",
            outcome=f"No other joint has more than {small:.2f}; elbow and shoulder pitch have at "
            f"least {min(column[[0, 3]].min() for column in x.values()):.2f}.",
            checks=(
                at_most("largest other share", small, min(c[[0, 3]].min() for c in x.values())),
            ),
        ),
        Statement(
            claim="Vertical grasp: y is mostly shoulder roll, shoulder yaw and wrist yaw.",
            outcome=f"Largest in y: {_top(y['vertical'], 4)}.",
            checks=(at_least(unit, _margin(y["vertical"], (1, 2, 4)), 0.0),),
            because="the three are there, but the wrist pitch has as much "
            f"({y['vertical'][5]:.2f}); our lengths and wrist angles are not Cosero's.",
        ),
        Statement(
            claim="Horizontal grasp: all joints but the elbow contribute to y.",
            outcome=f"The elbow has {y['horizontal'][3]:.3f}, the others "
            f"{np.delete(y['horizontal'], 3).min():.2f} to "
            f"{np.delete(y['horizontal'], 3).max():.2f}.",
            checks=(
                at_most("elbow", float(y["horizontal"][3]), 0.02),
                at_least("least of the others", float(np.delete(y["horizontal"], 3).min()), 0.05),
            ),
        ),
        Statement(
            claim="Yaw needs shoulder roll, wrist yaw and wrist roll (read: in the horizontal "
            "grasp).",
            outcome=f"Largest in yaw: {_top(yaw['horizontal'], 3)}.",
            checks=(at_least(unit, _margin(yaw["horizontal"], (1, 4, 6)), 0.0),),
        ),
        Statement(
            claim="Vertical grasp: yaw is mostly shoulder roll and wrist pitch.",
            outcome=f"Largest in yaw: {_top(yaw['vertical'], 3)}.",
            checks=(at_least(unit, _margin(yaw["vertical"], (1, 5)), 0.0),),
        ),
    )


def _study(worst: float) -> Statement:
    return band(
        claim="An independent implementation gives the same two matrices, to the three digits it "
        "prints.",
        outcome=f"The largest difference of any of the 98 entries is {worst:.1e}.",
        checks=(at_most("largest difference", worst, 1e-3),),
    )


def draw(outcomes: Mapping[str, Array], options: Options) -> None:
    """Draw the activation matrix of each grasp pose beside a picture of the arm in this pose."""
    draw_matrices(outcomes, POSES, JOINTS, COLUMNS, options.figures)


# --- Fig. 3: activation matrices as annotated heat maps, each beside its posture ---

#: Colour scale of the heat maps.
SHADES = LinearSegmentedColormap.from_list("shares", ["#f3f7fb", "#9ecae1", BLUE, "#08306b"])
#: Colours of the text on light cells and on dark cells.
DARK, PALE = "#1b1f25", "#fefefe"
#: Cells with at least this share of a joint have the darkest colour.
FULL = 0.55
#: Arguments of `Studio` for the pictures of the grasp poses; `handle` draws a bar in the hand.
VIEW: dict[str, Any] = {
    "look_at": (0.19, 0.0, -0.17),
    "distance": 0.82,
    "azimuth": 140.0,
    "elevation": -20.0,
    "handle": True,
}
#: Width of the gap before the null space's column, as a share of a column's width.
GAP = 0.25


def draw_matrices(
    matrices: Mapping[str, Array],
    poses: Mapping[str, Array],
    joints: Sequence[str],
    columns: Sequence[str],
    folder: Path,
) -> None:
    """Draw the figure `1-activation`: one row per pose, with a picture and the matrix.

    Args:
        matrices: Activation matrix per pose: (n, k + 1) for n joints and k task axes.
        poses: Joint positions (n,) [rad] per pose.
        joints: Names of the matrix rows.
        columns: Names of the matrix columns.
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
    """Return a picture of an arm at q (n,) [rad]; None if off-screen rendering is not possible.

    `view` has arguments of `Studio`; by default the camera shows the whole arm from its side.
    """
    plant = Plant(model, servos)
    plant.reset(q)
    view = view or beside(plant)
    try:
        with Studio(plant, size=(420, 360), **view) as studio:
            return studio.picture(q)
    except CANNOT_DRAW:
        return None


def beside(plant: Plant) -> dict[str, Any]:
    """Return arguments of `Studio` for a camera that shows the whole arm from its side."""
    positions = plant.mj_data.site_xpos
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
    radius = float(np.linalg.norm(positions - middle, axis=1).max())
    out = plant.tool[:2, 3] - positions[0, :2]
    heading = float(np.rad2deg(np.arctan2(out[1], out[0])))
    return {
        "look_at": middle,
        "distance": 3.0 * radius,
        "azimuth": heading + 125.0,
        "elevation": -18.0,
    }


def show(ax: Axes, picture: NDArray[np.uint8] | None, title: str) -> None:
    """Put a picture with a title into axes without a frame; for None write that it is missing."""
    ax.set_axis_off()
    ax.set_title(title)
    if picture is None:
        ax.text(0.5, 0.5, "no picture: nothing here can draw off screen", ha="center", color=MUTED)
    else:
        ax.imshow(picture, interpolation="antialiased")


def heat(ax: Axes, matrix: Array, joints: Sequence[str], columns: Sequence[str]) -> None:
    """Draw an activation matrix as a heat map with numbers; a gap precedes the last column.

    The last column belongs to the null space. `joints` and `columns` name rows and columns.
    """
    rows, count = matrix.shape
    edges = np.arange(count, dtype=np.float64)
    edges[-1] += GAP
    for k in range(count):
        for i in range(rows):
            value = float(matrix[i, k])
            shade = SHADES(min(max(value, 0.0) / FULL, 1.0))
            ax.add_patch(_cell(edges[k], i, shade))
            if value >= 0.005:
                ink = PALE if value > 0.45 * FULL else DARK
                text = f"{value:.2f}".lstrip("0")
                ax.text(
                    edges[k] + 0.5, i + 0.5, text, ha="center", va="center", color=ink, fontsize=8.5
                )
    ax.set_xlim(0.0, edges[-1] + 1.0)
    ax.set_ylim(rows, 0.0)
    ax.set_xticks(edges + 0.5, columns)
    ax.set_yticks(np.arange(rows) + 0.5, joints)
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.grid(visible=False)
    for spine in ax.spines.values():
        spine.set_visible(False)


def _cell(x: float, y: float, shade: tuple[float, float, float, float]) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x + 0.02, y + 0.02), 0.96, 0.96, facecolor=shade, edgecolor="none")
