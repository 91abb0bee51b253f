"""Force to move the arm against the drift of its stiff axes, and the return."""

from __future__ import annotations

from string import ascii_uppercase
from typing import TYPE_CHECKING

from matplotlib.lines import Line2D

from experiments.figures.style import LAW_COLOURS, label_points, shade
from pliant._report.style import WIDE, canvas, label_end, save, thin

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from experiments.chapters.comparison import Way
    from experiments.episode import Trace
    from experiments.result import Numbers

#: Curves shown over time: one of each family.
OVER_TIME = ("stiff", "uniform 30", "paper 0.999", "cap 0", "cap 0.999", "impedance")


def draw(
    numbers: Numbers, traces: Mapping[str, Trace], ways: Mapping[str, Way], folder: Path
) -> None:
    """Draw `5-comparison`."""
    with canvas(1, 2, size=(WIDE, 5.6), width_ratios=[1.15, 1.0]) as (figure, axes):
        ax, over = axes[0]
        names: list[tuple[float, float, str, str]] = []
        key_of_letters = []
        for letter, (key, way) in zip(ascii_uppercase, ways.items(), strict=False):
            force, drift = numbers[key]["force"], 1e3 * numbers[key]["drift"]
            stays = numbers[key]["returned"] is None
            colour = LAW_COLOURS[way.family]
            ax.plot(
                force,
                drift,
                "o",
                markersize=8,
                markeredgewidth=1.6,
                color=colour,
                markerfacecolor="none" if stays else colour,
            )
            names.append((force, drift, letter, colour))
            key_of_letters.append(Line2D([], [], linestyle="", label=f"{letter}  {way.name}"))
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlim(2.0, 110.0)
        ax.set_ylim(0.6, 300.0)
        ax.set_xticks([3, 5, 10, 20, 50, 100], ["3", "5", "10", "20", "50", "100"])
        ax.set_yticks([1, 3, 10, 30, 100], ["1", "3", "10", "30", "100"])
        ax.minorticks_off()
        ax.set_xlabel("force to move it by 0.15 m [N]")
        ax.set_ylabel("drift of the stiff positions [mm]")
        ax.set_title("filled: comes back; open: does not")
        marks = []
        for key in OVER_TIME:
            if key in traces:
                trace, colour = traces[key], LAW_COLOURS[ways[key].family]
                step = thin(trace.t)
                dashed = key == "cap 0"
                over.plot(
                    trace.t[step],
                    -1e3 * trace.error[step, 1],
                    color=colour,
                    linestyle=(0, (4, 2)) if dashed else "-",
                )
                marks.append((-1e3 * float(trace.error[-1, 1]), ways[key].name, colour))
        over.set_ylim(-40.0, 260.0)
        shade(over, 2.0, 5.0, "hand")
        over.set_xlim(0.0, 9.0)
        over.set_xlabel("time [s]")
        over.set_ylabel("y, from its target [mm]")
        over.set_title("pulled toward +y, let go at 5 s")
        label_end(over, 9.0, marks, size=7.5)
        label_points(ax, sorted(names, key=lambda name: -name[1]), size=8.5)
        figure.legend(
            handles=key_of_letters,
            loc="outside lower left",
            ncols=4,
            handlelength=0.0,
            labelcolor=[LAW_COLOURS[way.family] for way in ways.values()],
        )
        save(figure, folder, "5-comparison")
