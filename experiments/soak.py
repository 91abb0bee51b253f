"""Minutes of control over real bytes while 1 % of all transactions fail.

``python -m experiments.soak [--family sts|x|p1] [--minutes 10] [--rate 100]`` runs in real time,
with servos, wire timing and the simulated arm in a process of their own; ``--stepped`` in emulated
time, as fast as the computer allows.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments.bus_arm import FAMILIES, configuration, emulator, stepped
from experiments.bus_audit import Audit
from experiments.setups import displaced
from pliant.arm import Arm
from pliant.config import factory
from pliant.emulator import Faults
from pliant.emulator.faults import KINDS
from pliant.emulator.process import EmulatorProcess
from pliant.loop import Loop
from pliant.servo import ServoBus

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from pliant.drive import JointReadings
    from pliant.emulator import ArmEmulator

    Array = NDArray[np.float64]

#: Share of transactions with a fault, all kinds alike.
SHARE = 0.01
#: The target's amplitude [m], axis by axis, and its periods [s].
SWING, PERIODS = {"x": 0.04, "y": 0.06, "z": 0.04}, {"x": 3.1, "y": 4.3, "z": 3.7}
#: Allowed difference between the emulator's and the driver's stall torques.
TABLES = 0.001
#: Distance from the true position that is not staleness [counts]: half a count of rounding, and
#: half of one between the two tables' scales of an EX-106+, 250.92° and 251°.
ROUNDING = 1.2
#: Largest age of positions that commands are computed from: the loop's own bound [s].
OLD = 0.1
#: In real time, on a busy machine: minimum reply timeout, and timeouts for positions and a silent
#: host [s].
PATIENCE, COMM_TIMEOUT, WATCHDOG = 0.05, 20.0, 2.0


class Recorder(ServoBus):
    """A driver that records its readings and commands.

    Attributes:
        readings: Positions returned as valid: (joint, angle, from, to) [rad, s].
        asked: Requested limits (n,) [N·m], in order.
        ceilings: Largest limits (n,) [N·m], read from the servos at open.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Start with an empty record."""
        super().__init__(*args, **kwargs)
        self.readings: list[tuple[int, float, float, float]] = []
        self.asked: list[Array] = []
        self.ceilings = np.zeros(self.n)

    def read(self) -> JointReadings:
        """Read, and record."""
        sample = super().read()
        now = time.perf_counter() if self.clock is None else self.clock.now()
        times = np.broadcast_to(sample.time, self.n)
        self.readings += [
            (i, float(sample.position[i]), float(times[i]), now)
            for i in np.flatnonzero(sample.ok).tolist()
        ]
        return sample

    def write(self, goal: ArrayLike, limit: ArrayLike, velocity: ArrayLike | None = None) -> None:
        """Record, and write."""
        self.asked.append(np.array(limit, dtype=np.float64))
        super().write(goal, limit, velocity)

    def enable(self, goal: ArrayLike, limit: ArrayLike) -> None:
        """Record, and enable."""
        self.asked.append(np.array(limit, dtype=np.float64))
        self.ceilings = np.array(self.servos.max_torque)
        super().enable(goal, limit)


@dataclass(frozen=True, kw_only=True)
class Soaked:
    """Result of a soak.

    Attributes:
        family: The servos.
        seconds: Time under control.
        ended: The error that ended it early, else empty.
        loop: Counters of the loop.
        bus: Counters of driver and arm.
        struck: Number of faults of each kind.
        broken: Rules broken, by name; empty is good.
        late: Positions returned as valid that were not true at any time between request and reply:
            the reply belonged to an earlier request.
        stale: Those that were not true within 0.1 s before the reply either.
        furthest: Largest distance from the true position of that time [counts].
        telling: Share of the positions that would be detected as stale if they were three cycles
            old: the sensitivity of the comparison.
        positions: Number of compared positions.
        limits: Number of limits compared with the requested ones.
        off: Largest distance of a limit on the wire from the requested one [counts].
        above: Limits above the requested ones.
        lateness: Of ticks, as text.
        lag: Time the emulator dropped because the computer was too slow [s].
    """

    family: str
    seconds: float
    ended: str
    loop: dict[str, int]
    bus: dict[str, int]
    struck: dict[str, int]
    broken: dict[str, int]
    late: int
    stale: int
    furthest: float
    telling: float
    positions: int
    limits: int
    off: float
    above: int
    lateness: str
    lag: float
    load: tuple[float, ...] = field(default_factory=os.getloadavg)

    @property
    def missed(self) -> float:
        """Share of the loop's deadlines that it skipped [%]."""
        ticks, missed = self.loop["ticks"], self.loop["missed"]
        return 100.0 * missed / max(ticks + missed, 1)

    @property
    def good(self) -> bool:
        """True if the run was complete, no rule was broken, and limits and positions matched."""
        return not (self.ended or self.broken or self.stale or self.above) and self.off <= 1.0


