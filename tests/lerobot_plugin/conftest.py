"""Fixtures for tests of the LeRobot plugin, with LeRobot itself or with a stand-in for it."""

import importlib
import sys
import warnings
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="the plugin's tests run on the simulator: extra sim")

from lerobot_plugin.helpers import FastClock

from pliant.sim import drive

ROOT = Path(__file__).resolve().parents[2] / "integrations" / "lerobot"
STANDIN = Path(__file__).parent / "standin"
PACKAGES = ("lerobot", "draccus", "lerobot_robot_pliant", "lerobot_teleoperator_wave")


@pytest.fixture(scope="session")
def plugin(tmp_path_factory):
    """Import the plugin; LeRobot's folder is a temporary one."""
    home = tmp_path_factory.mktemp("lerobot")
    folders = [str(ROOT), str(ROOT / "tests")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HF_LEROBOT_HOME", str(home))
        patch.setenv("HF_LEROBOT_CALIBRATION", str(home / "calibration"))
        patch.setattr(sys, "path", [*folders, *sys.path])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                importlib.import_module("lerobot.robots")
            except ImportError:
                sys.path.insert(0, str(STANDIN))
            plugin = importlib.import_module("lerobot_robot_pliant")
            importlib.import_module("lerobot_teleoperator_wave")
        yield plugin
        for name in [name for name in sys.modules if name.partition(".")[0] in PACKAGES]:
            del sys.modules[name]


@pytest.fixture(scope="session")
def errors(plugin):
    return importlib.import_module("lerobot.utils.errors")


@pytest.fixture(autouse=True, scope="module")
def fast():
    """Run the simulator faster than real time; the plugin's times are simulated times."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drive, "MonotonicClock", FastClock)
        yield
