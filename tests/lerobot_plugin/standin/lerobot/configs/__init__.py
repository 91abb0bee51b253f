"""Stand-in for LeRobot's descriptions of features."""

from dataclasses import dataclass
from enum import StrEnum


class FeatureType(StrEnum):
    """Kind of a feature."""

    STATE = "STATE"
    VISUAL = "VISUAL"
    ENV = "ENV"
    ACTION = "ACTION"


@dataclass
class PolicyFeature:
    """Kind and shape of a feature."""

    type: FeatureType
    shape: tuple[int, ...]
