"""What `import pliant` brings along, and what it leaves for later."""

from __future__ import annotations

import subprocess
import sys

import pytest

import pliant


def run(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    ).stdout.split()


def test_every_name_is_there_and_documented():
    for name in pliant.__all__:
        thing = getattr(pliant, name)
        assert thing is not None
    assert set(pliant.__all__) <= set(dir(pliant))
    assert "robots" in dir(pliant)
    assert pliant._core.__all__
    assert set(pliant._core.__all__) - {"__version__"} <= set(pliant.__all__)


def test_import_is_light():
    code = (
        "import numpy, sys; before = set(sys.modules); import pliant; "
        "print(*(set(sys.modules) - before))"
    )
    own = {"pliant", "pliant._core"}
    assert set(run(code)) <= own | {"__future__", "importlib.metadata"}


def test_parts_are_loaded_when_named():
    assert run("import pliant, sys; pliant.robots; print('pliant.robots' in sys.modules)") == [
        "True"
    ]
    with pytest.raises(AttributeError, match="module 'pliant' has no attribute 'robot'"):
        _ = pliant.robot
