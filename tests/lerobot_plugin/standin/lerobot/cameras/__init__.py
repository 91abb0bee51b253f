"""Stand-in for LeRobot's cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import draccus
from lerobot.utils.device import make_device


@dataclass(kw_only=True)
class CameraConfig(draccus.ChoiceRegistry):
    """Configuration of a camera."""

    fps: int | None = None
    width: int | None = None
    height: int | None = None


class Camera:
    """A camera."""

    def __init__(self, config: CameraConfig) -> None:
        self.fps, self.width, self.height = config.fps, config.width, config.height


def make_cameras_from_configs(configs: dict[str, CameraConfig]) -> dict[str, Any]:
    """Return the cameras by name."""
    return {name: make_device(config) for name, config in configs.items()}
