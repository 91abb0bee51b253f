"""`pliant report`: why an arm was soft or not, as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console


def run(
    log: Annotated[Path, tyro.conf.Positional],
    *,
    output: Path | None = None,
) -> None:
    """Make a page of a log that `pliant run --log` or `pliant.log.Recorder` made.

    Args:
        log: The MCAP file.
        output: Folder for report.html and its pictures; default: beside the log, named after it.
    """
    from pliant.log import read
    from pliant.log.report import report

    data = read(log)
    page = report(data, output or log.with_name(f"{log.stem}_report"), title=log.stem)
    Console().print(str(page.resolve()), highlight=False, soft_wrap=True)
