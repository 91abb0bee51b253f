"""Simulated control loop of the experiments: conditions, runs, and a record of the true state."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

import pliant
from experiments.poses import arm, servos
from pliant.sim import Door, Plant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from experiments.poses import Array
    from pliant.sim import Fixture, Hand
    from pliant.sim.friction import Friction

    #: Function of the time [s] that returns the target pose (4, 4).
    Target = Callable[[float], Array]


class Commanded(Protocol):
    """Interface of the command that a controller returns for the servos."""

    @property
    def goal(self) -> Array:
        """Joint goals (n,) [rad]."""

    @property
    def torque_limit(self) -> Array:
        """Torque limits (n,) [N·m]."""


class Controlling(Protocol):
    """Interface of a controller in the loop: `pliant.Controller` or a baseline.

    If a baseline has a method `listen`, the loop calls it before each step with the motor torques
    of the last period (n,) [N·m].
    """

    def reset(self, q: Array) -> object:
        """Start at rest in q (n,) [rad]."""

    def step(self, q: Array, target: Array) -> Commanded:
        """Return the command for positions q (n,) [rad] and the target pose (4, 4)."""


@dataclass(frozen=True)
class Trace:
    """Record of the true state, with one row per tick, at the end of the tick.

    Attributes:
        t: Time (N,) [s].
        q, dq: Joint positions and velocities (N, n) [rad, rad/s].
        goal, limit, torque: Commanded goal [rad], commanded torque limit [N·m] and true torque
            [N·m] of the servos (N, n).
        position: Position of the tool (N, 3) [m].
        error: Target minus actual pose (N, 6) [m, rad], base axes.
        moved: Change of the pose since the start (N, 6) [m, rad], base axes.
        compliance: Compliance c of each of k task axes (N, k), 1 at a small and 0 at a large
            deviation; NaN for controllers without compliance.
        force, moment: Force and torque of the first hand, averaged over the tick (N, 3) [N, N·m].
        grip: Largest force and torque in the door's grip so far (N, 2) [N, N·m]; 0 without a door.
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
        """Return a mask (N,) that is True for ticks that end after `start`, up to `end` [s]."""
        return (self.t > start + 1e-9) & (self.t <= end + 1e-9)

    def at(self, time: float) -> int:
        """Return the index of the tick that ends at `time` [s]."""
        return int(np.argmin(np.abs(self.t - time)))


def closed_loop(
    plant: Plant,
    controller: Controlling,
    target: Array | Target,
    duration: float,
    *,
    on_tick: Callable[[float, Plant], None] | None = None,
) -> Iterator[tuple[float, Array, Commanded]]:
    """Run the control loop from the present state of plant and controller.

    The loop does not reset plant or controller.

    Args:
        plant: The simulated arm, with its hands and fixtures.
        controller: The controller, which gets the readings of the simulated bus.
        target: Target pose (4, 4): a function of time, or an array that the caller may change.
        duration: Duration [s].
        on_tick: Callback before each tick with the time [s] and the plant.

    Yields:
        Start time [s], target and command of each tick, after the tick.
    """
    listen = getattr(controller, "listen", None)
    for tick in range(round(duration * plant.rate)):
        time = tick / plant.rate
        if on_tick is not None:
            on_tick(time, plant)
        if listen is not None:
            listen(plant.torque)
        pose = target(time) if callable(target) else target
        command = controller.step(plant.read().q, pose)
        plant.write(command.goal, command.torque_limit)
        plant.advance()
        yield time, pose, command


def run(
    plant: Plant,
    controller: Controlling,
    target: Array | Target,
    duration: float,
    *,
    q: Array,
    on_tick: Callable[[float, Plant], None] | None = None,
) -> Trace:
    """Reset plant and controller to a pose at rest and run the control loop.

    Args:
        plant: The simulated arm, with its hands and fixtures.
        controller: The controller, which gets the readings of the simulated bus.
        target: Target pose (4, 4), or a function of time.
        duration: Duration [s].
        q: Start pose (n,) [rad].
        on_tick: Callback before each tick with the time [s] and the plant.

    Returns:
        Record of the run.
    """
    plant.reset(q)
    controller.reset(q)
    start = plant.tool
    door = next((fixture for fixture in plant.fixtures if isinstance(fixture, Door)), None)
    rows: list[tuple[Array, ...]] = []
    for _, pose, command in closed_loop(plant, controller, target, duration, on_tick=on_tick):
        tool = plant.tool
        hand = plant.hands[0] if plant.hands else None
        # Baseline controllers have no diagnostics; their compliance is recorded as NaN.
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
                pliant.functional.pose_error(tool, pose),
                pliant.functional.pose_error(start, tool),
                np.full(6, np.nan) if known is None else known.compliance,
                np.zeros(3) if hand is None else hand.force,
                np.zeros(3) if hand is None else hand.torque,
                np.zeros(2) if door is None else np.array([door.peak_force, door.peak_torque]),
                np.array(0.0 if door is None else door.angle),
            )
        )
    return Trace(*(np.array(column) for column in zip(*rows, strict=True)))


