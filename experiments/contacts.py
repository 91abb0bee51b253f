"""Contact detection without force sensors: latency, missed contacts, false alarms.

``python -m experiments.contacts`` lets a hand of random stiffness and speed meet the tool 1000
times in random poses, and lets the arm move freely for one hour, both at 100 Hz, with flickering
encoder counts and friction assumed wrong by up to 30 %. Other cases (everything known, k_p off,
identified gears, servos that report their load, a small arm) get a quarter of that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import pliant
from experiments import program
from experiments.arms import load
from experiments.campaign import REAL_GEARS
from experiments.runner import run_jobs
from experiments.simulation import scaled
from pliant.robots import COUNT_12_BIT
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from experiments.arms import Arm
    from experiments.poses import Array
    from pliant.sim.ground_truth import GroundTruth


RATE = 100.0
#: Start and duration of a hand's contact [s].
COMES, STAYS = 0.7, 0.8
#: Random contacts: stiffness [N/m], speed [m/s] and largest force [N] of the hand, speed of the arm
#: [m/s]; the first two are drawn by their logarithms.
STIFFNESS, SPEED, FORCE, MOTION = (200.0, 20e3), (0.02, 0.25), (0.15, 0.9), (0.0, 0.15)
#: Free motion: largest distance of the joints from a middle pose [rad], time from point to point
#: [s].
WANDER, LEG = 0.45, (1.2, 3.0)
#: Share of legs after which the arm rests for half a second.
RESTS = 0.3


@dataclass(frozen=True)
class Case:
    """Errors of the controller's assumptions, and the part of them that the estimator knows.

    Attributes:
        name: Name in tables.
        arm: Name of the arm.
        encoder: True if readings have counts that flicker.
        friction: Share by which assumed friction and damping are off, at random by joint.
        kp: Share by which assumed k_p is off, at random by joint.
        gears: True if friction depends on speed and load.
        identified: True if the controller knows the gears' friction by speed and load.
        sensed: True if servos report their load, 10 % off at most and with 1 % of noise.
        delay: Known delay of readings and commands [ticks].
        told: Further options of `pliant.ContactEstimator`.
    """

    name: str
    arm: str = "arm7"
    encoder: bool = True
    friction: float = 0.3
    kp: float = 0.0
    gears: bool = False
    identified: bool = False
    sensed: bool = False
    delay: tuple[int, int] = (0, 0)
    told: Mapping[str, Any] = field(default_factory=dict)

    def options(self) -> dict[str, Any]:
        """Return the options of the estimator: known errors, in shares."""
        known = {"kp_error": max(self.kp, 0.02), "gravity_error": 0.02, "load_error": 0.1}
        return {"friction_error": max(self.friction, 0.05), **known, **self.told}


@dataclass(frozen=True)
class Record:
    """One run, one row per reading.

    Attributes:
        felt: Estimated force (N, 3) [N] and torque (N, 3) [N·m], base axes: (N, 6).
        bound: Its uncertainty (N, 6).
        truth: True force in the period before the reading (N, 6).
        evidence: Largest residual of a joint over its bound (N,).
    """

    felt: Array
    bound: Array
    truth: Array
    evidence: Array


class Bump:
    """A hand that meets the tool at its present position and continues behind a spring.

    ``f = clip(stiffness (speed (t - t0) - shift since t0), 0, limit)`` along a direction: it pushes
    and never pulls.
    """

    at = "tool"

    def __init__(self, direction: Array, stiffness: float, speed: float, limit: float) -> None:
        """Direction (3,) in base axes, stiffness [N/m], speed [m/s], largest force [N]."""
        self.direction, self.stiffness, self.speed, self.limit = direction, stiffness, speed, limit
        self._met: Array | None = None

    def force(self, ground_truth: GroundTruth, t: float) -> tuple[Array, Array, Array]:
        """The push at the tool."""
        place, none = ground_truth.frame("tool").position, np.zeros(3)
        if not COMES <= t < COMES + STAYS:
            return none, none, place
        if self._met is None:
            self._met = place.copy()
        deep = self.speed * (t - COMES) - float(self.direction @ (place - self._met))
        return min(max(self.stiffness * deep, 0.0), self.limit) * self.direction, none, place


class Bench:
    """Runs of one arm in one case; the run's number is the random seed."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.arm: Arm = load(case.arm)

    @cached_property
    def poses(self) -> Array:
        """Return poses (N, n) [rad], none near a singular one or a stop."""
        low, high = np.asarray(self.arm.model.lower), np.asarray(self.arm.model.upper)
        room = 0.5 if self.arm.model.n > 5 else 0.3
        found = self.arm.poses(len(self.arm.drawn))
        clear: Array = found[((found > low + room) & (found < high - room)).all(axis=1)]
        held = [self.arm.capacity(q, 2, -1.0) > 0.3 * self.arm.median_capacity[0] for q in clear]
        poses: Array = clear[np.array(held)]
        return poses

    def contact(self, number: int) -> Record:
        """Run one random contact."""
        rng = np.random.default_rng((number, 1))
        q = self.poses[number % len(self.poses)]
        direction, way = _direction(rng), _direction(rng)
        most = rng.uniform(*FORCE) * 0.45 * self.arm.median_capacity[0]
        hand = Bump(direction, _log(rng, STIFFNESS), _log(rng, SPEED), most)
        speed = rng.uniform(*MOTION) if rng.random() < 0.5 else 0.0
        pose = self.arm.model.forward_kinematics(q)

        def target(t: float) -> Array:
            moved = pose.copy()
            moved[:3, 3] += way * speed * max(t - 0.2, 0.0)
            return moved

        plant, controller, contact = self._make(rng, (hand,))
        return self._run(plant, controller, contact, q, target, seconds=COMES + STAYS, rng=rng)

    def free(self, number: int, seconds: float) -> Record:
        """Run free motion from point to point, smooth, with rests."""
        rng = np.random.default_rng((number, 2))
        q = self.poses[number % len(self.poses)]
        path = _Path(rng, q, np.asarray(self.arm.model.lower), np.asarray(self.arm.model.upper))
        plant, controller, contact = self._make(rng, ())
        kinematics = self.arm.model.forward_kinematics

        def target(t: float) -> Array:
            pose: Array = kinematics(path(t))
            return pose

        return self._run(plant, controller, contact, q, target, seconds=seconds, rng=rng)

    def _make(
        self, rng: np.random.Generator, hands: tuple[Bump, ...]
    ) -> tuple[Plant, pliant.Controller, pliant.ContactEstimator]:
        """Make plant, controller and estimator of one run."""
        case, true = self.case, self.arm.servos
        n = self.arm.model.n

        def off(share: float) -> Array:
            return rng.uniform(1.0 - share, 1.0 + share, n)

        count = COUNT_12_BIT if case.encoder else 0.0
        table = REAL_GEARS[case.arm].assumed(true) if case.identified else true
        # Drawn in this order: friction, damping, k_p.
        assumed = scaled(table, off(case.friction), off(case.friction)).replace(
            kp=off(case.kp) * np.asarray(table.kp), encoder_step=count
        )
        task, delay = " ".join(self.arm.axes), sum(case.delay) / RATE
        settings = pliant.Settings(task=task, rate=RATE, delay=delay)
        controller = pliant.Controller(self.arm.model, settings, assumed)
        options: dict[str, Any] = {
            "rate": RATE,
            "delay": case.delay,
            "encoder_step": count,
            "encoder_flicker": int(case.encoder),
        }
        if case.gears:
            options["friction"] = REAL_GEARS[case.arm]
        seed = int(rng.integers(2**31))
        plant = Plant(self.arm.model, true, scene=hands, seed=seed, **options)
        return plant, controller, pliant.ContactEstimator(controller, **case.options())

    def _run(
        self,
        plant: Plant,
        controller: pliant.Controller,
        contact: pliant.ContactEstimator,
        q: Array,
        target: Any,
        *,
        seconds: float,
        rng: np.random.Generator,
    ) -> Record:
        """Close the loop and record the estimate."""
        plant.reset(q)
        controller.reset(q)
        count = round(seconds * RATE)
        felt, bound, truth = (np.zeros((count, 6)) for _ in range(3))
        evidence = np.zeros(count)
        usable = np.asarray(self.arm.servos.max_torque)
        gain = rng.uniform(0.9, 1.1, usable.size)
        for tick in range(count):
            reading = plant.read().q
            load = None
            if self.case.sensed and tick > 0:
                load = gain * plant.torque + 0.01 * usable * rng.standard_normal(usable.size)
            found = contact.update(reading, load=load)
            felt[tick], bound[tick] = found.force_base, found.uncertainty_base
            evidence[tick] = found.residual_ratio
            if plant.hands:
                truth[tick, :3] = plant.hands[0].force
            command = controller.step(reading, target(tick / RATE))
            plant.write(command.goal, command.torque_limit)
            plant.advance()
        return Record(felt, bound, truth, evidence)


