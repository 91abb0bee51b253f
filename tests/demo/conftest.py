"""Fixtures for tests of the demo."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def search_path():
    """Return PYTHONPATH with the project's root, for processes that run in other folders."""
    return os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))


@pytest.fixture
def demo_command(tmp_path):
    """Return a function that runs the demo in a new process and empty folder, without a display."""
    return runner(tmp_path, "experiments.demo", PYTHONPATH=search_path())


@pytest.fixture
def pliant_command(tmp_path):
    """Return a function that runs `pliant` in a new process and empty folder, without a display."""
    return runner(tmp_path, "pliant.cli")


@pytest.fixture(scope="session")
def quick_demo(tmp_path_factory):
    """Run the quick demo once; return its folder, the ended process, and the saved results.

    `SHARED` in tests/conftest.py runs all tests that use it in one worker.
    """
    folder = tmp_path_factory.mktemp("demo")
    demo = runner(folder, "experiments.demo", PYTHONPATH=search_path())
    result = demo("--quick", "--out", "here")
    assert result.returncode == 0, result.stderr
    out = folder / "here"
    return out, result, json.loads((out / "results.json").read_text(encoding="utf-8"))


def runner(folder, module, **always):
    """Return a function that runs a module, or `code`, in a new process."""

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
