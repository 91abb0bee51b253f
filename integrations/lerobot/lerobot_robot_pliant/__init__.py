"""Compliant arms for LeRobot: ``--robot.type=pliant_follower``.

LeRobot imports this package by its name and finds the robots and teleoperators registered here.
"""

import sys

try:
    import lerobot  # noqa: F401  (imported only to explain its absence)
except ModuleNotFoundError as error:
    if error.name != "lerobot":
        raise
    version = ".".join(map(str, sys.version_info[:2]))
    remedy = (
        f"make an environment with Python >= 3.12 (this one has {version})"
        if sys.version_info < (3, 12)
        else "pip install lerobot"
    )
    raise ImportError(
        f"lerobot_robot_pliant is a plugin of LeRobot, which is not installed: {remedy}"
    ) from error

from lerobot_robot_pliant.bimanual import BiPliantFollower, BiPliantFollowerConfig
from lerobot_robot_pliant.follower import PliantFollower, PliantFollowerConfig
from lerobot_robot_pliant.leader import PliantLeader, PliantLeaderConfig
from lerobot_robot_pliant.softness import PliantSoftness, PliantSoftnessConfig

__all__ = [
    "BiPliantFollower",
    "BiPliantFollowerConfig",
    "PliantFollower",
    "PliantFollowerConfig",
    "PliantLeader",
    "PliantLeaderConfig",
    "PliantSoftness",
    "PliantSoftnessConfig",
]
