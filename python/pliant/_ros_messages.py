"""Contents of the ROS 2 messages that a log and a live connection share, and their definitions.

A message is a dictionary of its fields. Times are in nanoseconds since 1970.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import PliantError, Pose

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pliant._typing import Array

#: Names of the message types.
JOINT_STATE = "sensor_msgs/msg/JointState"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
STRING = "std_msgs/msg/String"
WRENCH_STAMPED = "geometry_msgs/msg/WrenchStamped"

_LINE = "=" * 80
_HEADER = f"""{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
_VECTOR = f"""{_LINE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
_GEOMETRY = f"""{_LINE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{_VECTOR}{_LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
_TIME = f"""{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
#: ROS 2 definition of each message type, with the types that it contains.
DEFINITIONS = {
    JOINT_STATE: f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_HEADER}{_TIME}""",
    POSE_STAMPED: f"""std_msgs/Header header
geometry_msgs/Pose pose
{_LINE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{_GEOMETRY}{_HEADER}{_TIME}""",
    TF_MESSAGE: f"""geometry_msgs/TransformStamped[] transforms
{_LINE}
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
{_LINE}
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
{_GEOMETRY}{_HEADER}{_TIME}""",
    STRING: "string data\n",
    WRENCH_STAMPED: f"""std_msgs/Header header
geometry_msgs/Wrench wrench
{_LINE}
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
{_VECTOR}{_HEADER}{_TIME}""",
}


def joint_state(
    time: int, names: Sequence[str], position: Array, velocity: Array, effort: Array
) -> dict[str, Any]:
    """Return a JointState; shorter values are padded with NaN, a list of only NaN becomes empty.

    Args:
        time: Time of the positions [ns].
        names: Names of the joints.
        position: Positions [rad or m].
        velocity: Velocities [rad/s or m/s].
        effort: Torques or forces [N·m or N].
    """
    values = {"position": position, "velocity": velocity, "effort": effort}
    lists = {
        key: [] if np.isnan(value).all() else _pad(value, len(names)).tolist()
        for key, value in values.items()
    }
    return {"header": header(time), "name": list(names), **lists}


def pose_stamped(time: int, frame: str, pose: Array) -> dict[str, Any]:
    """Return a PoseStamped with a pose (4, 4) in a frame at a time [ns]."""
    return {"header": header(time, frame), "pose": _pose(pose)}


def tf_message(time: int, poses: Iterable[tuple[str, str, Array]]) -> dict[str, Any]:
    """Return a TFMessage at a time [ns] from parent, child and pose `parent_from_child` (4, 4)."""
    transforms = []
    for parent, child, pose in poses:
        fields = _pose(pose)
        transform = {"translation": fields["position"], "rotation": fields["orientation"]}
        transforms.append(
            {"header": header(time, parent), "child_frame_id": child, "transform": transform}
        )
    return {"transforms": transforms}


def wrench_stamped(time: int, frame: str, wrench: Array) -> dict[str, Any]:
    """Return a WrenchStamped with force and torque (6,) [N, N·m] along the axes of a frame."""
    force, torque = (dict(zip("xyz", part.tolist(), strict=True)) for part in np.split(wrench, 2))
    return {"header": header(time, frame), "wrench": {"force": force, "torque": torque}}


def header(time: int, frame: str = "") -> dict[str, Any]:
    """Return a Header with a time [ns] and a frame."""
    seconds, rest = divmod(time, 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": frame}


def _pad(value: Array, length: int) -> Array:
    """Pad values with NaN to a given length, for joints outside the chain, which lack the value."""
    return np.concatenate((value, np.full(length - value.size, np.nan)))


def _pose(matrix: Array) -> dict[str, dict[str, float]]:
    x, y, z, w = _quaternion(matrix)
    position = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
    return {"position": position, "orientation": {"x": x, "y": y, "z": z, "w": w}}


def _quaternion(matrix: Array) -> list[float]:
    """Return the quaternion x y z w of the rotation nearest to the upper left 3×3 block."""
    u, _, v = np.linalg.svd(matrix[:3, :3])
    pose = np.eye(4)
    pose[:3, :3] = u @ v
    try:
        x, y, z, w = Pose(pose).xyzw.tolist()
    except PliantError:
        return [0.0, 0.0, 0.0, 1.0]
    return [x, y, z, w]
