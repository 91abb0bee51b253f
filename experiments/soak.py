"""Soak test: control of an emulated arm for minutes while 1 % of all transactions fail.

``python -m experiments.soak [--family sts|x|p1] [--minutes 10] [--rate 100]`` runs in real time,
with the emulator in a separate process. With ``--stepped`` it runs in emulated time, as fast as the
computer allows.
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
from experiments import command_line, markdown
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


#: Names of the EEPROM register that bounds each torque limit register; they depend on the family.
CEILING = {
    "torque_limit": ("max_torque", "max_torque_limit"),
    "goal_current": ("current_limit",),
    "goal_pwm": ("pwm_limit",),
}


class Audit:
    """Callback for every bus transaction of an emulated arm: checks the rules for a host.

    The rules forbid, for example, torque on before a goal. The emulator calls this object as
    `log.watch`.

    Args:
        bus: The emulator.
        machine: True records times by the system clock instead of the emulated time.

    Attributes:
        broken: Number of violations of each rule by name.
        faults: Number of injected faults of each kind.
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

    def __call__(self, transaction: Transaction) -> None:
        """Check and count one transaction; record true positions and sent torque limits."""
        self.transactions += 1
        for fault in transaction.faults:
            self.faults[fault.partition(" ")[0]] += 1
        if "read" in transaction.instruction:
            now = time.perf_counter() if self._machine else transaction.time
            self._truth.extend((now, *self._bus.plant.q))
        if transaction.instruction == "sync_write":
            self._sent(transaction.request)
        for write in transaction.writes:
            self._written(write)

    def report(self) -> dict[str, dict[str, int]]:
        """Return the numbers of violations, faults and transactions so far."""
        broken = Counter(self.broken)
        broken["goal without torque on after it"] += len(self._pending)
        return {
            "broken": {rule: count for rule, count in broken.items() if count},
            "faults": dict(self.faults),
            "log": {"transactions": self.transactions},
        }

    def truth(self) -> Array:
        """Return the true joint positions at every read transaction, as an array (N, 1 + n).

        A row has the time [s] and the joint positions [rad].
        """
        return np.array(self._truth).reshape(-1, 1 + self._bus.plant.n)

    def limits(self) -> dict[int, list[float]]:
        """Return the torque limits [N·m] of all sync writes in order, by servo id.

        Limits in packets that servos did not receive are included.
        """
        return {id: [self.torque(id, v) for v in sent] for id, sent in self._limits.items()}

    def units(self) -> dict[int, float]:
        """Return the torque of one count of the limit register [N·m], by servo id."""
        return {id: self.torque(id, 1) for id in self._servos}

    def torque(self, id: int, register: int) -> float:
        """Return the torque limit at standstill [N·m] for a value of the limit register.

        Args:
            id: Id of the servo.
            register: Value of the register that limits the servo's torque.

        Returns:
            Torque limit from the emulator's data of the servo, independent of the driver's.
        """
        servo = self._servos[id]
        if "goal_current" in servo.table:
            return register * servo.model.current_unit * servo.model.motor.torque_per_amp
        full = {"dxl1": 1023, "sts": 1000, "x": 885}[servo.model.family]
        return servo.stall * register / full

    def _sent(self, request: bytes) -> None:
        """Record the torque limits in a sync write, whether or not servos received it."""
        for frame in Framer().feed(request):
            width = 2 if frame.protocol == 2 else 1
            start = int.from_bytes(frame.params[:width], "little")
            size = int.from_bytes(frame.params[width : 2 * width], "little")
            payload = frame.params[2 * width :]
            for at in range(0, len(payload), 1 + size):
                servo = self._servos[payload[at]]
                data = payload[at + 1 : at + 1 + size]
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
        """Check a write that a servo received, and count violations of the rules.

        Before torque on, a limit and then a goal must be written. A goal while torque is off must
        be followed by torque on. EEPROM must not be written, and no write may be refused.
        """
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
    """Return the name of the register that limits the torque of a servo."""
    return next(n for n in ("torque_limit", "goal_current", "goal_pwm") if n in servo.table)


