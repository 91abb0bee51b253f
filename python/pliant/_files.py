"""Bounded reading of input files and atomic writing of output files."""

from __future__ import annotations

import os
import stat
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator


#: Largest sizes [bytes]: `SMALL` of a settings file, `LARGE` of a file with samples.
SMALL, LARGE = 1 << 20, 1 << 28


def read_text(path: Path, max_size: int = SMALL) -> str:
    """Read a text file.

    Args:
        path: The file.
        max_size: Largest size [bytes].

    Raises:
        ConfigError: A pipe, a device or a folder, or too large.
        OSError: Missing, or not readable.
        UnicodeDecodeError: Not UTF-8 text.
    """
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise ConfigError(f"{path} is {kind}: name a file")
    with path.open("rb") as stream:
        data = stream.read(max_size + 1)
    if len(data) > max_size:
        raise ConfigError(
            f"{path} is larger than {max_size / 1e6:.0f} MB: it is another kind of file"
        )
    return data.decode("utf-8")


def printable(text: str) -> str:
    """Replace control characters, which a terminal would execute, by U+FFFD."""
    return "".join(c if c.isprintable() or c in " \n\t" else "�" for c in text)


#: Number of leading bytes that identify the kind of a file.
HEAD = 4096
#: Test of the first `HEAD` bytes for each kind of file that a command may write.
KINDS: dict[str, Callable[[bytes], bool]] = {
    "log": lambda head: head.startswith(b"\x89MCAP0\r\n"),
    "motion": lambda head: b"pliant motion" in head,
    "picture": lambda head: (
        head.startswith((b"\x89PNG\r\n", b"%PDF-")) or b"<svg" in head or b"<!DOCTYPE svg" in head
    ),
    "table": lambda head: head.startswith((b"PK\x03\x04", b"PAR1")),
    "page": lambda head: head.lstrip().lower().startswith((b"<!doctype html", b"<html")),
}


def check_output(path: Path, kind: str, inputs: Iterable[Path | str | None] = ()) -> bool:
    """Check that a file can be written without loss of another file; nothing is changed.

    Args:
        path: File to write.
        kind: Key of `KINDS`.
        inputs: Files that are read; None and missing files are ignored.

    Returns:
        True if a file of the same kind exists and will be replaced.

    Raises:
        ConfigError: The path is one of the inputs, a folder, or a file of another kind; its folder
            does not exist; or it is not writable.
    """
    for other in inputs:
        if other is not None and _is_same(path, Path(other)):
            raise ConfigError(f"{path} is read by this command: name another file to write")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise ConfigError(f"there is no folder {folder}")
    if path.is_dir():
        raise ConfigError(f"{path} cannot be written: it is a folder; name a file")
    if path.exists() and not path.is_file():
        return False  # a device or a pipe: only writing would tell
    try:
        # Creating a temporary file is the only reliable test of write access to the folder.
        with replacing(path, keep=False):
            pass
        if not path.exists():
            return False
        with path.open("r+b") as stream:
            head = stream.read(HEAD)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written: {error.strerror}; name another file"
        ) from error
    if head and not KINDS[kind](head):
        raise ConfigError(
            f"{path} is there and is no {kind}: name another file, or remove this one first"
        )
    return bool(head)


@contextmanager
def replacing(path: Path, *, keep: bool = True) -> Iterator[Path]:
    """Yield a temporary file beside `path`; it replaces `path` at the end, or is removed on errors.

    Args:
        path: File to write.
        keep: True to replace `path` at the end; False to remove the temporary file.

    Raises:
        OSError: The folder or the disk rejects the file.
    """
    if path.exists() and not path.is_file():
        yield path  # a device or a pipe
        return
    beside = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        beside.touch(mode=0o666)
        yield beside
        if not keep:
            beside.unlink()
            return
        if path.exists():
            beside.chmod(path.stat().st_mode & 0o777)
        beside.replace(path)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise


def _is_same(path: Path, other: Path) -> bool:
    """Return True if two paths are the same file, also through links."""
    with suppress(OSError):
        if path.samefile(other):
            return True
    return path.absolute() == other.absolute()
