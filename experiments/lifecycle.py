"""Reactions of the simulated arm to faults of bus, servos and program, and simulated descents.

``python -m experiments.lifecycle`` prints the table of docs/lifecycle.md. `experiments.descent`
measures descents with wrong assumptions about the arm.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments import command_line, markdown
from experiments.arms import ranges
from experiments.poses import arm, displaced, tool
from pliant import robots
from pliant.arm.arm import Arm
from pliant.drive import JointReadings
from pliant.loop import Loop, Tick
from pliant.sim import Plant, SimDrive, SpringConstraint, table
from pliant.sim.hand import ForceProfile
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from experiments.poses import Array
    from pliant import Servos
    from pliant.sim import Hand

    Act = Callable[[Tick, "FaultyDrive", Arm, float], Array | None]

#: Time of the fault in the control loop, duration of a temporary fault, and duration of the loop
#: [s].
WHEN, LONG, END = 1.0, 1.0, 4.0
#: Joint that fails, in the middle of the arm.
LOST = "elbow_pitch"


class FaultyDrive(SimDrive):
    """Drive of a simulated arm with faults of bus and servos.

    Attributes:
        silent: Names of the joints that do not answer.
        powerless: Names of the joints without power, which neither answer nor exert torque.
        deaf: True if all writes are lost.
    """

    def __init__(self, plant: Plant, servos: Servos | None = None) -> None:
        """Start without a fault; the arm assumes `servos`, by default the plant's servo table."""
        super().__init__(plant, servos=servos)
        self.silent: set[str] = set()
        self.powerless: set[str] = set()
        self.deaf = False

    def read(self) -> JointReadings:
        """Return the readings; joints that do not answer have NaN and `ok` False."""
        sample = super().read()
        is_missing = np.isin(self.names, [*self.silent, *self.powerless])
        position = np.where(is_missing, np.nan, sample.position)
        return JointReadings(position, sample.ok & ~is_missing, sample.time)

    def write(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Write goals and limits, unless all writes are lost; joints without power get limit 0."""
        if not self.deaf:
            limit = np.where(np.isin(self.names, list(self.powerless)), 0.0, limit)
            super().write(goal, limit, velocity)


@dataclass(frozen=True, kw_only=True)
class FaultCase:
    """Fault that occurs one second after the start of the loop.

    Attributes:
        title: Description in the table.
        act: Function that is called in every tick from the fault on. Its arguments are tick, drive,
            arm and the time since the fault [s]. It returns the target pose (4, 4), or None if no
            command is to be written.
        loop: Further arguments of `pliant.Loop`.
    """

    title: str
    act: Act
    loop: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FaultResult:
    """Result of a fault.

    Attributes:
        outcome: `goes on` or `is lowered`.
        reason: Error that ended the loop; empty if none did.
        speed: Largest speed of the tool from the fault to the end of the loop [m/s].
        descent: Largest speed of the tool during the descent [m/s].
        drop: Drop of the tool below its height at the fault, until the end of the loop [m].
        force: Largest force on a hand that holds the tool in place, averaged over a control period
            [N].
        along: Largest force on the hand along each base axis x, y, z [N].
    """

    outcome: str
    reason: str
    speed: float
    descent: float
    drop: float
    force: float
    along: tuple[float, ...]


def run_fault(case: FaultCase, *, held: bool = False) -> FaultResult:
    """Apply a fault to `arm7`, which holds its grasp pose with soft y at 100 Hz; lower the arm.

    Args:
        case: The fault.
        held: True: from the fault on, a hand holds the tool in place by springs of 3000 N/m.

    Returns:
        The result, including the descent.
    """
    model = arm()
    hand = SpringConstraint(
        axes="x y z", course=ForceProfile(start=WHEN + 0.5, rise=0.0, end=np.inf)
    )
    plant = Plant(model, delay=(1, 1), scene=[hand] if held else [])
    plant.reset(VERTICAL)
    drive = FaultyDrive(plant)
    robot = Arm(model, drive, handle_signals=False)
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
            forces.extend(np.array(hand.force) for hand in plant.hands)

    drive.clock.on_tick = look
    reason, last = "", 0
    try:
        with robot:
            begun[0] = robot.clock.now() + WHEN
            try:
                for tick in Loop(robot, controller, duration=END, **case.loop):
                    time_since = tick.began - begun[0]
                    target = (
                        case.act(tick, drive, robot, time_since) if time_since > -1e-9 else GRASP
                    )
                    if target is not None:
                        tick.write(controller.step(tick.q, target, dt=tick.dt))
            finally:
                last = len(heights)
    except (pliant.PliantError, KeyboardInterrupt) as error:
        reason = str(error) or type(error).__name__
    start, last = heights[0], max(last, 1)
    return FaultResult(
        outcome="is lowered" if reason else "goes on",
        reason=reason,
        speed=max(speeds[:last]),
        descent=max(speeds[last:]),
        drop=max(0.0, start - min(heights[:last])),
        force=float(np.linalg.norm(forces, axis=1).max()),
        along=tuple(float(value) for value in np.abs(forces).max(axis=0)),
    )


GRASP: Array = tool(VERTICAL)


def _stall(tick: Tick, drive: FaultyDrive, robot: Arm, since: float) -> Array:
    """Block the loop for one second in the first tick of the fault; return the grasp pose."""
    if since < 0.005:
        robot.clock.wait_until(robot.clock.now() + LONG)
    return GRASP


def _nan(tick: Tick, drive: FaultyDrive, robot: Arm, since: float) -> Array:
    """Return a target of NaN for the duration of the fault, then the grasp pose."""
    return np.full((4, 4), np.nan) if since < LONG else GRASP


def _nan_caught(tick: Tick, drive: FaultyDrive, robot: Arm, since: float) -> Array | None:
    """Skip the ticks during the fault, like a program that detects a NaN target itself.

    Return None in a skipped tick, and the grasp pose after the fault.
    """
    if since < LONG:
        tick.skip()
        return None
    return GRASP


def _nothing(tick: Tick, drive: FaultyDrive, robot: Arm, since: float) -> Array | None:
    """Return None, so that no command is written, during the fault; then the grasp pose."""
    return None if since < LONG else GRASP


def _jump(tick: Tick, drive: FaultyDrive, robot: Arm, since: float) -> Array:
    """Return a target 1 m in front of the grasp pose for one second, then the grasp pose."""
    return displaced(GRASP, "x", 1.0) if since < LONG else GRASP


def _silence(seconds: float, *, deaf: bool = False) -> Act:
    """Return an action after which no joint answers for `seconds`; with `deaf`, writes are lost."""

    def act(tick: Tick, drive: FaultyDrive, robot: Arm, since: float) -> Array:
        if since < 0.005:
            drive.silent, drive.deaf = set(drive.names), deaf
            clock, callback = drive.clock, drive.clock.on_tick
            end = clock.now() + seconds

            def heal() -> None:
                if callback is not None:
                    callback()
                if clock.now() >= end:
                    drive.silent, drive.deaf = set(), False

            clock.on_tick = heal
        return GRASP

    return act


def _lost(*, powerless: bool) -> Act:
    """Return an action after which the joint `LOST` no longer answers.

    With `powerless`, it exerts no torque either.
    """

    def act(tick: Tick, drive: FaultyDrive, robot: Arm, since: float) -> Array:
        (drive.powerless if powerless else drive.silent).add(LOST)
        return GRASP

    return act


def _interrupt(tick: Tick, drive: FaultyDrive, robot: Arm, since: float) -> Array:
    """Raise KeyboardInterrupt in the program's loop, as Ctrl-C does."""
    raise KeyboardInterrupt


FAULT_CASES: tuple[FaultCase, ...] = (
    FaultCase(title="no fault", act=lambda tick, drive, robot, since: GRASP),
    FaultCase(title="Ctrl-C, or any exception", act=_interrupt),
    FaultCase(title="the program stalls for 1 s", act=_stall),
    FaultCase(title="the same, `Loop(max_step_time=2.0)`", act=_stall, loop={"max_step_time": 2.0}),
    FaultCase(title="target NaN, the error not caught", act=_nan),
    FaultCase(title="target NaN for 1 s, caught: `tick.skip()`", act=_nan_caught),
    FaultCase(title="no command for 1 s", act=_nothing),
    FaultCase(title="target jumps by 1 m for 1 s", act=_jump),
    FaultCase(title="no positions for 0.3 s", act=_silence(0.3)),
    FaultCase(title="no positions for 1 s", act=_silence(1.0)),
    FaultCase(title="no more positions", act=_silence(np.inf)),
    FaultCase(title="bus silent both ways for 1 s", act=_silence(1.0, deaf=True)),
    FaultCase(title="elbow no longer answers", act=_lost(powerless=False)),
    FaultCase(title="elbow loses power", act=_lost(powerless=True)),
)


# --- Descents ---

#: Load at the tool that the arm does not know [kg], and distance of the table below the tool or the
#: wrist, whichever is lower [m].
LOAD, TABLE = 0.3, 0.10
#: Largest share of a servo's usable torque that the weight of arm and load may need in a pose.
MAX_LOAD_SHARE = 0.9
#: Observation time after torque off [s].
AFTER = 1.0


@dataclass(frozen=True, kw_only=True)
class LowerResult:
    """Result of one descent.

    Attributes:
        speed: Largest speed of the tool during the descent [m/s].
        rise: Largest rise of the tool above its start during the descent [m].
        after: Largest speed of the tool within a second after torque off [m/s].
        force: Largest force on one point of the table, averaged over a control period [N].
        resting: Sum of the forces on all points of the table, 1 s after torque off [N].
        seconds: Duration of the descent [s].
    """

    speed: float
    rise: float
    after: float
    force: float
    resting: float
    seconds: float


def lower(
    q: Array,
    *,
    load: float = 0.0,
    over_table: bool = False,
    ticks: int = 0,
    robot: str = "arm7",
    kp_scale: float = 1.0,
    stiffness_known: bool = True,
    answered: float = 1.0,
) -> LowerResult:
    """Enable a simulated arm, lower it, and return the result.

    Args:
        q: Start pose (n,) [rad].
        load: Unknown mass at the tool [kg].
        over_table: True adds a table 0.10 m below the tool or the wrist, whichever is lower.
        ticks: Delay of readings, equal to that of writes [control periods of 10 ms].
        robot: Name of a built-in arm.
        kp_scale: True over assumed stiffness of the servos.
        stiffness_known: True if the arm assumes that its k_p is known within 10 %.
        answered: Share of the control periods of the descent in which readings arrive (0 to 1),
            drawn at random.
    """
    model = robots.load(robot)
    plant = Plant(
        model,
        payload=(load, (0.0, 0.0, 0.0)) if load else None,
        delay=(ticks, ticks),
        kp_scale=kp_scale,
    )
    plant.reset(q)
    if over_table:
        scene: Sequence[Hand] = table(min(plant.tool[2, 3], plant.wrist[2]) - TABLE)
        plant.set_hands(scene)
    drive = FaultyDrive(plant, plant.table.replace(stiffness_known=stiffness_known))
    arm = Arm(model, drive, handle_signals=False)
    speeds: list[float] = []
    heights: list[float] = []
    forces: list[float] = [0.0]
    rng = np.random.default_rng(0)

    def look() -> None:
        drive.silent = set() if rng.random() < answered else set(drive.names)
        twist = plant.ground_truth.frame("tool").twist()
        speeds.append(float(np.linalg.norm(twist[:3])))
        heights.append(float(plant.tool[2, 3]))
        forces.extend(float(np.linalg.norm(hand.force)) for hand in plant.hands)

    arm.enable()
    drive.clock.on_tick = look
    drive.silent = set(drive.names) if answered == 0.0 else set()
    begin, high = plant.time, float(plant.tool[2, 3])
    arm.lower()
    seconds, speed, force = plant.time - begin, max(speeds), max(forces)
    rise = max(max(heights) - high, 0.0)
    speeds.clear()
    drive.clock.wait_until(plant.time + AFTER)
    rest_force = sum(float(np.linalg.norm(felt.force)) for felt in plant.hands)
    return LowerResult(
        speed=speed,
        rise=rise,
        after=max(speeds),
        force=force,
        resting=rest_force,
        seconds=seconds,
    )


def postures(count: int, *, seed: int = 0, robot: str = "arm7", load: float = LOAD) -> list[Array]:
    """Return `count` random poses (n,) [rad] in which the servos can hold the arm and a load.

    Args:
        count: Number of poses.
        seed: Random seed.
        robot: Name of a built-in arm.
        load: Mass at the tool [kg].
    """
    model, heavy = robots.load(robot), robots.load(robot, payload=(load, (0.0, 0.0, 0.0)))
    assert model.servos is not None
    max_torque = np.asarray(model.servos.max_torque)
    low, high = ranges(model)
    rng = np.random.default_rng(seed)
    poses: list[Array] = []
    while len(poses) < count:
        q = rng.uniform(low, high)
        if np.all(np.abs(heavy.gravity(q)) < MAX_LOAD_SHARE * max_torque):
            poses.append(q)
    return poses


def fault_table() -> str:
    """Run every fault, without and with a hand that holds the tool; return a Markdown table."""
    rows = []
    for case in FAULT_CASES:
        without_hand, with_hand = run_fault(case), run_fault(case, held=True)
        speeds = (
            f"{without_hand.speed:.2f}",
            f"{1e3 * without_hand.drop:.1f}",
            f"{without_hand.descent:.2f}",
        )
        rows.append((case.title, without_hand.outcome, *speeds, f"{with_hand.force:.1f}"))
    columns = (
        "what happens",
        "the arm",
        "tool meanwhile [m/s]",
        "drop [mm]",
        "tool lowered [m/s]",
        "hand feels [N]",
    )
    return markdown.table(columns, rows)


def main() -> None:
    """Print the table of faults."""
    print(fault_table())


if __name__ == "__main__":
    command_line.start(main)
