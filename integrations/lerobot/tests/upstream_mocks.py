"""Pytest plugin: our robot and a test teleoperator in place of the mocks in LeRobot's tests."""

import sys
from functools import partial
from types import ModuleType

from lerobot_robot_pliant import PliantFollowerConfig
from lerobot_teleoperator_wave import WaveConfig


def replace(name: str, **entries: object) -> None:
    """Replace a mock by a module with these entries."""
    module = ModuleType(name)
    vars(module).update(entries)
    sys.modules[name] = module


replace(
    "tests.mocks.mock_robot",
    MockRobotConfig=partial(PliantFollowerConfig, backend="sim", rest_q=[0.0, -1.2, 1.2, 0.6, 0.0]),
)
replace("tests.mocks.mock_teleop", MockTeleopConfig=WaveConfig)
