"""Provenance of measured numbers: versions, commit and machine."""

from __future__ import annotations

import platform
import subprocess
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from pliant._core import __version__

#: Packages whose versions affect the numbers or pictures.
PACKAGES = ("numpy", "mujoco", "matplotlib")


@dataclass(frozen=True)
class Facts:
    """Data needed to reproduce the numbers.

    Attributes:
        versions: Version of each package and of Python.
        commit: Commit of the working copy; None for an installed wheel.
        machine: Processor and operating system.
    """

    versions: dict[str, str]
    commit: str | None
    machine: str


def collect() -> Facts:
    """Return versions, commit and machine of this run."""
    versions = {"pliant": __version__, "Python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    machine = f"{platform.system()} {platform.machine()}"
    return Facts(versions, commit(Path(__file__).resolve().parent), machine)


def commit(folder: Path) -> str | None:
    """Return the short hash of the commit of this repository; None if `folder` is not inside it.

    A `+` at the end means uncommitted changes.
    """
    top = _git(folder, "rev-parse", "--show-toplevel")
    # An installed copy of the package may lie in the repository of another project, whose commit
    # must not be returned.
    if top is None or not (Path(top) / "python" / "pliant").is_dir():
        return None
    head = _git(folder, "rev-parse", "--short=10", "HEAD")
    if head is None:
        return None
    return head + ("+" if _git(folder, "status", "--porcelain", "--untracked-files=no") else "")


def _git(folder: Path, *args: str) -> str | None:
    """Return the output of a git command in a folder; None if the command fails."""
    try:
        result = subprocess.run(
            ["git", "-C", str(folder), *args],
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.strip() if result.returncode == 0 else None