class _Path:
    """Joint motion from point to point with minimum jerk, with random rests."""

    def __init__(self, rng: np.random.Generator, middle: Array, low: Array, high: Array) -> None:
        self._rng, self._middle = rng, middle
        self._low, self._high = low + 0.3, high - 0.3
        self._begin, self._end, self._from, self._to = 0.0, 0.5, middle, middle

    def __call__(self, t: float) -> Array:
        if t >= self._end:
            self._begin, self._from = self._end, self._to
            wish = self._middle + self._rng.uniform(-WANDER, WANDER, self._middle.size)
            self._to = np.clip(wish, self._low, self._high)
            self._end += self._rng.uniform(*LEG)
            if self._rng.random() < RESTS:
                self._to, self._end = self._from, self._begin + 0.5
        s = (t - self._begin) / (self._end - self._begin)
        smooth = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        where: Array = self._from + smooth * (self._to - self._from)
        return where


def _direction(rng: np.random.Generator) -> Array:
    """Return a random direction (3,)."""
    vector = rng.standard_normal(3)
    unit: Array = vector / np.linalg.norm(vector)
    return unit


def _log(rng: np.random.Generator, span: tuple[float, float]) -> float:
    """Return a random number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(*np.log(span))))


# --- Detection of recorded contacts by thresholds: detections, false alarms, latency ---

#: Consecutive readings beyond a threshold that make a contact: the last is 20 ms after the first.
READINGS = 3
#: A contact is strong if its true force exceeds this share of the median static capacity, for this
#: number of readings.
STRONG_FORCE, STRONG = 0.15, 10
#: Number of readings skipped at the start of a run, while the estimate settles.
START = 30
#: First reading that can include the hand.
FIRST = round(COMES * RATE) + 1
#: Thresholds as shares of the arm's median static capacity.
SHARES = (0.03, 0.05, 0.075, 0.10, 0.125, 0.15, 0.20, 0.25, 0.30, 0.40)


#: Sizes of rules `guarded` (share of the uncertainty) and `evidence` (share of the joints' bounds).
GUARDS, EVIDENCE = (0.4, 0.5, 0.6, 0.8, 1.0), (0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5)


@dataclass(frozen=True)
class Rule:
    """A rule for detecting contacts.

    Attributes:
        kind: `force`: |F| on x, y or z above `size` [N]; `guarded`: above `size` times its
            uncertainty; `evidence`: some joint above `size` times its bound.
        size: See `kind`.
    """

    kind: Literal["force", "guarded", "evidence"]
    size: float

    def beyond(self, record: Record) -> NDArray[np.bool_]:
        """Return where the rule holds: (N, 3), or (N, 1) for `evidence`."""
        out: NDArray[np.bool_]
        if self.kind == "evidence":
            out = (record.evidence > self.size)[:, None]
        else:
            scale = record.bound[:, :3] if self.kind == "guarded" else 1.0
            out = np.abs(record.felt[:, :3]) > self.size * scale
        out[:START] = False
        return out

    def __str__(self) -> str:
        text = {"force": "force > {:.3g} N", "guarded": "force > {:.2g} × bound"}
        return text.get(self.kind, "evidence > {:.3g}").format(self.size)


@dataclass(frozen=True)
class Seen:
    """Result of one rule in one case.

    Attributes:
        case: Name of the case.
        rule: The rule.
        alarms: False alarms in free motion, and the duration in hours.
        hours: See `alarms`.
        strong: Contacts whose true force exceeded `STRONG_FORCE` of the capacity for 0.1 s.
        missed: Share of these that were not detected.
        seen: Share of all contacts that were detected.
        late: Median and 95th percentile of the time [s] from the true force being that strong to
            the event; an earlier event counts as 0.
        after: The same from the first touch.
        force: Median of the true force at the event [N].
    """

    case: str
    rule: Rule
    alarms: int
    hours: float
    strong: int
    missed: float
    seen: float
    late: tuple[float, float]
    after: tuple[float, float]
    force: float


def events(beyond: NDArray[np.bool_]) -> list[int]:
    """Return readings at which a row of booleans (N,) has been true for long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], beyond.astype(np.int8), [0]))))
    stretches = zip(edges[::2], edges[1::2], strict=True)
    return [int(a) + READINGS - 1 for a, b in stretches if b - a >= READINGS]


