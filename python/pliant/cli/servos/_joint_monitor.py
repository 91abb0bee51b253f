"""`pliant servos doctor --watch`: show joint angles while a hand moves the arm, torque off."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.live import Live
from rich.markup import escape

from pliant.cli._console import make_table, print_line
from pliant.config import factory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike
    from rich.table import Table

    from pliant._core import Model
    from pliant._typing import Array, Mask
    from pliant.cli._console import Console
    from pliant.config import Config


#: Time between two readings of the joint angles [s].
PERIOD = 0.1
#: Change of the angle above which a joint counts as moved [rad].
MIN_MOTION = 0.05
#: Angle by which a joint may exceed a position limit before it counts as out of range [rad].
LIMIT_TOLERANCE = 0.01


class JointMonitor:
    """Angles of all joints, and the expected motion of the tool for each joint.

    Attributes:
        model: The robot.
        names: Names of the N joints, grippers included.
        position: Last measured angles (N,) [rad]; NaN for a joint that has never replied.
        last_motion: Sentence on the joint that moved last and on the motion to expect of the tool.
    """

    def __init__(self, config: Config, model: Model, names: tuple[str, ...]) -> None:
        """Create a monitor without readings."""
        self.model, self.names = model, names
        self._up = -np.array(config.robot.gravity)
        self._limits = {
            name: (float(low), float(high))
            for name, low, high in zip(model.joint_names, model.lower, model.upper, strict=True)
        }
        if config.gripper is not None:
            opened, closed = config.gripper.opened, config.gripper.closed
            if opened is not None and closed is not None:
                self._limits[config.gripper.joint] = min(opened, closed), max(opened, closed)
        self.position = np.full(len(names), np.nan)
        self._reference, self._ok = self.position.copy(), np.isfinite(self.position)
        self.last_motion = ""

    def update(self, position: Array, ok: Mask) -> bool:
        """Process readings (N,) [rad], valid where `ok` is True; return True if a joint has moved.

        A joint has moved if its angle differs by `MIN_MOTION` or more from the angle at the last
        call that returned True.
        """
        self.position, self._ok = np.where(ok, position, self.position), ok
        self._reference = np.where(np.isnan(self._reference), self.position, self._reference)
        motion = np.nan_to_num(self.position - self._reference)
        joint = int(np.argmax(np.abs(motion)))
        if abs(motion[joint]) < MIN_MOTION:
            return False
        self.last_motion = self._sentence(joint, float(motion[joint]))
        self._reference = self.position.copy()
        return True

    @property
    def rows(self) -> Iterator[tuple[str, str, str, str]]:
        """Yield per joint: name, angle, limits, and motion of the tool as the angle grows."""
        phrases = self._directions()
        for name, q, ok in zip(self.names, self.position, self._ok, strict=True):
            low, high = self._limits.get(name, (-np.inf, np.inf))
            span = f"{low:+.2f} to {high:+.2f}" if np.isfinite([low, high]).all() else "none"
            outside = (
                ""
                if np.isnan(q) or low - LIMIT_TOLERANCE <= q <= high + LIMIT_TOLERANCE
                else ", outside"
            )
            angle = f"{q:+.2f} rad ({np.degrees(q):+.0f}°)" if ok else "no answer"
            yield name, angle, span + outside, phrases.get(name, "")

    @property
    def tool(self) -> str:
        """Return a sentence with the position of the tool [m], by forward kinematics."""
        x, y, z = self.model.forward_kinematics(self._chain())[:3, 3]
        return f"tool at x {x:+.3f}, y {y:+.3f}, z {z:+.3f} m in {self.model.base}"

    @property
    def rest(self) -> str:
        """Return the line `rest_q = [...]` with the present pose; "" until all joints replied."""
        known = dict(zip(self.names, self.position.tolist(), strict=True))
        pose = [known[name] for name in self.model.joint_names]
        if np.isnan(pose).any():
            return ""
        return f"rest_q = [{', '.join(f'{round(q, 2) + 0.0:.2f}' for q in pose)}]"

    def _sentence(self, joint: int, motion: float) -> str:
        name = self.names[joint]
        grew = "grew" if motion > 0.0 else "fell"
        begin = f"{name} {grew} by {abs(motion):.2f} rad to {self.position[joint]:+.2f}"
        if name not in self.model.joint_names:
            return begin
        return f"{begin}: for this model the tool {self._directions(falling=motion < 0.0)[name]}"

    def _directions(self, *, falling: bool = False) -> dict[str, str]:
        phrases = joint_directions(self.model, self._chain(), up=self._up, falling=falling)
        return dict(zip(self.model.joint_names, phrases, strict=True))

    def _chain(self) -> Array:
        """Return the joint positions (n,) [rad] without grippers; 0 for joints without a reply."""
        known = dict(zip(self.names, np.nan_to_num(self.position), strict=True))
        return np.array([known[name] for name in self.model.joint_names])


def watch(config: Config, console: Console, seconds: float | None) -> None:
    """Show the joint angles until Ctrl-C, or for a time [s]; nothing is written to the servos.

    A terminal shows a live table; other outputs get a line whenever a joint has moved.

    Raises:
        ServoError: A port cannot be opened, or a servo is missing or unsuitable.
    """
    model = config.model()
    drive: Any = factory.make_drive(config, model)
    drive.open()
    monitor = None
    try:
        monitor = JointMonitor(config, model, tuple(drive.names))
        _begin(console, [n for n, on in zip(drive.names, drive.enabled, strict=True) if on])
        end = None if seconds is None else time.monotonic() + seconds
        with Live(console=console, auto_refresh=False) as live:
            first = True
            while end is None or time.monotonic() < end:
                sample = drive.read()
                has_moved = monitor.update(sample.position, sample.ok)
                if console.is_terminal:
                    live.update(_table(monitor), refresh=True)
                else:
                    _lines(console, monitor, first=first, moved=has_moved)
                first = False
                time.sleep(PERIOD)
    except KeyboardInterrupt:
        pass  # Ctrl-C is the normal end
    finally:
        drive.close()
        _end(console, monitor)


def _end(console: Console, monitor: JointMonitor | None) -> None:
    """Print the final pose as the line `rest_q = [...]` for the configuration file."""
    if monitor is not None and monitor.rest:
        print_line(
            "To let the arm rest in this pose, write this line under [life] of its file:", console
        )
        print_line(monitor.rest, console)


def _begin(console: Console, enabled: list[str]) -> None:
    """Print instructions to the user, and the names `enabled` of joints whose torque is on."""
    print_line(
        "Nothing is switched on. Hold the arm and move one joint at a time, from the base outward: "
        "as its angle grows the tool must go where its line says. If it goes the other way, change "
        "the joint's `sign` in [servo]. Ctrl-C ends, and prints the pose as a rest pose",
        console,
    )
    if enabled:
        print_line(
            f"torque is on already, so these joints cannot be moved by hand: {', '.join(enabled)}",
            console,
        )


def _table(monitor: JointMonitor) -> Table:
    headings = ("joint", "angle", r"limits \[rad]", "as it grows the tool")
    caption = f"{monitor.tool}\n{monitor.last_motion}\n{escape(monitor.rest)}"
    table = make_table(*headings, right={"angle"}, caption=caption, caption_justify="left")
    for row in monitor.rows:
        table.add_row(*row)
    return table


def _lines(console: Console, monitor: JointMonitor, *, first: bool, moved: bool) -> None:
    lines = []
    if first:
        lines = [
            f"{name}: {angle}, limits {span}"
            + (f"; as it grows the tool {motion}" if motion else "")
            for name, angle, span, motion in monitor.rows
        ]
    if moved:
        lines = [monitor.last_motion]
    for line in [*lines, monitor.tool] if lines else []:
        print_line(line, console)


#: Tool translation per joint angle below which a joint is said to rotate the tool in place [m/rad].
MIN_TRANSLATION = 0.02
#: Minimum ratio of a vector component to the norm; smaller components are not shown in the text.
MIN_SHARE = 0.3


def joint_directions(
    model: Model, q: ArrayLike, *, up: ArrayLike, falling: bool = False
) -> tuple[str, ...]:
    """Describe the motion of the tool as each joint angle grows, from the geometric Jacobian.

    Each phrase gives the largest components of the linear motion, in base axes. For a joint that
    only rotates the tool in place, the phrase gives the axes of rotation.

    Args:
        model: The robot.
        q: Joint positions (n,) [rad].
        up: Upward vector (3,) in base axes; a component along it is labelled up or down.
        falling: True to describe the motion as the joint angle decreases.

    Returns:
        One phrase per joint, such as `goes +x 0.11, -z (down) 0.30 m/rad`.
    """
    columns = np.asarray(model.jacobian(q)).T * (-1.0 if falling else 1.0)
    up_axis = np.asarray(up, dtype=np.float64)
    up_axis = up_axis / max(float(np.linalg.norm(up_axis)), 1e-9)
    return tuple(_direction(column[:3], column[3:], up_axis) for column in columns)


def _direction(linear: Array, angular: Array, up: Array) -> str:
    if np.linalg.norm(linear) >= MIN_TRANSLATION:
        return f"goes {_axes(linear, up, numbers=True)} m/rad"
    return f"turns in place about {_axes(angular, up, numbers=False)}, as a screw goes in"


def _axes(vector: Array, up: Array, *, numbers: bool) -> str:
    """Return the large components of a vector (3,) as text, the largest first."""
    size, parts = np.abs(vector), []
    for axis in np.argsort(-size):
        if size[axis] >= MIN_SHARE * np.linalg.norm(vector):
            sign = 1.0 if vector[axis] > 0.0 else -1.0
            upward = sign * up[axis]
            word = " (up)" if upward > 0.9 else " (down)" if upward < -0.9 else ""
            number = f" {size[axis]:.2f}" if numbers else ""
            parts.append(f"{'+' if sign > 0.0 else '-'}{'xyz'[axis]}{word}{number}")
    return ", ".join(parts)
