"""Checks of output files, before the arm moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from pliant._core import ConfigError
from pliant._files import check_output

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from pliant.config import Config
    from pliant.log import Recorder


def check_written(path: Path, kind: str, inputs: Iterable[Path | str | None] = ()) -> None:
    """Check that a file can be written, and warn if an existing one will be replaced.

    Raises:
        ConfigError: See `pliant._files.check_output`.
    """
    if check_output(path, kind, inputs):
        text = f"{path}: the {kind} that is there will be replaced"
        Console(stderr=True).print(text, highlight=False, soft_wrap=True, markup=False)


def check_log(path: Path | None, inputs: Iterable[Path | str | None] = ()) -> None:
    """Check that the requested log can be written, before torque comes on.

    Raises:
        ConfigError: The name does not end in .mcap, or see `check_written`.
        ImportError: The extra log is not installed.
    """
    if path is not None:
        import pliant.log  # noqa: F401 -- what it needs is there

        check_written(path, "log", inputs)
        if path.suffix != ".mcap":
            raise ConfigError(f"--log {path}: a log ends with .mcap: {path.with_suffix('.mcap')}")


def recorder_of(path: Path, *, config: Config, note: str = "") -> Recorder:
    """Return the recorder of a command's log; import the extra only if needed."""
    from pliant.log import Recorder

    return Recorder(path, config=config, note=note)