def first(felt: NDArray[np.bool_]) -> int | None:
    """Return the reading (N, 3) that first detects the hand, None if never."""
    found = [e for column in felt[FIRST:].T for e in events(column)]
    return FIRST + min(found) if found else None


def least_silent(free: Sequence[Record], columns: slice) -> float:
    """Return the smallest threshold without alarm in free motion, on these columns [N or N·m]."""
    most = 0.0
    for record in free:
        force = np.abs(record.felt[START:, columns])
        lasting = np.lib.stride_tricks.sliding_window_view(force, READINGS, axis=0).min(axis=-1)
        most = max(most, float(lasting.max()))
    return most


def look(
    case: str, rule: Rule, strength: float, free: Sequence[Record], contacts: Sequence[Record]
) -> Seen:
    """Evaluate one rule; `strength` [N] defines a strong contact."""
    late: list[float] = []
    after: list[float] = []
    force: list[float] = []
    strong = missed = seen = 0
    for record in contacts:
        true = np.abs(record.truth[:, :3])
        is_strong = bool(((true > strength).sum(axis=0) >= STRONG).any())
        found = first(rule.beyond(record))
        strong += is_strong
        missed += is_strong and found is None
        if found is not None:
            seen += 1
            after.append((found - FIRST + 1) / RATE)
            force.append(float(true[found].max()))
            if is_strong:
                passed = int(np.flatnonzero((true > strength).any(axis=1))[0])
                late.append(max(found - passed, 0) / RATE)
    return Seen(
        case=case,
        rule=rule,
        alarms=sum(len(events(c)) for record in free for c in rule.beyond(record).T),
        hours=sum(len(record.felt) for record in free) / RATE / 3600.0,
        strong=strong,
        missed=missed / max(strong, 1),
        seen=seen / max(len(contacts), 1),
        late=_quantiles(late),
        after=_quantiles(after),
        force=float(np.median(force)) if force else float("nan"),
    )


