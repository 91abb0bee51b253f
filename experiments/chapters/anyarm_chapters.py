"""Chapters that suit any arm: activation, swinging, promises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from experiments import metrics
from experiments.chapters import anyarm, anyarm_runs
from experiments.chapters.anyarm import Source
from experiments.chapters.anyarm_drag import Dragged
from experiments.result import (
    Chapter,
    Figure,
    Numbers,
    Statement,
    at_least,
    at_most,
    mm,
)
from experiments.runner import Job
from experiments.setups import AXES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from experiments.chapters.anyarm_runs import Promise
    from experiments.chapters.common import Options
    from experiments.episode import Trace

    Array = NDArray[np.float64]

#: Poses of the promise, in a full and in a quick run.
POSES = (12, 2)


@dataclass(frozen=True)
class Activation:
    """Chapter 1: the activation matrix at the pose."""

    source: Source
    NUMBER: ClassVar[int] = 1
    TITLE: ClassVar[str] = "Which joint does what"

    def jobs(self, options: Options) -> list[Job]:
        """Return one job."""
        return [Job("matrix", anyarm_runs.activation, (self.source,))]

    def measure(self, outcomes: Mapping[str, Array]) -> Numbers:
        """Return the matrix."""
        arm = anyarm.load(self.source)
        return {
            "joints": list(arm.model.joint_names),
            "columns": [*arm.axes, "null"],
            "pose": arm.pose.tolist(),
            "activation": outcomes["matrix"].tolist(),
        }

    def chapter(self, numbers: Numbers) -> Chapter:
        """State the leading joint of each axis."""
        arm = anyarm.load(self.source)
        share = np.array(numbers["activation"])[:, : len(arm.axes)]
        sums = np.abs(share.sum(axis=0) - 1.0).max()
        leads = "; ".join(
            f"{axis}: {arm.model.joint_names[int(share[:, k].argmax())]} {share[:, k].max():.2f}"
            for k, axis in enumerate(arm.axes)
        )
        figure = Figure(
            file="1-activation",
            title="Activation matrix",
            done=f"Task axes {' '.join(arm.axes)} for {arm.model.n} joints; {arm.where}. Each "
            "column tells how a torque budget for one axis is shared among the joints.",
            caption="Columns sum to one; the column of the null space stands apart and is empty "
            "without redundancy.",
            statements=(
                Statement(
                    claim="The shares of each axis sum to one.",
                    outcome=f"They do within {sums:.0e}. Largest share: {leads}.",
                    tests=(at_most("error of a sum", float(sums), 1e-9),),
                    source="study",
                ),
            ),
        )
        return Chapter(
            number=self.NUMBER,
            title=self.TITLE,
            lead="How the joints share the work of each direction in space.",
            figures=(figure,),
            numbers=numbers,
        )

    def draw(self, outcomes: Mapping[str, Array], options: Options) -> None:
        """Draw matrix and posture."""
        from experiments.figures import anyarm as drawing

        drawing.activation(anyarm.load(self.source), outcomes["matrix"], options.figures)


@dataclass(frozen=True)
class Swinging:
    """Chapter 3: the target swings along the soft axis."""

    source: Source
    NUMBER: ClassVar[int] = 3
    TITLE: ClassVar[str] = "A compliant axis still tracks"

    def jobs(self, options: Options) -> list[Job]:
        """Return one job."""
        return [Job("swing", anyarm_runs.swing, (self.source,))]

    def measure(self, outcomes: Mapping[str, Trace]) -> Numbers:
        """Return the rms error over amplitude, and the other positions."""
        arm, trace = anyarm.load(self.source), outcomes["swing"]
        axis = AXES.index(arm.soft)
        swing = trace.between(1.0, 17.0)
        others = [row for row in arm.rows if row < 3 and row != axis]
        return {
            "amplitude": arm.way,
            "share": metrics.rms(trace.error[swing, axis]) / arm.way,
            "others": metrics.largest(trace.error[swing][:, others]),
        }

    def chapter(self, numbers: Numbers) -> Chapter:
        """Judge the tracking."""
        arm = anyarm.load(self.source)
        figure = Figure(
            file="3-swing",
            title=f"A sinusoid in {arm.soft} while {arm.soft} is compliant",
            done=f"The target swings twice by {mm(numbers['amplitude'])} with a period of 8 s, η = "
            "0, default strengths.",
            caption="Above: the axis and its target. Below: the other positions of the task.",
            statements=(
                Statement(
                    claim="It follows with an rms error below a tenth of the amplitude.",
                    outcome=f"{numbers['share']:.3f} of the amplitude; other positions within "
                    f"{mm(numbers['others'])}.",
                    tests=(at_most("rms error / amplitude", numbers["share"], 0.10),),
                    because="the softest strength is not far above what friction takes; a firmer "
                    "axis tracks better.",
                    source="study",
                ),
            ),
        )
        return Chapter(
            number=self.NUMBER,
            title=self.TITLE,
            lead="Being soft must not mean being late.",
            figures=(figure,),
            numbers=numbers,
            headline=(("rms error / amplitude", f"{numbers['share']:.3f}"),),
        )

    def draw(self, outcomes: Mapping[str, Trace], options: Options) -> None:
        """Draw the swing."""
        from experiments.figures import anyarm as drawing

        drawing.swing(anyarm.load(self.source), outcomes["swing"], options.figures)


@dataclass(frozen=True)
class Promised:
    """Chapter 4: the promised cap against the force on a hand."""

    source: Source
    NUMBER: ClassVar[int] = 4
    TITLE: ClassVar[str] = "Promised and felt"

    def jobs(self, options: Options) -> list[Job]:
        """Return a job per pose: every axis, both ways."""
        count = POSES[options.quick]
        return [
            Job(f"pose {k}", anyarm_runs.promises, (self.source, k, count)) for k in range(count)
        ]

    def measure(self, outcomes: Mapping[str, Sequence[Promise]]) -> Numbers:
        """Return every push, and the number of kept promises."""
        pushes = [one for several in outcomes.values() for one in several]
        errors = [abs(one.measured - one.promise) / one.cap for one in pushes]
        return {
            "pushes": len(pushes),
            "kept": sum(one.kept for one in pushes),
            "median_error": float(np.median(errors)) if errors else float("nan"),
            "each": [
                {
                    "axis": p.axis,
                    "sign": p.sign,
                    "cap": p.cap,
                    "promise": p.promise,
                    "measured": p.measured,
                }
                for p in pushes
            ],
        }

    def chapter(self, numbers: Numbers) -> Chapter:
        """Judge the share of promises that were kept."""
        share = numbers["kept"] / max(numbers["pushes"], 1)
        figure = Figure(
            file="4-promise",
            title="Promised cap against measured push-back",
            done="At well conditioned random poses each task axis in turn is made soft with one "
            "cap, 30 % of this arm's median static capacity (rotations 14 %), the tool is dragged "
            "away, and the force is read when it is still. Poses where the servos cannot give the "
            "cap are left out.",
            caption="On the diagonal the promise is kept exactly; the band is ± 15 % of the cap. "
            "Friction of the joints is allowed for on top in the count.",
            statements=(
                Statement(
                    claim="At least 92 % of the promises are kept within 15 % of the cap and the "
                    "joints' friction.",
                    outcome=f"{numbers['kept']} of {numbers['pushes']} ({share:.0%}); median error "
                    f"{numbers['median_error']:.1%} of the cap.",
                    tests=(
                        at_least("share kept", share, 0.92),
                        at_least("pushes", numbers["pushes"], 1.0),
                    ),
                    source="study",
                ),
            ),
        )
        return Chapter(
            number=self.NUMBER,
            title=self.TITLE,
            lead="Law cap is set in newtons. This is the check that newtons come out.",
            figures=(figure,),
            numbers=numbers,
            headline=(("promises kept", f"{numbers['kept']} of {numbers['pushes']}"),),
        )

    def draw(self, outcomes: Mapping[str, Sequence[Promise]], options: Options) -> None:
        """Draw promise against force."""
        from experiments.figures import anyarm as drawing

        drawing.promises([one for several in outcomes.values() for one in several], options.figures)


def experiments(source: Source) -> dict[int, Any]:
    """Return the chapters by number."""
    chapters = (Activation(source), Dragged(source), Swinging(source), Promised(source))
    return {chapter.NUMBER: chapter for chapter in chapters}
