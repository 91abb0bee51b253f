"""Compliant axes from one line of text: "y=2 z=5"."""

from __future__ import annotations

import math

from pliant._core import Axis, ConfigError, Controller, Model, Settings, Task


def apply_soft(
    settings: Settings, soft: str, model: Model, *, holds: bool = False, option: str = "soft"
) -> Settings:
    """Return settings in which the named axes yield to a push.

    Args:
        settings: Settings of a configuration.
        soft: "y=2" caps the force along y at 2 N (N·m for rotations); "y" uses the default caps of
            the arm; "" changes nothing.
        model: The arm.
        holds: True: all axes that `soft` does not name are stiff. False: they keep their settings.
        option: Name of the option in errors, such as "--soft".

    Raises:
        ConfigError: A word is invalid, is not an axis of the task, or repeats an axis; or a cap is
            above the arm's holding force.
    """
    if not soft:
        return settings
    task = settings.task
    axes: dict[str, Axis] = {} if holds else dict(settings.axes.items())
    caps = _parse_caps(soft, task, option)
    strongest: dict[str, Axis] = dict(Controller(model, Settings.firm(task=task)).axes.items())
    preset: dict[str, Axis] = dict(Settings.soft(" ".join(caps), task=task).axes.items())
    for name, cap in caps.items():
        hold = strongest[name].hold
        if cap is not None and hold is not None and cap > hold:
            unit = "N" if name in "xyz" else "N·m"
            raise ConfigError(
                f"{option} {name}={cap:g}: this arm holds {name} with at most {hold:.3g} {unit}; a "
                "cap is at most that"
            )
        if cap is not None:
            axes[name] = Axis(soft=cap, profile="constant")
        else:
            axes[name] = Axis(yields="both") if holds else preset[name]
    return settings.replace(axes=axes)


def _parse_caps(soft: str, task: Task, option: str) -> dict[str, float | None]:
    """Return the cap [N, N·m] of each axis in words "y" or "y=2"; None for an axis without a cap.

    Raises:
        ConfigError: A word is invalid, is not an axis of the task, or repeats an axis.
    """
    caps: dict[str, float | None] = {}
    for word in soft.replace(",", " ").split():
        name, has_cap, number = word.partition("=")
        check_axes(name, task, option, "task in [settings] of a file of your own")
        try:
            cap = float(number) if has_cap else None
        except ValueError:
            raise ConfigError(
                f"{option} takes axis or axis=newtons, e.g. 'y=2 z=5', got {word!r}"
            ) from None
        if cap is not None and not 0.0 <= cap < math.inf:
            raise ConfigError(f"{option} {word}: a cap is a number from 0 up, got {cap:g}")
        for axis in Task(axes=name).names:
            if axis in caps:
                raise ConfigError(f"{option} {soft!r} names {axis} twice: one cap per axis")
            caps[axis] = cap
    return caps


def check_axes(axes: str, task: Task, option: str, remedy: str) -> None:
    """Check that the task contains the named axes.

    `remedy` is the part of the error message that says how to choose another task.

    Raises:
        ConfigError: A word is not the name of an axis, or the task does not have the axis.
    """
    try:
        unknown = [name for name in Task(axes=axes).names if name not in task.names]
    except ConfigError as error:
        message = str(error).removeprefix("task.axes: ")
        raise ConfigError(f"{option} {axes!r}: {message}") from None
    if unknown:
        raise ConfigError(
            f"{option} {axes!r}: {', '.join(unknown)} is not an axis of the task, which has "
            f"{', '.join(task.names)}; {remedy}"
        )
