"""`pliant report`: why an arm was soft or not, as a page."""

from __future__ import annotations

from rich.console import Console

from pliant.cli.files import check_written
from pliant.cli.flags import File, LogFile
from pliant.outputs import check_output


def run(
    log: LogFile,
    *,
    output: File = None,
) -> None:
    """Make a page of a log that `pliant run --log` or `pliant.log.Recorder` made.

    Args:
        log: The MCAP file.
        output: Folder for report.html and its pictures; default: beside the log, named after it.
    """
    from pliant.log import read
    from pliant.log.report import report

    data = read(log)
    folder = output or log.with_name(f"{log.stem}_report")
    if folder.is_dir():
        check_written(folder / "report.html", "page", [log])
    else:
        check_output(folder, "page", [log])
    page = report(data, folder, title=log.stem)
    Console().print(str(page.resolve()), highlight=False, soft_wrap=True, markup=False)
