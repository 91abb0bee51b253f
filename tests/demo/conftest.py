"""Shared code of the demonstration's tests."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def demo_command(tmp_path):
    """Run the demo in a process of its own, in an empty folder and without a display."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return runner(tmp_path, "experiments.demo", PYTHONPATH=path)


@pytest.fixture
def pliant_command(tmp_path):
    """Run the command in a process of its own, away from the sources and without a display."""
    return runner(tmp_path, "pliant.cli")


def runner(folder, module, **always):
    """Return a function that runs a module, or code, in a process of its own."""

    def run(*args, code=None, **environment):
        entry = ["-c", code] if code else ["-m", module]
        return subprocess.run(
            [sys.executable, *entry, *args],
            cwd=folder,
            env={**os.environ, "MUJOCO_GL": "egl", "OMP_NUM_THREADS": "1", **always, **environment},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )

    return run
