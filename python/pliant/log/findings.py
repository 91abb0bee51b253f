"""What a run shows, in numbers and sentences: why it was soft or not, and where strength ended.

Sentences are made from the log's own numbers; what the controller says of a pose is in `felt`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._report.words import listed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant import Axis
    from pliant.log.felt import Felt
    from pliant.log.reader import Log

    Array = NDArray[np.float64]

#: Compliance above which an axis counts as soft, and below which as firm.
SOFT, FIRM = 0.99, 0.01
#: A tick is late where it comes this many periods after the one before [1].
LATE = 1.5
#: Spans that are nearer to each other than this are one [s].
GAP = 0.05


@dataclass(frozen=True)
class Span:
    """A stretch of time in which a joint was at a bound.

    Attributes:
        joint: Its name.
        start, end: Since the beginning of the log [s].
        why: `"torque"`: limit at the servo's ceiling; `"position"`: at a position limit.
        axis: The task axis that asked most of it, None where no axis did.
    """

    joint: str
    start: float
    end: float
    why: str
    axis: str | None


def unit(axis: str, *, force: bool = False) -> str:
    """Unit of a deviation along an axis, or of a force."""
    return ("N" if force else "mm") if axis in "xyz" else ("N·m" if force else "mrad")


def since(log: Log) -> Array:
    """Time since the beginning of the log (N,) [s]."""
    time: Array = log.time - log.time[0]
    return time


def spans(log: Log) -> list[Span]:
    """When joints were at their torque ceiling or at a position limit, in order of time."""
    time, found = since(log), []
    for why, flags in (("torque", log.saturated), ("position", log.locked)):
        for j, joint in enumerate(log.run["joints"]):
            for first, last in _runs(time, flags[:, j] > 0.5):
                axis = _asking(log, j, first, last) if why == "torque" else None
                end = time[last] + log.dt[last]
                found.append(Span(joint, float(time[first]), float(end), why, axis))
    return sorted(found, key=lambda span: span.start)


def _runs(time: Array, on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last tick of every stretch, stretches that almost touch as one."""
    out: list[tuple[int, int]] = []
    for tick in np.flatnonzero(on):
        if out and time[tick] - time[out[-1][1]] <= GAP:
            out[-1] = (out[-1][0], int(tick))
        else:
            out.append((int(tick), int(tick)))
    return out


def _asking(log: Log, joint: int, first: int, last: int) -> str | None:
    """The axis that asks most of a joint meanwhile: activation (10) times the force in use.

    Law paper has no such force; its budget (11) takes the place.
    """
    axes, here = log.run["axes"], slice(first, last + 1)
    used = log.wrench[here]
    force = np.abs(used) if np.isfinite(used).all() else log.axis_strength[here]
    mean = (log.activation[here, joint, : len(axes)] * force).mean(axis=0)
    return str(axes[int(mean.argmax())]) if mean.max() > 0.0 else None


def asked(axis: Axis | None, name: str) -> str:
    """What was asked of an axis, in a few words."""
    if axis is None:
        return "–"
    newton = unit(name, force=True)
    if axis.yields == "none" or axis.soft is None or axis.firm is None:
        return "holds" if axis.hold is None else f"holds, {axis.hold:g} {newton}"
    sides = "both ways" if axis.yields == "both" else f"pushed toward {axis.yields}"
    # A constant cap is `soft` at every deviation.
    ends = sorted({*axis.soft} if axis.profile == "constant" else {*axis.soft, *axis.firm})
    caps = " to ".join(f"{end:g}" for end in (ends[:1] if len(ends) == 1 else (ends[0], ends[-1])))
    eta = f", η {axis.adaptation:g}" if axis.adaptation else ""
    return f"yields {sides}, {caps} {newton}{eta}"


