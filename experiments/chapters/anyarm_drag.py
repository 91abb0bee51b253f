"""The chapter in which a hand drags any arm: one axis soft, and all axes stiff."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from experiments import metrics
from experiments.chapters import anyarm, anyarm_runs
from experiments.chapters.anyarm import Source
from experiments.result import Chapter, Figure, Numbers, Statement, at_most, mm, near
from experiments.runner import Job
from experiments.setups import AXES
from pliant._report.page import Table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from experiments.chapters.anyarm import Arm
    from experiments.chapters.common import Options
    from experiments.episode import Trace

#: Kinds of the drag: stiffness, η, direction.
DRAGS = (
    ("soft", 0.999, 1),
    ("soft", 0.999, -1),
    ("soft", 0.0, 1),
    ("soft", 0.0, -1),
    ("stiff", 0.0, 1),
    ("stiff", 0.0, -1),
)


@dataclass(frozen=True)
class Dragged:
    """Chapter 2: one axis soft, dragged by a hand; the same all stiff."""

    source: Source
    NUMBER: ClassVar[int] = 2
    TITLE: ClassVar[str] = "Held, dragged, let go"

    def jobs(self, options: Options) -> list[Job]:
        """Return the runs: soft with and without adaptation, and stiff, both ways."""
        runs = [d for d in DRAGS if d[2] == 1] if options.quick else DRAGS
        return [
            Job("strengths", anyarm_runs.strengths, (self.source,)),
            *(
                Job(f"{k} {eta:g} {sign:+d}", anyarm_runs.drag, (self.source, k, eta, sign))
                for k, eta, sign in runs
            ),
        ]

    def measure(self, outcomes: Mapping[str, Any]) -> Numbers:
        """Return numbers by kind: the worse of both directions."""
        arm, given = anyarm.load(self.source), outcomes["strengths"]
        kinds: dict[str, dict[str, float]] = {}
        for name, trace in outcomes.items():
            if name == "strengths":
                continue
            kind = name.rsplit(" ", maxsplit=1)[0]
            one = self._one(arm, trace, given)
            had = kinds.get(kind, one)
            kinds[kind] = {k: (min if k == "moved" else max)(v, had[k]) for k, v in one.items()}
        return {
            "soft_axis": arm.soft,
            "way": arm.way,
            "strengths": {"soft": given.soft, "firm": given.firm, "hold": given.hold},
            **kinds,
        }

    def _one(self, arm: Arm, trace: Trace, given: anyarm_runs.Strengths) -> dict[str, float]:
        axis = AXES.index(arm.soft)
        others = [row for row in arm.rows if row < 3 and row != axis]
        still = trace.between(*metrics.HELD)
        felt = trace.force[:, axis]
        c = float(np.nanmean(trace.compliance[still, arm.axes.index(arm.soft)]))
        jacobian = np.asarray(arm.model.jacobian(trace.q[trace.at(metrics.HELD[1])]))
        inverse = np.linalg.pinv(jacobian[arm.rows])[:, arm.rows.index(axis)]
        before = trace.at(metrics.PULLING[0])
        return {
            "before": metrics.largest(
                trace.error[before, arm.rows][: len([r for r in arm.rows if r < 3])]
            ),
            "moved": metrics.moved(trace, axis),
            "force": metrics.largest(felt),
            "held": abs(float(felt[still].mean())),
            "promised": c * given.soft + (1.0 - c) * given.firm,
            "friction": float(np.abs(inverse) @ np.asarray(arm.servos.friction)),
            "give": max(
                (float(jacobian[row] ** 2 @ (1.0 / np.asarray(arm.servos.kp))) for row in others),
                default=0.0,
            ),
            "drift": metrics.drift(trace, others) if others else 0.0,
            "left": abs(float(trace.error[-1, axis])),
            "crept": abs(
                float(trace.moved[-1, axis] - trace.moved[trace.at(metrics.PULLING[1]), axis])
            ),
        }

    def chapter(self, numbers: Numbers) -> Chapter:
        """Judge against the promises and against the stiff arm."""
        arm = anyarm.load(self.source)
        follow, firm, stiff = numbers["soft 0.999"], numbers["soft 0"], numbers["stiff 0"]
        given, soft = numbers["strengths"], numbers["soft_axis"]
        figure = Figure(
            file="2-dragged",
            title=f"A hand drags the tool by {mm(numbers['way'])} in {soft}",
            done=f"Law cap with this arm's default strengths in {soft}: {given['soft']:g} N at "
            f"small, {given['firm']:g} N at large deviation, {given['hold']:g} N where it is "
            "stiff. The hand pulls within 2 to 3.5 s, holds on until 5 s, and lets go. With η = "
            f"0.999, with η = 0, and with all axes stiff; {arm.where}.",
            caption="Solid: pulled toward +, dashed: toward −.",
            statements=(
                Statement(
                    claim="At rest it stays where it shall, within 5 mm and less.",
                    outcome=f"All stiff: {mm(stiff['before'])} off; soft, η = 0.999: "
                    f"{mm(follow['before'])}.",
                    tests=(at_most("off", max(stiff["before"], follow["before"]), 0.005, "m"),),
                    because="dry friction of the gears hides that much of a small error.",
                    source="study",
                ),
                Statement(
                    claim="Soft, it follows a hand for less than half the force a stiff arm needs.",
                    outcome=f"{follow['force']:.2f} N instead of {stiff['force']:.2f} N for "
                    f"{mm(follow['moved'])}.",
                    tests=(at_most("share", follow["force"] / stiff["force"], 0.5),),
                    because="friction that is not fed forward and the arm's inertia are most of "
                    "what the hand feels.",
                    source="study",
                ),
                Statement(
                    claim="The stiff positions drift less than 15 % of the way meanwhile, and less "
                    "than on a stiff arm.",
                    outcome=f"{mm(follow['drift'])} of {mm(numbers['way'])}; {mm(stiff['drift'])} "
                    "when all is stiff.",
                    tests=(
                        at_most("drift over way", follow["drift"] / numbers["way"], 0.15),
                        at_most(
                            "drift over stiff", follow["drift"] / max(stiff["drift"], 1e-6), 1.0
                        ),
                    ),
                    because=f"a newton on its stiff axes moves them by up to {mm(follow['give'])}: "
                    "no law makes servos stiffer than they are.",
                    source="study",
                ),
                Statement(
                    claim="η = 0: held away, it pulls back with the force that was set for that "
                    "deviation, up to 15 % and friction, and returns.",
                    outcome=f"{firm['held']:.2f} N of {firm['promised']:.2f} N; {mm(firm['left'])} "
                    "are left 4 s after.",
                    tests=(
                        near(
                            "held",
                            firm["held"],
                            firm["promised"],
                            rel=0.15,
                            plus=firm["friction"],
                            unit="N",
                        ),
                        at_most("left over way", firm["left"] / numbers["way"], 0.15),
                    ),
                    source="study",
                ),
                Statement(
                    claim="η = 0.999: let go, it stays.",
                    outcome=f"It moves by {mm(follow['crept'])} in the 4 s after.",
                    tests=(at_most("moves", follow["crept"], 0.015, "m"),),
                    source="study",
                ),
            ),
        )
        return Chapter(
            number=self.NUMBER,
            title=self.TITLE,
            lead="One axis yields, the others hold. What does a hand need to move the arm, what do "
            "the other axes do, does it come back?",
            figures=(figure,),
            tables=(_drag_table(numbers),),
            numbers=numbers,
            headline=(
                (
                    f"dragged in {soft}, soft",
                    f"{follow['force']:.2f} N, {mm(follow['drift'])} drift",
                ),
                (
                    f"dragged in {soft}, all stiff",
                    f"{stiff['force']:.2f} N, {mm(stiff['drift'])} drift",
                ),
            ),
        )

    def draw(self, outcomes: Mapping[str, Any], options: Options) -> None:
        """Draw place, drift and force."""
        from experiments.figures import anyarm as drawing

        traces = {name: one for name, one in outcomes.items() if name != "strengths"}
        drawing.dragged(anyarm.load(self.source), traces, options.figures)


def _drag_table(numbers: Numbers) -> Table:
    rows = [
        (
            name,
            mm(one["moved"]),
            f"{one['force']:.2f} N",
            f"{one['held']:.2f} N",
            mm(one["drift"]),
            mm(one["left"]),
        )
        for name, one in ((k, numbers[k]) for k in ("soft 0.999", "soft 0", "stiff 0"))
    ]
    return Table(
        caption="The worse of both directions. Held: mean force while the hand holds still; left: "
        "4 s after the release.",
        columns=("axis and η", "moved", "force", "held", "drift of the others", "left"),
        rows=tuple(rows),
    )
