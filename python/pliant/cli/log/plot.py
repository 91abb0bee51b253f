"""`pliant log plot`: plot joints and task axes of a log over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._extras import missing
from pliant._files import replacing
from pliant.cli._console import print_line
from pliant.cli._flags import File, LogFile
from pliant.cli.log._output import read_for_output

if TYPE_CHECKING:
    from pathlib import Path

    from pliant.log import Log

#: Supported suffixes of the output file.
SUFFIXES = (".png", ".svg", ".pdf")
#: For each half of the picture: the plotted columns of the log with the labels of their y axes.
FIGURES = {
    "joints": (
        ("q", "position [rad]"),
        ("goal", "goal [rad]"),
        ("torque_limit", "torque limit [N·m]"),
    ),
    "task": (
        ("deviation", "deviation [m, rad]"),
        ("axis_strength", "cap [N, N·m]"),
        ("softness", "softness"),
    ),
}


def run(log: LogFile, *, output: File = None) -> None:
    """Plot joints and task axes over time.

    Args:
        log: MCAP file of `pliant run --log` or `pliant.log.Recorder`.
        output: Output path. A file ending in .png, .svg or .pdf. Default: a .png beside the log,
            with its name.
    """
    data, file = read_for_output(log, output, SUFFIXES, command="pliant log plot", kind="picture")
    with replacing(file) as temporary:
        _plot(temporary, data)
    print_line(str(file))


def _plot(file: Path, log: Log) -> None:
    """Plot the quantities of a log against time, to a file: joints left, task axes right."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(missing("pliant log plot", "plot")) from error
    kinds = [kind for kind in FIGURES if kind == "joints" or log.run["axes"]]
    rows = len(FIGURES["joints"])
    figure = Figure(figsize=(6.0 * len(kinds), 2.4 * rows), layout="constrained")
    grid = figure.subplots(rows, len(kinds), squeeze=False, sharex=True)
    time = log.time - log.time[0]
    for column, kind in enumerate(kinds):
        names = log.run["joints"] if kind == "joints" else log.run["axes"]
        for row, (name, label) in enumerate(FIGURES[kind]):
            grid[row, column].plot(time, log.columns[name], label=names, linewidth=1.0)
            grid[row, column].set_ylabel(label)
        grid[0, column].legend(fontsize="small", ncols=2)
        grid[-1, column].set_xlabel("time [s]")
    figure.savefig(file)
