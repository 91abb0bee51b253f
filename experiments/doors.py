"""Experiments with hinged doors, held rigidly or by a handle that turns in the grip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments.poses import displaced, pull, tool
from experiments.simulation import NOMINAL, Trace, run
from pliant import NullSpace
from pliant.sim import doors as leaves
from pliant.sim.postures import AT_DOOR, AT_DOOR_HORIZONTAL, AT_OVEN, VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from experiments.disturbances import Law
    from experiments.poses import Array
    from experiments.simulation import Commanded, Conditions
    from pliant.sim.doors import Door
    from pliant.sim.grasp import Grip


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Door, start pose of the arm, and motion that opens the door.

    Attributes:
        leaf: Function that returns the door, as a fixture of the simulator.
        start: Joint positions with the hand at the handle of the closed door (7,) [rad].
        soft: Names of the soft axes, along which the handle determines the tool's path.
        distance: Distance by which the target, or the base, moves to open the door [m].
        base: True if the base of the arm moves instead of the target.
    """

    leaf: Callable[..., Door]
    start: Array
    soft: str = "y yaw"
    distance: float = 0.28
    base: bool = False


SCENES: Mapping[str, Scene] = {
    "door": Scene(leaf=leaves.door, start=AT_DOOR),
    "fridge": Scene(leaf=leaves.fridge, start=AT_DOOR),
    "horizontal": Scene(leaf=leaves.door, start=AT_DOOR_HORIZONTAL),
    "oven": Scene(leaf=leaves.oven, start=AT_OVEN, soft="z pitch", distance=0.26),
    "base door": Scene(leaf=leaves.door, start=VERTICAL, base=True),
    "base fridge": Scene(leaf=leaves.fridge, start=VERTICAL, base=True),
}


@dataclass(frozen=True, kw_only=True)
class OpenResult:
    """Result of opening a door.

    Attributes:
        angle: Largest opening [deg].
        force: Largest force at the handle in any physics step [N].
        torque: Largest torque at the handle in any physics step [N·m]; 0 for a handle that turns in
            the grip.
        trace: Recorded run.
    """

    angle: float
    force: float
    torque: float
    trace: Trace


def open_door(
    law: Callable[..., Law],
    scene: str = "door",
    grip: Grip = "rigid",
    *,
    conditions: Conditions = NOMINAL,
) -> OpenResult:
    """Pull a door open for 9.5 s and return the result.

    Args:
        law: Function that returns settings for the arguments `soft` (soft axes) and `null_space`.
        scene: Key of `SCENES`.
        grip: `rigid`, or `turning` for a handle that turns in the grip.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    setup = SCENES[scene]
    drive = leaves.Drive(distance=setup.distance) if setup.base else None
    leaf = setup.leaf(grip=grip, drive=drive)
    start = tool(setup.start)
    target = start if setup.base else pull(start, setup.distance)
    settings = law(soft=setup.soft, null_space=NullSpace(gain=1.0))
    trace = run(conditions.build(leaf), conditions.controller(settings), target, 9.5, q=setup.start)
    return OpenResult(
        angle=float(np.rad2deg(leaf.widest)),
        force=leaf.peak_force,
        torque=leaf.peak_torque,
        trace=trace,
    )


# --- Opening and closing a door until it resists; resistance is detected from joint positions ---

#: Opening at which the leaf meets its end stop [deg].
STOP = 45.0
#: A motion ends when the estimated force against it has exceeded `THRESHOLD` [N] for `PERSISTENCE`
#: [s].
THRESHOLD, PERSISTENCE = 15.0, 0.2
#: Speed of the target [m/s], rest between opening and closing [s], start of the opening [s].
SPEED, REST, BEGIN = 0.05, 1.0, 1.0
#: Time that a run allows for opening, and for closing [s].
LONGEST = 8.0


class ByResistance:
    """Controller that opens a door until it resists, rests, and closes the door until it resists.

    The target moves along -x to open and along +x to close the door. Resistance is detected by the
    force that `pliant.ContactEstimator` estimates from joint positions.

    Attributes:
        ends: Times at which resistance was detected [s].
    """

    def __init__(self, inner: pliant.Controller, period: float) -> None:
        """Wrap a controller with this control period [s]."""
        self._inner, self._contact, self._period = inner, pliant.ContactEstimator(inner), period
        self.ends: list[float] = []

    def reset(self, q: Array) -> None:
        """Start at rest in q (n,) [rad]."""
        self._inner.reset(q)
        self._contact.reset()
        self._way, self._time, self._pressed, self._resting = 0.0, 0.0, 0.0, BEGIN
        self.ends = []

    @property
    def compliance(self) -> Array:
        """Compliance of each task axis, from the diagnostics of the wrapped controller."""
        return self._inner.diagnostics.compliance

    def step(self, q: Array, target: Array) -> Commanded:
        """Return the command of one tick; `target` is the pose (4, 4) at the closed door."""
        force = float(self._contact.update(q).force_base[0])
        if self._resting > 0.0:
            self._resting -= self._period
        elif len(self.ends) < 2:
            direction = -1.0 if not self.ends else 1.0
            self._way += direction * SPEED * self._period
            against = -direction * force > THRESHOLD
            self._pressed = self._pressed + self._period if against else 0.0
            if self._pressed >= PERSISTENCE - 1e-9:
                self.ends.append(self._time)
                self._pressed, self._resting = 0.0, REST
        self._time += self._period
        return self._inner.step(q, displaced(target, "x", self._way))


@dataclass(frozen=True, kw_only=True)
class OpenCloseResult:
    """Result of opening and closing a door until it resists.

    Attributes:
        ends: Angle of the door when resistance was detected [deg]: first while it was opened, then
            while it was closed. An entry is missing if none was detected.
        force: Largest force at the handle in any physics step [N].
        trace: Recorded run.
    """

    ends: tuple[float, ...]
    force: float
    trace: Trace


def open_and_close(
    law: Callable[..., Law],
    scene: str = "door",
    grip: Grip = "rigid",
    *,
    conditions: Conditions = NOMINAL,
) -> OpenCloseResult:
    """Open a door with a stop at 45 deg until it resists, rest 1 s, close it until it resists.

    Args:
        law: Function that returns settings for the arguments `soft` (soft axes) and `null_space`.
        scene: Key of `SCENES`, without a moving base.
        grip: `rigid`, or `turning` for a handle that turns in the grip.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    setup = SCENES[scene]
    leaf = setup.leaf(grip=grip, stop=float(np.deg2rad(STOP)))
    period = 1.0 / conditions.rate
    inner = conditions.controller(law(soft=setup.soft, null_space=pliant.NullSpace(gain=1.0)))
    if not isinstance(inner, pliant.Controller):
        raise pliant.ConfigError("a door is felt through a controller of pliant's own")
    controller = ByResistance(inner, period)
    duration = BEGIN + 2.0 * LONGEST
    trace = run(conditions.build(leaf), controller, tool(setup.start), duration, q=setup.start)
    return OpenCloseResult(
        ends=tuple(float(np.rad2deg(trace.leaf[trace.at(end)])) for end in controller.ends),
        force=leaf.peak_force,
        trace=trace,
    )
