"""Messages about missing extras, with the pip command that installs them."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path


def pip() -> str:
    """Return the command that installs packages into the running environment."""
    python = Path(sys.executable)
    # Do not resolve: the interpreter of a virtual environment is a symbolic link.
    shown = os.path.relpath(python) if python.is_relative_to(Path.cwd()) else str(python)
    if importlib.util.find_spec("pip") is None:
        return f"uv pip install --python {shown}"
    return f"{shown} -m pip install"


def missing(what: str, extra: str) -> str:
    """Return one line: the missing extra, and the command that installs it.

    pliant itself is installed from a clone or a wheel, so pip does not need a package index for it.

    Args:
        what: Feature that needs the extra, as the beginning of a sentence.
        extra: Name of the extra in `pyproject.toml`.
    """
    return f"{what} needs the extra \"{extra}\": {pip()} 'pliant[{extra}]'"
