"""Contact detection without force sensors: latency, missed contacts, false alarms.

``python -m experiments.contacts`` simulates 1000 contacts of `arm7` with a hand of random stiffness
and speed in random poses, and one hour of motion without contact, at 100 Hz. Encoder counts
flicker, and the assumed friction is wrong by up to 30 %. Other cases (no errors, wrong k_p,
identified gears, servos that report their load, a small arm) get a quarter of the runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import pliant
from experiments import command_line, markdown
from experiments.arms import load
from experiments.campaign import REAL_GEARS
from experiments.results import write_results
from experiments.runner import run_jobs
from experiments.simulation import scaled
from pliant.robots import COUNT_12_BIT
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from experiments.arms import Arm
    from experiments.poses import Array
    from pliant.sim.ground_truth import GroundTruth


RATE = 100.0
#: Start and duration of a contact [s].
CONTACT_START, CONTACT_DURATION = 0.7, 0.8
#: Ranges of random contacts: stiffness [N/m] and speed [m/s] of the hand (log-uniform); largest
#: force of the hand, divided by 0.45 times `Arm.median_capacity`, which is about the default
#: `Axis.firm` [1]; speed of the arm's target [m/s].
STIFFNESS, SPEED, FORCE, MOTION = (200.0, 20e3), (0.02, 0.25), (0.15, 0.9), (0.0, 0.15)
#: Motion without contact: largest distance of each joint from a middle pose [rad], and range of the
#: duration of a motion from point to point [s].
MOTION_RANGE, SEGMENT_TIME = 0.45, (1.2, 3.0)
#: Share of the motions from point to point that are replaced by a rest of half a second.
REST_SHARE = 0.3


@dataclass(frozen=True)
class Case:
    """Errors of the controller's assumptions, and options of the estimator.

    Attributes:
        name: Name in tables.
        arm: Name of the arm.
        encoder: True if encoder counts flicker.
        friction: Largest relative error of assumed friction and damping, random per joint.
        kp: Largest relative error of assumed k_p, random per joint.
        gears: True if the true friction depends on speed and load, as identified on real gears.
        identified: True if the controller assumes the friction of `gears`.
        sensed: True if servos report their load, with errors up to 10 % and 1 % noise.
        delay: Delay of readings and commands, known to the controller [ticks].
        estimator: Further options of `pliant.ContactEstimator`, which replace those of `options`.
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
    estimator: Mapping[str, Any] = field(default_factory=dict)

    def options(self) -> dict[str, Any]:
        """Return the options of `pliant.ContactEstimator`, with the case's largest errors."""
        errors = {"kp_error": max(self.kp, 0.02), "gravity_error": 0.02, "load_error": 0.1}
        return {"friction_error": max(self.friction, 0.05), **errors, **self.estimator}


@dataclass(frozen=True)
class Record:
    """Record of one run, with one row per reading.

    Attributes:
        wrench: Estimated force [N] and torque [N·m] on the tool in base axes (N, 6).
        bound: Uncertainty of `wrench` (N, 6).
        truth: True force and torque on the tool in the period before the reading (N, 6).
        evidence: Largest ratio of a joint's torque residual to its uncertainty (N,).
    """

    wrench: Array
    bound: Array
    truth: Array
    evidence: Array


class Bump:
    """Hand that meets the tool at its present position and moves on, with a spring in between.

    At time t, the force along the direction of motion is
    ``clip(stiffness (speed (t - t0) - shift), 0, limit)``, with the displacement `shift` of the
    tool along this direction since the start t0 of the contact. The hand never pulls.
    """

    at = "tool"

    def __init__(self, direction: Array, stiffness: float, speed: float, limit: float) -> None:
        """Set direction (3,) in base axes, stiffness [N/m], speed [m/s], largest force [N]."""
        self.direction, self.stiffness, self.speed, self.limit = direction, stiffness, speed, limit
        self._met: Array | None = None

    def force(self, ground_truth: GroundTruth, t: float) -> tuple[Array, Array, Array]:
        """Return force, torque and point of application, as `pliant.sim.Hand` defines them."""
        position, no_torque = ground_truth.frame("tool").position, np.zeros(3)
        if not CONTACT_START <= t < CONTACT_START + CONTACT_DURATION:
            return no_torque, no_torque, position
        if self._met is None:
            self._met = position.copy()
        shift = float(self.direction @ (position - self._met))
        compression = self.speed * (t - CONTACT_START) - shift
        return (
            min(max(self.stiffness * compression, 0.0), self.limit) * self.direction,
            no_torque,
            position,
        )


