"""Files that a command will write when the arm has moved: what cannot be written is said before."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant import ConfigError

if TYPE_CHECKING:
    from pathlib import Path


def check_writable(path: Path) -> None:
    """See that a file can be written; what is there stays as it is.

    Raises:
        ConfigError: Its folder is not there, it is a folder, or nobody may write it.
    """
    if not path.absolute().parent.is_dir():
        raise ConfigError(f"there is no folder {path.absolute().parent}")
    there = path.exists()
    if there and not (path.is_file() or path.is_dir()):
        return  # a device or a pipe: only writing would tell
    try:
        with path.open("ab"):
            pass
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from error
    if not there:
        path.unlink()


def check_log(path: Path | None) -> None:
    """See that a log can be made, if one is asked for, before torque comes on.

    Raises:
        ConfigError: The file cannot be written.
        ImportError: The extra log is not installed.
    """
    if path is not None:
        import pliant.log  # noqa: F401 -- what it needs is there

        check_writable(path)
