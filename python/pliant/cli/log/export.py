"""`pliant log export`: convert a log to a table with one row per control cycle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._extras import pip
from pliant._files import replacing
from pliant.cli._console import print_line
from pliant.cli._flags import File, LogFile
from pliant.cli.log._output import read_for_output

if TYPE_CHECKING:
    from pathlib import Path

    from pliant.log import Log


def run(log: LogFile, *, output: File = None, parquet: bool = False) -> None:
    """Write a table with one row per tick.

    Args:
        log: MCAP file of `pliant run --log` or `pliant.log.Recorder`.
        output: Output path. A file ending in .npz, or .parquet with --parquet. Default: beside the
            log, with its name.
        parquet: Write Parquet instead of NumPy's npz (needs pyarrow).
    """
    suffix = ".parquet" if parquet else ".npz"
    hint = "" if parquet else " (--parquet writes .parquet)"
    data, file = read_for_output(
        log, output, (suffix,), command="pliant log export", kind="table", hint=hint
    )
    with replacing(file) as temporary:
        if parquet:
            _parquet(temporary, data)
        else:
            columns: dict[str, Any] = dict(data.columns)
            np.savez_compressed(temporary, **columns)
    print_line(str(file))


def _parquet(file: Path, log: Log) -> None:
    """Write a Parquet file; each quantity of the log has one column per joint or task axis."""
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
