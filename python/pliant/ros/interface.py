"""`ArmInterface`: topics and parameters of an arm, the same for ROS 2 and Foxglove.

It checks everything that comes from the network before it is sent to the control loop.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant import _ros_messages as ros
from pliant._core import ConfigError, Controller, PliantError, Pose
from pliant._refusals import Refusals
from pliant._validation import AXES
from pliant.ros.messages import NewSettings
from pliant.view.messages import Change, Target
from pliant.view.settings_editor import SettingsEditor

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pliant._core import Axis
    from pliant._typing import Array
    from pliant.ros.messages import ArmState, RobotInfo
    from pliant.view.messages import Message

    Parameter = float | list[float] | str

#: Maximum age of a target, according to its time stamp [s]; a stamp of 0 is not checked.
MAX_AGE = 0.5
#: Message type of six numbers, one per axis x, y, z, roll, pitch, yaw.
SIX = "std_msgs/msg/Float64MultiArray"
#: Published topics with their message types; `~` is the name of the node.
PUBLISHED = {
    "joint_states": ros.JOINT_STATE,
    "/tf": ros.TF_MESSAGE,
    "~/current_pose": ros.POSE_STAMPED,
    "~/external_wrench": ros.WRENCH_STAMPED,
}
#: Topic of the URDF; its last message is kept for subscribers that come later.
DESCRIPTION = "robot_description"
#: Subscribed topics with their message types.
SUBSCRIBED = {
    "~/target_pose": ros.POSE_STAMPED,
    "~/target_joint": ros.JOINT_STATE,
    "~/target_stiffness": SIX,
    "~/target_softness": SIX,
}
#: Fields of `pliant.Axis` that are parameters, as `axes.x.soft`.
FIELDS = ("yields", "soft", "firm", "hold", "stiffness", "adaptation")
#: Names that CRISP controllers give to the stiffness of each axis.
CRISP_STIFFNESS = {
    f"task.k_{kind}_{letter}": AXES[3 * group + index]
    for group, kind in enumerate(("pos", "rot"))
    for index, letter in enumerate("xyz")
}


class ArmInterface:
    """Topics and parameters of an arm; a second controller validates changes of the settings.

    Args:
        info: Description of the arm.
        send: Function that sends a message to the control loop.

    Attributes:
        urdf: Text of the URDF.
    """

    def __init__(self, info: RobotInfo, send: Callable[[Message], None]) -> None:
        """Create the controller that validates the settings."""
        self._model, self._extra, self._send = info.model, info.extra, send
        self._controller = Controller(info.model, info.settings, info.servos)
        self._editor = SettingsEditor(info.settings.task.axes, info.settings.rate, info.settings)
        self._editor.settings = info.settings
        self._numbers, self._lock = itertools.count(1), threading.Lock()
        self._refusals = {topic: Refusals(topic) for topic in (*SUBSCRIBED, "parameters")}
        self.urdf: str = info.model.source[0]

    # Methods that publish the state of the arm.

    def publish(self, state: ArmState) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the topics of `PUBLISHED` with the messages of a state."""
        base, tip = self._model.base, self._model.tip
        tool = self._model.forward_kinematics(state.q)
        position = np.concatenate((state.q, state.extra))
        names = [*self._model.joint_names, *self._extra]
        yield "joint_states", ros.joint_state(state.time, names, position, state.dq, state.load)
        yield "/tf", ros.tf_message(state.time, self._transforms(state))
        yield "~/current_pose", ros.pose_stamped(state.time, base, tool)
        # ROS expects a wrench in the axes of its frame, at the origin of that frame.
        wrench = (state.wrench.reshape(2, 3) @ tool[:3, :3]).reshape(6)
        yield "~/external_wrench", ros.wrench_stamped(state.time, tip, wrench)

    def _transforms(self, state: ArmState) -> Iterator[tuple[str, str, Array]]:
        """Yield parent link, child link and pose `parent_from_child` of every joint of the URDF."""
        extra = dict(zip(self._extra, state.extra.tolist(), strict=True))
        for joint in self._model.joints:
            pose = joint.origin.matrix
            if joint.kind != "fixed":
                pose = pose @ _motion(joint.kind, joint.axis, self._position(joint, state, extra))
            links = self._model.links
            yield links[joint.parent].name, links[joint.child].name, pose

    def _position(self, joint: Any, state: ArmState, extra: Mapping[str, float]) -> float:
        """Return the position of a joint [rad or m], also of one outside the chain."""
        if joint.mimic is not None:
            driver = self._position(self._model.joints[joint.mimic.joint], state, extra)
            return float(joint.mimic.multiplier * driver + joint.mimic.offset)
        if joint.q_index is not None:
            return float(state.q[joint.q_index])
        position = extra.get(joint.name, math.nan)
        return position if math.isfinite(position) else float(joint.locked_at or 0.0)

    # Methods that handle targets and softness from the network.

    def receive(self, topic: str, message: Any) -> None:
        """Handle a message of a topic of `SUBSCRIBED`; report it if it is rejected.

        A rejected message changes nothing: the arm keeps its target and its settings.
        """
        handlers: dict[str, Callable[[Any], None]] = {
            "~/target_pose": self._target_pose,
            "~/target_joint": self._target_joint,
            "~/target_stiffness": self._target_stiffness,
            "~/target_softness": self._target_softness,
        }
        try:
            handlers[topic](message)
        except (PliantError, ArithmeticError, TypeError, ValueError) as error:
            self.refuse(topic, error)

    def refuse(self, topic: str, error: Exception) -> None:
        """Report a rejected message of a topic."""
        self._refusals[topic].report(error)

    def _target_pose(self, message: Any) -> None:
        _check_age(message.header.stamp)
        frame, base = message.header.frame_id, self._model.base
        if frame not in {"", base}:
            raise ConfigError(
                f"frame_id = {frame!r} is not the base {base!r}: transform the pose to {base!r}"
            )
        p, o = message.pose.position, message.pose.orientation
        pose = Pose.from_xyzw((p.x, p.y, p.z), (o.x, o.y, o.z, o.w)).matrix
        self._model.check_target(pose)
        self._send(Target(pose))

    def _target_joint(self, message: Any) -> None:
        _check_age(message.header.stamp)
        names, known = list(message.name), self._model.joint_names
        if sorted(names) != sorted(known) or len(message.position) != len(names):
            raise ConfigError(
                f"it has {len(message.position)} positions of {', '.join(names) or 'no joint'}: "
                f"send one of each of {', '.join(known)}"
            )
        by_name = dict(zip(names, message.position, strict=True))
        q = np.array([float(by_name[name]) for name in known])
        self._model.check_joint_target(q)
        self._send(Target(self._model.forward_kinematics(q)))

    def _target_stiffness(self, message: Any) -> None:
        self._change({axis: {"stiffness": value} for axis, value in self._six(message)})

    def _target_softness(self, message: Any) -> None:
        axes: dict[str, Axis] = {name: axis for name, axis in self._controller.axes.items()}
        changes: dict[str, dict[str, Any]] = {}
        for axis, value in self._six(message):
            # A cap has no effect on an axis that does not yield.
            yields = axes[axis].yields
            changes[axis] = {"soft": value, "yields": "both" if yields == "none" else yields}
        self._change(changes)

    def _six(self, message: Any) -> Iterator[tuple[str, float]]:
        """Yield task axis and value for each number of a message that is not NaN."""
        values = [float(value) for value in message.data]
        if len(values) != len(AXES):
            raise ConfigError(f"it has {len(values)} numbers: send 6, for {' '.join(AXES)}")
        for axis, value in zip(AXES, values, strict=True):
            if axis in self._controller.axes and not math.isnan(value):
                yield axis, value

    # Parameters.

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Values of the parameters by name; a list contains the values for pushes to − and +."""
        law = self._controller.settings.law
        out: dict[str, Parameter] = {}
        name: str
        for name, axis in self._controller.axes.items():
            for field in FIELDS:
                value = getattr(axis, field)
                if value is not None:
                    out[f"axes.{name}.{field}"] = _parameter(value)
        if law == "impedance":
            for alias, name in CRISP_STIFFNESS.items():
                if f"axes.{name}.stiffness" in out:
                    out[alias] = out[f"axes.{name}.stiffness"]
        return out

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Change all parameters, or none of them if one is invalid.

        Raises:
            ConfigError: A name is unknown, or the controller rejects a value; also reported.
        """
        try:
            changes: dict[str, dict[str, Any]] = {}
            for name, value in values.items():
                axis, field = self._locate(name)
                changes.setdefault(axis, {})[field] = value
            self._change(changes)
        except ConfigError as error:
            self.refuse("parameters", error)
            raise

    def _locate(self, name: str) -> tuple[str, str]:
        """Return axis and field of a parameter."""
        if name in CRISP_STIFFNESS:
            return CRISP_STIFFNESS[name], "stiffness"
        group, _, rest = name.partition(".")
        axis, _, field = rest.partition(".")
        if group != "axes" or axis not in self._controller.axes or field not in FIELDS:
            raise ConfigError(
                f"there is no parameter {name!r}: there are axes.AXIS.FIELD with the axes "
                f"{', '.join(self._controller.axes)} and the fields {', '.join(FIELDS)}"
            )
        return axis, field

    def _change(self, changes: Mapping[str, Mapping[str, Any]]) -> None:
        """Change fields of task axes, all or none, and send the settings to the loop."""
        with self._lock:
            previous, law = self._editor.settings, self._controller.settings.law
            try:
                for axis, fields in changes.items():
                    if "stiffness" in fields and law != "impedance":
                        raise ConfigError(
                            f"stiffness of {axis} belongs to law = 'impedance', and the law is "
                            f'{law!r}: set law = "impedance" in the arm\'s file, or send caps to '
                            "~/target_softness"
                        )
                    self._editor.apply(Change(0, axis, _fields(axis, fields)), self._controller)
            except PliantError:
                self._editor.settings = previous
                self._controller.update(self._editor.effective)
                raise
            if changes:
                self._send(NewSettings(next(self._numbers), self._editor.effective))