def sentence(log: Log, felt: Felt | None, k: int) -> str:
    """Why an axis was soft, firm or stiff where it was farthest off."""
    name, tick = log.run["axes"][k], int(np.abs(log.deviation[:, k]).argmax())
    off = f"{1e3 * log.deviation[tick, k]:+.1f} {unit(name)} at {since(log)[tick]:.2f} s"
    cap = f"{log.axis_strength[tick, k]:.3g} {unit(name, force=True)}"
    softness, c = log.softness[tick, k], log.compliance[tick, k]
    axis = None if felt is None else felt.strengths.get(name)
    if softness < FIRM:
        why = f"it holds with up to {cap}"
        if axis is not None and axis.yields in {"+", "-"}:
            why = f"it yields toward {axis.yields} only, and was off to the other side: {why}"
    elif c > SOFT:
        why = f"soft: the deviation counts as small, the cap was {cap}"
    elif c < FIRM:
        why = f"firm: the deviation counts as large, the cap was {cap}"
    else:
        why = f"between soft and firm (compliance {c:.2f}), the cap was {cap}"
    ended = [name for name, on in zip(log.run["joints"], log.saturated[tick], strict=True) if on]
    more = f"; no torque was left in {listed(ended)}" if ended else ""
    if (share := float((log.deviation_limited[:, k] > 0.5).mean())) > 0.0:
        more += f"; its deviation limit let the target wait or follow in {share:.0%} of the ticks"
    return f"{name}: farthest off {off}. There {why}{more}."


def most_felt(felt: Felt, k: int) -> int | None:
    """Tick of the largest force along an axis that exceeds its bound; None without one.

    In the first half second the bound is all torque that the servos have, and forces within a bound
    may be none.
    """
    force = np.abs(felt.force[:, k])
    sure = np.where(force > felt.bound[:, k], force, -1.0)
    return int(sure.argmax()) if sure.max() > 0.0 else None


def above(log: Log, felt: Felt, k: int) -> float:
    """Share of ticks in which more than cap, friction and doubt together was felt along an axis."""
    allowed = log.axis_strength[:, k] + felt.report.friction[k] + felt.bound[:, k]
    return float((np.abs(felt.force[:, k]) > allowed).mean())


@dataclass(frozen=True)
class Health:
    """How regular the loop was and what the servos said of themselves.

    Attributes:
        period: Nominal time between two ticks [s].
        gaps: Between the ticks there were (N − 1,) [s].
        late: Ticks that came later than `LATE` periods after the one before.
        lag: From sampling to the begin of the tick, median and largest [s].
        delay: That the controller was told, last [s].
        old: Joints with readings older than `LATE` periods: in how many ticks.
        voltage: Lowest and highest of all servos [V]; None where no servo tells.
        temperature: Highest per joint that tells [°C].
        counters: Of the bus; empty where the log has no end.
    """

    period: float
    gaps: Array
    late: int
    lag: tuple[float, float]
    delay: float
    old: dict[str, int]
    voltage: tuple[float, float] | None
    temperature: dict[str, float]
    counters: dict[str, int]


def health(log: Log) -> Health:
    """Loop and bus in numbers."""
    period, joints = 1.0 / float(log.run["rate"]), log.run["joints"]
    gaps = np.diff(log.time)
    old = (log.age > LATE * period).sum(axis=0)
    volts = log.voltage[np.isfinite(log.voltage)]
    warm = np.where(np.isfinite(log.temperature), log.temperature, -np.inf).max(axis=0)
    told = log.columns.get("delay", np.full(1, np.nan))
    return Health(
        period=period,
        gaps=gaps,
        late=int((gaps > LATE * period).sum()),
        lag=(float(np.median(log.lag)), float(log.lag.max())),
        delay=float(told[-1]),
        old={name: int(count) for name, count in zip(joints, old, strict=True) if count},
        voltage=(float(volts.min()), float(volts.max())) if volts.size else None,
        temperature={
            name: float(t) for name, t in zip(joints, warm, strict=True) if np.isfinite(t)
        },
        counters=dict(log.end.get("counters", {})),
    )