def honesty(free: Sequence[Record], contacts: Sequence[Record]) -> dict[str, float]:
    """Return errors [N], bounds [N], and the share of readings whose error exceeds its bound."""
    out = {}
    for name, records in (("free", free), ("contact", contacts)):
        error = np.concatenate([(r.felt - r.truth)[START:, :3] for r in records])
        bound = np.concatenate([r.bound[START:, :3] for r in records])
        out[f"{name} rms"] = float(np.sqrt((error**2).mean()))
        out[f"{name} bound"] = float(np.median(bound))
        out[f"{name} beyond"] = float((np.abs(error) > bound).mean())
    return out


def _quantiles(values: Sequence[float]) -> tuple[float, float]:
    if not values:
        return float("nan"), float("nan")
    middle, high = np.quantile(values, (0.5, 0.95))
    return float(middle), float(high)


def text(rows: Sequence[Seen]) -> str:
    """Return the table of rules, as Markdown."""
    columns = (
        *("case", "event", "false alarms", "in [h]", "seen %", "strong contacts", "missed %"),
        *("after strong [ms]: median", "95th", "after the touch: median", "95th"),
        "force then [N]",
    )
    lines = []
    for r in rows:
        cells = [r.case, str(r.rule), str(r.alarms), f"{r.hours:.2g}", f"{100 * r.seen:.1f}"]
        cells += [str(r.strong), f"{100 * r.missed:.1f}"]
        cells += [f"{1e3 * value:.0f}" for value in (*r.late, *r.after)] + [f"{r.force:.1f}"]
        lines.append(cells)
    return program.markdown(columns, lines)


