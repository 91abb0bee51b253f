"""The flag `--soft`: compliant axes, each with an optional cap."""

from __future__ import annotations

import math

import pliant


def check_soft(axes: str, task: pliant.Task, remedy: str) -> None:
    """Check that the task has the axes.

    Args:
        axes: Their names, as `pliant.Task` takes them.
        task: The task.
        remedy: How to get another task, for the error message.

    Raises:
        ConfigError: A word is no axis, or no axis of the task.
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


def caps(soft: str, task: pliant.Task) -> dict[str, float | None]:
    """Parse `--soft`: words "y" or "y=2" to caps [N, N·m], None without a cap.

    Raises:
        ConfigError: A word is invalid, is no axis of the task, or repeats an axis.
    """
    found: dict[str, float | None] = {}
    for word in soft.replace(",", " ").split():
        name, given, number = word.partition("=")
        check_soft(name, task, "task in [settings] of a file of your own")
        try:
            cap = float(number) if given else None
        except ValueError:
            raise pliant.ConfigError(
                f"--soft takes axis or axis=newtons, e.g. 'y=2 z=5', got {word!r}"
            ) from None
        if cap is not None and not 0.0 <= cap < math.inf:
            raise pliant.ConfigError(f"--soft {word}: a cap is a number from 0 up, got {cap:g}")
        for axis in pliant.Task(axes=name).names:
            if axis in found:
                raise pliant.ConfigError(f"--soft {soft!r} names {axis} twice: one cap an axis")
            found[axis] = cap
    return found


def softened(
    settings: pliant.Settings, soft: str, model: pliant.Model, *, holds: bool
) -> pliant.Settings:
    """Return settings with the axes of `--soft` compliant.

    Args:
        settings: Settings of the configuration.
        soft: "y=2" caps y at 2 N (N·m for rotations), "y" takes the arm's own caps.
        model: The arm.
        holds: True: the other axes hold. False: they keep their settings.

    Raises:
        ConfigError: As `caps`; or a cap is above the arm's holding force.
    """
    if not soft:
        return settings
    task = settings.task
    axes: dict[str, pliant.Axis] = {} if holds else dict(settings.axes.items())
    found = caps(soft, task)
    strongest: dict[str, pliant.Axis] = dict(
        pliant.Controller(model, pliant.Settings.firm(task=task)).axes.items()
    )
    preset: dict[str, pliant.Axis] = dict(
        pliant.Settings.soft(" ".join(found), task=task).axes.items()
    )
    for name, cap in found.items():
        hold = strongest[name].hold
        if cap is not None and hold is not None and cap > hold:
            unit = "N" if name in "xyz" else "N·m"
            raise pliant.ConfigError(
                f"--soft {name}={cap:g}: this arm holds {name} with at most {hold:.3g} {unit}; a "
                "cap is at most that"
            )
        if cap is not None:
            axes[name] = pliant.Axis(soft=cap, profile="constant")
        else:
            axes[name] = pliant.Axis(yields="both") if holds else preset[name]
    return settings.replace(axes=axes)
