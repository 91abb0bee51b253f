"""`pliant replay`: play a motion softly."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

from rich.console import Console

import pliant
from pliant.cli.files import check_log
from pliant.cli.flags import ArmName, Axes, File, MotionFile, Override
from pliant.cli.keys import Keys
from pliant.cli.soft import check_soft

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pliant.arm import Arm
    from pliant.log import Recorder
    from pliant.teach import Replay


def run(
    arm: ArmName,
    motion: MotionFile,
    *,
    soft: Axes = "",
    speed: float = 1.0,
    wait: tuple[float, float] = (0.03, 0.25),
    stop: float | None = None,
    times: int = 1,
    log: File = None,
    override: Override,
) -> None:
    """Go to where the motion begins, play it, and lower the arm.

    What is blocked waits: the motion's clock stands while the tool is farther off than --wait, and
    goes on when it is let go.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        motion: File of `pliant teach`, or a log (.mcap).
        soft: How soft each axis is: "y=2 z=5" caps these at 2 and 5 N (N·m for roll, pitch, yaw),
            "y" takes the arm's own caps; the others hold. Nothing: the file's settings.
        speed: Factor on the motion's speed.
        wait: Deviation of the tool [m], [rad] at which the motion waits.
        stop: Force [N] that stops the arm; Enter goes on. Nothing: never.
        times: How often.
        log: MCAP file to write (extra log).
        override: What the command line says in place of the file.
    """
    check_log(log)
    read = override.load(arm)
    settings = softened(read.settings(), soft)
    if times < 1:
        raise pliant.ConfigError(f"--times must be at least 1, got {times}")
    loaded = _load(motion)
    loaded.fits(read.model())
    options: dict[str, Any] = {"speed": speed, "wait": wait, "stop": stop}
    made = read.arm()
    # What does not go together is said before torque comes on.
    pliant.teach.Replay(pliant.Controller(made.model, settings, made.servos), loaded, **options)
    with made as live:
        controller = pliant.Controller(live.model, settings, live.servos)
        replay = partial(pliant.teach.Replay, motion=loaded, **options)
        if log is None:
            _play(live, controller, replay, times, None)
            return
        from pliant.log import Recorder

        with Recorder(log, live, controller, config=read, note=f"replay of {motion}") as recorder:
            _play(live, recorder.controller, replay, times, recorder)


def _load(path: Path) -> pliant.teach.Motion:
    """The motion, with a word if it is of a log that ends early."""
    if path.suffix != ".mcap":
        return pliant.teach.Motion.load(path)
    from pliant.log import read

    log = read(path)
    try:
        made = pliant.teach.Motion.logged(log)
    except pliant.ConfigError as error:
        raise pliant.ConfigError(f"{path}: {error}") from error
    if not log.whole:
        Console().print(
            f"{path} was cut short: it is played up to {made.duration:.2f} s, where it ends",
            highlight=False,
            soft_wrap=True,
        )
    return made


def _play(
    arm: Arm, controller: Any, make: Callable[..., Replay], times: int, recorder: Recorder | None
) -> None:
    """Play it, and say what happens."""
    console, keys, replay, said, left = Console(), Keys(), make(controller), "", times
    begun = waited = 0.0
    for tick in pliant.Loop(arm, controller):
        begun = begun or tick.time
        command = replay.step(tick.q, dt=tick.dt, load=tick.state.load)
        tick.write(command, replay.extra(arm))
        if recorder is not None:
            recorder.add(tick, command)
        if keys.enter():
            replay.resume()
        if replay.state != said:
            said = replay.state
            hint = {"stopped": ": something pushes; Enter goes on", "blocked": ": it waits"}
            console.print(f"{replay.time:6.2f} s  {said}{hint.get(said, '')}", highlight=False)
        if replay.done:
            left, waited = left - 1, waited + replay.waited
            if not left:
                break
            replay = make(controller)
    console.print(
        f"played {times} times in {tick.time - begun:.1f} s, waited {waited:.1f} s",
        highlight=False,
    )


def softened(settings: pliant.Settings, soft: str) -> pliant.Settings:
    """Settings whose axes named in `soft` are capped, and whose others hold.

    Raises:
        ConfigError: A word is not `axis` or `axis=number`, or the axis is not the task's.
    """
    if not soft:
        return settings
    axes: dict[str, pliant.Axis] = {}
    for word in soft.replace(",", " ").split():
        name, given, number = word.partition("=")
        check_soft(name, settings.task, "task in [settings] of a file of your own")
        try:
            cap = float(number) if given else None
        except ValueError:
            raise pliant.ConfigError(
                f"--soft takes axis or axis=newtons, e.g. 'y=2 z=5', got {word!r}"
            ) from None
        if cap is not None and not 0.0 <= cap < math.inf:
            raise pliant.ConfigError(f"--soft {word}: a cap is a number from 0 up, got {cap:g}")
        if name in axes:
            raise pliant.ConfigError(f"--soft {soft!r} names {name} twice: one cap an axis")
        axes[name] = (
            pliant.Axis(yields="both") if cap is None else pliant.Axis(soft=cap, profile="constant")
        )
    return settings.replace(axes=axes)
