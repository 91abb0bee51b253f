"""Findings in a log, as numbers and sentences: why axes yielded, joints at limits, loop timing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._report import listed

if TYPE_CHECKING:
    from pliant._core import Axis
    from pliant._typing import Array, Mask
    from pliant.log.forces import ForceEstimates
    from pliant.log.reader import Log


#: An axis counts as soft above `SOFT_COMPLIANCE`, and as firm below `FIRM_COMPLIANCE` (compliance:
#: 1 at a small deviation, 0 at a large one).
SOFT_COMPLIANCE, FIRM_COMPLIANCE = 0.99, 0.01
#: A tick (control cycle) is late if it follows the previous one by more than this many periods.
LATE_PERIODS = 1.5
#: Two spans at a limit are merged into one if the gap between them is at most this long [s].
MAX_GAP = 0.05


@dataclass(frozen=True)
class Span:
    """A time span in which a joint was at its maximum torque or at a position limit.

    Attributes:
        joint: Name of the joint.
        start, end: Times since the beginning of the log [s].
        why: `"torque"`: the torque limit was the maximum torque of the servo; `"position"`: the
            joint was at a position limit.
        axis: Task axis that loaded the joint most; None if no axis loaded it, or for `"position"`.
    """

    joint: str
    start: float
    end: float
    why: str
    axis: str | None


def unit(axis: str, *, force: bool = False) -> str:
    """Return the displayed unit of the deviation along an axis, or of the force if `force`."""
    return ("N" if force else "mm") if axis in "xyz" else ("N·m" if force else "mrad")


def elapsed_time(log: Log) -> Array:
    """Return the time since the beginning of the log of each of its N ticks (N,) [s]."""
    time: Array = log.time - log.time[0]
    return time


def spans(log: Log) -> list[Span]:
    """Return all spans in which joints were at their maximum torque or at a position limit."""
    time, out = elapsed_time(log), []
    for why, flags in (("torque", log.saturated), ("position", log.locked)):
        for j, joint in enumerate(log.run["joints"]):
            for first, last in _true_ranges(time, flags[:, j] > 0.5):
                axis = _loading_axis(log, j, first, last) if why == "torque" else None
                end = time[last] + log.dt[last]
                out.append(Span(joint, float(time[first]), float(end), why, axis))
    return sorted(out, key=lambda span: span.start)


def _true_ranges(time: Array, on: Mask) -> list[tuple[int, int]]:
    """Return first and last tick of each run of True values; merge runs `MAX_GAP` or less apart."""
    out: list[tuple[int, int]] = []
    for tick in np.flatnonzero(on):
        if out and time[tick] - time[out[-1][1]] <= MAX_GAP:
            out[-1] = (out[-1][0], int(tick))
        else:
            out.append((int(tick), int(tick)))
    return out


def _loading_axis(log: Log, joint: int, first: int, last: int) -> str | None:
    """Return the task axis that loads a joint most between two ticks; None: no axis loads it.

    The load is the joint's share in the axis (activation matrix, equation 10 of the paper) times
    the commanded force along the axis. Law `paper` computes no such force; for it, the load is the
    share times the axis strength, as in the torque limits of equation 11.
    """
    axes, ticks = log.run["axes"], slice(first, last + 1)
    wrench = log.wrench[ticks]
    force = np.abs(wrench) if np.isfinite(wrench).all() else log.axis_strength[ticks]
    mean = (log.activation[ticks, joint, : len(axes)] * force).mean(axis=0)
    return str(axes[int(mean.argmax())]) if mean.max() > 0.0 else None


def describe_setting(axis: Axis | None, name: str) -> str:
    """Return a phrase on the settings of an axis: yielding directions, caps, adaptation."""
    if axis is None:
        return "–"
    newton = unit(name, force=True)
    if axis.yields == "none" or axis.soft is None or axis.firm is None:
        return "holds" if axis.hold is None else f"holds, {axis.hold:g} {newton}"
    sides = "both ways" if axis.yields == "both" else f"pushed toward {axis.yields}"
    # Leave out `firm` for profile `constant`, which does not use it.
    ends = sorted({*axis.soft} if axis.profile == "constant" else {*axis.soft, *axis.firm})
    caps = " to ".join(f"{end:g}" for end in (ends[:1] if len(ends) == 1 else (ends[0], ends[-1])))
    eta = f", η {axis.adaptation:g}" if axis.adaptation else ""
    return f"yields {sides}, {caps} {newton}{eta}"


def sentence(log: Log, forces: ForceEstimates | None, k: int) -> str:
    """Return a sentence that explains the compliance of axis k at its largest deviation."""
    name, tick = log.run["axes"][k], int(np.abs(log.deviation[:, k]).argmax())
    peak = f"{1e3 * log.deviation[tick, k]:+.1f} {unit(name)} at {elapsed_time(log)[tick]:.2f} s"
    cap = f"{log.axis_strength[tick, k]:.3g} {unit(name, force=True)}"
    softness, c = log.softness[tick, k], log.compliance[tick, k]
    axis = None if forces is None else forces.strengths.get(name)
    if softness < FIRM_COMPLIANCE:
        why = f"it holds with up to {cap}"
        if axis is not None and axis.yields in {"+", "-"}:
            why = f"it yields toward {axis.yields} only, and was off to the other side: {why}"
    elif c > SOFT_COMPLIANCE:
        why = f"soft: the deviation counts as small, the cap was {cap}"
    elif c < FIRM_COMPLIANCE:
        why = f"firm: the deviation counts as large, the cap was {cap}"
    else:
        why = f"between soft and firm (compliance {c:.2f}), the cap was {cap}"
    joints = [name for name, on in zip(log.run["joints"], log.saturated[tick], strict=True) if on]
    notes = f"; no torque was left in {listed(joints)}" if joints else ""
    if (share := float((log.deviation_limited[:, k] > 0.5).mean())) > 0.0:
        notes += f"; its deviation limit let the target wait or follow in {share:.0%} of the ticks"
    return f"{name}: farthest off {peak}. There {why}{notes}."


def largest_force_tick(forces: ForceEstimates, k: int) -> int | None:
    """Return the tick of the largest force along axis k; None if no force is significant."""
    force = np.abs(forces.force[:, k])
    significant = np.where(force > forces.bound[:, k], force, -1.0)
    return int(significant.argmax()) if significant.max() > 0.0 else None


def exceeded_share(log: Log, forces: ForceEstimates, k: int) -> float:
    """Return the share of ticks in which |force| on axis k exceeds cap + friction + uncertainty."""
    friction = forces.report.axes[log.run["axes"][k]].friction
    allowed = log.axis_strength[:, k] + friction + forces.bound[:, k]
    return float((np.abs(forces.force[:, k]) > allowed).mean())


@dataclass(frozen=True)
class Health:
    """Timing of the loop, and values reported by the servos.

    Attributes:
        period: Nominal time between two ticks [s].
        gaps: Measured times between ticks (N − 1,) [s].
        late: Number of ticks more than `LATE_PERIODS` periods after the previous tick.
        lag: Median and maximum of the time from sampling to the beginning of the tick [s].
        delay: Delay in the controller at the end of the log [s]; NaN if the log has no delay.
        old: Number of ticks with a reading older than `LATE_PERIODS` periods, by joint; joints
            without such ticks are left out.
        voltage: Lowest and highest supply voltage of all servos [V]; None if none is reported.
        temperature: Highest temperature by joint [°C], for joints that report it.
        counters: Counters of the servo bus by name; empty if the log was not closed.
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
    """Return the timing of the loop and the values reported by the servos."""
    period, joints = 1.0 / float(log.run["rate"]), log.run["joints"]
    gaps = np.diff(log.time)
    old = (log.age > LATE_PERIODS * period).sum(axis=0)
    voltages = log.voltage[np.isfinite(log.voltage)]
    temperatures = np.where(np.isfinite(log.temperature), log.temperature, -np.inf).max(axis=0)
    delays = log.columns.get("delay", np.full(1, np.nan))
    return Health(
        period=period,
        gaps=gaps,
        late=int((gaps > LATE_PERIODS * period).sum()),
        lag=(float(np.median(log.lag)), float(log.lag.max())),
        delay=float(delays[-1]),
        old={name: int(count) for name, count in zip(joints, old, strict=True) if count},
        voltage=(float(voltages.min()), float(voltages.max())) if voltages.size else None,
        temperature={
            name: float(t) for name, t in zip(joints, temperatures, strict=True) if np.isfinite(t)
        },
        counters=dict(log.end.get("counters", {})),
    )
