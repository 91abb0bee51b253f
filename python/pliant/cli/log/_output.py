"""Log and output file of `pliant log plot` and `pliant log export`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError
from pliant.cli._flags import check_writable

if TYPE_CHECKING:
    from pathlib import Path

    from pliant.log import Log


def read_for_output(
    path: Path,
    output: Path | None,
    suffixes: tuple[str, ...],
    *,
    command: str,
    kind: str,
    hint: str = "",
) -> tuple[Log, Path]:
    """Return a log, and the path of the file to write.

    The file is `output`, or else the path of the log with the first of the possible suffixes.

    Raises:
        ConfigError: The suffix of `output` is not possible, or the file cannot be written, is the
            log itself, or exists and is not of this kind; or the log has no ticks.
    """
    from pliant.log import read

    if output is not None and output.suffix not in suffixes:
        raise ConfigError(
            f"--output {output}: {command} writes {', '.join(suffixes)}{hint}, "
            f"got {output.suffix or 'no suffix'}"
        )
    file = output or path.with_suffix(suffixes[0])
    check_writable(file, kind, [path])
    log = read(path)
    if not len(log):
        raise ConfigError(f"{path} has no ticks")
    return log, file
