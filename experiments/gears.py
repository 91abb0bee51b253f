"""Remedies for gears that stick: ``python -m experiments.gears``.

The gears of `arm7` and `so101` have the friction identified on real gears, which stick and rub more
under load. The controller knows this friction, but the true one is 0.7, 1 and 1.3 times as large. A
hand drags the tool along a soft axis, and the arm opens a door. The program prints the largest
force of the hand and at the handle without a remedy and for each remedy, and the price of the
remedy in an arm at rest: torque reversals, heat, and minutes without a limit cycle. With
``--rest-only`` it measures only the arm at rest, and does not stop at the first limit cycle.

The remedies are not in the package: each adds torques to the command of `pliant.Controller`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

import pliant
from experiments import command_line, controllers, markdown, metrics
from experiments.campaign import REAL_GEARS
from experiments.poses import pull
from experiments.runner import Job, run_by_key
from experiments.simulation import closed_loop, run, scaled
from pliant import robots
from pliant.functional import PaperOptions
from pliant.sim import DRAG_15N, Drag, Plant
from pliant.sim.doors import Door
from pliant.sim.postures import AT_DOOR, VERTICAL

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from experiments.poses import Array
    from pliant.sim import Friction, Hand
    from pliant.sim.plant import Fixture
    from pliant.types import Diagnostics

    #: Name of the remedy, name of the arm, delay of readings and of commands [ticks].
    Row = tuple[str, str, int]

#: Control period [s], and creep of joints that friction holds, relative to MuJoCo's default.
PERIOD, CREEP = 0.01, 0.1
#: Angle of an encoder count [rad].
COUNT = float(np.deg2rad(0.088))
#: Times of an arm at rest [s]: settling time, shortest observation time after it, and averaging
#: window of the joint speeds.
SETTLE, OBSERVED, WINDOW = 3.0, 3.0, 1.0
#: Bounds of an arm at rest: largest displacement of the tool [m] and rms speed of the joints in a
#: window [rad/s].
STAYS, STILL = 2e-3, 0.02
#: Change of a servo's torque that counts as a reversal, as a share of its usable torque.
REVERSAL = 0.005
#: Learning of the ratio of true to assumed friction: bounds of the ratio, smallest joint speed
#: [rad/s] and travel [rad] that count, and duration of the motion [s].
LEARNED, TEACHING, TRAVEL, LESSON = (0.6, 1.5), 0.1, 0.1, 8.0


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """Change of the friction feed-forward.

    Attributes:
        name: Name in the table.
        saturation: Joint speed above which the feed-forward has its full value [rad/s].
        by_reference: True adds the joint speeds of the target's motion to the measured ones, for
            the direction of the feed-forward.
        by_tool: True takes the direction from the tool's measured motion instead of each joint's.
        dither: Amplitude of an alternating torque, as a share of the assumed static friction.
        ticks: Ticks after which the alternating torque changes its sign.
        learns: True learns the size of the friction in a free motion before the measurement.
    """

    name: str
    saturation: float = 0.05
    by_reference: bool = False
    by_tool: bool = False
    dither: float = 0.0
    ticks: int = 2
    learns: bool = False


REMEDIES = {
    remedy.name: remedy
    for remedy in (
        Remedy(name="present law"),
        Remedy(name="saturates at 0.02 rad/s", saturation=0.02),
        Remedy(name="direction of the reference", by_reference=True),
        Remedy(name="direction of the tool", by_tool=True),
        Remedy(name="dither 0.3", dither=0.3),
        Remedy(name="dither 0.6", dither=0.6),
        Remedy(name="learned", learns=True),
        Remedy(name="learned, dither 0.6", learns=True, dither=0.6),
    )
}
#: Ratios of true to assumed friction.
FACTORS = (0.7, 1.0, 1.3)
#: Row that has the friction of the servo table instead of the friction of real gears.
IDEAL = "ideal gears"


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Arm with its two tasks.

    Attributes:
        start: Start pose of the drag (n,) [rad].
        at_door: Start pose at the handle (n,) [rad].
        hand: The hand of the drag, whose axis is soft.
        door: Arguments of `pliant.sim.Door`.
        soft: Names of the soft axes at the door.
        distance: Distance by which the target moves to open the door [m].
        task: Names of the task axes.
    """

    start: Array
    at_door: Array
    hand: Drag
    door: Mapping[str, Any]
    soft: str
    distance: float
    task: str = "xyz rpy"


