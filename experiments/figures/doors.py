"""Doors: pictures, force over angle, all scenes, opening and closing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MultipleLocator

from experiments.chapters.doors_text import NAMES
from experiments.doors import SCENES
from experiments.figures.activation import show
from experiments.figures.pictures import CANNOT_DRAW, Studio
from experiments.figures.style import LAW_COLOURS
from experiments.resistance import PERSISTENCE, STOP, THRESHOLD
from experiments.setups import arm, tool
from pliant._report.style import INK, MUTED, WIDE, canvas, label_end, level, save, thin
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from experiments.doors import Opened
    from experiments.episode import Trace

    Array = NDArray[np.float64]

#: Times of the pictures [s]; the pull begins at 1 s and ends at 6.6 s.
INSTANTS = (0.5, 2.5, 4.5, 6.6)
VIEW: dict[str, Any] = {
    "look_at": (0.30, -0.12, -0.20),
    "distance": 1.02,
    "azimuth": 12.0,
    "elevation": -58.0,
    "size": (380, 360),
}
LABELS = {
    "cap": "cap, y and yaw compliant",
    "stiff": "all stiff",
    "paper": "paper, no gravity model",
}


def strips(outcomes: Mapping[str, Opened], folder: Path) -> None:
    """Draw the arm at the door at equal times, soft above, stiff below."""
    laws = ("cap", "stiff")
    with canvas(len(laws), len(INSTANTS), size=(WIDE, 5.0)) as (figure, axes):
        for row, law in enumerate(laws):
            trace = outcomes[f"open/door/rigid/{law}"].trace
            pictures = _frames(trace)
            for column, instant in enumerate(INSTANTS):
                k = trace.at(instant)
                angle = float(np.rad2deg(trace.leaf[k]))
                show(axes[row, column], pictures[column], "")
                axes[row, column].set_title(
                    f"{instant:g} s: {abs(angle):.0f}°", fontweight="normal", loc="center"
                )
            axes[row, 0].text(
                -0.04,
                0.5,
                LABELS[law],
                transform=axes[row, 0].transAxes,
                rotation=90,
                ha="right",
                va="center",
                fontweight="bold",
                color=LAW_COLOURS[law],
            )
        save(figure, folder, "4-door-strip")


def _frames(trace: Trace) -> list[NDArray[np.uint8] | None]:
    setup = SCENES["door"]
    plant = Plant(arm(), scene=[setup.leaf()])
    plant.reset(setup.start)
    try:
        with Studio(plant, **VIEW, trail=circle()) as studio:
            return [
                studio.picture(trace.q[trace.at(t)], {"door:hinge": float(trace.leaf[trace.at(t)])})
                for t in INSTANTS
            ]
    except CANNOT_DRAW:
        return [None] * len(INSTANTS)


def circle(most: float = 80.0) -> Array:
    """Return points (k, 3) [m] of the handle's path, up to `most` [deg]."""
    handle = tool(SCENES["door"].start)[:3, 3]
    arm_of_handle = np.array([0.0, 0.30, 0.0])
    angle = np.deg2rad(np.linspace(0.0, most, 41))[:, None]
    turned = np.cos(angle) * arm_of_handle + np.sin(angle) * np.array([-0.30, 0.0, 0.0])
    points: Array = handle - arm_of_handle + turned
    return points


def force_over_angle(outcomes: Mapping[str, Opened], folder: Path) -> None:
    """Draw the largest force so far against the opening, per grip, and the handle's path."""
    grips = [grip for grip in ("rigid", "turning") if f"open/door/{grip}/cap" in outcomes]
    with canvas(1, len(grips) + 1, size=(WIDE, 3.6)) as (figure, axes):
        for column, grip in enumerate(grips):
            ax = axes[0, column]
            ends = []
            for law in ("stiff", "paper", "cap"):
                run = outcomes.get(f"open/door/{grip}/{law}")
                if run is None:
                    continue
                angle, force = np.rad2deg(run.trace.leaf), run.trace.grip[:, 0]
                ahead = np.maximum.accumulate(angle)
                ax.plot(ahead, force, color=LAW_COLOURS[law])
                ax.plot(ahead[-1:], force[-1:], marker="o", markersize=4, color=LAW_COLOURS[law])
                ends.append((float(ahead[-1]), float(force[-1]), law))
            for x, y, law in ends:
                ax.annotate(
                    law,
                    (x, y),
                    xytext=(6, 0),
                    textcoords="offset points",
                    va="center",
                    color=LAW_COLOURS[law],
                    fontsize=8,
                )
            ax.set_title(f"{grip} grip")
            ax.set_xlabel("opening of the leaf [deg]")
            ax.set_xlim(0.0, 84.0)
            ax.set_ylim(bottom=0.0)
        axes[0, 0].set_ylabel("largest force at the handle so far [N]")
        _paths(axes[0, -1], outcomes)
        save(figure, folder, "4-door-force")


