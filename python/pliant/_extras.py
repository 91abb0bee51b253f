"""Error messages about missing extras (optional dependencies), with the command to install them."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path


def pip() -> str:
    """Return the start of a command (pip or uv) that installs into the running environment."""
    python = Path(sys.executable)
    # Do not resolve links: a virtual environment's interpreter links to the system's interpreter.
    interpreter = os.path.relpath(python) if python.is_relative_to(Path.cwd()) else str(python)
    if importlib.util.find_spec("pip") is None:
        return f"uv pip install --python {interpreter}"
    return f"{interpreter} -m pip install"


def missing(what: str, extra: str) -> str:
    """Return a sentence with the missing extra and the command that installs it.

    Args:
        what: Feature that needs the extra, as the beginning of a sentence.
        extra: Name of the extra in `pyproject.toml`.
    """
    return f"{what} needs the extra \"{extra}\": {pip()} 'pliant[{extra}]'"


def require(what: str, extra: str, *modules: str) -> None:
    """Check that the modules of an extra are installed; `what` needs them.

    Raises:
        ImportError: A module is missing; the message has the command that installs the extra.
    """
    if not all(map(importlib.util.find_spec, modules)):
        raise ImportError(missing(what, extra))
