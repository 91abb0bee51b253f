"""Layout of a log: its own messages, and the vectors that the loop sends to the writer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pliant._typing import Array


#: Version of the layout; logs of another version cannot be read.
VERSION = "1"
#: Names of the attachments (files inside the MCAP file): description of the run, robot model,
#: settings, configuration, and bus counters at the end.
RUN, URDF, SETTINGS = "run.json", "robot.urdf", "settings.txt"
CONFIG, END = "config.json", "end.json"

#: Columns of a log with one value per joint (n,): `STATE` read from the servos, `COMMAND` sent.
STATE = ("q", "dq", "load", "current", "voltage", "temperature", "age")
COMMAND = ("goal", "torque_limit", "speed_limit")
#: Columns of a log with one value per task axis (k,), named as in `Controller.diagnostics`.
AXES = (
    "deviation",
    "adapted_deviation",
    "task_velocity",
    "softness",
    "compliance",
    "axis_strength",
    "wrench",
    "deviation_limited",
)
#: Columns of a log from `Controller.diagnostics` with one value per joint (n,).
JOINT = ("saturated", "locked", "gravity", "feed_forward")
#: Columns of a log from `Controller.diagnostics` with a single value per tick.
SCALARS = ("sigma_min", "sigma_max", "damping", "gamma", "gain_factor")


@dataclass(frozen=True)
class Vector:
    """Layout of a float64 vector that consists of named pieces, such as "q" with n entries.

    Attributes:
        pieces: Name and length of each piece, in order.
    """

    pieces: tuple[tuple[str, int], ...]

    @property
    def size(self) -> int:
        """Total length of the vector."""
        return sum(length for _, length in self.pieces)

    def split(self, whole: Array) -> dict[str, Array]:
        """Return the pieces of an array by name, as views; the last axis of the array is split."""
        ends = np.cumsum([length for _, length in self.pieces])[:-1]
        names = [name for name, _ in self.pieces]
        return dict(zip(names, np.split(whole, ends, axis=-1), strict=True))


def tick(n: int, k: int | None, extra: int) -> Vector:
    """Return the layout of the vector with all recorded values of a tick (control cycle).

    Args:
        n: Number of joints of the chain.
        k: Number of task axes; None: the run has no `Controller`.
        extra: Number of joints outside the chain.
    """
    pieces = [("time", 1), ("dt", 1), ("index", 1), ("lag", 1), ("delay", 1)]
    pieces += [(name, n) for name in (*STATE, *COMMAND)] + [("extra", extra)]
    if k is not None:
        pieces += [("target", 16), ("reference", 16), ("activation", n * (k + 1))]
        pieces += [(name, k) for name in AXES] + [(name, n) for name in JOINT]
        pieces += [(name, 1) for name in SCALARS]
    return Vector(tuple(pieces))


def step(n: int) -> Vector:
    """Return the layout of the vector of a recorded `Controller.step`, for n joints.

    It holds the arguments (NaN if omitted) and the resulting command.
    """
    sizes = {"dt": 1, "target": 16, "twist": 6}
    names = ("dt", "q", "target", "q_target", "dq", "twist", "gradient", *COMMAND)
    return Vector(tuple((name, sizes.get(name, n)) for name in names))


def tick_message(vector: Vector) -> str:
    """Return the ROS 2 message definition of a tick with the fields of `vector`."""
    return "".join(
        f"float64{'' if length == 1 and name in SINGLE else '[]'} {name}\n"
        for name, length in vector.pieces
    )


#: Names of pieces of a vector that are a single number, not a list.
SINGLE = frozenset(("time", "dt", "index", "lag", "delay", *SCALARS))

#: ROS 2 message definition of a recorded call of the controller. The arguments of a step are
#: fields; the arguments of any other call are JSON in the field `arguments`.
CALL = "uint64 sequence\nstring what\nstring arguments\nfloat64 dt\n" + "".join(
    f"float64[] {name}\n" for name, _ in step(1).pieces[1:]
)


def numbers(pieces: dict[str, Array], names: Iterable[str]) -> dict[str, Any]:
    """Return the named pieces as message fields: a number, or a list that is empty if all NaN."""
    out: dict[str, Any] = {}
    for name in names:
        values = pieces[name]
        if name in SINGLE:
            out[name] = float(values[0])
        else:
            out[name] = [] if np.isnan(values).all() else values.tolist()
    return out