def _paths(ax: Any, outcomes: Mapping[str, Opened]) -> None:
    """Draw the tool's path seen from above, with the circle of the handle."""
    path = circle()
    hinge = path[0] + np.array([0.0, -0.30, 0.0])
    ax.plot(1e3 * path[:, 1], 1e3 * path[:, 0], color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    for law in ("cap", "paper", "stiff"):
        run = outcomes.get(f"open/door/rigid/{law}")
        if run is not None:
            way = run.trace.position[thin(run.trace.t)]
            ax.plot(1e3 * way[:, 1], 1e3 * way[:, 0], color=LAW_COLOURS[law], linewidth=2.0)
            ax.plot(
                1e3 * way[-1, 1], 1e3 * way[-1, 0], marker="o", markersize=4, color=LAW_COLOURS[law]
            )
    ax.plot(1e3 * hinge[1], 1e3 * hinge[0], marker="s", markersize=5, color=INK)
    ax.annotate(
        "hinge",
        (1e3 * hinge[1], 1e3 * hinge[0]),
        xytext=(0, 6),
        textcoords="offset points",
        fontsize=8,
        ha="center",
    )
    ax.set_aspect("equal", adjustable="datalim")
    ax.invert_xaxis()
    ax.set_title("the hand from above, rigid grip")
    ax.set_xlabel("y [mm], left is left")
    ax.set_ylabel("x [mm]")


def scenes(outcomes: Mapping[str, Opened], folder: Path) -> None:
    """Draw peak force and angle of every scene and grip, all stiff against cap."""
    rows = [
        (scene, grip)
        for scene in SCENES
        for grip in ("rigid", "turning")
        if f"open/{scene}/{grip}/cap" in outcomes
    ]
    with canvas(1, 1, size=(WIDE * 0.85, 0.9 + 0.34 * len(rows))) as (figure, axes):
        ax = axes[0, 0]
        for place, (scene, grip) in enumerate(rows):
            cap = outcomes[f"open/{scene}/{grip}/cap"]
            stiff = outcomes[f"open/{scene}/{grip}/stiff"]
            ax.plot([cap.force, stiff.force], [place, place], color=MUTED, linewidth=1.0, zorder=1)
            for run, law, side in ((cap, "cap", -1), (stiff, "stiff", 1)):
                ax.plot(run.force, place, "o", markersize=6, color=LAW_COLOURS[law], zorder=2)
                ax.annotate(
                    f"{run.angle:.0f}°",
                    (run.force, place),
                    xytext=(8 * side, 0),
                    textcoords="offset points",
                    ha="left" if side > 0 else "right",
                    va="center",
                    fontsize=8,
                    color=LAW_COLOURS[law],
                )
        ax.set_yticks(range(len(rows)), [f"{NAMES[scene]}, {grip}" for scene, grip in rows])
        ax.set_ylim(len(rows) - 0.4, -0.9)
        ax.set_xlim(left=-8.0)
        ax.grid(visible=False, axis="y")
        ax.set_xlabel("largest force at the handle [N]; beside the dots: opening reached")
        first = rows[0]
        for law, align in (("cap", "center"), ("stiff", "center")):
            force = outcomes[f"open/{first[0]}/{first[1]}/{law}"].force
            name = "all stiff" if law == "stiff" else law
            ax.annotate(
                name,
                (force, -0.55),
                ha=align,
                va="center",
                fontsize=8.5,
                fontweight="bold",
                color=LAW_COLOURS[law],
            )
        save(figure, folder, "4-scenes")


def closing(traces: Mapping[str, Trace], felt: Callable[[Trace], Array], folder: Path) -> None:
    """Draw leaf and estimated force while doors are opened and closed by resistance."""
    chosen = [
        (key, title)
        for key, title in (
            ("both/door/rigid/cap", "door, rigid grip"),
            ("both/fridge/rigid/cap", "fridge, rigid grip"),
            ("both/horizontal/turning/cap", "horizontal handle, turning"),
            ("both/door/rigid/stiff", "door, rigid grip, all stiff"),
        )
        if key in traces
    ]
    with canvas(2, len(chosen), size=(WIDE, 4.4), sharex=True, sharey="row") as (figure, axes):
        for column, (key, title) in enumerate(chosen):
            trace = traces[key]
            step = thin(trace.t)
            t = trace.t[step]
            colour = LAW_COLOURS[key.rsplit("/", maxsplit=1)[-1]]
            top, low = axes[:, column]
            top.plot(t, np.rad2deg(trace.leaf[step]), color=colour)
            force = felt(trace)
            for k in recognised(trace.t, force):
                top.plot(trace.t[k], np.rad2deg(trace.leaf[k]), "o", markersize=5, color=INK)
                low.plot(trace.t[k], force[k], "o", markersize=5, color=INK)
            low.plot(t, force[step], color=colour, linewidth=1.1)
            low.xaxis.set_major_locator(MultipleLocator(5.0))
            for side in (THRESHOLD, -THRESHOLD):
                level(low, side)
            level(top, STOP, "stop" if column == 0 else "")
            top.set_title(title)
            low.set_xlabel("time [s]")
        axes[0, 0].set_ylabel("opening of the leaf [deg]")
        axes[1, 0].set_ylabel("estimated force in x [N]")
        label_end(axes[1, -1], float(axes[1, -1].get_xlim()[1]), [(THRESHOLD, "±15 N", MUTED)])
        save(figure, folder, "4-open-close")


def recognised(t: Array, force: Array) -> list[int]:
    """Return the ticks at which resistance was detected, first to a pull, then to a push."""
    ticks = round(PERSISTENCE / float(t[1] - t[0]))
    found: list[int] = []
    for sign in (1.0, -1.0):
        begin = found[0] + 1 if found else 0
        against = sign * force[begin:] > THRESHOLD
        lasting = np.convolve(against, np.ones(ticks), mode="valid") >= ticks - 0.5
        if not lasting.any():
            break
        found.append(begin + int(np.argmax(lasting)) + ticks - 1)
    return found