BENCHES = {
    "arm7": Bench(
        start=VERTICAL,
        at_door=AT_DOOR,
        hand=DRAG_15N,
        door={"grip": "rigid"},
        soft="y yaw",
        distance=0.28,
    ),
    # Only the pan joint moves y, and it carries no load. Therefore z is soft, and the door has a
    # horizontal hinge.
    "so101": Bench(
        start=np.array([0.0, -0.3, 0.6, 0.8, 0.0]),
        at_door=np.array([0.0, 0.3, 0.1, 0.8, 0.0]),
        hand=replace(DRAG_15N, axis="z", distance=0.06, limit=8.0, at="tool"),
        door={
            "grip": "turning",
            "hinge": (0.0, 0.0, -0.12),
            "axis": (0.0, -1.0, 0.0),
            "mass": 0.3,
            "friction": 0.03,
            "damping": 0.02,
            "balanced": True,
        },
        soft="z",
        distance=0.08,
        task="xyz",
    ),
}


@cache
def model(arm: str) -> pliant.Model:
    """Return a built-in arm by name."""
    return robots.load(arm)


def servos(arm: str) -> pliant.Servos:
    """Return the servo table of a built-in arm by name."""
    table = model(arm).servos
    assert table is not None
    return table


@dataclass(frozen=True, kw_only=True)
class Case:
    """Conditions of a run.

    Attributes:
        arm: Name of the arm, a key of `BENCHES`.
        delay: Delay of readings, and of commands [ticks], known to the controller.
        friction: True over assumed friction; None: friction of the servo table, known exactly.
        encoder_step: Angle of an encoder count [rad]; 0: exact readings.
    """

    arm: str = "arm7"
    delay: int = 0
    friction: float | None = 1.0
    encoder_step: float = 0.0

    def build(self, *scene: Hand | Fixture) -> Plant:
        """Return the simulated arm with hands and fixtures."""
        return Plant(
            model(self.arm),
            rate=1.0 / PERIOD,
            delay=(self.delay, self.delay),
            encoder_step=self.encoder_step,
            friction="coulomb" if self.friction is None else self.true_friction(self.friction),
            friction_creep=CREEP,
            scene=scene,
        )

    def true_friction(self, factor: float) -> Friction:
        """Return `factor` times the friction identified on real gears."""
        gears = REAL_GEARS[self.arm].spread(model(self.arm).n)
        shape = ("speed", "exponent")
        return replace(
            gears, **{key: factor * v for key, v in vars(gears).items() if key not in shape}
        )

    def table(self) -> pliant.Servos:
        """Return the servo table that the controller assumes, with friction of factor 1."""
        table = servos(self.arm)
        if self.friction is not None:
            table = REAL_GEARS[self.arm].assumed(table)
        return table.replace(encoder_step=self.encoder_step)


