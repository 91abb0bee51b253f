"""`pliant log info`: print a summary of a log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._files import printable
from pliant.cli._console import Console, print_line
from pliant.cli._flags import LogFile

if TYPE_CHECKING:
    from pathlib import Path

    from pliant.log import Log


def run(log: LogFile) -> None:
    """Print length, joints, axes, timing, largest deviations and torque saturation of a log.

    Args:
        log: MCAP file of `pliant run --log` or `pliant.log.Recorder`.
    """
    from pliant.log import read

    console = Console()
    for line in _lines(log, read(log)):
        print_line(printable(line), console)


def _lines(path: Path, log: Log) -> list[str]:
    """Return the lines of the printed summary of a log."""
    run, axes = log.run, log.run["axes"]
    span = float(log.time[-1] - log.time[0]) if len(log) else 0.0
    lines = [
        f"{path}: {len(log)} ticks in {span:.2f} s, {path.stat().st_size / 1e6:.2f} MB",
        f"joints: {', '.join(run['joints'])}" + "".join(f" + {name}" for name in run["extra"]),
        f"axes: {' '.join(axes)}" if axes else "no controller (hand guiding)",
        f"made by pliant {run['pliant']}" + (f": {run['note']}" if run["note"] else ""),
    ]
    if log.damage:
        lines.append(f"damaged: {log.damage}; the data before the damage are shown")
    elif not log.whole:
        lines.append("not completed: program and writer died; what they had written is shown")
    if log.missing:
        lines.append(f"{log.missing} calls of the controller are missing from the log")
    if len(log):
        intervals = 1e3 * np.diff(log.time)
        median, longest = np.median(intervals), intervals.max() if intervals.size else 0.0
        lines.append(f"from tick to tick {median:.1f} ms (median), {longest:.1f} ms at most")
    if axes and len(log):
        worst = np.abs(log.deviation).max(axis=0)
        lines.append(
            "largest deviation: "
            + ", ".join(
                f"{name} {value:.3f} {'m' if name in 'xyz' else 'rad'}"
                for name, value in zip(axes, worst, strict=True)
            )
        )
        share = log.saturated.mean(axis=0)
        lines.append(
            "at the maximum torque: "
            + ", ".join(
                f"{name} {value:.0%}" for name, value in zip(run["joints"], share, strict=True)
            )
        )
    return lines
