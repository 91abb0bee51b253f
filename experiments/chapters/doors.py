"""Chapter 4: doors and a fridge, opened and closed; the handle determines the path."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import laws
from experiments.chapters import doors_text
from experiments.chapters.common import Options
from experiments.conditions import NOMINAL
from experiments.doors import SCENES, open_door
from experiments.resistance import STOP, open_and_close
from experiments.result import Chapter, Numbers
from experiments.runner import Job
from experiments.setups import arm

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any

    from numpy.typing import NDArray

    from experiments.doors import Opened
    from experiments.episode import Trace
    from experiments.hands import Law
    from experiments.resistance import OpenedAndClosed

    Array = NDArray[np.float64]

NUMBER = 4
TITLE = "Doors"
GRIPS = ("rigid", "turning")


def stiff(*, soft: str, **more: Any) -> Law:
    """Make all axes stiff, whatever the scene's soft axes."""
    return laws.all_stiff(**more)


LAWS: Mapping[str, Callable[..., Law]] = {
    "cap": laws.cap,
    "paper": partial(laws.paper, 8.0),
    "stiff": stiff,
}


def jobs(options: Options) -> list[Job]:
    """Return every scene, both grips, soft and stiff; then opening and closing by resistance."""
    scenes = ("door",) if options.quick else tuple(SCENES)
    grips = ("rigid",) if options.quick else GRIPS
    runs = [
        Job(f"open/{scene}/{grip}/{law}", open_door, (make, scene, grip))
        for scene in scenes
        for grip in grips
        for law, make in LAWS.items()
        if law != "paper" or scene == "door"
    ]
    still = [scene for scene in scenes if not SCENES[scene].base]
    runs += [
        Job(f"both/{scene}/{grip}/{law}", open_and_close, (LAWS[law], scene, grip))
        for scene in still
        for grip in grips
        for law in ("cap", "stiff")
        if law == "cap" or scene == "door"
    ]
    return runs


def measure(outcomes: Mapping[str, Any]) -> Numbers:
    """Return numbers by scene, grip and law: opening, and opening and closing."""
    opening: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    both: dict[str, dict[str, dict[str, dict[str, Any]]]] = {}
    for name, run in outcomes.items():
        kind, scene, grip, law = name.split("/")
        if kind == "open":
            opening.setdefault(scene, {}).setdefault(grip, {})[law] = _opened(run)
        else:
            both.setdefault(scene, {}).setdefault(grip, {})[law] = _both(run)
    return {"opening": opening, "opening_and_closing": both, "stop": STOP}


def _opened(run: Opened) -> dict[str, float]:
    usable = np.asarray(NOMINAL.servos().max_torque)
    return {
        "angle": run.angle,
        "force": run.force,
        "torque": run.torque,
        "largest_limit_share": float((run.trace.limit.max(axis=0) / usable).max()),
    }


def _both(run: OpenedAndClosed) -> dict[str, Any]:
    return {
        "ends": list(run.ends),
        "force": run.force,
        "widest": float(np.rad2deg(run.trace.leaf.max())),
        "at_end": float(np.rad2deg(run.trace.leaf[-1])),
    }


def felt(trace: Trace) -> Array:
    """Return the force in x (N,) [N] estimated from the joint positions, replayed from a run."""
    contact = pliant.ContactEstimator(pliant.Controller(arm(), laws.cap(), NOMINAL.servos()))
    force = np.zeros(trace.t.size)
    for k in range(trace.t.size):
        sent = (trace.goal[k], trace.limit[k])
        force[k] = contact.update(trace.q[k], sent=sent).force_base[0]
    return force


def chapter(numbers: Numbers) -> Chapter:
    """Judge the paper's statements on doors, and the bands."""
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
        figures=doors_text.figures(opening, both),
        tables=(doors_text.opening_table(opening), doors_text.closing_table(both)),
        numbers=numbers,
        headline=(
            ("door, rigid grip, cap", f"{soft['angle']:.1f}°, {soft['force']:.1f} N"),
            ("door, rigid grip, all stiff", f"{hard['angle']:.1f}°, {hard['force']:.1f} N"),
            ("recognised ends, rigid grip", ", ".join(f"{end:.1f}°" for end in ends) or "none"),
        ),
    )


def draw(outcomes: Mapping[str, Any], options: Options) -> None:
    """Draw the strips of pictures, force over angle, all scenes, and opening and closing."""
    from experiments.figures import doors

    doors.strips(outcomes, options.figures)
    doors.force_over_angle(outcomes, options.figures)
    doors.scenes(outcomes, options.figures)
    doors.closing(
        {n: r.trace for n, r in outcomes.items() if n.startswith("both/")}, felt, options.figures
    )
