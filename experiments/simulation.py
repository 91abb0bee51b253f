"""One closed loop: plant, controller, target, conditions, and a record of the true state."""

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
    from pliant.sim import Fixture, Hand, Plant
    from pliant.sim.friction import Friction

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


def closed_loop(
    plant: Plant,
    controller: Controlling,
    target: Array | Target,
    duration: float,
    *,
    on_tick: Callable[[float, Plant], None] | None = None,
) -> Iterator[tuple[float, Array, Commanded]]:
    """Close the loop from the present state; yield time, target and command after each tick.

    Args:
        plant: The simulated arm, with its hands and fixtures.
        controller: The controller; it receives only what the plant's bus reports.
        target: Pose (4, 4) of the tool, a function of time, or an array that the caller changes.
        duration: Length [s].
        on_tick: Called before each tick with the time and the plant.
    """
    listen = getattr(controller, "listen", None)
    for tick in range(round(duration * plant.rate)):
        time = tick / plant.rate
        if on_tick is not None:
            on_tick(time, plant)
        if listen is not None:
            listen(plant.torque)
        wanted = target(time) if callable(target) else target
        command = controller.step(plant.read().q, wanted)
        plant.write(command.goal, command.torque_limit)
        plant.advance()
        yield time, wanted, command


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
    rows: list[tuple[Array, ...]] = []
    for _, wanted, command in closed_loop(plant, controller, target, duration, on_tick=on_tick):
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


# --- Conditions: loop, bus, servos, and the controller's assumptions ---


@runtime_checkable
class FromModel(Protocol):
    """A baseline controller, made for the arm when a run begins."""

    def __call__(self, model: pliant.Model, period: float) -> Controlling:
        """Make one for a control period [s]."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Loop, bus, servos and assumptions; by default 100 Hz, no delay, everything known.

    Attributes:
        rate: Control rate [Hz].
        delay: Ticks from sampling to read() and from write() to the servo; known to the controller.
        believed: Assumed over true friction and damping.
        encoder_step: Encoder count [rad], known to the controller.
        gears: Friction by speed and load in place of the table's.
        gears_known: True if the controller knows it.
        encoder_flicker: Counts by which readings toggle at random.
        plant: More options of `pliant.sim.Plant`, which override the above and are unknown to the
            controller.
    """

    rate: float = 100.0
    delay: tuple[int, int] = (0, 0)
    believed: float = 1.0
    encoder_step: float = 0.0
    gears: Friction | None = None
    gears_known: bool = False
    encoder_flicker: int = 0
    plant: Mapping[str, Any] = field(default_factory=dict)

    def with_plant(self, **options: Any) -> Conditions:
        """Return the same conditions with more options of the plant."""
        return replace(self, plant={**self.plant, **options})

    def build(self, *scene: Hand | Fixture) -> Plant:
        """Build the simulated arm with its hands and fixtures."""
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
        return scaled(true, self.believed, self.believed).replace(
            kv=self.believed * np.asarray(true.kv), encoder_step=self.encoder_step
        )

    def controller(self, law: pliant.Settings | FromModel) -> Controlling:
        """Make the controller of one run: from settings, or a baseline."""
        if isinstance(law, pliant.Settings):
            delay = sum(self.delay) / self.rate
            settings = law.replace(rate=self.rate, delay=delay)
            return pliant.Controller(arm(), settings, self.servos())
        return law(arm(), 1.0 / self.rate)


def scaled(table: pliant.Servos, friction: Array | float, damping: Array | float) -> pliant.Servos:
    """Return a servo table with scaled friction and damping."""
    return table.replace(
        friction=friction * np.asarray(table.friction),
        load_friction=friction * np.asarray(table.load_friction),
        stribeck=friction * np.asarray(table.stribeck),
        load_stribeck=friction * np.asarray(table.load_stribeck),
        damping=damping * np.asarray(table.damping),
    )


#: Ideal conditions: 100 Hz, no delay, all parameters known to the controller.
NOMINAL = Conditions()
#: Conditions of typical hardware: one tick of delay of readings and one of commands.
TICK_EACH_WAY = Conditions(delay=(1, 1))