# --- Run and evaluation of the soak test ---

#: Share of transactions with a fault; all kinds of fault are equally likely.
SHARE = 0.01
#: Amplitude [m] and period [s] of the target's motion along each axis.
SWING, PERIODS = {"x": 0.04, "y": 0.06, "z": 0.04}, {"x": 3.1, "y": 4.3, "z": 3.7}
#: Allowed relative difference of torque limits computed from the emulator's and the driver's data.
STALL_TOLERANCE = 0.001
#: Allowed distance of a reading from the true position [encoder counts]: half a count of rounding,
#: half a count because emulator and driver assume ranges of 251° and 250.92° for the EX-106+, and a
#: margin.
ROUNDING = 1.2
#: Largest age of the positions from which a command is computed [s], as `Loop` allows.
MAX_AGE = 0.1
#: Timeouts that are long enough for a busy computer [s]: minimum time that the driver waits for a
#: reply, `comm_timeout` of the arm, and bus watchdog of the servos.
PATIENCE, COMM_TIMEOUT, WATCHDOG = 0.05, 20.0, 2.0


class Recorder(ServoBus):
    """Servo bus that records its readings and commands.

    Attributes:
        readings: Positions that the bus returned as valid, as tuples of joint index, angle [rad],
            and start and end time of the reading [s].
        asked: Torque limits (n,) [N·m] of all commands, in order.
        ceilings: Largest torque limits (n,) [N·m] that the servos accept, stored by `enable`.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Start with an empty record."""
        super().__init__(*args, **kwargs)
        self.readings: list[tuple[int, float, float, float]] = []
        self.asked: list[Array] = []
        self.ceilings = np.zeros(self.n)

    def read(self) -> JointReadings:
        """Read all joints and record the valid positions."""
        sample = super().read()
        now = time.perf_counter() if self.clock is None else self.clock.now()
        times = np.broadcast_to(sample.time, self.n)
        self.readings += [
            (i, float(sample.position[i]), float(times[i]), now)
            for i in np.flatnonzero(sample.ok).tolist()
        ]
        return sample

    def write(self, goal: ArrayLike, limit: ArrayLike, velocity: ArrayLike | None = None) -> None:
        """Record the torque limits of a command, then write it."""
        self.asked.append(np.array(limit, dtype=np.float64))
        super().write(goal, limit, velocity)

    def enable(self, goal: ArrayLike, limit: ArrayLike, lead: ArrayLike | None = None) -> None:
        """Record the torque limits, then switch torque on."""
        self.asked.append(np.array(limit, dtype=np.float64))
        self.ceilings = np.array(self.servos.max_torque)
        super().enable(goal, limit, lead)


