"""Table and picture of the comparison, with one row per implementation."""

from __future__ import annotations

import os
import platform
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from comparison.environments import ROOT
from comparison.timing import TimedProcess


@dataclass(frozen=True)
class Row:
    """Results of one implementation, a row of the table.

    Attributes:
        name, version: Name of the implementation, and version of its library.
        step, kinematics: Median time of a control step, and of pose and Jacobian, over the rounds
            [µs], minus the time of the empty loop; NaN if the implementation lacks the function.
        tail: 99.9th percentile of the time of single steps [µs], minus the median of empty calls.
        batch: Millions of configurations per second, for which one core computes pose and Jacobian.
        ratio, kinematics_ratio: `step` and `kinematics` over those of pliant in the same round,
            median over the rounds.
    """

    name: str
    version: str
    step: float
    tail: float
    kinematics: float
    batch: float
    ratio: float
    kinematics_ratio: float


def rows(processes: list[TimedProcess]) -> list[Row]:
    """Return one row per process; the first process must be pliant, the reference of the ratios."""
    own = processes[0]
    out = []
    for process in processes:
        single = np.array(process.singles.get("step/single", []))
        empty = np.array(process.singles.get("empty/single", [0.0]))
        tail = np.percentile(single, 99.9) - np.median(empty) if single.size else np.nan
        out.append(
            Row(
                process.name,
                process.version,
                float(np.nanmedian(net(process, "step"))) / 1e3,
                float(tail) / 1e3,
                float(np.nanmedian(net(process, "kinematics"))) / 1e3,
                1e3 / float(np.nanmedian(process.medians["batch/whole"])),
                float(np.nanmedian(net(process, "step") / net(own, "step"))),
                float(np.nanmedian(net(process, "kinematics") / net(own, "kinematics"))),
            )
        )
    return out


def net(process: TimedProcess, task: str) -> np.ndarray:
    """Return the time of one call of a task in each round [ns], minus that of the empty loop."""
    return np.array(process.medians[f"{task}/whole"]) - np.array(process.medians["empty/whole"])


def where() -> str:
    """Return a text with commit, processor, Python version and machine load."""
    commit = _git("rev-parse", "--short=12", "HEAD") or "unknown commit"
    if _git("status", "--porcelain", "--untracked-files=no"):
        commit += " with changes"
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return f"commit {commit}; {processor()}; CPython {platform.python_version()}{load}"


def processor() -> str:
    """Return name, family (if Linux reports it) and number of cores of the processor."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    fields = dict(
        (key.strip(), value.strip())
        for key, _, value in (line.partition(":") for line in text.splitlines())
    )
    family = f" family {fields['cpu family']}" if "cpu family" in fields else ""
    return f"{fields.get('model name', platform.machine())}{family}, {os.cpu_count()} cores"


def markdown(table_rows: list[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        "| | step, median | × ours | p99.9 | FK + J | × ours | batch FK + J, one core |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in table_rows:
        cells = (
            f"{row.name}",
            f"{row.step:.2f} µs",
            f"{row.ratio:.1f}",
            f"{row.tail:.2f} µs",
            f"{row.kinematics:.2f} µs",
            f"{row.kinematics_ratio:.1f}",
            f"{row.batch:.2f} M/s",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def floor(processes: list[TimedProcess]) -> float:
    """Return the 99.9th percentile of the time of empty calls, minus their median [µs]."""
    empty = np.array(processes[0].singles.get("empty/single") or [np.nan])
    return float(np.percentile(empty, 99.9) - np.median(empty)) / 1e3


def plot(table_rows: list[Row], path: Path, note: str) -> None:
    """Draw the times of all rows on logarithmic axes into the file `path`.

    The left plot has a line per step, from the median to the 99.9th percentile; the right plot has
    the medians of pose and Jacobian. `note` is a text at the bottom.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FuncFormatter

    figure, axes = plt.subplots(1, 2, figsize=(10, 0.34 * len(table_rows) + 1.7), sharey=True)
    positions = np.arange(len(table_rows))
    parts = (
        (axes[0], "one step of law paper", [(row.step, row.tail) for row in table_rows]),
        (axes[1], "pose and Jacobian", [(row.kinematics, row.kinematics) for row in table_rows]),
    )
    for axis, title, values in parts:
        for position, row, (median, tail) in zip(positions, table_rows, values, strict=True):
            colour = "#c1121f" if row.name.startswith("pliant") else "#33415c"
            axis.plot([median, tail], [position, position], color=colour, linewidth=1.2, alpha=0.45)
            axis.plot(median, position, "o", color=colour, markersize=7)
            text = f"{median:.2f}" if median < 10.0 else f"{median:.0f}"
            axis.annotate(
                text,
                (median, position),
                (-8, 0),
                textcoords="offset points",
                **{"va": "center", "ha": "right", "fontsize": 9, "color": colour},
            )
        axis.set_xscale("log")
        axis.set_xlim(left=0.3 * min(median for median, _ in values))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axis.set_title(title, loc="left", fontsize=11)
        axis.grid(axis="x", color="0.9")
        axis.set_axisbelow(True)
        axis.spines[["top", "right", "left"]].set_visible(False)
        axis.tick_params(axis="y", length=0)
    axes[0].set_xlabel("from Python [µs], logarithmic: dot median, line to p99.9")
    axes[1].set_xlabel("from Python [µs], logarithmic: median")
    axes[0].set_yticks(positions, [row.name for row in table_rows])
    axes[0].invert_yaxis()
    figure.text(0.005, 0.008, note, fontsize=7, color="0.4")
    figure.tight_layout(rect=(0, 0.03, 1, 1))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _git(*arguments: str) -> str:
    result = subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return result.stdout.strip() if result.returncode == 0 else ""
