"""Chapter 4 of the report: doors and a fridge, opened and closed along the handle's path."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MultipleLocator

import pliant
from experiments import controllers
from experiments.chapters.activation import show
from experiments.chapters.common import LAW_COLOURS, Options
from experiments.doors import PERSISTENCE, SCENES, STOP, THRESHOLD, open_and_close, open_door
from experiments.pictures import CANNOT_DRAW, Studio
from experiments.poses import arm, tool
from experiments.report import Chapter, Figure, Numbers, Statement, at_least, at_most, band, between
from experiments.runner import Job
from experiments.simulation import NOMINAL
from pliant._report import listed
from pliant._report.page import Table
from pliant._report.style import INK, MUTED, WIDE, canvas, label_end, level, save, thin
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from experiments.disturbances import Law
    from experiments.doors import OpenCloseResult, OpenResult
    from experiments.poses import Array
    from experiments.simulation import Trace


NUMBER = 4
TITLE = "Doors"
GRIPS = ("rigid", "turning")


def stiff(*, soft: str, **options: Any) -> Law:
    """Return a law with all axes stiff; the argument `soft` is ignored."""
    return controllers.all_stiff(**options)


LAWS: Mapping[str, Callable[..., Law]] = {
    "cap": controllers.cap,
    "paper": partial(controllers.paper, 8.0),
    "stiff": stiff,
}


def jobs(options: Options) -> list[Job]:
    """Return the runs of every scene, grip and law.

    A run opens a door, or opens and closes it, each until resistance is detected. With option
    `quick`, only the door with a rigid grip is run.
    """
    scenes = ("door",) if options.quick else tuple(SCENES)
    grips = ("rigid",) if options.quick else GRIPS
    runs = [
        Job(f"open/{scene}/{grip}/{law}", open_door, (make, scene, grip))
        for scene in scenes
        for grip in grips
        for law, make in LAWS.items()
        if law != "paper" or scene == "door"
    ]
    fixed_base = [scene for scene in scenes if not SCENES[scene].base]
    runs += [
        Job(f"both/{scene}/{grip}/{law}", open_and_close, (LAWS[law], scene, grip))
        for scene in fixed_base
        for grip in grips
        for law in ("cap", "stiff")
        if law == "cap" or scene == "door"
    ]
    return runs


def measure(outcomes: Mapping[str, Any]) -> Numbers:
    """Return angles [deg], forces [N] and torques [N·m] of the runs, by scene, grip and law."""
    opening: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    both: dict[str, dict[str, dict[str, dict[str, Any]]]] = {}
    for name, run in outcomes.items():
        kind, scene, grip, law = name.split("/")
        if kind == "open":
            opening.setdefault(scene, {}).setdefault(grip, {})[law] = _opened(run)
        else:
            both.setdefault(scene, {}).setdefault(grip, {})[law] = _both(run)
    return {"opening": opening, "opening_and_closing": both, "stop": STOP}


def _opened(run: OpenResult) -> dict[str, float]:
    max_torque = np.asarray(NOMINAL.servos().max_torque)
    return {
        "angle": run.angle,
        "force": run.force,
        "torque": run.torque,
        "largest_limit_share": float((run.trace.limit.max(axis=0) / max_torque).max()),
    }


def _both(run: OpenCloseResult) -> dict[str, Any]:
    return {
        "ends": list(run.ends),
        "force": run.force,
        "widest": float(np.rad2deg(run.trace.leaf.max())),
        "at_end": float(np.rad2deg(run.trace.leaf[-1])),
    }


def estimated_force(trace: Trace) -> Array:
    """Return the force on the tool along x at each tick (N,) [N], estimated without a force sensor.

    `pliant.ContactEstimator` gets the recorded joint positions and commands.
    """
    contact = pliant.ContactEstimator(pliant.Controller(arm(), controllers.cap(), NOMINAL.servos()))
    force = np.zeros(trace.t.size)
    for k in range(trace.t.size):
        command = (trace.goal[k], trace.limit[k])
        force[k] = contact.update(trace.q[k], sent=command).force_base[0]
    return force


def chapter(numbers: Numbers) -> Chapter:
    """Return the chapter with statements of the paper and of our study about doors."""
    opening, both = numbers["opening"], numbers["opening_and_closing"]
    rigid = opening["door"]["rigid"]
    soft, hard = rigid["cap"], rigid["stiff"]
    ends = both["door"]["rigid"]["cap"]["ends"]
    return Chapter(
        number=NUMBER,
        title=TITLE,
        lead="The arm holds a handle, pulls straight back, and lets the door decide where the "
        "handle goes: lateral motion and rotation about the hinge's direction are compliant, "
        "everything else holds. No force sensor is used, not even to notice the end.",
        figures=door_figures(opening, both),
        tables=(opening_table(opening), closing_table(both)),
        numbers=numbers,
        headline=(
            ("door, rigid grip, cap", f"{soft['angle']:.1f}°, {soft['force']:.1f} N"),
            ("door, rigid grip, all stiff", f"{hard['angle']:.1f}°, {hard['force']:.1f} N"),
            ("recognised ends, rigid grip", ", ".join(f"{end:.1f}°" for end in ends) or "none"),
        ),
    )


def draw(outcomes: Mapping[str, Any], options: Options) -> None:
    """Draw all figures of the chapter."""
    draw_strips(outcomes, options.figures)
    draw_force_over_angle(outcomes, options.figures)
    draw_scenes(outcomes, options.figures)
    draw_closing(
        {n: r.trace for n, r in outcomes.items() if n.startswith("both/")},
        estimated_force,
        options.figures,
    )


# --- The paper's statements on doors and the fridge, and the results of a run ---

#: Smallest required opening [deg] and largest allowed force [N] of law cap, by scene: first with
#: the rigid, then with the turning grip.
BANDS = {
    "door": ((64.0, 32.0), (64.0, 25.0)),
    "fridge": ((64.0, 34.0), (64.0, 32.0)),
    "horizontal": ((64.0, 33.0), (64.0, 25.0)),
    "oven": ((57.0, 26.0), (57.0, 15.0)),
    "base door": ((63.0, 52.0), (65.0, 25.0)),
    "base fridge": ((63.0, 52.0), (65.0, 32.0)),
}
NAMES = {
    "door": "door",
    "fridge": "fridge",
    "horizontal": "door, horizontal handle",
    "oven": "oven",
    "base door": "door, base moves",
    "base fridge": "fridge, base moves",
}
#: Opening below which a door counts as stuck [deg].
STUCK = 35.0
#: Allowed difference between the opening at a detected end of the motion and at the true end [deg].
END_TOLERANCE = 1.0


def door_figures(opening: Numbers, both: Numbers) -> tuple[Figure, ...]:
    """Return the figures of the chapter with their texts and statements.

    Args:
        opening: Numbers of the runs that open a door, by scene, grip and law.
        both: Numbers of the runs that open and close a door, by scene, grip and law.
    """
    grips = list(opening["door"])
    return (
        Figure(
            file="4-door-strip",
            title="Opening a door with a rigid grip",
            done="The hand is welded to the handle of a 3 kg leaf; its hinge is 0.30 m to the "
            "right. The target moves straight back by 0.28 m at 0.05 m/s. Above: y and yaw "
            "compliant (law cap, η = 0.999); below: all six axes stiff.",
            paper="The robot grasps the handle and moves back; lateral motion and rotation about "
            "the vertical axis are compliant, so that the hand can follow the circle of the "
            "handle.",
            caption="Pictures of the simulation at equal times; the thin arc is the path the "
            "handle has to take.",
            statements=(_follows(opening),),
        ),
        Figure(
            file="4-door-force",
            title="What the handle has to bear",
            done="The same pull, from a closed door as far as each law gets: largest force at the "
            "handle so far, against the opening. The paper's law has no gravity model and a budget "
            "of 8 N·m.",
            caption="A curve that ends early is a door that got stuck. An ideal pull of 0.28 m "
            "would open it by 69°.",
            statements=(_against_stiff(opening, grips), *_paper_law(opening)),
        ),
        Figure(
            file="4-scenes",
            title="Door, fridge and oven; target or base moving",
            done="The fridge weighs 6 kg and has a magnetic seal of 20 N; the oven's leaf turns "
            "about a horizontal hinge below its handle, so there z and pitch are compliant. With a "
            "moving base the target stands still and the hinge moves away at 0.05 m/s: the handle "
            "is kept where it is relative to the robot. Rigid grip: welded; turning: the handle "
            "can turn in the hand.",
            paper="Cosero and Dynamaid opened doors and a fridge this way, at RoboCup 2010 in "
            "front of a jury, with handles aligned vertically and horizontally.",
            caption="Largest force at the handle, all stiff against cap; the opening that was "
            "reached is written beside it.",
            statements=(_all_open(opening), *_scene_bands(opening)),
        ),
        Figure(
            file="4-open-close",
            title="Open until it resists, close until it resists",
            done=f"The leaf has a stop at {STOP:g}°. From 1 s the target moves back until the "
            "force in x, estimated from joint positions, goals and limits alone, has exceeded 15 N "
            "for 0.2 s; after a second of rest it moves forward until the same happens.",
            paper="The robot pulls until the handle resists further motion, and closes the door by "
            "pushing forward until the closed door resists.",
            caption="Above: opening of the leaf; dots: where the end was recognised. Below: the "
            "estimated force, and the threshold.",
            statements=(_ends(both), *_stiff_ends(both)),
        ),
    )


def _all(opening: Numbers, law: str) -> Iterator[tuple[str, str, Numbers]]:
    for scene, grips in opening.items():
        for grip, laws in grips.items():
            if law in laws:
                yield scene, grip, laws[law]


def _follows(opening: Numbers) -> Statement:
    soft, hard = opening["door"]["rigid"]["cap"], opening["door"]["rigid"]["stiff"]
    return Statement(
        claim="Compliant in lateral motion and yaw, the hand follows the handle round its circle.",
        outcome=f"The door opens by {soft['angle']:.1f}°; with all axes stiff by "
        f"{hard['angle']:.1f}°.",
        checks=(
            at_least("angle", soft["angle"], BANDS["door"][0][0], "deg"),
            at_most("angle, all stiff", hard["angle"], STUCK, "deg"),
        ),
    )


def _against_stiff(opening: Numbers, grips: list[str]) -> Statement:
    ratios = {
        grip: opening["door"][grip]["stiff"]["force"] / opening["door"][grip]["cap"]["force"]
        for grip in grips
    }
    parts = [
        f"{opening['door'][grip]['cap']['force']:.1f} N instead of "
        f"{opening['door'][grip]['stiff']['force']:.1f} N ({grip} grip)"
        for grip in grips
    ]
    return band(
        claim="Against all axes stiff the force at the handle is at most half.",
        outcome=f"{listed(parts)}.",
        checks=tuple(at_least(f"ratio, {grip}", ratio, 2.0) for grip, ratio in ratios.items()),
    )


def _paper_law(opening: Numbers) -> tuple[Statement, ...]:
    if "paper" not in opening["door"]["rigid"]:
        return ()
    grips = {grip: laws["paper"] for grip, laws in opening["door"].items()}
    rigid = grips["rigid"]
    turning = grips.get("turning")
    freer = (
        f"; where it can, {turning['angle']:.1f}° at {turning['force']:.1f} N" if turning else ""
    )
    return (
        Statement(
            claim="The paper's own law opens the door.",
            outcome=f"With a handle that cannot turn in the hand it gets to {rigid['angle']:.1f}° "
            f"at {rigid['force']:.1f} N{freer}.",
            checks=(
                at_least("angle, rigid grip", rigid["angle"], 60.0, "deg"),
                *(
                    (at_least("angle, turning grip", turning["angle"], 60.0, "deg"),)
                    if turning
                    else ()
                ),
            ),
            because="with a rigid grip the inverse of all six rows requests a motion in x without "
            "motion in y and yaw, and the servos enforce it between two ticks. A real hand, "
            "like the one at RoboCup, lets the handle turn.",
        ),
    )


def _all_open(opening: Numbers) -> Statement:
    angles = [run["angle"] for _, _, run in _all(opening, "cap")]
    worst = min(angles)
    scenes = listed([NAMES[scene] for scene in opening])
    return Statement(
        claim="Doors and fridges open, with vertical and with horizontal handles, the robot moving "
        "back.",
        outcome=f"{scenes}: all {len(angles)} runs open, the least by {worst:.1f}°.",
        checks=(at_least("least angle", worst, 57.0, "deg"),),
    )


def _scene_bands(opening: Numbers) -> tuple[Statement, ...]:
    checks, texts = [], []
    for scene, grip, run in _all(opening, "cap"):
        angle, force = BANDS[scene][grip == "turning"]
        checks += [
            at_least(f"{scene}, {grip}: angle", run["angle"], angle, "deg"),
            at_most(f"{scene}, {grip}: force", run["force"], force, "N"),
        ]
        if grip == "rigid":
            texts.append(f"{NAMES[scene]} {run['angle']:.1f}°, {run['force']:.1f} N")
    return (
        band(
            claim="Law cap reaches the angles and forces of the study in every scene and with both "
            "grips.",
            outcome=f"Rigid grip: {'; '.join(texts)}.",
            checks=tuple(checks),
        ),
    )


def _ends(both: Numbers) -> Statement:
    checks, texts, forces = [], [], []
    for scene, grip, run in _all(both, "cap"):
        ends = run["ends"]
        first = ends[0] if ends else float("nan")
        second = ends[1] if len(ends) > 1 else float("nan")
        checks += [
            between(
                f"{scene}, {grip}: open", first, STOP - END_TOLERANCE, STOP + END_TOLERANCE, "deg"
            ),
            between(f"{scene}, {grip}: closed", second, -END_TOLERANCE, END_TOLERANCE, "deg"),
        ]
        texts.append(f"{first:.1f}°/{second:.1f}°")
        forces.append(run["force"])
    checks.append(at_most("peak force", max(forces), 65.0, "N"))
    return Statement(
        claim="The end of both motions is recognised by resistance.",
        outcome=f"Recognised at (open/closed) {listed(texts)}; at most {max(forces):.0f} N at the "
        "handle.",
        checks=tuple(checks),
    )


def _stiff_ends(both: Numbers) -> tuple[Statement, ...]:
    stiff = both["door"].get("rigid", {}).get("stiff")
    if stiff is None:
        return ()
    text = f"{stiff['ends'][0]:.1f}°" if stiff["ends"] else "nowhere"
    first = stiff["ends"][0] if stiff["ends"] else 0.0
    return (
        band(
            claim="All stiff and rigidly gripped, the arm takes its own resistance for the end.",
            outcome=f"It takes the door for open at {text}.",
            checks=(at_most("angle", first, 20.0, "deg"),),
        ),
    )


def opening_table(opening: Numbers) -> Table:
    """Return a table with opening angle and largest force of every run that opens a door."""
    rows = [
        (
            NAMES[scene],
            grip,
            law,
            f"{run['angle']:.1f}°",
            f"{run['force']:.1f} N",
            f"{run['torque']:.2f} N·m" if grip == "rigid" else "–",
        )
        for scene, grips in opening.items()
        for grip, laws in grips.items()
        for law, run in laws.items()
    ]
    return Table(
        caption="Opening: how far, and the largest force and torque at the handle in any physics "
        "step.",
        columns=("scene", "grip", "law", "opened", "force", "torque"),
        rows=tuple(rows),
    )


def closing_table(both: Numbers) -> Table:
    """Return a table with the openings at which resistance was detected, of every run."""
    rows = []
    for scene, grips in both.items():
        for grip, laws in grips.items():
            for law, run in laws.items():
                ends = [f"{end:.1f}°" for end in run["ends"]] + ["missed"] * (2 - len(run["ends"]))
                rows.append((NAMES[scene], grip, law, *ends, f"{run['force']:.1f} N"))
    return Table(
        caption=f"Opening and closing: leaf when the end was recognised; the stop is at {STOP:g}°.",
        columns=("scene", "grip", "law", "open at", "closed at", "peak force"),
        rows=tuple(rows),
    )


# --- Doors: pictures, force over angle, all scenes, opening and closing ---

#: Times of the pictures in a run [s]; the pull lasts from 1 s to 6.6 s.
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


def draw_strips(outcomes: Mapping[str, OpenResult], folder: Path) -> None:
    """Draw pictures of the arm at the door at `INSTANTS`: soft axes (top), all stiff (bottom)."""
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


def circle(largest: float = 80.0) -> Array:
    """Return points (k, 3) [m] of the handle's circular path, up to an opening `largest` [deg]."""
    handle = tool(SCENES["door"].start)[:3, 3]
    arm_of_handle = np.array([0.0, 0.30, 0.0])
    angle = np.deg2rad(np.linspace(0.0, largest, 41))[:, None]
    turned = np.cos(angle) * arm_of_handle + np.sin(angle) * np.array([-0.30, 0.0, 0.0])
    points: Array = handle - arm_of_handle + turned
    return points