@dataclass(frozen=True, kw_only=True)
class SoakResult:
    """Result of a soak test.

    Attributes:
        family: Servo family.
        seconds: Duration of the control loop [s].
        ended: Error that ended the loop early; empty if none did.
        loop: Counters of the loop.
        bus: Counters of bus and arm.
        struck: Number of injected faults of each kind.
        broken: Number of violations of each rule of `Audit` by name; empty if there are none.
        late: Number of valid readings that differ by more than `ROUNDING` from all true positions
            between request and reply: replies to an earlier request.
        stale: Number of `late` readings that also differ from all true positions in the `MAX_AGE`
            before the reply.
        furthest: Largest distance of a reading from the true positions between request and reply,
            or in the `MAX_AGE` before the reply for a `late` reading [counts].
        telling: Share of the readings of the control loop that would count as `late` if they were
            three cycles old. It shows how sensitive the comparison is.
        positions: Number of compared readings.
        limits: Number of torque limits compared with the requested ones.
        off: Largest difference between a sent and the requested torque limit, beyond
            `STALL_TOLERANCE` [register counts].
        above: Number of sent torque limits above the requested ones.
        lateness: Delays of the starts of the loop's ticks, as text.
        lag: Time that the emulator dropped because the computer was too slow [s].
        load: Load averages of the computer at the end, as `os.getloadavg`.
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
        """Share of the deadlines that the loop skipped [%]."""
        ticks, missed = self.loop["ticks"], self.loop["missed"]
        return 100.0 * missed / max(ticks + missed, 1)

    @property
    def good(self) -> bool:
        """True if the run ended without error or violated rule, with correct data.

        A position is correct if it is a true one of the last `MAX_AGE` before its reply, a sent
        torque limit if it is the requested one or one count less.
        """
        return not (self.ended or self.broken or self.stale or self.above) and self.off <= 1.0


def stale(readings: list[tuple[int, float, float, float]], truth: Array, count: Array) -> Array:
    """Return the distance of each reading from the true positions between request and reply.

    Args:
        readings: Readings, as in `Recorder.readings`.
        truth: True positions, from `Audit.truth`.
        count: Angle of an encoder count of each joint [rad].

    Returns:
        Distance of each reading from the range of the true positions [counts]; infinite for a
        reading without a true position in its time.
    """
    times = truth[:, 0]
    out = np.zeros(len(readings))
    for k, (joint, angle, begin, end) in enumerate(readings):
        first = max(int(np.searchsorted(times, begin - 1e-9)), 0)
        last = int(np.searchsorted(times, end + 1e-9, side="right"))
        positions = truth[first:last, 1 + joint]
        if positions.size == 0:
            out[k] = np.inf
            continue
        out[k] = (
            max(float(positions.min()) - angle, angle - float(positions.max()), 0.0) / count[joint]
        )
    return out


def drive(arm: Arm, seconds: float, rate: float) -> tuple[Loop, str, float]:
    """Enable the arm, follow a moving target with a compliant y axis, and switch torque off.

    Args:
        arm: The arm.
        seconds: Duration of the motion [s].
        rate: Control rate [Hz].

    Returns:
        The control loop, the text of the error that ended it ("" if none did), and the time at
        which the loop began [s].
    """
    settings = pliant.Settings.soft("y").replace(rate=rate)
    error_text = ""
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
        error_text = str(error)
    try:
        arm.disable_torque()
    except pliant.PliantError as error:
        error_text = f"{error_text} {error}".strip()
    return loop, error_text, begin


def judge(
    family: str,
    arm: Arm,
    run_result: tuple[Loop, str, float],
    ask: Callable[[str], Any],
    lag: float,
) -> SoakResult:
    """Evaluate a run from the records of the host and of the emulator.

    Args:
        family: Servo family.
        arm: The arm, whose drive is a `Recorder`.
        run_result: Result of `drive`.
        ask: Function that calls the method of the emulator's `Audit` with this name.
        lag: Time that the emulator dropped because the computer was too slow [s].
    """
    (loop, error_text, start), chain = run_result, arm.drive
    assert isinstance(chain, Recorder)
    report, truth = ask("report"), ask("truth")
    count = np.array(
        [2.0 * np.pi / spec.row.counts_per_turn / spec.gear_ratio for spec in chain.specs]
    )
    distance = stale(chain.readings, truth, count)
    earlier = [(i, q, min(begin, end - MAX_AGE), end) for i, q, begin, end in chain.readings]
    distance_in_age = np.where(distance > ROUNDING, stale(earlier, truth, count), distance)
    shift = 3.0 * loop.period
    # Omit the readings during `enable`: an arm at rest has the same position as three cycles ago.
    shifted = [
        (i, q, begin + shift, end + shift) for i, q, begin, end in chain.readings if begin >= start
    ]
    sent_limits, unit = ask("limits"), ask("units")
    ids = [spec.id for spec in chain.specs]
    requested = np.minimum(np.array(chain.asked), chain.ceilings)
    if any(len(sent_limits[id]) != len(requested) for id in ids):
        counts = [len(sent_limits[id]) for id in ids]
        raise AssertionError(f"{len(requested)} limits were asked for, on the wire were {counts}")
    wire = np.array([sent_limits[id] for id in ids]).T
    room = STALL_TOLERANCE * requested
    step = np.array([unit[id] for id in ids])
    excess = np.maximum(np.abs(requested - wire) - room, 0.0) / step
    return SoakResult(
        family=family,
        seconds=len(loop.lateness) * loop.period,
        ended=error_text,
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
        late=int((distance > ROUNDING).sum()),
        stale=int((distance_in_age > ROUNDING).sum()),
        furthest=float(distance_in_age.max()),
        telling=float((stale(shifted, truth, count) > ROUNDING).mean()),
        positions=len(distance),
        limits=excess.size,
        off=float(excess.max()),
        above=int((wire - requested > room + 1e-9).sum()),
        lateness=str(loop.lateness),
        lag=lag,
    )


def shares(share: float = SHARE) -> dict[str, float]:
    """Return for each kind of fault the share of transactions with it; their sum is `share`."""
    return dict.fromkeys(KINDS, share / len(KINDS))


def soak_stepped(family: str, seconds: float, *, rate: float = 100.0, seed: int = 1) -> SoakResult:
    """Run the soak test in emulated time, with the emulator in this process."""
    faults = Faults(seed=seed)
    options = {"rate": rate, "comm_timeout": COMM_TIMEOUT}
    with stepped(family, chain=Recorder, arm=options, faults=faults, log=10) as (bus, arm):
        audit = Audit(bus, machine=False)
        arm.open()
        bus.log.watch = audit
        faults.by_chance(**shares())
        run_result = drive(arm, seconds, rate)
        return judge(family, arm, run_result, lambda name: getattr(audit, name)(), bus.lag)


def audited_emulator(family: str, seed: int) -> ArmEmulator:
    """Return the emulator of a soak test in real time, whose log calls an `Audit`."""
    bus = emulator(family, faults=Faults(seed=seed), log=10)
    bus.log.watch = Audit(bus, machine=True)
    return bus


def soak(family: str, seconds: float, *, rate: float = 100.0, seed: int = 1) -> SoakResult:
    """Run the soak test in real time, with the emulator in a separate process."""
    arm_config = configuration(family)
    with EmulatorProcess(audited_emulator, family, seed) as bus:
        chain = Recorder(
            factory.servo_specs(arm_config, bus.ports), rate=rate, reply_timeout_min=PATIENCE
        )
        try:
            arm = Arm(
                arm_config.model(),
                chain,
                rate=rate,
                comm_timeout=COMM_TIMEOUT,
                watchdog=WATCHDOG,
                handle_signals=False,
            )
            arm.open()
            bus.call("faults.by_chance", **shares())
            run_result = drive(arm, seconds, rate)
            ask = lambda name: bus.call(f"log.watch.{name}")  # noqa: E731
            return judge(family, arm, run_result, ask, bus.call("lag"))
        finally:
            chain.close()


def table(runs: list[SoakResult]) -> str:
    """Return the counters as a Markdown table with one column per run."""
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
    return markdown.table(titles, ((name, *values) for name, values in rows.items()))


def main(
    *,
    family: Literal["sts", "x", "p1"] | None = None,
    minutes: float = 10.0,
    rate: float = 100.0,
    seed: int = 1,
    stepped: bool = False,
) -> None:
    """Run the soak test and print the counters; exit with an error if a run was not `good`.

    Args:
        family: Servo family; default: all, one after the other.
        minutes: Duration in minutes.
        rate: Control rate [Hz].
        seed: Random seed of the faults.
        stepped: True runs in emulated time.
    """
    run = soak_stepped if stepped else soak
    families = [family] if family else list(FAMILIES)
    runs = [run(name, 60.0 * minutes, rate=rate, seed=seed) for name in families]
    print(table(runs))
    if not all(one.good for one in runs):
        sys.exit("a rule was broken: see the table")


if __name__ == "__main__":
    command_line.start(main)
