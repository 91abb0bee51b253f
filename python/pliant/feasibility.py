"""Reports on the forces that an arm can exert in a pose or along a path."""

from pliant._core import (
    AxisReport,
    FeasibilityReport,
    Issue,
    JointStop,
    PoseReport,
    check_path,
)

__all__ = [
    "AxisReport",
    "FeasibilityReport",
    "Issue",
    "JointStop",
    "PoseReport",
    "check_path",
]
