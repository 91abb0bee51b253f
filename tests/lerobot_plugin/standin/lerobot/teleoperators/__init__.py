"""Stand-in for LeRobot's teleoperators."""

from dataclasses import dataclass

import draccus
from lerobot.utils.device import Device, DeviceConfig, make_device


@dataclass(kw_only=True)
class TeleoperatorConfig(DeviceConfig, draccus.ChoiceRegistry):
    """Configuration of a teleoperator."""


class Teleoperator(Device):
    """A teleoperator."""

    kind = "teleoperators"


make_teleoperator_from_config = make_device
