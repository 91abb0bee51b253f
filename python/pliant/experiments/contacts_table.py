"""What thresholds see of recorded contacts, what they see in free motion, and how late."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant.experiments.contacts_bench import COMES, RATE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from pliant.experiments.contacts_bench import Record

    Array = NDArray[np.float64]

#: Readings beyond a threshold that make an event: 20 ms, the first not counted.
READINGS = 3
#: Readings for which a true force must exceed a threshold to count as a contact that strong.
STRONG = 10
#: Readings of a run that are not looked at: the estimate starts.
START = 30
#: First reading that can see the hand.
FIRST = round(COMES * RATE) + 1
#: Thresholds as shares of the arm's median static capacity.
SHARES = (0.03, 0.05, 0.075, 0.10, 0.125, 0.15, 0.20, 0.25, 0.30, 0.40)


@dataclass(frozen=True)
class Seen:
    """One threshold, one case.

    Attributes:
        case: Name of the case.
        threshold: On each of x, y, z [N]; 0: the uncertainty alone.
        guarded: Whether the uncertainty raises it where that is larger.
        alarms: False alarms in free motion, and in how many hours.
        hours: See `alarms`.
        strong: Contacts whose true force was beyond the threshold along some axis for 0.1 s.
        missed: Share of these that were not seen.
        seen: Share of all contacts that were seen.
        late: Median and 95th percentile of the time [s] from the true force passing the threshold.
        after: The same from the first touch.
        force: Median of the true force at that moment [N].
    """

    case: str
    threshold: float
    guarded: bool
    alarms: int
    hours: float
    strong: int
    missed: float
    seen: float
    late: tuple[float, float]
    after: tuple[float, float]
    force: float


def events(beyond: NDArray[np.bool_]) -> list[int]:
    """Readings at which a row of booleans (N,) has been true for long enough, one per stretch."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], beyond.astype(np.int8), [0]))))
    stretches = zip(edges[::2], edges[1::2], strict=True)
    return [int(a) + READINGS - 1 for a, b in stretches if b - a >= READINGS]


def beyond(record: Record, threshold: float, guarded: bool) -> NDArray[np.bool_]:
    """Whether a force is felt beyond the threshold, by axis (N, 3)."""
    least = record.bound[:, :3] if guarded else 0.0
    out: NDArray[np.bool_] = np.abs(record.felt[:, :3]) > np.maximum(threshold, least)
    out[:START] = False
    return out


def alarms(record: Record, threshold: float, guarded: bool) -> int:
    """False alarms of a free run, all axes."""
    felt = beyond(record, threshold, guarded)
    return sum(len(events(felt[:, axis])) for axis in range(3))


def first(felt: NDArray[np.bool_]) -> int | None:
    """Reading (N, 3) at which the hand is noticed first, None if never."""
    found = [e for axis in range(3) for e in events(felt[FIRST:, axis])]
    return FIRST + min(found) if found else None


def least_silent(free: Sequence[Record], columns: slice) -> float:
    """Smallest threshold that raises no alarm in free motion, on these columns [N or N·m]."""
    most = 0.0
    for record in free:
        force = np.abs(record.felt[START:, columns])
        lasting = np.lib.stride_tricks.sliding_window_view(force, READINGS, axis=0).min(axis=-1)
        most = max(most, float(lasting.max()))
    return most


def look(
    case: str,
    threshold: float,
    guarded: bool,
    free: Sequence[Record],
    contacts: Sequence[Record],
) -> Seen:
    """What one threshold sees."""
    late: list[float] = []
    after: list[float] = []
    force: list[float] = []
    strong = missed = seen = 0
    for record in contacts:
        true = np.abs(record.truth[:, :3])
        passed = np.flatnonzero((true > threshold).any(axis=1))
        is_strong = bool(((true > threshold).sum(axis=0) >= STRONG).any())
        strong += is_strong
        found = first(beyond(record, threshold, guarded))
        seen += found is not None
        missed += is_strong and found is None
        if found is not None:
            after.append((found - FIRST + 1) / RATE)
            force.append(float(true[found].max()))
            if is_strong:
                late.append((found - int(passed[0])) / RATE)
    return Seen(
        case=case,
        threshold=threshold,
        guarded=guarded,
        alarms=sum(alarms(record, threshold, guarded) for record in free),
        hours=sum(len(record.felt) for record in free) / RATE / 3600.0,
        strong=strong,
        missed=missed / max(strong, 1),
        seen=seen / max(len(contacts), 1),
        late=_quantiles(late),
        after=_quantiles(after),
        force=float(np.median(force)) if force else float("nan"),
    )


def honesty(free: Sequence[Record], contacts: Sequence[Record]) -> dict[str, float]:
    """Errors [N], bounds [N], and the share of readings whose error was beyond its bound."""
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
    """The table of thresholds, as Markdown."""
    lines = [
        "| case | threshold [N] | in force | false alarms | in [h] | strong contacts | missed % "
        "| all seen % | after the true force [ms]: median | 95th | after the touch: median | 95th "
        "| force then [N] |",
        "|---" * 13 + "|",
    ]
    for r in rows:
        in_force = "max(threshold, bound)" if r.guarded else "as it is"
        cells = [r.case, f"{r.threshold:.2g}", in_force, str(r.alarms), f"{r.hours:.2g}"]
        cells += [str(r.strong), f"{100 * r.missed:.1f}", f"{100 * r.seen:.1f}"]
        cells += [f"{1e3 * value:.0f}" for value in (*r.late, *r.after)] + [f"{r.force:.1f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def save(folder: Path, rows: Sequence[Seen], about: Mapping[str, Any]) -> None:
    """Write `results.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    data = {**about, "rows": [asdict(row) for row in rows]}
    (folder / "results.json").write_text(json.dumps(_plain(data), indent=1) + "\n")


def _plain(value: Any) -> Any:
    """The same without NaN, which JSON has not."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return round(float(value), 6) if np.isfinite(value) else None
    return value


def draw(folder: Path, rows: Sequence[Seen]) -> None:
    """Write `contacts.png`: alarms against contacts seen, and how late."""
    from pliant.experiments.figures import style

    cases = list(dict.fromkeys(row.case for row in rows))
    colours = (style.BLUE, style.ORANGE, style.GREEN, style.PURPLE, style.SKY, style.RED)
    with style.canvas(1, 2, size=(style.WIDE, 3.4)) as (figure, axes):
        left, right = axes[0]
        for case, colour in zip(cases, colours * 3, strict=False):
            mine = [row for row in rows if row.case == case and not row.guarded and row.threshold]
            rate = [max(row.alarms / row.hours, 0.5) for row in mine]
            left.plot(rate, [100 * row.seen for row in mine], "o-", color=colour, markersize=3)
            left.set_xscale("log")
            size = [row.threshold for row in mine]
            right.plot(
                size, [1e3 * row.late[0] for row in mine], "-", color=colour, label=case
            )
            right.plot(size, [1e3 * row.late[1] for row in mine], ":", color=colour)
        left.set_xlabel("false alarms per hour of free motion (0 drawn at 0.5)")
        left.set_ylabel("contacts seen [%]")
        left.set_title("One dot per threshold")
        right.set_xlabel("threshold [N]")
        right.set_ylabel("later than the true force [ms]")
        right.set_title("Median, dotted: 95th percentile")
        right.legend(fontsize=6.5)
        style.save(figure, folder, "contacts")
