"""Teleoperation: an arm that follows the joints of a leader arm or a policy, and yields."""

from pliant._core import JointFollower

__all__ = ["JointFollower"]