class Bench:
    """Simulated runs of one arm in one `Case`; the number of a run is its random seed."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.arm: Arm = load(case.arm)

    @cached_property
    def poses(self) -> Array:
        """Return random poses (N, n) [rad] away from singularities and joint stops.

        In all of them the servos hold an additional load at the tool.
        """
        low, high = np.asarray(self.arm.model.lower), np.asarray(self.arm.model.upper)
        room = 0.5 if self.arm.model.n > 5 else 0.3
        candidates = self.arm.poses(len(self.arm.drawn))
        away_from_stops: Array = candidates[
            ((candidates > low + room) & (candidates < high - room)).all(axis=1)
        ]
        is_held = [
            self.arm.capacity(q, 2, -1.0) > 0.3 * self.arm.median_capacity[0]
            for q in away_from_stops
        ]
        poses: Array = away_from_stops[np.array(is_held)]
        return poses

    def contact(self, number: int) -> Record:
        """Run one random contact and return its record."""
        rng = np.random.default_rng((number, 1))
        q = self.poses[number % len(self.poses)]
        direction, motion = _direction(rng), _direction(rng)
        max_force = rng.uniform(*FORCE) * 0.45 * self.arm.median_capacity[0]
        hand = Bump(direction, _log(rng, STIFFNESS), _log(rng, SPEED), max_force)
        speed = rng.uniform(*MOTION) if rng.random() < 0.5 else 0.0
        pose = self.arm.model.forward_kinematics(q)

        def target(t: float) -> Array:
            moved_pose = pose.copy()
            moved_pose[:3, 3] += motion * speed * max(t - 0.2, 0.0)
            return moved_pose

        plant, controller, contact = self._make(rng, (hand,))
        return self._run(
            plant, controller, contact, q, target, seconds=CONTACT_START + CONTACT_DURATION, rng=rng
        )

    def free(self, number: int, seconds: float) -> Record:
        """Run smooth motion without contact for `seconds` [s]; return its record.

        The motion goes from one random joint position to the next, with rests.
        """
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
        """Make the simulated arm with its hands, the controller and the estimator of one run."""
        case, true = self.case, self.arm.servos
        n = self.arm.model.n

        def random_factors(share: float) -> Array:
            return rng.uniform(1.0 - share, 1.0 + share, n)

        count = COUNT_12_BIT if case.encoder else 0.0
        table = REAL_GEARS[case.arm].assumed(true) if case.identified else true
        # Keep the order of the random numbers (friction, damping, k_p): another order changes all
        # documented results.
        assumed = scaled(
            table, random_factors(case.friction), random_factors(case.friction)
        ).replace(kp=random_factors(case.kp) * np.asarray(table.kp), encoder_step=count)
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
        """Run the control loop from pose q for `seconds`; return the estimates at every tick."""
        plant.reset(q)
        controller.reset(q)
        count = round(seconds * RATE)
        wrench, bound, truth = (np.zeros((count, 6)) for _ in range(3))
        evidence = np.zeros(count)
        max_torque = np.asarray(self.arm.servos.max_torque)
        gain = rng.uniform(0.9, 1.1, max_torque.size)
        for tick in range(count):
            positions = plant.read().q
            load = None
            if self.case.sensed and tick > 0:
                load = gain * plant.torque + 0.01 * max_torque * rng.standard_normal(
                    max_torque.size
                )
            estimate = contact.update(positions, load=load)
            wrench[tick], bound[tick] = estimate.force_base, estimate.uncertainty_base
            evidence[tick] = estimate.residual_ratio
            if plant.hands:
                truth[tick, :3] = plant.hands[0].force
            command = controller.step(positions, target(tick / RATE))
            plant.write(command.goal, command.torque_limit)
            plant.advance()
        return Record(wrench, bound, truth, evidence)


class _Path:
    """Minimum-jerk joint motion between random points around a pose, with random rests.

    Calls must have increasing times [s]; each returns the joint positions (n,) [rad].
    """

    def __init__(self, rng: np.random.Generator, middle: Array, low: Array, high: Array) -> None:
        self._rng, self._middle = rng, middle
        self._low, self._high = low + 0.3, high - 0.3
        self._begin, self._end, self._from, self._to = 0.0, 0.5, middle, middle

    def __call__(self, t: float) -> Array:
        if t >= self._end:
            self._begin, self._from = self._end, self._to
            random_q = self._middle + self._rng.uniform(
                -MOTION_RANGE, MOTION_RANGE, self._middle.size
            )
            self._to = np.clip(random_q, self._low, self._high)
            self._end += self._rng.uniform(*SEGMENT_TIME)
            if self._rng.random() < REST_SHARE:
                self._to, self._end = self._from, self._begin + 0.5
        s = (t - self._begin) / (self._end - self._begin)
        smooth = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        joints: Array = self._from + smooth * (self._to - self._from)
        return joints


def _direction(rng: np.random.Generator) -> Array:
    """Return a random unit vector (3,), with all directions equally likely."""
    vector = rng.standard_normal(3)
    unit: Array = vector / np.linalg.norm(vector)
    return unit


def _log(rng: np.random.Generator, span: tuple[float, float]) -> float:
    """Return a log-uniform random number in the range `span`."""
    return float(np.exp(rng.uniform(*np.log(span))))


# --- Detection of recorded contacts by thresholds: detections, false alarms, latency ---

#: A contact is detected after this number of consecutive readings above a threshold.
READINGS = 3
#: A contact counts as strong if a component of the true force exceeds this share of the arm's
#: median static capacity during at least `STRONG_READINGS` readings.
STRONG_FORCE, STRONG_READINGS = 0.15, 10
#: Number of readings skipped at the start of a run, while the estimate settles.
START = 30
#: Index of the first reading during the contact.
FIRST = round(CONTACT_START * RATE) + 1
#: Thresholds of the rules `force`, as shares of the arm's median static capacity, see `Rule`.
SHARES = (0.03, 0.05, 0.075, 0.10, 0.125, 0.15, 0.20, 0.25, 0.30, 0.40)


#: Thresholds of the rules `guarded` and `evidence`, as ratios, see `Rule`.
GUARDS, EVIDENCE = (0.4, 0.5, 0.6, 0.8, 1.0), (0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5)


@dataclass(frozen=True)
class Rule:
    """Rule that detects contacts by a threshold.

    Attributes:
        kind: Compared quantity. `force`: a component of the estimated force exceeds `size` [N].
            `guarded`: a component exceeds `size` times its uncertainty. `evidence`: for some
            joint, the ratio of torque residual to uncertainty exceeds `size`.
        size: Threshold [N] or ratio.
    """

    kind: Literal["force", "guarded", "evidence"]
    size: float

    def beyond(self, record: Record) -> NDArray[np.bool_]:
        """Return a mask that is True for readings above the threshold.

        Its columns are the force components (N, 3); for the rule `evidence`, there is one (N, 1).
        """
        out: NDArray[np.bool_]
        if self.kind == "evidence":
            out = (record.evidence > self.size)[:, None]
        else:
            scale = record.bound[:, :3] if self.kind == "guarded" else 1.0
            out = np.abs(record.wrench[:, :3]) > self.size * scale
        out[:START] = False
        return out

    def __str__(self) -> str:
        text = {"force": "force > {:.3g} N", "guarded": "force > {:.2g} × bound"}
        return text.get(self.kind, "evidence > {:.3g}").format(self.size)


@dataclass(frozen=True)
class RuleResult:
    """Result of one rule in one case.

    Attributes:
        case: Name of the case.
        rule: The rule.
        alarms: Number of false alarms in motion without contact.
        hours: Duration of the motion without contact [h].
        strong: Number of strong contacts, as `STRONG_FORCE` defines them.
        missed: Share of strong contacts that were not detected.
        seen: Share of all contacts that were detected.
        late: Median and 95th percentile of the time from the first strong true force of a strong
            contact to its detection [s]; an earlier detection counts as 0.
        after: Median and 95th percentile of the time from the first touch to the detection [s].
        force: Median over the contacts of the largest component of the true force at the detection
            [N].
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


