"""Modules that `import pliant` loads, and modules that are loaded only when they are used."""

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
        item = getattr(pliant, name)
        assert item is not None
    assert set(pliant.__all__) <= set(dir(pliant))
    assert "robots" in dir(pliant)
    assert pliant._core.__all__
    public = {
        *pliant.__all__,
        *pliant.feasibility.__all__,
        *pliant.functional.__all__,
        *pliant.model.__all__,
        *pliant.arm.__all__,
        *pliant.teleop.__all__,
        *pliant.types.__all__,
    }
    # Names that only `pliant.arm`, `pliant.gym`, `pliant.identify` and `pliant.servo` use.
    internal = {
        *("ArmCycle", "ArmPoints", "BusCycle", "BusStatus", "CommandLimiter", "ExclusiveAccess"),
        *("HandGuidingLaw", "PortState", "PositionFilter", "SUPPORT", "ServoCodec"),
        *("ThermalModel", "torque_margin", "update_contacts"),
        *(() if sys.platform == "win32" else ("SerialPort", "ServoGroup")),
    }
    assert set(pliant._core.__all__) == (public & set(pliant._core.__all__)) | internal


def test_import_is_light():
    code = (
        "import numpy, sys; before = set(sys.modules); import pliant; "
        "print(*(set(sys.modules) - before))"
    )
    packages = {"pliant", "pliant._core"}
    assert set(run(code)) <= packages | {"__future__", "importlib.metadata"}


def test_a_second_interpreter_of_the_process_is_refused():
    code = """
import os
try:
    import _interpreters as interpreters
except ImportError:
    import _xxsubinterpreters as interpreters
import pliant
for what in ("pliant", "pliant._core"):
    end, start = os.pipe()
    inside = (
        f"import os\\ntry: import {what}; word = 'imported'\\n"
        f"except ImportError: word = 'refused'\\nos.write({start}, word.encode())"
    )
    interpreters.run_string(interpreters.create(), inside)
    print(os.read(end, 100).decode())
print(pliant.robots.arm7().gravity([0.0] * 7).shape)
"""
    assert run(code) == ["refused", "refused", "(7,)"]


def test_parts_are_loaded_when_named():
    assert run("import pliant, sys; pliant.robots; print('pliant.robots' in sys.modules)") == [
        "True"
    ]
    with pytest.raises(AttributeError, match="module 'pliant' has no attribute 'robot'"):
        _ = pliant.robot


def test_a_part_without_its_extra_is_an_attribute_that_is_missing():
    code = """
import sys
sys.modules["gymnasium"] = None
import inspect, pliant
print(hasattr(pliant, "gym"), len(inspect.getmembers(pliant)) > 20)
try: pliant.gym
except AttributeError as error: print("pliant[gym]" in str(error))
try: from pliant import gym
except ImportError as error: print("pliant[gym]" in str(error))
"""
    assert run(code) == ["False", "True", "True", "True"]
