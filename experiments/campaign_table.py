"""Results of a cap campaign: figures per arm and disturbance, a table, a file and a picture."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.files import write_results

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from experiments.campaign_bench import Promise

    #: Promises by arm and disturbance.
    Found = Mapping[tuple[str, str], Sequence[Promise]]

#: Distance from the stops above which a pose is clear [rad].
CLEAR = 0.15
#: Required shares of kept promises: nominal, disturbed.
GOALS = (0.97, 0.95)


@dataclass(frozen=True, kw_only=True)
class Row:
    """Figures of one arm under one disturbance; shares are of the runs, errors of the cap.

    Attributes:
        arm, disturbance: Names.
        poses: Number of poses.
        cases: Promises, rejected ones included.
        refused: Share of the cases that the limits cannot hold.
        kept: Share in band, every pose and axis.
        kept_free, kept_guided: The same with the other axes free and held.
        announced: Share for which the report predicted a position limit on the path of the push.
        kept_rest: Share in band of all others: the decisive figure.
        kept_announced: Share in band of the announced ones.
        as_said: Share of these in band with the announced friction.
        stopped: Share not in band, provably by a joint at its position limit.
        kept_clear: Share in band with every joint clear of its stops at the end.
        clear: Share of such cases.
        kept_truly: Share within the band of the true friction.
        median, p95: Median and 95th percentile of |felt - promised| over the cap.
        median_free, p95_free: The same, other axes free.
        drift: 95th percentile of the stiff axes' drift under the middle cap, other axes free [mm].
        drift_kept: Share of these below 5 mm.
        friction: Median of the hidden friction [N or N·m], over the cap.
    """

    arm: str
    disturbance: str
    poses: int
    cases: int
    refused: float
    kept: float
    kept_free: float
    kept_guided: float
    announced: float
    kept_rest: float
    kept_announced: float
    as_said: float
    stopped: float
    kept_clear: float
    clear: float
    kept_truly: float
    median: float
    p95: float
    median_free: float
    p95_free: float
    drift: float
    drift_kept: float
    friction: float

    @property
    def met(self) -> bool:
        """True if enough of the promises without an announcement were kept."""
        return self.kept_rest >= GOALS[self.disturbance != "nominal"]


def summary(arm: str, disturbance: str, found: Sequence[Promise]) -> Row:
    """Compute the figures of one arm under one disturbance."""
    run = [one for one in found if not one.refused]
    caps = {axis: sorted({p.cap for p in found if p.axis == axis}) for axis in "xyz"}
    drifts = [
        1e3 * p.drift
        for p in run
        if not p.guided and caps.get(p.axis) and p.cap == caps[p.axis][len(caps[p.axis]) // 2]
    ]
    free = [p for p in run if not p.guided]
    clear = [p for p in run if p.room >= CLEAR]
    return Row(
        arm=arm,
        disturbance=disturbance,
        poses=len({p.pose for p in found}),
        cases=len(found),
        refused=1.0 - len(run) / max(len(found), 1),
        kept=_share([p.kept for p in run]),
        kept_free=_share([p.kept for p in free]),
        kept_guided=_share([p.kept for p in run if p.guided]),
        announced=_share([p.announced for p in run]),
        kept_rest=_share([p.kept for p in run if not p.announced]),
        kept_announced=_share([p.kept for p in run if p.announced]),
        as_said=_share([p.kept_as_said for p in run if p.announced]),
        stopped=_share([p.stopped for p in run]),
        kept_clear=_share([p.kept for p in clear]),
        clear=len(clear) / max(len(run), 1),
        kept_truly=_share(
            [abs(p.felt - p.promise) <= p.band - p.friction + p.true_friction for p in run]
        ),
        median=_quantile([abs(p.error) for p in run], 0.5),
        p95=_quantile([abs(p.error) for p in run], 0.95),
        median_free=_quantile([abs(p.error) for p in free], 0.5),
        p95_free=_quantile([abs(p.error) for p in free], 0.95),
        drift=_quantile(drifts, 0.95),
        drift_kept=_share([d < 5.0 for d in drifts]),
        friction=_quantile([p.friction / p.cap for p in run], 0.5),
    )


def _share(values: Sequence[bool]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _quantile(values: Sequence[float], q: float) -> float:
    return float(np.quantile(values, q)) if values else float("nan")


def text(rows: Sequence[Row]) -> str:
    """Return the table, as Markdown."""
    lines = [
        "| arm | disturbance | poses | cases | refused % | stop announced % "
        "| in band % of the rest | strictly, of all | free | guided | of the announced | as said "
        "| by a limit | clear of stops | true friction | error: median % | 95th % "
        "| free: median | 95th | drift 95th [mm] | < 5 mm % | met |",
        "|---" * 22 + "|",
    ]
    for r in rows:
        shares = (
            r.refused,
            r.announced,
            r.kept_rest,
            r.kept,
            r.kept_free,
            r.kept_guided,
            r.kept_announced,
            r.as_said,
            r.stopped,
            r.kept_clear,
            r.kept_truly,
        )
        errors = (r.median, r.p95, r.median_free, r.p95_free)
        cells = [r.arm, r.disturbance, str(r.poses), str(r.cases)]
        cells += [f"{100.0 * value:.1f}" for value in (*shares, *errors)]
        cells += [f"{r.drift:.1f}", f"{100.0 * r.drift_kept:.0f}", "yes" if r.met else "NO"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def save(folder: Path, rows: Sequence[Row], found: Found, about: Mapping[str, Any]) -> None:
    """Write `results.json`: options, figures, and every promise that was not kept."""
    missed = [
        {"arm": arm, "disturbance": disturbance, **asdict(one)}
        for (arm, disturbance), promises in found.items()
        for one in promises
        if not (one.refused or one.kept)
    ]
    write_results(folder, {**about, "rows": [asdict(row) for row in rows], "missed": missed})


def draw(folder: Path, rows: Sequence[Row], found: Found) -> None:
    """Draw `campaign.png`: distribution of the errors, by arm and by disturbance."""
    from experiments.figures import caps

    first = rows[0].arm if rows else ""
    panels = {
        "Nominal, by arm": {arm: p for (arm, name), p in found.items() if name == "nominal"},
        f"{first}, one disturbance at a time": {
            name: p for (arm, name), p in found.items() if arm == first
        },
    }
    caps.draw(panels, folder, "campaign")
