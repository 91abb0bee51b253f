"""What to say where a part is missing that an extra brings: the one place with pip's command."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path


def pip() -> str:
    """The command that installs into the environment that runs, whichever that is."""
    python = Path(sys.executable)
    # Not resolved: the interpreter of a virtual environment is a link to another.
    shown = os.path.relpath(python) if python.is_relative_to(Path.cwd()) else str(python)
    if importlib.util.find_spec("pip") is None:
        return f"uv pip install --python {shown}"
    return f"{shown} -m pip install"


def missing(what: str, extra: str) -> str:
    """One line: what needs which extra, and how to get it.

    pliant itself is installed, from a clone or a wheel, so pip looks for it on no index.

    Args:
        what: Who needs it, as the beginning of a sentence.
        extra: Its name in `pyproject.toml`.
    """
    return f"{what} needs the extra \"{extra}\": {pip()} 'pliant[{extra}]'"
