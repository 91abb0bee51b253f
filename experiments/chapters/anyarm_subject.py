"""Any arm as the subject of a demonstration."""

from __future__ import annotations

from experiments.chapters import anyarm, anyarm_chapters
from experiments.chapters.anyarm import Source
from experiments.demonstration import Subject


def subject(source: Source) -> Subject:
    """Load an arm and select the experiments that suit it.

    Raises:
        PliantError: The arm is rejected.
    """
    arm = anyarm.load(source)
    name = source.name or arm.model.name
    return Subject(
        name,
        anyarm_chapters.experiments(source),
        f"Compliant control of {name} ({arm.model.n} joints, task axes {' '.join(arm.axes)}) on "
        "simulated position servos with torque limits: what the default law does with this arm, in "
        "numbers of this run.",
        arm.notes,
    )
