"""Checks of the file that `pliant log plot` and `pliant log export` write."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError
from pliant.cli._flags import check_writable

if TYPE_CHECKING:
    from pathlib import Path

    from pliant.log import Log


def check_output(output: Path | None, command: str, suffixes: tuple[str, ...], hint: str) -> None:
    """Check that `--output` has a supported suffix and an existing folder.

    Raises:
        ConfigError: The suffix is not supported, or the folder does not exist.
    """
    if output is None:
        return
    if output.suffix not in suffixes:
        raise ConfigError(
            f"--output {output}: {command} writes {', '.join(suffixes)}{hint}, "
            f"got {output.suffix or 'no suffix'}"
        )
    if not output.absolute().parent.is_dir():
        raise ConfigError(f"--output {output}: there is no folder {output.absolute().parent}")


def check_log_and_output(path: Path, log: Log, output: Path, kind: str) -> None:
    """Check that a log has ticks (control cycles) and that the output file can be written.

    Raises:
        ConfigError: The log at `path` has no ticks; or the output file cannot be written, is the
            log itself, or exists and is not of this kind.
    """
    check_writable(output, kind, [path])
    if not len(log):
        raise ConfigError(f"{path} has no ticks")
