"""Results of each preset of `Settings` in a simulated task, compared with all axes stiff.

``python -m experiments.presets`` prints the table of docs/presets.md. With a path as argument, it
also draws the force against the deviation of a soft axis, for each `Axis.profile`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from experiments import command_line, compliance, disturbances, tasks
from experiments.simulation import NOMINAL, TICK_EACH_WAY, Conditions
from pliant import Axis, Settings

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Literal

    from experiments.disturbances import Law
    from experiments.poses import Array

    Profile = Literal["hardening", "constant", "softening"]

#: Caps `soft` and `firm` of the drawn profiles [N].
SOFT, FIRM = 4.0, 15.0
#: Conditions by name: ideal; a delay of one tick for readings and for commands; this delay with
#: friction errors of 30 %.
UNDER: dict[str, Conditions] = {
    "nominal": NOMINAL,
    "tick each way": TICK_EACH_WAY,
    "assumed × 0.7": Conditions(delay=(1, 1), assumed_ratio=0.7),
    "assumed × 1.3": Conditions(delay=(1, 1), assumed_ratio=1.3),
}


def _drawer(law: Law, conditions: Conditions) -> str:
    result = tasks.pull_drawer(law, conditions=conditions)
    return (
        f"{1e3 * result.way:.0f} mm open, peak {result.force:.1f} N, across {result.across:.1f} N, "
        f"{result.torque:.1f} N·m"
    )


def _wipe(law: Law, conditions: Conditions) -> str:
    result = tasks.wipe(law, conditions=conditions)
    return (
        f"{result.mean:.1f} N ({result.least:.1f} to {result.most:.1f}), "
        f"{1e3 * result.off:.0f} mm off its path"
    )


def _hand_over(law: Law, conditions: Conditions) -> str:
    result = tasks.hand_over(law, conditions=conditions)
    return (
        f"person {result.effort:.0f} N, sag {1e3 * result.sag:.0f} mm, "
        f"tool afterwards {result.fastest:.2f} m/s"
    )


def _plug(law: Law, conditions: Conditions) -> str:
    results = [
        tasks.plug_in(law, offset=offset, tilt=tilt, conditions=conditions)
        for offset, tilt in tasks.MISPLACED
    ]
    force_along, force_across = (
        max(result.along for result in results),
        max(result.across for result in results),
    )
    return (
        f"{sum(result.inside for result in results)} of {len(results)} in, "
        f"along at most {force_along:.1f} N, across {force_across:.1f} N"
    )


def _guide(law: Law, conditions: Conditions) -> str:
    result = disturbances.drag(law, conditions=conditions)
    return (
        f"{result.force:.1f} N for {1e3 * result.moved:.0f} mm, "
        f"then at most {result.fastest:.1f} rad/s"
    )


#: Settings of each preset, and function that simulates its task and returns the results as text.
SCENES: dict[str, tuple[Settings, Callable[[Law, Conditions], str]]] = {
    "drawer()": (Settings.drawer(), _drawer),
    "wipe(press=5.0)": (Settings.wipe(press=5.0), _wipe),
    "hand_over()": (Settings.hand_over(), _hand_over),
    "plug(push=10.0)": (Settings.plug(push=10.0), _plug),
    "hand_guiding()": (Settings.hand_guiding(), _guide),
}


def draw(path: Path) -> None:
    """Draw measured and expected force against deviation of y for each profile into a file.

    This function needs Matplotlib.
    """
    from pliant._report import style

    deviations = np.linspace(0.0, 0.15, 301)
    servo_force = compliance.stiffness("y") * deviations
    c = np.clip(1.0 - (deviations - 0.01) / 0.09, 0.0, 1.0)
    profiles: dict[Profile, tuple[str, Array]] = {
        "hardening": (style.BLUE, c * SOFT + (1.0 - c) * FIRM),
        "constant": (style.GREEN, np.full_like(deviations, SOFT)),
        "softening": (style.RED, c * FIRM + (1.0 - c) * SOFT),
    }
    with style.canvas(size=(6.4, 3.2)) as (figure, grid):
        ax, ends = grid[0, 0], []
        for profile, (colour, strength) in profiles.items():
            settings = Settings(axes={"y": Axis(soft=SOFT, firm=FIRM, profile=profile)})
            curve = compliance.answer(settings)
            ax.plot(1e3 * curve.deviation, curve.force, color=colour)
            ax.plot(
                1e3 * deviations, np.minimum(strength, servo_force), color=colour, ls=":", lw=1.0
            )
            ends.append((float(curve.force[-1]), profile, colour))
        ax.set(xlim=(0.0, 150.0), ylim=(0.0, 18.0))
        ax.set(xlabel="deviation in y [mm]", ylabel="force of the hand [N]")
        ax.set_title("Profiles: felt (solid) and promised (dotted)")
        style.label_end(ax, 150.0, ends)
        figure.savefig(path, dpi=style.PIXELS_PER_INCH, metadata={"Software": None})


def main(picture: tyro.conf.Positional[Path | None] = None) -> None:
    """Print the results of all presets under all conditions.

    Args:
        picture: File for the picture of force against deviation; default: no picture.
    """
    for name, conditions in UNDER.items():
        print(f"\n{name}")
        for preset, (settings, scene) in SCENES.items():
            print(f"  {preset:<18} {scene(settings, conditions)}")
            print(f"  {'all axes stiff':<18} {scene(Settings.firm(), conditions)}")
    if picture is not None:
        draw(picture)


if __name__ == "__main__":
    command_line.start(main)
