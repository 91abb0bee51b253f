"""Axes that a flag `--soft` names, beside those that the task has."""

from __future__ import annotations

import pliant


def check_soft(axes: str, task: pliant.Task, remedy: str) -> None:
    """See that the task has the axes.

    Args:
        axes: Their names, as `pliant.Task` takes them.
        task: The task.
        remedy: How the command gets another task.

    Raises:
        ConfigError: A word is no axis, or one that the task does not have.
    """
    try:
        odd = [name for name in pliant.Task(axes=axes).names if name not in task.names]
    except pliant.ConfigError as error:
        said = str(error).removeprefix("task.axes: ")
        raise pliant.ConfigError(f"--soft {axes!r}: {said}") from None
    if odd:
        raise pliant.ConfigError(
            f"--soft {axes!r}: {', '.join(odd)} is no axis of the task, which has "
            f"{', '.join(task.names)}; {remedy}"
        )
