"""`pliant replay`: play a motion compliantly."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console

from pliant import teach
from pliant._core import ConfigError, Controller
from pliant.cli._console import EnterKey, print_line
from pliant.cli._flags import (
    ArmName,
    Axes,
    ConfigFlags,
    File,
    MotionFile,
    apply_soft,
    check_log,
    recorder_of,
)
from pliant.config import connect
from pliant.loop import Loop

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pliant.arm import Arm
    from pliant.teach import Replay


def run(
    arm: ArmName,
    motion: MotionFile,
    *,
    soft: Axes = "",
    speed: float = 1.0,
    wait: tuple[float, float] = (0.03, 0.25),
    stop: Annotated[float | None, tyro.conf.arg(metavar="NEWTONS")] = None,
    times: int = 1,
    log: File = None,
    override: ConfigFlags,
) -> None:
    """Go to where the motion begins, play it, and lower the arm.

    What is blocked waits: the motion's clock stands while the tool is farther off than --wait, and
    goes on when it is let go.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        motion: Motion file. One of `pliant teach` (.json), or a log (.mcap).
        soft: Axes that yield: "y yaw" with the arm's own caps, "y=2 z=5" capped at 2 and 5 N (N·m
            for roll, pitch, yaw). The other axes hold. Default: the file's settings.
        speed: Factor on the motion's speed.
        wait: Deviation of the tool [m], [rad] at which the motion waits.
        stop: Force [N] that stops the arm; Enter goes on. Nothing: never.
        times: How often.
        log: MCAP file to write (extra log).
        override: Values that replace those of the configuration file.
    """
    read = override.load(arm)
    check_log(log, [*override.inputs(arm, read), motion])
    settings = apply_soft(read.settings(), soft, read.model(), holds=True)
    if times < 1:
        raise ConfigError(f"--times must be at least 1, got {times}")
    loaded = _load(motion)
    loaded.validate_for(read.model())
    options: dict[str, Any] = {"speed": speed, "wait": wait, "stop": stop}
    made = connect(read)
    # Check that controller and motion fit before torque comes on.
    teach.Replay(Controller(made.model, settings, made.servos), loaded, **options)
    play = _Play(times)
    try:
        with made as live:
            controller = Controller(live.model, settings, live.servos)
            replay = partial(teach.Replay, motion=loaded, **options)
            note = f"replay of {motion}"
            recorder = None if log is None else recorder_of(log, config=read, note=note)
            play.run(Loop(live, controller, recorder=recorder), live, replay)
    finally:
        play.summary()


def _load(path: Path) -> teach.Motion:
    """Load a motion; print a note if its log ends early."""
    if path.suffix != ".mcap":
        return teach.Motion.load(path)
    from pliant.log import read

    log = read(path)
    try:
        made = teach.Motion.from_log(log)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    if not log.whole:
        print_line(f"{path} was cut short: it is played up to {made.duration:.2f} s, where it ends")
    return made


class _Play:
    """Plays a motion a number of times, and prints its state."""

    def __init__(self, times: int) -> None:
        """Start with no motion played."""
        self._times, self._played = times, 0
        self._took = self._waited = 0.0
        self._console = Console()

    def run(self, loop: Loop, arm: Arm, make: Callable[..., Replay]) -> None:
        """Play the motion."""
        keys, replay, shown = EnterKey(), make(loop.controller), ""
        begun: float | None = None
        for tick in loop:
            begun = tick.time if begun is None else begun
            self._took = tick.time - begun
            command = replay.step(tick.q, dt=tick.dt, load=tick.state.load)
            tick.write(command, replay.extra(arm))
            if keys.pressed():
                replay.resume()
            if replay.state != shown:
                shown = replay.state
                hint = {"stopped": ": something pushes; Enter goes on", "blocked": ": it waits"}
                self._console.print(
                    f"{replay.time:6.2f} s  {shown}{hint.get(shown, '')}", highlight=False
                )
            if replay.done:
                self._played, self._waited = self._played + 1, self._waited + replay.blocked_time
                if self._played == self._times:
                    break
                replay = make(loop.controller)

    def summary(self) -> None:
        """Print how often it was played, after the descent: a terminal may block."""
        if self._took > 0.0:
            times = "1 time" if self._played == 1 else f"{self._played} times"
            whole = times if self._played == self._times else f"{times} of {self._times}"
            self._console.print(
                f"played {whole} in {self._took:.1f} s, waited {self._waited:.1f} s",
                highlight=False,
            )
