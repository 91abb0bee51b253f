"""`pliant log verify`: recompute the commands of a log and compare them."""

from __future__ import annotations

from pliant.cli._console import print_line
from pliant.cli._flags import LogFile


def run(log: LogFile) -> None:
    """Run the controller again on the logged positions, and compare its commands with the log.

    Args:
        log: MCAP file of `pliant run --log` or `pliant.log.Recorder`.
    """
    from pliant.log import read, verify

    result = verify(read(log))
    line = (
        f"recomputed: {result.steps} commands, all identical bit for bit"
        if result.same
        else f"recomputed: {result.differing} of {result.steps} commands differ, goals by at most "
        f"{result.largest:.2g} rad" + (" (calls are missing)" if result.missing else "")
    )
    print_line(line)