class RemedyController:
    """`pliant.Controller` whose command a remedy changes.

    Attributes:
        reading: Positions (n,) of the last step [rad].
    """

    def __init__(self, settings: pliant.Settings, case: Case, remedy: Remedy) -> None:
        """Make a controller for a case with settings that a remedy changes."""
        n, table = model(case.arm).n, case.table()
        if remedy.learns:
            table = scaled(table, friction_ratio(case), 1.0)
        self._settings = settings.replace(
            rate=1.0 / PERIOD,
            delay=2 * case.delay * PERIOD,
            task=BENCHES[case.arm].task,
            paper_options=PaperOptions(friction_speed=remedy.saturation),
        )
        self._remedy = remedy
        self._inner = pliant.Controller(model(case.arm), self._settings, table)

        def each(name: str) -> Array:
            return np.broadcast_to(np.asarray(getattr(table, name), dtype=np.float64), (n,))

        self._kp, self._torque, self._speed = map(each, ("kp", "max_torque", "stribeck_speed"))
        self._dry = tuple(map(each, ("friction", "stribeck", "load_friction", "load_stribeck")))

    @property
    def diagnostics(self) -> Diagnostics:
        """Diagnostics of the last step of the controller."""
        return self._inner.diagnostics

    def reset(self, q: Array) -> None:
        """Start at rest in q (n,) [rad]."""
        self._inner.reset(q)
        self._tick = 0
        self._before: Array | None = None

    def friction(self) -> Array:
        """Return the assumed dry friction (n,) [N·m] at speed and load of the last step."""
        diagnostics = self.diagnostics
        constant, stribeck, load, load_stribeck = self._dry
        x = np.abs(diagnostics.velocity) / self._speed
        share = 1.0 / (1.0 + x + x**2)
        torque = np.abs(diagnostics.gravity + diagnostics.task_jacobian.T @ diagnostics.wrench)
        torque = np.minimum(torque, self._torque)
        out: Array = constant + share * stribeck + (load + share * load_stribeck) * torque
        return out

    def step(self, q: Array, target: Array) -> controllers.Goals:
        """Return goals and limits for positions q (n,) [rad] and the target pose (4, 4)."""
        command = self._inner.step(q, target)
        self.reading = q
        extra = self._extra(target)
        self._tick, self._before = self._tick + 1, np.array(target)
        return controllers.Goals(
            command.goal + extra / self._kp,
            np.minimum(command.torque_limit + np.abs(extra), self._torque),
        )

    def _extra(self, target: Array) -> Array:
        """Return the torque (n,) [N·m] that the remedy adds to the command."""
        diagnostics, remedy = self.diagnostics, self._remedy
        measured = np.asarray(diagnostics.velocity)
        toward = measured.copy()
        jacobian = np.asarray(diagnostics.task_jacobian)
        compliance = jacobian / self._kp @ jacobian.T + 1e-9 * np.eye(len(jacobian))
        if remedy.by_tool:
            toward = jacobian.T @ np.linalg.solve(compliance, jacobian @ measured) / self._kp
        if remedy.by_reference and self._before is not None:
            change = pliant.functional.pose_error(self._before, target)[: len(jacobian)]
            stiff = (1.0 - np.asarray(diagnostics.softness)) * change / PERIOD
            toward = toward + jacobian.T @ np.linalg.solve(compliance, stiff) / self._kp
        dry = self.friction()
        v_0, share = remedy.saturation, self._settings.compensation.friction
        extra = diagnostics.gamma * share * dry * (np.tanh(toward / v_0) - np.tanh(measured / v_0))
        if remedy.dither > 0.0:
            sign = 1.0 if self._tick // remedy.ticks % 2 else -1.0
            extra = extra + sign * remedy.dither * dry / (1.0 + (measured / 0.05) ** 2)
        out: Array = extra
        return out


@cache
def friction_ratio(case: Case) -> Array:
    """Return the ratio of true to assumed friction (n,) that is estimated in free motion.

    The target moves on a circle through the workspace. For each moving joint, least squares fit the
    ratio of the torque from its lead, without gravity and damping, to the assumed friction. A joint
    that hardly moves keeps 1. The method does not distinguish friction from the force of a hand.
    """
    plant, bench = case.build(), BENCHES[case.arm]
    table, arm = case.table(), model(case.arm)
    controller = RemedyController(controllers.cap(soft=""), case, Remedy(name="free motion"))
    home = arm.forward_kinematics(bench.start)
    radius = 0.3 * abs(bench.distance)

    def circle(time: float) -> Array:
        pose, angle = home.copy(), 2.0 * np.pi * time / 4.0
        pose[:3, 3] += radius * np.array([np.cos(angle) - 1.0, np.sin(angle), np.sin(2.0 * angle)])
        return pose

    plant.reset(bench.start)
    controller.reset(bench.start)
    damping = np.asarray(table.damping) + np.asarray(table.kv)
    if table.limit_type == "pwm":
        damping = damping + np.asarray(table.max_torque) / np.asarray(table.no_load_speed)
    numerator, denominator, travel = np.zeros(arm.n), np.zeros(arm.n), np.zeros(arm.n)
    goals: list[Array] = [bench.start] * (2 * case.delay + 1)
    for _, _, command in closed_loop(plant, controller, circle, LESSON):
        goals.append(command.goal)
        # Use the goal in force before the last reading, and the position in the middle of that
        # period.
        v = np.asarray(controller.diagnostics.velocity)
        q = controller.reading - 0.5 * PERIOD * v
        friction_torque = np.asarray(table.kp) * (goals[-2 - 2 * case.delay] - q)
        friction_torque = friction_torque - arm.gravity(q) - damping * v
        assumed = controller.friction() * np.sign(v)
        teaches = np.abs(v) > TEACHING
        numerator += np.where(teaches, friction_torque * assumed, 0.0)
        denominator += np.where(teaches, assumed**2, 0.0)
        travel += np.where(teaches, np.abs(v) * PERIOD, 0.0)
    known = travel > TRAVEL
    ratio = np.where(known, numerator / np.where(known, denominator, 1.0), 1.0)
    return np.clip(ratio, *LEARNED)