def draw_force_over_angle(outcomes: Mapping[str, OpenResult], folder: Path) -> None:
    """Draw the largest force so far over the opening angle, for each grip, and the tool's path."""
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
                widest = np.maximum.accumulate(angle)
                ax.plot(widest, force, color=LAW_COLOURS[law])
                ax.plot(widest[-1:], force[-1:], marker="o", markersize=4, color=LAW_COLOURS[law])
                ends.append((float(widest[-1]), float(force[-1]), law))
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


def _paths(ax: Any, outcomes: Mapping[str, OpenResult]) -> None:
    """Draw the tool's paths seen from above, with the hinge and the circle of the handle."""
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


def draw_scenes(outcomes: Mapping[str, OpenResult], folder: Path) -> None:
    """Draw largest force and opening for every scene and grip: law cap, and all axes stiff."""
    rows = [
        (scene, grip)
        for scene in SCENES
        for grip in ("rigid", "turning")
        if f"open/{scene}/{grip}/cap" in outcomes
    ]
    with canvas(1, 1, size=(WIDE * 0.85, 0.9 + 0.34 * len(rows))) as (figure, axes):
        ax = axes[0, 0]
        for index, (scene, grip) in enumerate(rows):
            cap = outcomes[f"open/{scene}/{grip}/cap"]
            stiff = outcomes[f"open/{scene}/{grip}/stiff"]
            ax.plot([cap.force, stiff.force], [index, index], color=MUTED, linewidth=1.0, zorder=1)
            for run, law, side in ((cap, "cap", -1), (stiff, "stiff", 1)):
                ax.plot(run.force, index, "o", markersize=6, color=LAW_COLOURS[law], zorder=2)
                ax.annotate(
                    f"{run.angle:.0f}°",
                    (run.force, index),
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


def draw_closing(
    traces: Mapping[str, Trace], force_of: Callable[[Trace], Array], folder: Path
) -> None:
    """Draw opening angle and estimated force of runs that open and close a door.

    Args:
        traces: Record of each run by key.
        force_of: Function that estimates the force along x at each tick [N] from a record.
        folder: Target folder.
    """
    cases = [
        (key, title)
        for key, title in (
            ("both/door/rigid/cap", "door, rigid grip"),
            ("both/fridge/rigid/cap", "fridge, rigid grip"),
            ("both/horizontal/turning/cap", "horizontal handle, turning"),
            ("both/door/rigid/stiff", "door, rigid grip, all stiff"),
        )
        if key in traces
    ]
    with canvas(2, len(cases), size=(WIDE, 4.4), sharex=True, sharey="row") as (figure, axes):
        for column, (key, title) in enumerate(cases):
            trace = traces[key]
            step = thin(trace.t)
            t = trace.t[step]
            colour = LAW_COLOURS[key.rsplit("/", maxsplit=1)[-1]]
            top, low = axes[:, column]
            top.plot(t, np.rad2deg(trace.leaf[step]), color=colour)
            force = force_of(trace)
            for k in detected_ends(trace.t, force):
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


def detected_ends(t: Array, force: Array) -> list[int]:
    """Return the ticks at which resistance is detected: first of opening, then of closing.

    Args:
        t: Time of each tick (N,) [s].
        force: Estimated force along x at each tick (N,) [N].

    Returns:
        At most two indices: the first ticks at which the force has exceeded `THRESHOLD` for
        `PERSISTENCE`, toward +x and after that toward -x.
    """
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
