"""Initial postures of the simulated seven-joint arm, and default task axes of an arm."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pliant._typing import Array


def posture(*angles: float) -> Array:
    """Return joint positions [rad] as a read-only array."""
    q = np.array(angles)
    q.flags.writeable = False
    return q


#: Joint positions of the seven-joint arm [rad] with the tool at (0.38, 0, -0.28) m in base axes:
#: with tool axes parallel to base axes, and with the tool turned by +90 deg about x.
VERTICAL = posture(-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657)
HORIZONTAL = posture(-0.0426, -0.4950, 0.5438, -1.7376, -0.4434, -0.0602, -0.5572)
#: Initial joint positions of the seven-joint arm [rad]: at a door or fridge, with the tool at
#: (0.54, 0, -0.25) m; the same with the tool turned by +90 deg about x; and at an oven, with the
#: tool at (0.52, 0, -0.10) m and turned by +90 deg about x.
AT_DOOR = posture(-0.626, -0.418, 0.784, -1.194, 0.811, 0.468, -0.115)
AT_DOOR_HORIZONTAL = posture(-0.559, -0.343, 0.605, -1.194, -0.566, -0.039, -0.384)
AT_OVEN = posture(-0.677, -0.440, 0.523, -1.623, -0.720, 0.426, -0.547)


def task_axes(joints: int) -> tuple[str, ...]:
    """Return default task axes of an arm with this number of joints; with six or more, all axes."""
    if joints >= 6:
        return ("x", "y", "z", "roll", "pitch", "yaw")
    return {5: ("x", "y", "z"), 4: ("x", "z", "pitch"), 3: ("x", "y", "z")}.get(joints, ("x", "z"))
