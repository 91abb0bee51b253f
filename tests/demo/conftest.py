"""What the tests of the demonstration share."""

import os
import subprocess
import sys

import pytest


@pytest.fixture
def pliant_command(tmp_path):
    """Run the command in a process of its own, away from the sources and without a display."""

    def run(*args, code=None, **environment):
        entry = ["-c", code] if code else ["-m", "pliant.cli"]
        return subprocess.run(
            [sys.executable, *entry, *args],
            cwd=tmp_path,
            env={**os.environ, "MUJOCO_GL": "egl", "OMP_NUM_THREADS": "1", **environment},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )

    return run
