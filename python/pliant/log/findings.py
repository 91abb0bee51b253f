"""Findings of a run, as numbers and sentences: compliance of the axes, saturation of the joints.

The sentences use only the numbers of the log; the controller's pose report is in `felt`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._report.words import listed

if TYPE_CHECKING:
    from pliant._core import Axis
    from pliant._typing import Array, Mask
    from pliant.log.felt import Felt
    from pliant.log.reader import Log


#: Compliance above which an axis counts as soft, and below which as firm.
SOFT, FIRM = 0.99, 0.01
#: Time since the last tick above which a tick is late, in periods [1].
LATE = 1.5
#: Spans with a gap below this are merged [s].
GAP = 0.05


@dataclass(frozen=True)
class Span:
    """A time span in which a joint was at a bound.

    Attributes:
        joint: Its name.
        start, end: Since the beginning of the log [s].
        why: `"torque"`: limit at the servo's usable torque; `"position"`: at a position limit.
        axis: The task axis that loaded the joint most; None if no axis did.
    """

    joint: str
    start: float
    end: float
    why: str
    axis: str | None


def unit(axis: str, *, force: bool = False) -> str:
    """Return the unit of a deviation along an axis, or of a force."""
    return ("N" if force else "mm") if axis in "xyz" else ("N·m" if force else "mrad")


def since(log: Log) -> Array:
    """Return the time since the beginning of the log (N,) [s]."""
    time: Array = log.time - log.time[0]
    return time


def spans(log: Log) -> list[Span]:
    """Return the spans of joints at their torque or position limit, in order of time."""
    time, found = since(log), []
    for why, flags in (("torque", log.saturated), ("position", log.locked)):
        for j, joint in enumerate(log.run["joints"]):
            for first, last in _runs(time, flags[:, j] > 0.5):
                axis = _asking(log, j, first, last) if why == "torque" else None
                end = time[last] + log.dt[last]
                found.append(Span(joint, float(time[first]), float(end), why, axis))
    return sorted(found, key=lambda span: span.start)


def _runs(time: Array, on: Mask) -> list[tuple[int, int]]:
    """Return first and last tick of every stretch; stretches with a small gap are merged."""
    out: list[tuple[int, int]] = []
    for tick in np.flatnonzero(on):
        if out and time[tick] - time[out[-1][1]] <= GAP:
            out[-1] = (out[-1][0], int(tick))
        else:
            out.append((int(tick), int(tick)))
    return out


def _asking(log: Log, joint: int, first: int, last: int) -> str | None:
    """Return the axis that loads a joint most: activation (10) times the force in use.

    The paper's law has no such force; its budget (11) is used instead.
    """
    axes, here = log.run["axes"], slice(first, last + 1)
    used = log.wrench[here]
    force = np.abs(used) if np.isfinite(used).all() else log.axis_strength[here]
    mean = (log.activation[here, joint, : len(axes)] * force).mean(axis=0)
    return str(axes[int(mean.argmax())]) if mean.max() > 0.0 else None


def asked(axis: Axis | None, name: str) -> str:
    """Describe the settings of an axis in a few words."""
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
    """Explain why an axis was soft, firm or stiff at its largest deviation."""
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
    """Return the tick of the largest force along an axis above its bound; None without one.

    In the first half second the bound is the whole torque of the servos. A force within its bound
    may be zero.
    """
    force = np.abs(felt.force[:, k])
    sure = np.where(force > felt.bound[:, k], force, -1.0)
    return int(sure.argmax()) if sure.max() > 0.0 else None


def above(log: Log, felt: Felt, k: int) -> float:
    """Return the share of ticks with a force above cap, friction and uncertainty together."""
    friction = felt.report.axes[log.run["axes"][k]].friction
    allowed = log.axis_strength[:, k] + friction + felt.bound[:, k]
    return float((np.abs(felt.force[:, k]) > allowed).mean())


@dataclass(frozen=True)
class Health:
    """Timing of the loop, and values reported by the servos.

    Attributes:
        period: Nominal time between two ticks [s].
        gaps: Measured times between ticks (N − 1,) [s].
        late: Ticks more than `LATE` periods after the previous one.
        lag: Time from the sampling to the beginning of the tick, median and largest [s].
        delay: Last delay set in the controller [s].
        old: Number of ticks with readings older than `LATE` periods, by joint.
        voltage: Lowest and highest of all servos [V]; None if no servo reports it.
        temperature: Highest temperature per joint that reports it [°C].
        counters: Counters of the bus; empty if the log has no end.
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
    """Compute the timing of loop and bus."""
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
