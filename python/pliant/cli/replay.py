"""`pliant replay`: play a recorded motion with a compliant arm."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from pliant import teach
from pliant._core import ConfigError, Controller, PliantError
from pliant.cli._console import Console, Keyboard, print_line
from pliant.cli._flags import (
    ArmName,
    Axes,
    ConfigFlags,
    Duration,
    File,
    MotionFile,
    check_log,
    make_recorder,
)
from pliant.config import connect
from pliant.config._soft import apply_soft
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
    max_wait: Duration = 30.0,
    stop: Annotated[float | None, tyro.conf.arg(metavar="NEWTONS")] = None,
    times: int = 1,
    log: File = None,
    override: ConfigFlags,
) -> None:
    """Move to the start of the motion, play the motion, and lower the arm.

    The motion pauses while the tool deviates by more than --wait, for example at an obstacle. After
    a pause of --max-wait the command ends with an error, and lowers the arm.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        motion: Motion file. A file of `pliant teach` (.json), or a log (.mcap).
        soft: Axes that yield: "y yaw" with the arm's default caps, "y=2 z=5" with caps of 2 and 5 N
            (N·m for roll, pitch, yaw). The other axes hold. Default: settings of the configuration.
        speed: Factor on the speed of the motion.
        wait: Deviations of the tool [m] [rad] above which the motion pauses.
        max_wait: Longest pause [s]; inf: no limit.
        stop: Force [N] at which the arm stops; Enter continues. Default: the arm never stops.
        times: Number of repetitions.
        log: MCAP file to write (needs the extra log).
        override: Values that replace those of the configuration file.
    """
    arm_config = override.load(arm)
    check_log(log, [*override.inputs(arm, arm_config), motion])
    settings = apply_soft(
        arm_config.settings(), soft, arm_config.model(), holds=True, option="--soft"
    )
    if times < 1:
        raise ConfigError(f"--times must be at least 1, got {times}")
    if not max_wait > 0.0:
        raise ConfigError(f"--max-wait must be above 0 s, got {max_wait:g}")
    loaded = _load(motion)
    loaded.validate_for(arm_config.model())
    options: dict[str, Any] = {"speed": speed, "wait": wait, "stop": stop}
    connected = connect(arm_config)
    # Check settings and motion here, to raise errors before torque is on.
    teach.Replay(Controller(connected.model, settings, connected.servos), loaded, **options)
    player = _Player(times, max_wait)
    try:
        with connected as live:
            controller = Controller(live.model, settings, live.servos)
            replay = partial(teach.Replay, motion=loaded, **options)
            note = f"replay of {motion}"
            recorder = None if log is None else make_recorder(log, config=arm_config, note=note)
            player.run(Loop(live, controller, recorder=recorder), live, replay)
    finally:
        player.summary()


def _load(path: Path) -> teach.Motion:
    """Load a motion from a motion file or a log; print a note if the log is incomplete."""
    if path.suffix != ".mcap":
        return teach.Motion.load(path)
    from pliant.log import read

    log = read(path)
    try:
        loaded = teach.Motion.from_log(log)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    if not log.whole:
        print_line(
            f"{path} was cut short: it is played up to {loaded.duration:.2f} s, where it ends"
        )
    return loaded


class _Player:
    """Plays a motion a number of times and prints changes of its state."""

    def __init__(self, times: int, max_wait: float) -> None:
        """Create a player of `times` repetitions with pauses of at most `max_wait` [s]."""
        self._times, self._play_count = times, 0
        self._max_wait = max_wait
        self._duration = self._waiting_time = 0.0
        self._console = Console()

    def run(self, loop: Loop, arm: Arm, make: Callable[..., Replay]) -> None:
        """Play the motion in the control loop; `make` creates the `Replay` of a controller.

        Raises:
            PliantError: The motion paused for longer than `max_wait`.
        """
        keys, replay, last_state = Keyboard(), make(loop.controller), ""
        start: float | None = None
        # Waiting time of the repetitions before the present one, and time of the last tick that
        # was not blocked [s].
        waited_before, free = 0.0, 0.0
        for tick in loop:
            start = tick.time if start is None else start
            self._duration = tick.time - start
            command = replay.step(tick.q, dt=tick.dt, load=tick.state.load)
            tick.write(command, replay.extra(arm))
            self._waiting_time = waited_before + replay.blocked_time
            if replay.state != "blocked":
                free = self._duration
            elif self._duration - free > self._max_wait:
                raise PliantError(
                    f"the motion has paused for {self._max_wait:g} s (--max-wait) at "
                    f"{replay.time:.2f} s: the tool deviates by more than --wait. Remove the "
                    "obstacle, give the axes more force (--soft), or more --wait or --max-wait"
                )
            if keys.pressed():
                replay.resume()
            if replay.state != last_state:
                last_state = replay.state
                hint = {
                    "stopped": ": contact force above --stop; Enter continues",
                    "blocked": ": deviation above --wait; the motion pauses",
                }
                self._console.print(
                    f"{self._duration:6.2f} s  {last_state}{hint.get(last_state, '')}",
                    highlight=False,
                )
            if replay.done:
                self._play_count, waited_before = self._play_count + 1, self._waiting_time
                if self._play_count == self._times:
                    break
                replay = make(loop.controller)

    def summary(self) -> None:
        """Print repetitions, duration and paused time; called after the arm is lowered."""
        if self._duration > 0.0:
            times = "1 time" if self._play_count == 1 else f"{self._play_count} times"
            whole = times if self._play_count == self._times else f"{times} of {self._times}"
            self._console.print(
                f"played {whole} in {self._duration:.1f} s, waited {self._waiting_time:.1f} s",
                highlight=False,
            )
