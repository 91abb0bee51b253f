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


#: Largest size [bytes] of an input file: `SMALL` for configurations, `LARGE` for recorded samples.
SMALL, LARGE = 1 << 20, 1 << 28


def check_regular(path: Path) -> None:
    """Check that a path is a regular file: reading a pipe may wait forever.

    Raises:
        ConfigError: The path is a pipe, a device or a folder.
        OSError: The file is missing, or its folder is not readable.
    """
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise ConfigError(f"{path} is {kind}: name a file")


def read_text(path: Path, max_size: int = SMALL) -> str:
    """Return the contents of a UTF-8 text file.

    Args:
        path: The file.
        max_size: Largest accepted size of the file [bytes].

    Raises:
        ConfigError: The path is a pipe, a device or a folder, or the file is too large.
        OSError: The file is missing, or not readable.
        UnicodeDecodeError: The file is not UTF-8 text.
    """
    check_regular(path)
    with path.open("rb") as stream:
        data = stream.read(max_size + 1)
    if len(data) > max_size:
        raise ConfigError(
            f"{path} is larger than {max_size / 1e6:.0f} MB: it is another kind of file"
        )
    return data.decode("utf-8")


def printable(text: str) -> str:
    """Return the text with U+FFFD in place of control characters, which a terminal executes."""
    return "".join(c if c.isprintable() or c in " \n\t" else "�" for c in text)


#: Number of leading bytes that identify the kind of a file.
HEAD = 4096
#: For each kind of file that a command may write: function that recognizes its first `HEAD` bytes.
KINDS: dict[str, Callable[[bytes], bool]] = {
    "log": lambda head: head.startswith(b"\x89MCAP0\r\n"),
    "motion": lambda head: b"pliant motion" in head,
    "measurements file": lambda head: b'"pliant-measurements ' in head,
    "picture": lambda head: (
        head.startswith((b"\x89PNG\r\n", b"%PDF-")) or b"<svg" in head or b"<!DOCTYPE svg" in head
    ),
    "table": lambda head: head.startswith((b"PK\x03\x04", b"PAR1")),
    "page": lambda head: head.lstrip().lower().startswith((b"<!doctype html", b"<html")),
}


def check_output(path: Path, kind: str, inputs: Iterable[Path | str | None] = ()) -> bool:
    """Check that a file can be written and would not overwrite a file of another kind.

    The check leaves the file as it is.

    Args:
        path: File to write.
        kind: Key of `KINDS`.
        inputs: Files that the command reads; None and missing files are ignored.

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
        return False  # a device or a pipe cannot be checked without writing
    try:
        # Writing a temporary file is the only reliable test of access to the folder and of space.
        with replacing(path, keep=False) as temporary:
            temporary.write_bytes(bytes(HEAD))
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
            f"{path} is there and is not a {kind}: name another file, or remove this one first"
        )
    return bool(head)


@contextmanager
def replacing(path: Path, *, keep: bool = True) -> Iterator[Path]:
    """Context manager that writes `path` atomically.

    It yields the path of a temporary file in the same folder. At the end of the context this file
    replaces `path`; after an exception it is removed. A device or a pipe is yielded itself.

    Args:
        path: File to write.
        keep: True to replace `path` at the end; False to remove the temporary file.

    Raises:
        OSError: The folder or the disk rejects the file; the error names `path`.
    """
    if path.exists() and not path.is_file():
        yield path  # a device or a pipe
        return
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        temporary.touch(mode=0o666)
        yield temporary
        if not keep:
            temporary.unlink()
            return
        if path.exists():
            temporary.chmod(path.stat().st_mode & 0o777)
        temporary.replace(path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        # The error of a full disk names no file, others name the temporary one.
        if error.errno is not None and error.filename in {None, str(temporary)}:
            error.filename = str(path)
        raise
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


def _is_same(path: Path, other: Path) -> bool:
    """Return True if two paths name the same file, also through links."""
    with suppress(OSError):
        if path.samefile(other):
            return True
    return path.absolute() == other.absolute()
