"""The flag `--soft`: compliant axes, each with an optional cap."""

from __future__ import annotations

import math

from pliant._core import Axis, ConfigError, Controller, Model, Settings, Task


def check_soft(axes: str, task: Task, remedy: str) -> None:
    """Check that the task has the axes.

    Args:
        axes: Their names, as `pliant.Task` takes them.
        task: The task.
        remedy: How to get another task, for the error message.

    Raises:
        ConfigError: A word is no axis, or no axis of the task.
    """
    try:
        odd = [name for name in Task(axes=axes).names if name not in task.names]
    except ConfigError as error:
        said = str(error).removeprefix("task.axes: ")
        raise ConfigError(f"--soft {axes!r}: {said}") from None
    if odd:
        raise ConfigError(
            f"--soft {axes!r}: {', '.join(odd)} is no axis of the task, which has "
            f"{', '.join(task.names)}; {remedy}"
        )


def caps(soft: str, task: Task) -> dict[str, float | None]:
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
            raise ConfigError(
                f"--soft takes axis or axis=newtons, e.g. 'y=2 z=5', got {word!r}"
            ) from None
        if cap is not None and not 0.0 <= cap < math.inf:
            raise ConfigError(f"--soft {word}: a cap is a number from 0 up, got {cap:g}")
        for axis in Task(axes=name).names:
            if axis in found:
                raise ConfigError(f"--soft {soft!r} names {axis} twice: one cap an axis")
            found[axis] = cap
    return found


def softened(settings: Settings, soft: str, model: Model, *, holds: bool) -> Settings:
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
    axes: dict[str, Axis] = {} if holds else dict(settings.axes.items())
    found = caps(soft, task)
    strongest: dict[str, Axis] = dict(Controller(model, Settings.firm(task=task)).axes.items())
    preset: dict[str, Axis] = dict(Settings.soft(" ".join(found), task=task).axes.items())
    for name, cap in found.items():
        hold = strongest[name].hold
        if cap is not None and hold is not None and cap > hold:
            unit = "N" if name in "xyz" else "N·m"
            raise ConfigError(
                f"--soft {name}={cap:g}: this arm holds {name} with at most {hold:.3g} {unit}; a "
                "cap is at most that"
            )
        if cap is not None:
            axes[name] = Axis(soft=cap, profile="constant")
        else:
            axes[name] = Axis(yields="both") if holds else preset[name]
    return settings.replace(axes=axes)
