"""Faults of hosts, programs and buses during motion, and the reaction of the arm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments.setups import arm, displaced, tool
from pliant.arm.arm import Arm
from pliant.drive import JointReadings
from pliant.loop import Loop, Tick
from pliant.sim import Guide, Plant, SimDrive
from pliant.sim.hand import Course
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pliant import Servos

    Array = NDArray[np.float64]
    Act = Callable[[Tick, "SickDrive", Arm, float], Array | None]

#: Time of the fault, its default duration, and the end of the program [s].
WHEN, LONG, END = 1.0, 1.0, 4.0
#: The lost joint, in the middle of the arm.
LOST = "elbow_pitch"


class SickDrive(SimDrive):
    """A simulated arm whose bus or servos fail for a while.

    Attributes:
        silent: Joints that do not answer, by name.
        powerless: Joints without power: they neither answer nor exert torque.
        deaf: True if writes are lost.
    """

    def __init__(self, plant: Plant, servos: Servos | None = None) -> None:
        """Start without a fault; `servos` is the table that the arm assumes."""
        super().__init__(plant, servos=servos)
        self.silent: set[str] = set()
        self.powerless: set[str] = set()
        self.deaf = False

    def read(self) -> JointReadings:
        """Return readings of the joints that answer."""
        sample = super().read()
        lost = np.isin(self.names, [*self.silent, *self.powerless])
        position = np.where(lost, np.nan, sample.position)
        return JointReadings(position, sample.ok & ~lost, sample.time)

    def write(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send orders to the joints that receive them."""
        if not self.deaf:
            limit = np.where(np.isin(self.names, list(self.powerless)), 0.0, limit)
            super().write(goal, limit, velocity)


@dataclass(frozen=True, kw_only=True)
class Mishap:
    """A fault one second into a loop.

    Attributes:
        title: Description.
        act: Called at every tick from then on with tick, drive, arm and the time since [s]; returns
            a target (4, 4), or None to write no command.
        loop: More arguments of the loop.
    """

    title: str
    act: Act
    loop: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Suffered:
    """Result of a fault.

    Attributes:
        outcome: `goes on` or `is lowered`.
        reason: The error that ended the loop.
        speed: Highest speed of the tool from the fault to the end of the loop [m/s].
        descent: Highest speed of the tool during the descent [m/s].
        drop: Drop of the tool before it went on or was lowered [m].
        force: Largest mean over a tick of the force on a hand that holds the tool in place [N].
        along: The same along each axis of the base, x, y, z [N].
    """

    outcome: str
    reason: str
    speed: float
    descent: float
    drop: float
    force: float
    along: tuple[float, ...]


def suffer(mishap: Mishap, *, held: bool = False) -> Suffered:
    """Let `arm7` hold its grasp pose, y soft, at 100 Hz with a tick each way, and apply a fault.

    Args:
        mishap: The fault.
        held: True: a hand (3000 N/m) holds the tool in place from then on.

    Returns:
        The result until the arm was down.
    """
    model = arm()
    hand = Guide(axes="x y z", course=Course(start=WHEN + 0.5, rise=0.0, end=np.inf))
    plant = Plant(model, delay=(1, 1), scene=[hand] if held else [])
    plant.reset(VERTICAL)
    drive = SickDrive(plant)
    robot = Arm(model, drive, signals=False)
    settings = pliant.Settings.soft("y").replace(delay=0.02)
    controller = pliant.Controller(model, settings, robot.servos)
    speeds: list[float] = []
    heights: list[float] = []
    forces: list[Array] = [np.zeros(3)]
    begun = [np.inf]

    def look() -> None:
        if plant.time > begun[0]:
            speeds.append(float(np.linalg.norm(plant.ground_truth.frame("tool").twist()[:3])))
            heights.append(float(plant.tool[2, 3]))
            forces.extend(np.array(felt.force) for felt in plant.hands)

    drive.clock.on_tick = look
    reason, last = "", 0
    try:
        with robot:
            begun[0] = robot.clock.now() + WHEN
            try:
                for tick in Loop(robot, controller, duration=END, **mishap.loop):
                    since = tick.began - begun[0]
                    target = mishap.act(tick, drive, robot, since) if since > -1e-9 else GRASP
                    if target is not None:
                        tick.write(controller.step(tick.q, target, dt=tick.dt))
            finally:
                last = len(heights)
    except (pliant.PliantError, KeyboardInterrupt) as error:
        reason = str(error) or type(error).__name__
    start, last = heights[0], max(last, 1)
    return Suffered(
        outcome="is lowered" if reason else "goes on",
        reason=reason,
        speed=max(speeds[:last]),
        descent=max(speeds[last:]),
        drop=max(0.0, start - min(heights[:last])),
        force=float(np.linalg.norm(forces, axis=1).max()),
        along=tuple(float(most) for most in np.abs(forces).max(axis=0)),
    )


