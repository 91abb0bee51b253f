"""Reports on what an arm can exert in a pose or along a path."""

from pliant._core import (
    FeasibilityReport,
    Issue,
    PoseReport,
    check_path,
)

__all__ = [
    "FeasibilityReport",
    "Issue",
    "PoseReport",
    "check_path",
]