def stale(readings: list[tuple[int, float, float, float]], truth: Array, count: Array) -> Array:
    """Return the distance of positions from the true ones between their request and their reply.

    Args:
        readings: As `Recorder.readings`.
        truth: As `Audit.truth`.
        count: Size of a count of each joint [rad].

    Returns:
        Distance of each [counts], 0 inside the true range.
    """
    times = truth[:, 0]
    out = np.zeros(len(readings))
    for k, (joint, angle, begin, end) in enumerate(readings):
        first = max(int(np.searchsorted(times, begin - 1e-9)), 0)
        last = int(np.searchsorted(times, end + 1e-9, side="right"))
        seen = truth[first:last, 1 + joint]
        if seen.size == 0:
            out[k] = np.inf
            continue
        out[k] = max(float(seen.min()) - angle, angle - float(seen.max()), 0.0) / count[joint]
    return out


def drive(arm: Arm, seconds: float, rate: float) -> tuple[Loop, str]:
    """Follow a moving target, y soft; return the loop and the error that ended it."""
    settings = pliant.Settings.soft("y").replace(rate=rate)
    ended = ""
    arm.enable()
    controller = pliant.Controller(arm.model, settings, arm.servos)
    start = arm.model.forward_kinematics(arm.read().q)
    loop = Loop(arm, controller, rate=rate, duration=seconds, max_step_time=COMM_TIMEOUT)
    begin = arm.clock.now()
    try:
        for tick in loop:
            target = start
            for axis, swing in SWING.items():
                phase = 2.0 * np.pi * (tick.began - begin) / PERIODS[axis]
                target = displaced(target, axis, swing * float(np.sin(phase)))
            tick.write(controller.step(tick.q, target, dt=tick.dt))
    except pliant.PliantError as error:
        ended = str(error)
    try:
        arm.disable_torque()
    except pliant.PliantError as error:
        ended = f"{ended} {error}".strip()
    return loop, ended


def judge(
    family: str, arm: Arm, driven: tuple[Loop, str], ask: Callable[[str], Any], lag: float
) -> Soaked:
    """Compare the host's record with the emulator's."""
    (loop, ended), chain = driven, arm.drive
    assert isinstance(chain, Recorder)
    report, truth = ask("report"), ask("truth")
    count = np.array([2.0 * np.pi / spec.row.resolution / spec.gear for spec in chain.specs])
    away = stale(chain.readings, truth, count)
    earlier = [(i, q, min(begin, end - OLD), end) for i, q, begin, end in chain.readings]
    within = np.where(away > ROUNDING, stale(earlier, truth, count), away)
    later = 3.0 * loop.period
    shifted = [(i, q, begin + later, end + later) for i, q, begin, end in chain.readings]
    sent, unit = ask("limits"), ask("units")
    ids = [spec.id for spec in chain.specs]
    asked = np.minimum(np.array(chain.asked), chain.ceilings)
    if any(len(sent[id]) != len(asked) for id in ids):
        counts = [len(sent[id]) for id in ids]
        raise AssertionError(f"{len(asked)} limits were asked for, on the wire were {counts}")
    wire = np.array([sent[id] for id in ids]).T
    room = TABLES * asked
    step = np.array([unit[id] for id in ids])
    off = np.maximum(np.abs(asked - wire) - room, 0.0) / step
    return Soaked(
        family=family,
        seconds=len(loop.lateness) * loop.period,
        ended=ended,
        loop={
            "ticks": len(loop.lateness),
            "missed": loop.missed,
            "without readings": loop.missing,
            "rejected": loop.rejected,
            "restarts": loop.restarts,
        },
        bus=arm.counters,
        struck=report["faults"],
        broken=report["broken"],
        late=int((away > ROUNDING).sum()),
        stale=int((within > ROUNDING).sum()),
        furthest=float(within.max()),
        telling=float((stale(shifted, truth, count) > ROUNDING).mean()),
        positions=len(away),
        limits=off.size,
        off=float(off.max()),
        above=int((wire - asked > room + 1e-9).sum()),
        lateness=str(loop.lateness),
        lag=lag,
    )