@dataclass(frozen=True, kw_only=True)
class Rest:
    """Result of an arm at rest on its target.

    Attributes:
        reversals: Reversals of the servo torque, mean over the joints [1/s].
        heat: Mean squared servo torque over that of gravity alone [1].
        quiet: Time before the tool leaves `STAYS` or a joint exceeds `STILL` [min].
        minutes: Limit of the simulated time [min].
        displacement: Displacement of the tool at the end [m].
        largest_displacement: Largest displacement of the tool [m].
        speed: Largest rms speed of the joints in a window [rad/s].
    """

    reversals: float
    heat: float
    quiet: float
    minutes: float
    displacement: float
    largest_displacement: float
    speed: float

    @property
    def is_quiet(self) -> bool:
        """True if the arm stayed quiet to the end."""
        return self.quiet >= self.minutes - 1e-9


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of a remedy in one case.

    Attributes:
        drag: Largest force of the hand, averaged over a control period [N].
        door: Largest force at the handle in any physics step [N].
        angle: Largest opening of the door [deg].
        rest: Result of the arm at rest, up to the first sign of a limit cycle.
    """

    drag: float
    door: float
    angle: float
    rest: Rest


def measure(case: Case, remedy: str, minutes: float) -> Result:
    """Return the result of a remedy in one case; `minutes` is the time at rest [min]."""
    force = drag(case, REMEDIES[remedy])
    handle, angle = open_door(case, REMEDIES[remedy])
    rested = rest(case, remedy, minutes, to_the_end=False)
    return Result(drag=force, door=handle, angle=angle, rest=rested)


def drag(case: Case, remedy: Remedy) -> float:
    """Return the largest force of a hand that drags the arm along a soft axis [N]."""
    bench = BENCHES[case.arm]
    plant, axis = case.build(bench.hand), str(bench.hand.axis)
    law = RemedyController(controllers.cap(soft=axis), case, remedy)
    target = model(case.arm).forward_kinematics(bench.start)

    def grip(time: float, plant: Plant) -> None:
        if abs(time - metrics.PULLING[0]) < 0.5 * PERIOD:
            plant.ground_truth.remember()

    trace = run(plant, law, target, metrics.PULLING[1], q=bench.start, on_tick=grip)
    return metrics.largest(trace.force[:, "xyz".index(axis)])


def open_door(case: Case, remedy: Remedy) -> tuple[float, float]:
    """Return the largest force at the handle of a door [N], and its largest opening [deg]."""
    bench = BENCHES[case.arm]
    door = Door(**bench.door)
    null_space = pliant.NullSpace(gain=1.0)
    law = RemedyController(controllers.cap(soft=bench.soft, null_space=null_space), case, remedy)
    target = pull(model(case.arm).forward_kinematics(bench.at_door), bench.distance)
    run(case.build(door), law, target, 9.5, q=bench.at_door)
    return door.peak_force, float(np.rad2deg(door.widest))


def rest(case: Case, remedy: str, minutes: float, *, to_the_end: bool) -> Rest:
    """Hold the arm at rest on its target for `minutes`.

    Without `to_the_end`, the first sign of a limit cycle ends the simulation.
    """
    bench, arm = BENCHES[case.arm], model(case.arm)
    plant = case.build()
    law = RemedyController(controllers.cap(soft=str(bench.hand.axis)), case, REMEDIES[remedy])
    plant.reset(bench.start)
    law.reset(bench.start)
    target = arm.forward_kinematics(bench.start)
    for _ in closed_loop(plant, law, target, SETTLE):
        pass
    start = plant.tool[:3, 3]
    quiet: float | None = None
    drift, farthest, fastest = 0.0, 0.0, 0.0
    torques: list[Array] = []
    speeds: list[float] = []
    seconds = max(60.0 * minutes, OBSERVED)
    for time, _, _ in closed_loop(plant, law, target, seconds):
        if len(torques) < OBSERVED / PERIOD:
            torques.append(plant.torque)
        speeds = [*speeds[1 - round(WINDOW / PERIOD) :], metrics.rms(plant.dq)]
        drift = float(np.linalg.norm(plant.tool[:3, 3] - start))
        farthest = max(farthest, drift)
        if len(speeds) * PERIOD >= WINDOW:
            fastest = max(fastest, metrics.rms(np.array(speeds)))
        if quiet is None and (drift > STAYS or fastest > STILL):
            quiet = time + PERIOD
            if not to_the_end:
                break
    samples = np.array(torques)
    band = REVERSAL * np.asarray(servos(case.arm).max_torque)
    count = np.mean(
        [_reversals(column, size) for column, size in zip(samples.T, band, strict=True)]
    )
    return Rest(
        reversals=float(count) / (len(samples) * PERIOD),
        heat=float(np.mean(np.sum(samples**2, axis=1)) / np.sum(arm.gravity(bench.start) ** 2)),
        quiet=(seconds if quiet is None else quiet) / 60.0,
        minutes=seconds / 60.0,
        displacement=drift,
        largest_displacement=farthest,
        speed=fastest,
    )


def _reversals(values: Array, band: float) -> int:
    """Count the reversals of a signal that are larger than `band`."""
    reversals, direction, extreme = 0, 0.0, values[0]
    for value in values:
        if direction * (value - extreme) > 0.0:
            extreme = value
        elif abs(value - extreme) > band:
            reversals += direction != 0.0
            direction, extreme = np.sign(value - extreme), value
    return reversals


@dataclass(frozen=True, kw_only=True)
class Bound:
    """Force that a hand needs before a position servo without dither can react.

    Attributes:
        moves: Force that moves one joint against its static friction [N].
        counts: Force that turns this joint by one encoder count against its servo [N].
    """

    moves: float
    counts: float


def bound(case: Case) -> Bound:
    """Return the bound for the drag of a case with its true friction.

    A joint starts to move when the torque ``J_i F`` of the hand exceeds its static friction, which
    depends on the motor torque of the pose and on the load with the hand; the first of all joints
    counts. Until the reading changes, its goal stays, and the servo resists with k_p times the
    encoder count.
    """
    bench, arm = BENCHES[case.arm], model(case.arm)
    plant = case.build(bench.hand)
    plant.reset(bench.start)
    point = plant.ground_truth.frame(bench.hand.at).position - plant.tool[:3, 3]
    jacobian = arm.jacobian(bench.start)
    row = "xyz".index(str(bench.hand.axis))
    lever = jacobian[row] + np.cross(jacobian[3:].T, point)[:, row]
    forces = np.linspace(0.0, 50.0, 5001)
    push_torque, motor = forces[:, None] * lever, arm.gravity(bench.start)
    if case.friction is None:
        static_friction = np.broadcast_to(np.asarray(servos(case.arm).friction), push_torque.shape)
    else:
        static_friction = case.true_friction(case.friction).largest(motor, push_torque - motor, 0.0)
    moves = np.abs(push_torque) > static_friction
    begin = int(np.argmax(moves.any(axis=1)))
    first = int(np.argmax(moves[begin]))
    stiffness = float(np.broadcast_to(np.asarray(servos(case.arm).kp), (arm.n,))[first])
    return Bound(
        moves=float(forces[begin]), counts=stiffness * case.encoder_step / abs(float(lever[first]))
    )


#: Columns of `prices`.
PRICES = ("reversals [1/s]", "heat [1]", "quiet [min]")


def prices(results: Sequence[Rest]) -> tuple[str, ...]:
    """Return the cells of the worst reversals, heat and quiet time of arms at rest."""
    shortest = min(results, key=lambda result: result.quiet)
    return (
        f"{max(result.reversals for result in results):.0f}",
        f"{max(result.heat for result in results):.2f}",
        f"{'≥ ' if shortest.is_quiet else ''}{shortest.quiet:.2g}",
    )


def text(rows: Mapping[Row, Sequence[Result]]) -> str:
    """Return a Markdown table with one line per remedy, arm and delay.

    A cell with several numbers has one for each ratio of true to assumed friction; prices at rest
    are the worst of them.
    """
    columns = ("remedy", "arm", "ticks each way", "drag [N]", "door [N]", "opening [deg]")
    lines = []
    for row, results in rows.items():
        figures = [
            " / ".join(f"{getattr(result, name):.{digits}f}" for result in results)
            for name, digits in (("drag", 1), ("door", 1), ("angle", 0))
        ]
        lines.append((*row, *figures, *prices([result.rest for result in results])))
    return markdown.table((*columns, *PRICES), lines)


def rest_text(rows: Mapping[Row, Sequence[Rest]]) -> str:
    """Return a Markdown table of arms at rest to the end, with one line per remedy, arm and delay.

    Each cell has the worst of the ratios of true to assumed friction.
    """
    displacements = ("displaced at the end [mm]", "at most [mm]")
    columns = ("remedy", "arm", "ticks each way", *PRICES, *displacements, "joints [mrad/s]")
    lines = [
        (
            *row,
            *prices(results),
            *(
                f"{1e3 * max(getattr(result, name) for result in results):.{digits}f}"
                for name, digits in (("displacement", 1), ("largest_displacement", 1), ("speed", 2))
            ),
        )
        for row, results in rows.items()
    ]
    return markdown.table(columns, lines)


def main(
    *,
    arm: command_line.Arms = (),
    remedy: command_line.Arms = (),
    exact: bool = False,
    minutes: float = 0.05,
    rest_only: bool = False,
    delay: Annotated[tuple[int, ...], tyro.conf.UseAppendAction] = (),
    friction: Annotated[tuple[float, ...], tyro.conf.UseAppendAction] = (),
    jobs: int = 2,
) -> None:
    """Measure remedies for gears that stick, and print one table.

    Args:
        arm: Names of the arms; default: both.
        remedy: Names of the remedies; default: all.
        exact: True for exact readings, else encoders with counts of 0.088°.
        minutes: Time at rest of each row [min].
        rest_only: True measures only the arm at rest with real gears, to the end of `minutes`.
        delay: Delays of readings and of commands [ticks]; default: 0 and 1.
        friction: Ratios of true to assumed friction; default: all of `FACTORS`.
        jobs: Number of processes.
    """
    step = 0.0 if exact else COUNT
    arms, factors = arm or tuple(BENCHES), friction or FACTORS
    rows: dict[Row, list[str]] = {}
    work: list[Job] = []
    plan: list[tuple[str, str, tuple[float | None, ...]]]
    plan = [] if rest_only else [(IDEAL, "present law", (None,))]
    plan += [(key, key, factors) for key in remedy or tuple(REMEDIES)]
    for name, ticks, (label, key, ratios) in product(arms, delay or (0, 1), plan):
        keys = rows.setdefault((label, name, ticks), [])
        for ratio in ratios:
            keys.append(f"{label}|{name}|{ticks}|{ratio}")
            case = Case(arm=name, delay=ticks, friction=ratio, encoder_step=step)
            if rest_only:
                work.append(Job(keys[-1], rest, (case, key, minutes), {"to_the_end": True}))
            else:
                work.append(Job(keys[-1], measure, (case, key, minutes)))
    results = run_by_key(work, jobs, "gears")
    table = {row: [results[key] for key in keys] for row, keys in rows.items()}
    print(rest_text(table) if rest_only else text(table))
    if rest_only:
        return
    for name in arms:
        for kind, ratio in (("real", 1.0), ("ideal", None)):
            smallest = bound(Case(arm=name, friction=ratio, encoder_step=step))
            print(
                f"{name}, {kind} gears: a joint moves at {smallest.moves:.2f} N of the hand, and "
                f"{smallest.counts:.2f} N more turn it by a count"
            )


if __name__ == "__main__":
    command_line.start(main)
