"""Classes used by `pliant.Model`: links, joints, inertias and results of inverse kinematics."""

from pliant._core import (
    IkResult,
    Inertial,
    Joint,
    Link,
    Mimic,
)

__all__ = [
    "IkResult",
    "Inertial",
    "Joint",
    "Link",
    "Mimic",
]
