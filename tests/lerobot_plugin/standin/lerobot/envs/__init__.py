"""Stand-in for LeRobot's environments."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import draccus


@dataclass
class EnvConfig(draccus.ChoiceRegistry):
    """Configuration of an environment."""

    task: str | None = None
    fps: int = 30
    features: dict[str, Any] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    @property
    def gym_id(self) -> str:
        return f"{self.package_name}/{self.task}"