def draw(folder: Path, rows: Sequence[Seen]) -> None:
    """Draw `contacts.png`: false alarms against detected contacts, by case and rule."""
    from pliant._report import style

    cases = list(dict.fromkeys(row.case for row in rows))
    across = min(len(cases), 4)
    down = -(-len(cases) // across)
    looks = {
        "force": ("threshold [N]", style.ORANGE),
        "guarded": ("share of the bound", style.BLUE),
        "evidence": ("share of a joint's bound", style.GREEN),
    }
    with style.canvas(down, across, size=(style.WIDE, 3.1 * down)) as (figure, axes):
        panels = [ax for line in axes for ax in line]
        for ax in panels[len(cases) :]:
            ax.set_visible(False)
        for ax, case in zip(panels, cases, strict=False):
            for kind, (label, colour) in looks.items():
                mine = sorted(
                    (row for row in rows if row.case == case and row.rule.kind == kind),
                    key=lambda row: row.rule.size,
                )
                # The axis is logarithmic: zero alarms are drawn as half an alarm in the same time.
                rate = [max(row.alarms, 0.5) / row.hours for row in mine]
                seen = [100.0 * row.seen for row in mine]
                ax.plot(rate, seen, "o-", color=colour, markersize=3, linewidth=1.2, label=label)
            ax.set_xscale("log")
            ax.set_ylim(0.0, 102.0)
            ax.set_title(case, fontsize=8)
            ax.set_xlabel("false alarms per h (leftmost: none)")
        panels[0].set_ylabel("contacts seen [%]")
        panels[0].legend(fontsize=7, loc="lower right")
        style.save(figure, folder, "contacts")


# --- The program ---

#: The case of the documented numbers; the other cases follow.
MAIN = Case("encoder, friction ±30 %")
OTHERS = (
    Case("a tick each way", delay=(1, 1)),
    Case("all known", encoder=False, friction=0.0),
    Case("and k_p ±10 %", kp=0.1),
    Case("gears as they are", gears=True),
    Case("load reported", sensed=True),
    Case("load reported, gears as they are", sensed=True, gears=True),
    Case("gears as they are, told so", gears=True, told={"friction_error": 2.0}),
    Case("gears as they are, identified ±30 %", gears=True, identified=True),
    Case("so101", arm="so101"),
)
#: Length of a free run [s].
PIECE = 60.0


@dataclass(frozen=True)
class Job:
    """One run."""

    case: Case
    number: int
    seconds: float | None = None

    def run(self) -> Record:
        """Run it and return its record."""
        bench = Bench(self.case)
        if self.seconds is None:
            return bench.contact(self.number)
        return bench.free(self.number, self.seconds)


def measure(
    case: Case, contacts: int, minutes: int, processes: int = 1, piece: float = PIECE
) -> tuple[list[Seen], dict[str, float]]:
    """Run one case and evaluate every threshold.

    Args:
        case: The case.
        contacts: Number of random contacts.
        minutes: Duration of free motion.
        processes: Number of processes.
        piece: Length of one free run [s].

    Returns:
        A row per rule; errors, bounds and the thresholds without alarms.
    """
    pieces = round(60.0 * minutes / piece)
    free = list(run_jobs([Job(case, i, piece) for i in range(pieces)], processes, case.name))
    met = list(run_jobs([Job(case, i) for i in range(contacts)], processes, case.name))
    capacity = Bench(case).arm.median_capacity[0]
    silent = least_silent(free, slice(0, 3))
    sizes = sorted([*(float(f"{share * capacity:.2g}") for share in SHARES), silent])
    rules = [Rule("force", size) for size in sizes]
    rules += [Rule("guarded", share) for share in GUARDS]
    rules += [Rule("evidence", share) for share in EVIDENCE]
    strength = STRONG_FORCE * capacity
    rows = [look(case.name, rule, strength, free, met) for rule in rules]
    facts = honesty(free, met)
    facts["strong [N]"], facts["silent [N]"] = strength, silent
    facts["silent [N·m]"] = least_silent(free, slice(3, 6))
    return rows, facts


def main(
    *,
    contacts: int = 1000,
    minutes: int = 60,
    others: float = 0.25,
    jobs: int = 2,
    out: Path = Path("pliant-contacts"),
) -> None:
    """Measure thresholds on an estimated force.

    Args:
        contacts: Random contacts of the main case.
        minutes: Free motion of the main case.
        others: Share of both for each other case; 0: leave them out.
        jobs: Number of processes.
        out: Folder for results.json and the picture.
    """
    rows: list[Seen] = []
    facts: dict[str, dict[str, float]] = {}
    plan: Iterable[tuple[Case, float]] = [(MAIN, 1.0), *((case, others) for case in OTHERS)]
    for case, share in plan:
        number, duration = round(share * contacts), round(share * minutes)
        if min(number, duration) < 1:
            continue
        found, facts[case.name] = measure(case, number, duration, jobs)
        print(text(found), flush=True)
        print({name: round(value, 4) for name, value in facts[case.name].items()}, flush=True)
        rows += found
    about = {"contacts": contacts, "minutes": minutes, "facts": facts}
    program.write_results(out, {**about, "rows": [asdict(row) for row in rows]})
    draw(out, rows)
    print(f"contacts: {out / 'results.json'}, {out / 'contacts.png'}")


if __name__ == "__main__":
    program.start(main)
