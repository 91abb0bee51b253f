"""Stand-in for LeRobot's robots."""

from dataclasses import dataclass

import draccus
from lerobot.utils.device import Device, DeviceConfig, make_device


@dataclass(kw_only=True)
class RobotConfig(DeviceConfig, draccus.ChoiceRegistry):
    """Configuration of a robot."""


class Robot(Device):
    """A robot."""

    kind = "robots"


make_robot_from_config = make_device
