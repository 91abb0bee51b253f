"""Minutes of control over real bytes while 1 % of all transactions fail.

``python -m experiments.soak [--family sts|x|p1] [--minutes 10] [--rate 100]`` runs in real time,
with servos, wire timing and the simulated arm in a process of their own; ``--stepped`` in emulated
time, as fast as the computer allows.
"""

from __future__ import annotations

import os
import sys
import time
from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import pliant
from experiments import program
from experiments.emulated_arm import FAMILIES, configuration, emulator, stepped
from experiments.poses import displaced
from pliant.arm import Arm
from pliant.config import factory
from pliant.emulator import Faults
from pliant.emulator.faults import KINDS
from pliant.emulator.log import GOALS, LIMITS, SWITCH
from pliant.emulator.packets import Framer
from pliant.emulator.process import EmulatorProcess
from pliant.loop import Loop
from pliant.servo import ServoBus

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from experiments.poses import Array
    from pliant.drive import JointReadings
    from pliant.emulator import ArmEmulator, Servo, Transaction, Write


#: Register that bounds each limit register.
CEILING = {
    "torque_limit": ("max_torque", "max_torque_limit"),
    "goal_current": ("current_limit",),
    "goal_pwm": ("pwm_limit",),
}


class Audit:
    """Checks every transaction of an emulated arm: `emulator.log.watch = Audit(emulator)`.

    Args:
        bus: The emulator.
        machine: True: times are the machine's instead of the emulator's.

    Attributes:
        broken: Number of violations of each rule, by its name.
        faults: Number of faults of each kind.
        transactions: Number of transactions.
    """

    def __init__(self, bus: ArmEmulator, *, machine: bool) -> None:
        self._bus, self._machine = bus, machine
        self._servos = {servo.id: servo for servo in bus.servos}
        self._phase: dict[int, str] = dict.fromkeys(self._servos, "off")
        self._pending: set[int] = set()
        self._truth = array("d")
        self._limits: dict[int, array[int]] = {id: array("i") for id in self._servos}
        self.broken: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self.transactions = 0

    def __call__(self, seen: Transaction) -> None:
        """Process one transaction."""
        self.transactions += 1
        for fault in seen.faults:
            self.faults[fault.partition(" ")[0]] += 1
        if "read" in seen.instruction:
            now = time.perf_counter() if self._machine else seen.time
            self._truth.extend((now, *self._bus.plant.q))
        if seen.instruction == "sync_write":
            self._sent(seen.request)
        for write in seen.writes:
            self._written(write)

    def report(self) -> dict[str, dict[str, int]]:
        """Return violations, faults and transactions so far."""
        broken = Counter(self.broken)
        broken["goal without torque on after it"] += len(self._pending)
        return {
            "broken": {rule: count for rule, count in broken.items() if count},
            "faults": dict(self.faults),
            "log": {"transactions": self.transactions},
        }

    def truth(self) -> Array:
        """Return the true joint angles at every read: rows (time [s], q (n,) [rad])."""
        return np.array(self._truth).reshape(-1, 1 + self._bus.plant.n)

    def limits(self) -> dict[int, list[float]]:
        """Return the torque [N·m] of every limit in a sync write, by id, lost ones included."""
        return {id: [self.torque(id, v) for v in sent] for id, sent in self._limits.items()}

    def units(self) -> dict[int, float]:
        """Return the torque of one count of each servo's limit register [N·m], by id."""
        return {id: self.torque(id, 1) for id in self._servos}

    def torque(self, id: int, register: int) -> float:
        """Return the torque at standstill of a limit register [N·m], by the emulator's tables."""
        servo = self._servos[id]
        if "goal_current" in servo.table:
            return register * servo.model.unit * servo.model.motor.torque_per_amp
        full = {"dxl1": 1023, "sts": 1000, "x": 885}[servo.model.family]
        return servo.stall * register / full

    def _sent(self, request: bytes) -> None:
        """Read limits and ceilings from a sync write, also if servos did not receive it."""
        for frame in Framer().feed(request):
            wide = 2 if frame.protocol == 2 else 1
            start = int.from_bytes(frame.params[:wide], "little")
            size = int.from_bytes(frame.params[wide : 2 * wide], "little")
            rest = frame.params[2 * wide :]
            for at in range(0, len(rest), 1 + size):
                servo = self._servos[rest[at]]
                data = rest[at + 1 : at + 1 + size]
                name = limit_of(servo)
                register = servo.table[name]
                offset = register.address - start
                if offset >= 0 and offset + register.size <= size:
                    value = register.decode(data[offset : offset + register.size])
                    self._limits[servo.id].append(value)
                    self._below(servo, name, value)

    def _below(self, servo: Servo, name: str, value: int) -> None:
        ceiling = next(servo.get(top) for top in CEILING[name] if top in servo.table)
        self.broken["limit above the ceiling"] += value > ceiling or value < 0

    def _written(self, write: Write) -> None:
        """Check the order: limit, goal, torque; no EEPROM; no goal while torque is off."""
        self.broken["EEPROM written"] += write.eeprom
        self.broken["write refused"] += bool(write.error)
        values = write.values
        if not write.enabled and self._phase[write.id] == "on":
            self._phase[write.id] = "off"
        if LIMITS & values.keys() and self._phase[write.id] == "off":
            self._phase[write.id] = "limit"
        if GOALS & values.keys():
            if self._phase[write.id] == "off":
                self.broken["goal before limit"] += 1
            if not write.enabled:
                self._pending.add(write.id)
            if self._phase[write.id] == "limit":
                self._phase[write.id] = "goal"
        if SWITCH in values:
            self._switched(write, values[SWITCH])

    def _switched(self, write: Write, value: int) -> None:
        if value == 0:
            self._phase[write.id] = "off"
            return
        self.broken["torque before goal"] += self._phase[write.id] not in {"goal", "on"}
        self._phase[write.id] = "on"
        self._pending.discard(write.id)