def shares(share: float = SHARE) -> dict[str, float]:
    """Distribute a share of all transactions over all kinds of fault."""
    return dict.fromkeys(KINDS, share / len(KINDS))


def soak_stepped(family: str, seconds: float, *, rate: float = 100.0, seed: int = 1) -> Soaked:
    """Soak in emulated time, everything in this process."""
    faults = Faults(seed=seed)
    options = {"rate": rate, "comm_timeout": COMM_TIMEOUT}
    with stepped(family, chain=Recorder, arm=options, faults=faults, log=10) as (bus, arm):
        audit = Audit(bus, machine=False)
        arm.open()
        bus.log.watch = audit
        faults.by_chance(**shares())
        driven = drive(arm, seconds, rate)
        return judge(family, arm, driven, lambda name: getattr(audit, name)(), bus.lag)


def audited(family: str, seed: int) -> ArmEmulator:
    """Return the emulator of a soak in real time."""
    bus = emulator(family, faults=Faults(seed=seed), log=10)
    bus.log.watch = Audit(bus, machine=True)
    return bus


def soak(family: str, seconds: float, *, rate: float = 100.0, seed: int = 1) -> Soaked:
    """Soak in real time, servos and arm in a process of their own."""
    read = configuration(family)
    with EmulatorProcess(audited, family, seed) as bus:
        chain = Recorder(
            factory.servo_specs(read, bus.ports), rate=rate, reply_timeout_min=PATIENCE
        )
        try:
            arm = Arm(
                read.model(),
                chain,
                rate=rate,
                comm_timeout=COMM_TIMEOUT,
                watchdog=WATCHDOG,
                signals=False,
            )
            arm.open()
            bus.call("faults.by_chance", **shares())
            driven = drive(arm, seconds, rate)
            ask = lambda name: bus.call(f"log.watch.{name}")  # noqa: E731
            return judge(family, arm, driven, ask, bus.call("lag"))
        finally:
            chain.close()


def table(runs: list[Soaked]) -> str:
    """Return the counters as a table in Markdown, one column per run."""
    rows: dict[str, list[str]] = {}

    def row(name: str, values: list[Any]) -> None:
        rows[name] = [f"{v:.2f}" if isinstance(v, float) else str(v) for v in values]

    row("under control [s]", [run.seconds for run in runs])
    for name in runs[0].loop:
        row(name, [run.loop[name] for run in runs])
    row("share of deadlines missed [%]", [run.missed for run in runs])
    row("ticks late by", [run.lateness for run in runs])
    row("emulator dropped [s]", [run.lag for run in runs])
    row("load of the machine", [run.load[0] for run in runs])
    row("faults", [sum(run.struck.values()) for run in runs])
    for kind in KINDS:
        row(f"of which `{kind}`", [run.struck.get(kind, 0) for run in runs])
    for name in dict.fromkeys(name for run in runs for name in run.bus):
        row(f"bus: {name}", [run.bus.get(name, 0) for run in runs])
    row("positions compared with true ones", [run.positions for run in runs])
    row("of which replies to an earlier request", [run.late for run in runs])
    row("of which not true within 0.1 s", [run.stale for run in runs])
    row("largest difference [counts]", [run.furthest for run in runs])
    row("share that would be stale, were they 3 cycles old", [run.telling for run in runs])
    row("limits compared with requested ones", [run.limits for run in runs])
    row("largest shortfall [counts]", [run.off for run in runs])
    row("above the requested one", [run.above for run in runs])
    row("rules broken", [run.broken or "none" for run in runs])
    row("ended early by", [run.ended or "none" for run in runs])
    lines = ["| | " + " | ".join(FAMILIES[run.family].title for run in runs) + " |"]
    lines.append("|---" * (1 + len(runs)) + "|")
    lines += [f"| {name} | {' | '.join(values)} |" for name, values in rows.items()]
    return "\n".join(lines)


def main() -> None:
    """Run, print the counters, and fail if a rule was broken."""
    parser = argparse.ArgumentParser(prog="python -m experiments.soak")
    parser.add_argument("--family", choices=FAMILIES, help="default: one after the other")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=100.0, help="[Hz]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stepped", action="store_true", help="in the emulator's time")
    given = parser.parse_args()
    run = soak_stepped if given.stepped else soak
    runs = [
        run(family, 60.0 * given.minutes, rate=given.rate, seed=given.seed)
        for family in ([given.family] if given.family else FAMILIES)
    ]
    print(table(runs))
    if not all(one.good for one in runs):
        sys.exit("a rule was broken: see the table")


if __name__ == "__main__":
    main()