GRASP: Array = tool(VERTICAL)


def _stall(tick: Tick, drive: SickDrive, robot: Arm, since: float) -> Array:
    """Compute for a second instead of a tick."""
    if since < 0.005:
        robot.clock.wait_until(robot.clock.now() + LONG)
    return GRASP


def _nan(tick: Tick, drive: SickDrive, robot: Arm, since: float) -> Array:
    """Return NaN for a target."""
    return np.full((4, 4), np.nan) if since < LONG else GRASP


def _nan_caught(tick: Tick, drive: SickDrive, robot: Arm, since: float) -> Array | None:
    """Detect the NaN, and skip the tick."""
    if since < LONG:
        tick.skip()
        return None
    return GRASP


def _nothing(tick: Tick, drive: SickDrive, robot: Arm, since: float) -> Array | None:
    """Write nothing."""
    return None if since < LONG else GRASP


def _jump(tick: Tick, drive: SickDrive, robot: Arm, since: float) -> Array:
    """Move the target by one metre for a second."""
    return displaced(GRASP, "x", 1.0) if since < LONG else GRASP


def _silence(seconds: float, *, deaf: bool = False) -> Act:
    """Silence all joints for a while; `deaf`: they also receive nothing."""

    def act(tick: Tick, drive: SickDrive, robot: Arm, since: float) -> Array:
        if since < 0.005:
            drive.silent, drive.deaf = set(drive.names), deaf
            clock, look = drive.clock, drive.clock.on_tick
            end = clock.now() + seconds

            def heal() -> None:
                if look is not None:
                    look()
                if clock.now() >= end:
                    drive.silent, drive.deaf = set(), False

            clock.on_tick = heal
        return GRASP

    return act


def _lost(*, powerless: bool) -> Act:
    """Lose one joint for good."""

    def act(tick: Tick, drive: SickDrive, robot: Arm, since: float) -> Array:
        (drive.powerless if powerless else drive.silent).add(LOST)
        return GRASP

    return act


def _interrupt(tick: Tick, drive: SickDrive, robot: Arm, since: float) -> Array:
    """Raise Ctrl-C."""
    raise KeyboardInterrupt


MISHAPS: tuple[Mishap, ...] = (
    Mishap(title="no fault", act=lambda tick, drive, robot, since: GRASP),
    Mishap(title="Ctrl-C, or any exception", act=_interrupt),
    Mishap(title="the program stalls for 1 s", act=_stall),
    Mishap(title="the same, `Loop(max_step_time=2.0)`", act=_stall, loop={"max_step_time": 2.0}),
    Mishap(title="target NaN, the error not caught", act=_nan),
    Mishap(title="target NaN for 1 s, caught: `tick.skip()`", act=_nan_caught),
    Mishap(title="no command for 1 s", act=_nothing),
    Mishap(title="target jumps by 1 m for 1 s", act=_jump),
    Mishap(title="no positions for 0.3 s", act=_silence(0.3)),
    Mishap(title="no positions for 1 s", act=_silence(1.0)),
    Mishap(title="no more positions", act=_silence(np.inf)),
    Mishap(title="bus silent both ways for 1 s", act=_silence(1.0, deaf=True)),
    Mishap(title="elbow no longer answers", act=_lost(powerless=False)),
    Mishap(title="elbow loses power", act=_lost(powerless=True)),
)
