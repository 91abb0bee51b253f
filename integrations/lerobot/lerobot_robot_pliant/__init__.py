"""Compliant arms for LeRobot: ``--robot.type=pliant_follower``.

LeRobot imports this package by its name and finds the robots and teleoperators registered here.
"""

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