# --- Conditions of a run: control rate, delays, true servos, assumptions of the controller ---


@runtime_checkable
class FromModel(Protocol):
    """Interface of a factory that makes a baseline controller at the start of a run."""

    def __call__(self, model: pliant.Model, period: float) -> Controlling:
        """Return a controller for a model and a control period [s]."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Conditions of a run; by default 100 Hz, no delay, and correct assumptions of the controller.

    Attributes:
        rate: Control rate [Hz].
        delay: Delays of readings and of commands [ticks], known to the controller.
        assumed_ratio: Ratio of assumed to true friction and damping.
        encoder_step: Angle of an encoder count [rad], known to the controller; 0: exact readings.
        gears: True friction that depends on speed and load; None: friction of the servo table.
        gears_known: True if the controller knows the friction `gears`.
        encoder_flicker: Random error of the readings [counts].
        plant: Further options of `pliant.sim.Plant`, unknown to the controller.
    """

    rate: float = 100.0
    delay: tuple[int, int] = (0, 0)
    assumed_ratio: float = 1.0
    encoder_step: float = 0.0
    gears: Friction | None = None
    gears_known: bool = False
    encoder_flicker: int = 0
    plant: Mapping[str, Any] = field(default_factory=dict)

    def with_plant(self, **options: Any) -> Conditions:
        """Return a copy of the conditions with further options of `pliant.sim.Plant`."""
        return replace(self, plant={**self.plant, **options})

    def build(self, *scene: Hand | Fixture) -> Plant:
        """Return `arm7`, simulated under these conditions, with hands and fixtures."""
        options: dict[str, Any] = {
            "rate": self.rate,
            "delay": self.delay,
            "encoder_step": self.encoder_step,
            "encoder_flicker": self.encoder_flicker,
            **({} if self.gears is None else {"friction": self.gears}),
            **self.plant,
        }
        return Plant(arm(), scene=scene, **options)

    def servos(self) -> pliant.Servos:
        """Return the servo table of `arm7` that the controller assumes."""
        true = servos()
        if self.gears is not None and self.gears_known:
            true = self.gears.assumed(true)
        return scaled(true, self.assumed_ratio, self.assumed_ratio).replace(
            kv=self.assumed_ratio * np.asarray(true.kv), encoder_step=self.encoder_step
        )

    def controller(self, law: pliant.Settings | FromModel) -> Controlling:
        """Return a controller of `arm7` for one run.

        `law` are settings, or the factory of a baseline controller.
        """
        if isinstance(law, pliant.Settings):
            delay = sum(self.delay) / self.rate
            settings = law.replace(rate=self.rate, delay=delay)
            return pliant.Controller(arm(), settings, self.servos())
        return law(arm(), 1.0 / self.rate)


def scaled(table: pliant.Servos, friction: Array | float, damping: Array | float) -> pliant.Servos:
    """Return a servo table whose friction and damping are multiplied by these factors.

    A factor is a number, or an array with a number per joint (n,).
    """
    return table.replace(
        friction=friction * np.asarray(table.friction),
        load_friction=friction * np.asarray(table.load_friction),
        stribeck=friction * np.asarray(table.stribeck),
        load_stribeck=friction * np.asarray(table.load_stribeck),
        damping=damping * np.asarray(table.damping),
    )


#: Ideal conditions: 100 Hz, no delay, all parameters known to the controller.
NOMINAL = Conditions()
#: Conditions of typical hardware: a delay of one tick for readings and for commands.
TICK_EACH_WAY = Conditions(delay=(1, 1))
