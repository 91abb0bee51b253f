"""Bounded reading of input files: limited size, and no pipes or devices."""

from __future__ import annotations

import stat
from pathlib import Path

from pliant import ConfigError

#: Largest size of a settings file, and of a file with samples [bytes].
SMALL, LARGE = 1 << 20, 1 << 28


def read_text(path: Path, most: int = SMALL) -> str:
    """Read a text file.

    Args:
        path: The file.
        most: Largest size [bytes].

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
        data = stream.read(most + 1)
    if len(data) > most:
        raise ConfigError(f"{path} is larger than {most / 1e6:.0f} MB: it is another kind of file")
    return data.decode("utf-8")


def printable(text: str) -> str:
    """Remove control characters from a text, because a terminal would execute them."""
    return "".join(c if c.isprintable() or c in " \n\t" else "�" for c in text)
