"""`pliant log verify`: recompute the commands of a log and compare them."""

from __future__ import annotations

from pliant.cli._console import print_line
from pliant.cli._flags import LogFile


def run(log: LogFile) -> None:
    """Run the controller again on the logged positions, and compare its commands with the log.

    Args:
        log: MCAP file of `pliant run --log` or `pliant.log.Recorder`.
    """
    from pliant._core import ConfigError
    from pliant.log import read, verify

    recorded = read(log)
    result = verify(recorded)
    if result.steps == 0:
        damage = f"; it is damaged: {recorded.damage}" if recorded.damage else ""
        raise ConfigError(f"{log} has no command to compare{damage}")
    line = (
        f"recomputed: {result.steps} commands, all identical bit for bit"
        if result.same
        else f"recomputed: {result.differing} of {result.steps} commands differ, goals by at most "
        f"{result.largest:.2g} rad" + (" (calls are missing)" if result.missing else "")
    )
    print_line(line)
    if recorded.damage:
        print_line(f"damaged: {recorded.damage}; only the commands before the damage were compared")
    elif not recorded.whole:
        print_line("the log ends early: only the commands up to there were compared")
