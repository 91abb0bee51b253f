"""`pliant log report`: write an HTML report on the compliance in a log."""

from __future__ import annotations

from pliant._files import check_output
from pliant.cli._console import print_line
from pliant.cli._flags import File, LogFile, check_writable


def run(
    log: LogFile,
    *,
    output: File = None,
) -> None:
    """Write an HTML report that explains why the arm yielded or not.

    Args:
        log: MCAP file of `pliant run --log` or `pliant.log.Recorder`.
        output: Output path. A folder for report.html and figures; default: LOG_report.
    """
    from pliant.log import read
    from pliant.log.report import report

    data = read(log)
    folder = output or log.with_name(f"{log.stem}_report")
    if folder.is_dir():
        check_writable(folder / "report.html", "page", [log])
    else:
        check_output(folder, "page", [log])
    page = report(data, folder, title=log.stem)
    print_line(str(page.resolve()))
