"""A teleoperator without hardware, whose joint targets are sines around 0."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@TeleoperatorConfig.register_subclass("wave")
@dataclass(kw_only=True)
class WaveConfig(TeleoperatorConfig):
    """Options of the sines.

    Attributes:
        amplitude: Amplitude of each joint [°].
        period: Period of each joint [s].
        prefixes: Prefix of the joint names of each arm.
    """

    amplitude: float = 10.0
    period: float = 3.0
    prefixes: tuple[str, ...] = ("",)


class Wave(Teleoperator):
    """Sines of the time since `connect`."""

    config_class = WaveConfig
    name = "wave"

    def __init__(self, config: WaveConfig) -> None:
        super().__init__(config)
        self.config = config
        self._begin: float | None = None

    @property
    def action_features(self) -> dict[str, type]:
        return {f"{prefix}{m}.pos": float for prefix in self.config.prefixes for m in MOTORS}

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._begin is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        pass

    def configure(self) -> None:
        pass

    def connect(self, calibrate: bool = True) -> None:
        self._begin = time.perf_counter()

    def get_action(self) -> dict[str, float]:
        assert self._begin is not None
        share = math.sin(2 * math.pi * (time.perf_counter() - self._begin) / self.config.period)
        values = {motor: self.config.amplitude * share for motor in MOTORS[:-1]}
        values["gripper"] = 50.0 + 30.0 * share
        return {f"{p}{m}.pos": v for p in self.config.prefixes for m, v in values.items()}

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        pass

    def disconnect(self) -> None:
        self._begin = None
