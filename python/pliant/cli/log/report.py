"""`pliant log report`: why an arm was soft or not, as a page."""

from __future__ import annotations

from pliant._files import check_output
from pliant.cli._console import print_line
from pliant.cli._flags import File, LogFile, check_written


def run(
    log: LogFile,
    *,
    output: File = None,
) -> None:
    """Write a page that says why the arm was soft or not.

    Args:
        log: MCAP file of `pliant run --log` or `pliant.log.Recorder`.
        output: File to write, by default beside the log. A folder with report.html and its
            pictures.
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
    print_line(str(page.resolve()))
