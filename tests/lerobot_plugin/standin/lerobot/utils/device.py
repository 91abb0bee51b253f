"""Stand-in for LeRobot's base classes of robots and teleoperators, and for their factories."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import draccus


@dataclass(kw_only=True)
class DeviceConfig:
    """Options of every device."""

    id: str | None = None
    calibration_dir: Path | None = None


class Device:
    """A device that disconnects when it is deleted."""

    kind: ClassVar[str]
    name: ClassVar[str]
    is_connected: bool

    def __init__(self, config: DeviceConfig) -> None:
        self.id = config.id
        root = Path(os.environ["HF_LEROBOT_CALIBRATION"])
        self.calibration_dir = config.calibration_dir or root / self.kind / self.name
        self.calibration_dir.mkdir(parents=True, exist_ok=True)
        self.calibration_fpath = self.calibration_dir / f"{self.id}.json"

    def __str__(self) -> str:
        return f"{self.id} {type(self).__name__}"

    def __enter__(self) -> Any:
        self.connect()  # type: ignore[attr-defined]
        return self

    def __exit__(self, *_: object) -> None:
        self.disconnect()  # type: ignore[attr-defined]

    def __del__(self) -> None:
        try:
            if self.is_connected:
                self.disconnect()  # type: ignore[attr-defined]
        except Exception:
            pass


def make_device(config: draccus.ChoiceRegistry) -> Any:
    """Return the device of a configuration; its class has the same name without `Config`."""
    module = sys.modules[type(config).__module__]
    return getattr(module, type(config).__name__.removesuffix("Config"))(config)