def _check_age(stamp: Any) -> None:
    """Raise `ConfigError` if a time stamp is older than `MAX_AGE`; 0 is not checked."""
    sent = stamp.sec + 1e-9 * stamp.nanosec
    age = time.time() - sent
    if sent and age > MAX_AGE:
        raise ConfigError(
            f"its stamp is {age:.3g} s old, more than {MAX_AGE:g} s: synchronise the clocks of the "
            "computers, or send the stamp 0"
        )


def _fields(axis: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Convert values of parameters to fields of `pliant.Axis`."""
    out: dict[str, Any] = {}
    for field, value in fields.items():
        if field == "yields":
            if not isinstance(value, str):
                raise ConfigError(f"axes.{axis}.yields is a text, got {value!r}")
            out[field] = value
            continue
        numbers = np.array(value if isinstance(value, list | tuple) else [value], dtype=object)
        if not 1 <= numbers.size <= 2 or any(
            isinstance(number, bool) or not isinstance(number, int | float) for number in numbers
        ):
            raise ConfigError(f"axes.{axis}.{field} is one number, or two for − and +: {value!r}")
        pair = [float(number) for number in numbers]
        out[field] = pair[0] if len(pair) == 1 else (pair[0], pair[1])
    return out


def _parameter(value: Any) -> Parameter:
    """Convert a field of `pliant.Axis` to a parameter; two equal numbers become one."""
    if isinstance(value, str):
        return value
    numbers: list[float] = np.atleast_1d(np.asarray(value, dtype=float)).tolist()
    return numbers[0] if len(set(numbers)) == 1 else numbers


def _motion(kind: str, axis: Array, position: float) -> Array:
    """Return the motion of a joint (4, 4) at a position [rad or m] from its zero position."""
    if kind == "prismatic":
        return Pose.from_rotvec(axis * position, np.zeros(3)).matrix
    return Pose.from_rotvec(np.zeros(3), axis * position).matrix
