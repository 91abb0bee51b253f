"""Detection of recorded contacts by thresholds: detections, false alarms, latency."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from experiments.contacts_bench import COMES, RATE
from experiments.files import write_results

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from experiments.contacts_bench import Record

    Array = NDArray[np.float64]

#: Readings beyond a threshold that make an event: 20 ms, without the first.
READINGS = 3
#: A contact is strong if its true force exceeds this share of the median static capacity for so
#: many readings.
STRONG_FORCE, STRONG = 0.15, 10
#: Skipped readings at the start of a run, while the estimate settles.
START = 30
#: First reading that can include the hand.
FIRST = round(COMES * RATE) + 1
#: Thresholds as shares of the arm's median static capacity.
SHARES = (0.03, 0.05, 0.075, 0.10, 0.125, 0.15, 0.20, 0.25, 0.30, 0.40)


#: Shares of the uncertainty that guard a threshold, and of the joints' bounds.
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
    lines = [
        "| case | event | false alarms | in [h] | seen % | strong contacts | missed % "
        "| after strong [ms]: median | 95th | after the touch: median | 95th | force then [N] |",
        "|---" * 12 + "|",
    ]
    for r in rows:
        cells = [r.case, str(r.rule), str(r.alarms), f"{r.hours:.2g}", f"{100 * r.seen:.1f}"]
        cells += [str(r.strong), f"{100 * r.missed:.1f}"]
        cells += [f"{1e3 * value:.0f}" for value in (*r.late, *r.after)] + [f"{r.force:.1f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def save(folder: Path, rows: Sequence[Seen], about: Mapping[str, Any]) -> None:
    """Write `results.json`."""
    write_results(folder, {**about, "rows": [asdict(row) for row in rows]})


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
                # Zero alarms in so many hours are drawn at half an alarm in that time.
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
