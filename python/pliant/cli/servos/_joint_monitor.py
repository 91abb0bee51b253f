"""`pliant servos doctor --watch`: readings of joints moved by hand with torque off."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from pliant.cli._console import print_line
from pliant.config import factory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike
    from rich.console import Console

    from pliant._core import Model
    from pliant._typing import Array, Mask
    from pliant.config import Config


#: Period of the readings [s].
PERIOD = 0.1
#: Rotation above which a joint counts as moved [rad].
MIN_MOTION = 0.05
#: Distance beyond a limit up to which a joint counts as at the limit [rad].
LIMIT_TOLERANCE = 0.01


class JointMonitor:
    """Motion of the joints since their first reading.

    Attributes:
        model: The robot.
        names: Joints of the drive, grippers included.
        position: Last readings (N,) [rad]; NaN for a joint without a reply so far.
        last_motion: Sentence on the last moved joint and the expected motion of the tool.
    """

    def __init__(self, config: Config, model: Model, names: tuple[str, ...]) -> None:
        """Start without readings."""
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
        self._reference = self.position.copy()
        self.last_motion = ""

    def update(self, position: Array, ok: Mask) -> bool:
        """Take a reading; return True if a joint has moved since the last report."""
        self.position = np.where(ok, position, self.position)
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
        """Joint, angle, limits, and expected motion of the tool as the angle grows."""
        phrases = self._directions()
        for name, q in zip(self.names, self.position, strict=True):
            low, high = self._limits.get(name, (-np.inf, np.inf))
            span = f"{low:+.2f} to {high:+.2f}" if np.isfinite([low, high]).all() else "none"
            odd = (
                ""
                if np.isnan(q) or low - LIMIT_TOLERANCE <= q <= high + LIMIT_TOLERANCE
                else ", outside"
            )
            angle = "no answer" if np.isnan(q) else f"{q:+.2f} rad ({np.degrees(q):+.0f}°)"
            yield name, angle, span + odd, phrases.get(name, "")

    @property
    def tool(self) -> str:
        """Position of the tool by the model."""
        x, y, z = self.model.forward_kinematics(self._chain())[:3, 3]
        return f"tool at x {x:+.3f}, y {y:+.3f}, z {z:+.3f} m in {self.model.base}"

    @property
    def rest(self) -> str:
        """The pose as a line for a configuration file; empty until all joints have replied."""
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
        """Return the angles of the chain (n,) [rad]; 0 for joints without a reply."""
        known = dict(zip(self.names, np.nan_to_num(self.position), strict=True))
        return np.array([known[name] for name in self.model.joint_names])


def watch(config: Config, console: Console, seconds: float | None) -> None:
    """Show the joints until Ctrl-C, or for a time [s]; nothing is written to the servos.

    Without a terminal there is a line whenever a joint has been moved.

    Raises:
        ServoError: A port cannot be opened, or a servo is missing or cannot be driven.
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
                moved = monitor.update(sample.position, sample.ok)
                if console.is_terminal:
                    live.update(_table(monitor), refresh=True)
                else:
                    _lines(console, monitor, first=first, moved=moved)
                first = False
                time.sleep(PERIOD)
    except KeyboardInterrupt:
        pass  # the usual end
    finally:
        drive.close()
        _end(console, monitor)


def _end(console: Console, monitor: JointMonitor | None) -> None:
    """Print the final pose, to copy into the configuration."""
    if monitor is not None and monitor.rest:
        print_line(
            "If this is where the arm shall rest, write it under [life] of its file:", console
        )
        print_line(monitor.rest, console)


def _begin(console: Console, on: list[str]) -> None:
    """Print instructions, and the joints whose torque is on."""
    print_line(
        "Nothing is switched on. Hold the arm and move one joint at a time, from the base outward: "
        "as its angle grows the tool must go where its line says. If it goes the other way, turn "
        "the joint's `sign` round in [servo]. Ctrl-C ends, and prints the pose as a rest pose",
        console,
    )
    if on:
        print_line(f"torque is on already, they cannot be moved by hand: {', '.join(on)}", console)


def _table(monitor: JointMonitor) -> Table:
    table = Table(
        box=SIMPLE_HEAD,
        pad_edge=False,
        caption=f"{monitor.tool}\n{monitor.last_motion}\n{escape(monitor.rest)}",
    )
    table.caption_justify = "left"
    for name in ("joint", "angle", r"limits \[rad]", "as it grows the tool"):
        table.add_column(name, justify="right" if name == "angle" else "left")
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


#: Tool motion below which a joint only turns the tool in place [m/rad].
IN_PLACE = 0.02
#: Least share of the motion from which on an axis is named.
MIN_SHARE = 0.3


def joint_directions(
    model: Model, q: ArrayLike, *, up: ArrayLike, falling: bool = False
) -> tuple[str, ...]:
    """Describe the motion of the tool as each joint angle grows, in base axes.

    From the columns of the geometric Jacobian: the axes with most of the motion, with signs; if the
    tool turns in place, the axes of rotation.

    Args:
        model: The robot.
        q: Joint positions (n,) [rad].
        up: Upward vector (3,) in base axes; the axis along it is also labelled up or down.
        falling: Describe the motion for a falling angle instead.

    Returns:
        One phrase per joint, `goes +x 0.11, -z (down) 0.30 m/rad`.
    """
    columns = np.asarray(model.jacobian(q)).T * (-1.0 if falling else 1.0)
    rise = np.asarray(up, dtype=np.float64)
    rise = rise / max(float(np.linalg.norm(rise)), 1e-9)
    return tuple(_direction(column[:3], column[3:], rise) for column in columns)


def _direction(linear: Array, angular: Array, up: Array) -> str:
    if np.linalg.norm(linear) >= IN_PLACE:
        return f"goes {_axes(linear, up, numbers=True)} m/rad"
    return f"turns in place about {_axes(angular, up, numbers=False)}, as a screw goes in"


def _axes(vector: Array, up: Array, *, numbers: bool) -> str:
    """Format the large components of a vector, the largest first."""
    size, parts = np.abs(vector), []
    for axis in np.argsort(-size):
        if size[axis] >= MIN_SHARE * np.linalg.norm(vector):
            sign = 1.0 if vector[axis] > 0.0 else -1.0
            tilt = sign * up[axis]
            word = " (up)" if tilt > 0.9 else " (down)" if tilt < -0.9 else ""
            number = f" {size[axis]:.2f}" if numbers else ""
            parts.append(f"{'+' if sign > 0.0 else '-'}{'xyz'[axis]}{word}{number}")
    return ", ".join(parts)
