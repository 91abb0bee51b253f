"""One closed loop: plant, controller, target, and a record of the true state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

import pliant
from pliant.sim import Door

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pliant.sim import Plant

    Array = NDArray[np.float64]
    #: Pose (4, 4) of the target at a time [s].
    Target = Callable[[float], Array]


class Commanded(Protocol):
    """Output of a controller for the servos."""

    @property
    def goal(self) -> Array:
        """Joint goals (n,) [rad]."""

    @property
    def torque_limit(self) -> Array:
        """Torque limits (n,) [N·m]."""


class Controlling(Protocol):
    """Interface of a controller in the loop: `pliant.Controller`, or a baseline.

    A baseline with a method `listen` receives before each step the motor torques of the last period
    (n,) [N·m].
    """

    def reset(self, q: Array) -> object:
        """Start at rest in q."""

    def step(self, q: Array, target: Array) -> Commanded:
        """Run one tick."""


@dataclass(frozen=True)
class Trace:
    """True states, one row per tick, at the end of the tick.

    Attributes:
        t: Time (N,) [s].
        q, dq: Joint positions and velocities (N, n) [rad, rad/s].
        goal, limit, torque: Commands and true torque of the servos (N, n) [rad, N·m].
        position: Position of the tool (N, 3) [m].
        error: Target minus actual pose (N, 6) [m, rad], base axes.
        moved: Change of the pose since the start (N, 6) [m, rad], base axes.
        compliance: c of each task axis (N, k); NaN for controllers without.
        force, moment: Means over the tick of the first hand's force and torque (N, 3) [N, N·m].
        grip: Peak force and torque in the door's grip so far (N, 2); zeros without a door.
        leaf: Opening of the door (N,) [rad].
    """

    t: Array
    q: Array
    dq: Array
    goal: Array
    limit: Array
    torque: Array
    position: Array
    error: Array
    moved: Array
    compliance: Array
    force: Array
    moment: Array
    grip: Array
    leaf: Array

    def between(self, start: float, end: float) -> NDArray[np.bool_]:
        """Return the mask (N,) of the ticks in (start, end] s."""
        return (self.t > start + 1e-9) & (self.t <= end + 1e-9)

    def at(self, time: float) -> int:
        """Return the index of the tick that ends at `time` [s]."""
        return int(np.argmin(np.abs(self.t - time)))


def run(
    plant: Plant,
    controller: Controlling,
    target: Array | Target,
    duration: float,
    *,
    q: Array,
    on_tick: Callable[[float, Plant], None] | None = None,
) -> Trace:
    """Reset plant and controller to q at rest and close the loop for `duration` seconds.

    Args:
        plant: The simulated arm, with its hands and fixtures.
        controller: The controller; it receives only what the plant's bus reports.
        target: Pose (4, 4) of the tool, or a function of time.
        duration: Length [s].
        q: Start (n,) [rad].
        on_tick: Called before each tick with the time and the plant, e.g. to change a setting.

    Returns:
        The record of the run.
    """
    plant.reset(q)
    controller.reset(q)
    start = plant.tool
    door = next((fixture for fixture in plant.fixtures if isinstance(fixture, Door)), None)
    listen = getattr(controller, "listen", None)
    rows: list[tuple[Array, ...]] = []
    for tick in range(round(duration * plant.rate)):
        time = tick / plant.rate
        if on_tick is not None:
            on_tick(time, plant)
        wanted = target(time) if callable(target) else target
        if listen is not None:
            listen(plant.torque)
        command = controller.step(plant.read().q, wanted)
        plant.write(command.goal, command.torque_limit)
        plant.advance()
        tool = plant.tool
        felt = plant.hands[0] if plant.hands else None
        # Baselines have no diagnostics.
        known = getattr(controller, "diagnostics", None)
        rows.append(
            (
                np.array(plant.time),
                plant.q,
                plant.dq,
                command.goal,
                command.torque_limit,
                plant.torque,
                tool[:3, 3],
                pliant.functional.pose_error(tool, wanted),
                pliant.functional.pose_error(start, tool),
                np.full(6, np.nan) if known is None else known.compliance,
                np.zeros(3) if felt is None else felt.force,
                np.zeros(3) if felt is None else felt.torque,
                np.zeros(2) if door is None else np.array([door.peak_force, door.peak_torque]),
                np.array(0.0 if door is None else door.angle),
            )
        )
    return Trace(*(np.array(column) for column in zip(*rows, strict=True)))