def limit_of(servo: Servo) -> str:
    """Return the register that limits the torque of a servo."""
    return next(n for n in ("torque_limit", "goal_current", "goal_pwm") if n in servo.table)


# --- Minutes of control over real bytes while 1 % of all transactions fail ---

#: Share of transactions with a fault; all kinds of fault are equally likely.
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
        """Record the command, then write it."""
        self.asked.append(np.array(limit, dtype=np.float64))
        super().write(goal, limit, velocity)

    def enable(self, goal: ArrayLike, limit: ArrayLike) -> None:
        """Record, and enable."""
        self.asked.append(np.array(limit, dtype=np.float64))
        self.ceilings = np.array(self.servos.max_torque)
        super().enable(goal, limit)


@dataclass(frozen=True, kw_only=True)
class SoakResult:
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
) -> SoakResult:
    """Compare the host's record with the emulator's."""
    (loop, ended), chain = driven, arm.drive
    assert isinstance(chain, Recorder)
    report, truth = ask("report"), ask("truth")
    count = np.array(
        [2.0 * np.pi / spec.row.counts_per_turn / spec.gear_ratio for spec in chain.specs]
    )
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
    return SoakResult(
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
    """Return the share of transactions with each kind of fault, `share` in total."""
    return dict.fromkeys(KINDS, share / len(KINDS))


def soak_stepped(family: str, seconds: float, *, rate: float = 100.0, seed: int = 1) -> SoakResult:
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


def soak(family: str, seconds: float, *, rate: float = 100.0, seed: int = 1) -> SoakResult:
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
                handle_signals=False,
            )
            arm.open()
            bus.call("faults.by_chance", **shares())
            driven = drive(arm, seconds, rate)
            ask = lambda name: bus.call(f"log.watch.{name}")  # noqa: E731
            return judge(family, arm, driven, ask, bus.call("lag"))
        finally:
            chain.close()


def table(runs: list[SoakResult]) -> str:
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
    titles = ("", *(FAMILIES[run.family].title for run in runs))
    return program.markdown(titles, ((name, *values) for name, values in rows.items()))


def main(
    *,
    family: Literal["sts", "x", "p1"] | None = None,
    minutes: float = 10.0,
    rate: float = 100.0,
    seed: int = 1,
    stepped: bool = False,
) -> None:
    """Run, print the counters, and fail if a rule was broken.

    Args:
        family: Servos; default one after the other.
        minutes: Duration.
        rate: Control rate [Hz].
        seed: Random seed of the faults.
        stepped: In the emulator's time.
    """
    run = soak_stepped if stepped else soak
    families = [family] if family else list(FAMILIES)
    runs = [run(name, 60.0 * minutes, rate=rate, seed=seed) for name in families]
    print(table(runs))
    if not all(one.good for one in runs):
        sys.exit("a rule was broken: see the table")


if __name__ == "__main__":
    program.start(main)
