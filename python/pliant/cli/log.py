"""`pliant log`: what is in a log, as words, as pictures, as a table for notebooks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro
from rich.console import Console

import pliant
from pliant.cli.files import check_written
from pliant.cli.flags import File, LogFile
from pliant.extras import missing, pip
from pliant.inputs import printable
from pliant.outputs import replacing

if TYPE_CHECKING:
    from pliant.log import Log

#: Kinds of picture that plot writes.
PICTURES = (".png", ".svg", ".pdf")
#: Figures of a log: column, and what its axis says.
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


def run(
    what: Annotated[Literal["info", "plot", "export"], tyro.conf.Positional],
    log: LogFile,
    *,
    output: File = None,
    parquet: bool = False,
    verify: bool = False,
) -> None:
    """Look at a log that `pliant run --log` or `pliant.log.Recorder` made.

    info says what it holds; plot draws joints and task; export makes a table, one row per tick.

    Args:
        what: info, plot or export.
        log: The MCAP file.
        output: File to write: picture (png, svg, pdf) or table; default: beside the log.
        parquet: Export Parquet for pandas, polars, DuckDB (needs pyarrow); else NumPy's npz.
        verify: With info: run the controller again and compare every command.
    """
    from pliant.log import read

    _suits(what, output, parquet, verify)
    data = read(log)
    console = Console()
    if what == "info":
        _info(console, log, data, verify)
        return
    suffix = ".png" if what == "plot" else ".parquet" if parquet else ".npz"
    file = output or log.with_suffix(suffix)
    check_written(file, "picture" if what == "plot" else "table", [log])
    if not len(data):
        raise pliant.ConfigError(f"{log} has no ticks")
    with replacing(file) as beside:
        if what == "plot":
            _plot(beside, data)
        elif parquet:
            _parquet(beside, data)
        else:
            columns: dict[str, Any] = dict(data.columns)
            np.savez_compressed(beside, **columns)
    console.print(str(file), highlight=False, soft_wrap=True, markup=False)


def _suits(what: str, output: Path | None, parquet: bool, verify: bool) -> None:
    """Whether the flags go with what is asked for, and the file with what will be in it."""
    for flag, given, of in (
        ("--output", output is not None, ("plot", "export")),
        ("--parquet", parquet, ("export",)),
        ("--verify", verify, ("info",)),
    ):
        if given and what not in of:
            raise pliant.ConfigError(f"{flag} belongs to pliant log {' and '.join(of)}, not {what}")
    if output is None:
        return
    kinds = PICTURES if what == "plot" else (".parquet",) if parquet else (".npz",)
    if output.suffix not in kinds:
        hint = " (--parquet writes .parquet)" if what == "export" and not parquet else ""
        raise pliant.ConfigError(
            f"--output {output}: pliant log {what} writes {', '.join(kinds)}{hint}, "
            f"got {output.suffix or 'no suffix'}"
        )
    if not output.absolute().parent.is_dir():
        raise pliant.ConfigError(
            f"--output {output}: there is no folder {output.absolute().parent}"
        )


def _info(console: Console, path: Path, log: Log, again: bool) -> None:
    """What a log holds."""
    run, axes = log.run, log.run["axes"]
    span = float(log.time[-1] - log.time[0]) if len(log) else 0.0
    lines = [
        f"{path}: {len(log)} ticks in {span:.2f} s, {path.stat().st_size / 1e6:.2f} MB",
        f"joints: {', '.join(run['joints'])}" + "".join(f" + {name}" for name in run["extra"]),
        f"axes: {' '.join(axes)}" if axes else "no controller (hand guiding)",
        f"made by pliant {run['pliant']}" + (f": {run['note']}" if run["note"] else ""),
    ]
    if log.damage:
        lines.append(f"damaged: {log.damage}; what stands before that is here")
    elif not log.whole:
        lines.append("not completed: program and writer died; what they wrote is here")
    if log.missing:
        lines.append(f"{log.missing} calls of the controller were dropped")
    if len(log):
        late = 1e3 * np.diff(log.time)
        middle, most = np.median(late), late.max() if late.size else 0.0
        lines.append(f"from tick to tick {middle:.1f} ms (median), {most:.1f} ms at most")
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
            "at the torque ceiling: "
            + ", ".join(
                f"{name} {value:.0%}" for name, value in zip(run["joints"], share, strict=True)
            )
        )
    if again:
        lines.append(_again(log))
    for line in lines:
        console.print(printable(line), highlight=False, soft_wrap=True, markup=False)


def _again(log: Log) -> str:
    from pliant.log import verify

    result = verify(log)
    if result.same:
        return f"run again: {result.steps} commands, all the same, bit for bit"
    return (
        f"run again: {result.differing} of {result.steps} commands differ, goals by at most "
        f"{result.largest:.2g} rad" + (" (calls are missing)" if result.missing else "")
    )


def _plot(file: Path, log: Log) -> None:
    """Joints on the left, the task on the right."""
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


def _parquet(file: Path, log: Log) -> None:
    """One column per number; joints and axes by name."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise ImportError(f"--parquet needs pyarrow: {pip()} pyarrow") from error
    table: dict[str, Any] = {}
    joints, axes, ticks = log.run["joints"], log.run["axes"] or [], len(log)
    for name, values in log.columns.items():
        flat = values.reshape(ticks, -1)
        size = flat.shape[1]
        labels = {1: [""], len(joints): joints, len(axes): axes}.get(size, range(size))
        labels = log.run["extra"] if name == "extra" else labels
        for label, column in zip(labels, flat.T, strict=True):
            table[f"{name}.{label}" if label != "" else name] = column
    parquet.write_table(pa.table(table), file)