def events(is_above: NDArray[np.bool_]) -> list[int]:
    """Return the indices of the readings at which a mask (N,) causes a detection.

    Each stretch of at least `READINGS` true readings causes one, at its reading number `READINGS`.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([0], is_above.astype(np.int8), [0]))))
    stretches = zip(edges[::2], edges[1::2], strict=True)
    return [int(a) + READINGS - 1 for a, b in stretches if b - a >= READINGS]


def first(is_above: NDArray[np.bool_]) -> int | None:
    """Return the index of the first reading at which a column of a mask (N, k) detects a contact.

    None means that no column detects one.
    """
    detections = [e for column in is_above[FIRST:].T for e in events(column)]
    return FIRST + min(detections) if detections else None


def least_silent(free: Sequence[Record], columns: slice) -> float:
    """Return the smallest threshold that causes no false alarm in runs without contact [N or N·m].

    `columns` selects the components of the estimated force and torque.
    """
    threshold = 0.0
    for record in free:
        force = np.abs(record.wrench[START:, columns])
        lasting = np.lib.stride_tricks.sliding_window_view(force, READINGS, axis=0).min(axis=-1)
        threshold = max(threshold, float(lasting.max()))
    return threshold


def evaluate(
    case: str, rule: Rule, strength: float, free: Sequence[Record], contacts: Sequence[Record]
) -> RuleResult:
    """Return the result of one rule.

    Args:
        case: Name of the case.
        rule: The rule.
        strength: True force above which a contact counts as strong [N].
        free: Runs without contact.
        contacts: Runs with one contact each.
    """
    latencies: list[float] = []
    after: list[float] = []
    force: list[float] = []
    strong = missed_count = seen_count = 0
    for record in contacts:
        true = np.abs(record.truth[:, :3])
        is_strong = bool(((true > strength).sum(axis=0) >= STRONG_READINGS).any())
        detection = first(rule.beyond(record))
        strong += is_strong
        missed_count += is_strong and detection is None
        if detection is not None:
            seen_count += 1
            after.append((detection - FIRST + 1) / RATE)
            force.append(float(true[detection].max()))
            if is_strong:
                passed = int(np.flatnonzero((true > strength).any(axis=1))[0])
                latencies.append(max(detection - passed, 0) / RATE)
    return RuleResult(
        case=case,
        rule=rule,
        alarms=sum(len(events(c)) for record in free for c in rule.beyond(record).T),
        hours=sum(len(record.wrench) for record in free) / RATE / 3600.0,
        strong=strong,
        missed=missed_count / max(strong, 1),
        seen=seen_count / max(len(contacts), 1),
        late=_quantiles(latencies),
        after=_quantiles(after),
        force=float(np.median(force)) if force else float("nan"),
    )


def estimate_errors(free: Sequence[Record], contacts: Sequence[Record]) -> dict[str, float]:
    """Return the errors of the estimated force, without and during contacts.

    Returns:
        Rms error [N], median uncertainty [N] and share of errors above the uncertainty, over all
        components and readings.
    """
    out = {}
    for name, records in (("free", free), ("contact", contacts)):
        error = np.concatenate([(r.wrench - r.truth)[START:, :3] for r in records])
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


def text(rows: Sequence[RuleResult]) -> str:
    """Return the results as a Markdown table."""
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
    return markdown.table(columns, lines)


def draw(folder: Path, rows: Sequence[RuleResult]) -> None:
    """Plot detected contacts [%] against false alarms per hour by case and rule: `contacts.png`."""
    from pliant._report import style

    cases = list(dict.fromkeys(row.case for row in rows))
    columns = min(len(cases), 4)
    row_count = -(-len(cases) // columns)
    styles = {
        "force": ("threshold [N]", style.ORANGE),
        "guarded": ("share of the bound", style.BLUE),
        "evidence": ("share of a joint's bound", style.GREEN),
    }
    with style.canvas(row_count, columns, size=(style.WIDE, 3.1 * row_count)) as (figure, axes):
        panels = [ax for line in axes for ax in line]
        for ax in panels[len(cases) :]:
            ax.set_visible(False)
        for ax, case in zip(panels, cases, strict=False):
            for kind, (label, colour) in styles.items():
                points = sorted(
                    (row for row in rows if row.case == case and row.rule.kind == kind),
                    key=lambda row: row.rule.size,
                )
                # The axis is logarithmic, so zero alarms are drawn as half an alarm in the same
                # time.
                rate = [max(row.alarms, 0.5) / row.hours for row in points]
                detected = [100.0 * row.seen for row in points]
                ax.plot(
                    rate, detected, "o-", color=colour, markersize=3, linewidth=1.2, label=label
                )
            ax.set_xscale("log")
            ax.set_ylim(0.0, 102.0)
            ax.set_title(case, fontsize=8)
            ax.set_xlabel("false alarms per h (leftmost: none)")
        panels[0].set_ylabel("contacts seen [%]")
        panels[0].legend(fontsize=7, loc="lower right")
        style.save(figure, folder, "contacts")


# --- The program ---

#: Case whose numbers docs/contact.md reports.
MAIN = Case("encoder, friction ±30 %")
OTHERS = (
    Case("a tick each way", delay=(1, 1)),
    Case("all known", encoder=False, friction=0.0),
    Case("and k_p ±10 %", kp=0.1),
    Case("gears as they are", gears=True),
    Case("load reported", sensed=True),
    Case("load reported, gears as they are", sensed=True, gears=True),
    Case("gears as they are, told so", gears=True, estimator={"friction_error": 2.0}),
    Case("gears as they are, identified ±30 %", gears=True, identified=True),
    Case("so101", arm="so101"),
)
#: Duration of a run without contact [s].
PIECE = 60.0


@dataclass(frozen=True)
class Job:
    """One simulated run of a case, with a contact if `seconds` is None, else without.

    `number` is the random seed of the run, and `seconds` its duration.
    """

    case: Case
    number: int
    seconds: float | None = None

    def run(self) -> Record:
        """Run the simulation and return its record."""
        bench = Bench(self.case)
        if self.seconds is None:
            return bench.contact(self.number)
        return bench.free(self.number, self.seconds)


def measure(
    case: Case, contacts: int, minutes: int, processes: int = 1, piece: float = PIECE
) -> tuple[list[RuleResult], dict[str, float]]:
    """Run one case and evaluate every rule.

    Args:
        case: The case.
        contacts: Number of random contacts.
        minutes: Total duration of motion without contact [min].
        processes: Number of processes.
        piece: Duration of one run without contact [s].

    Returns:
        List with the result of each rule; and a map with errors and uncertainties of the estimated
        force, and the smallest thresholds without a false alarm.
    """
    pieces = round(60.0 * minutes / piece)
    free = list(run_jobs([Job(case, i, piece) for i in range(pieces)], processes, case.name))
    contact_records = list(run_jobs([Job(case, i) for i in range(contacts)], processes, case.name))
    capacity = Bench(case).arm.median_capacity[0]
    silent = least_silent(free, slice(0, 3))
    sizes = sorted([*(float(f"{share * capacity:.2g}") for share in SHARES), silent])
    rules = [Rule("force", size) for size in sizes]
    rules += [Rule("guarded", share) for share in GUARDS]
    rules += [Rule("evidence", share) for share in EVIDENCE]
    strength = STRONG_FORCE * capacity
    rows = [evaluate(case.name, rule, strength, free, contact_records) for rule in rules]
    facts = estimate_errors(free, contact_records)
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
    """Measure the detection of contacts by thresholds.

    Args:
        contacts: Number of random contacts of the main case.
        minutes: Duration of motion without contact in the main case, in minutes.
        others: Share of these contacts and minutes for each further case; 0 omits these cases.
        jobs: Number of processes.
        out: Folder for results.json and the picture.
    """
    rows: list[RuleResult] = []
    facts: dict[str, dict[str, float]] = {}
    plan: Iterable[tuple[Case, float]] = [(MAIN, 1.0), *((case, others) for case in OTHERS)]
    for case, share in plan:
        number, duration = round(share * contacts), round(share * minutes)
        if min(number, duration) < 1:
            continue
        rule_results, facts[case.name] = measure(case, number, duration, jobs)
        print(text(rule_results), flush=True)
        print({name: round(value, 4) for name, value in facts[case.name].items()}, flush=True)
        rows += rule_results
    options = {"contacts": contacts, "minutes": minutes, "facts": facts}
    write_results(out, {**options, "rows": [asdict(row) for row in rows]})
    draw(out, rows)
    print(f"contacts: {out / 'results.json'}, {out / 'contacts.png'}")


if __name__ == "__main__":
    command_line.start(main)
