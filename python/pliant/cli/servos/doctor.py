"""`pliant servos doctor`: check an arm's configuration, ports and servos."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from pliant._core import ConfigError, PliantError
from pliant.cli._flags import ArmName, ConfigFlags, Seconds, check_duration
from pliant.cli.servos._joint_monitor import watch as watch_joints
from pliant.config.doctor import examine

MARKS = {"good": "[green]ok  [/]", "note": "[yellow]note[/]", "bad": "[red]bad [/]"}
READY = (
    "ready, but for what no program sees: whether each joint is counted the right way round. "
    "Before torque comes on: the same command with --watch"
)


def run(
    arm: ArmName,
    *,
    override: ConfigFlags,
    watch: bool = False,
    duration: Seconds = None,
) -> None:
    """Look at files, ports, servos and this machine; nothing is written and nothing moves.

    Which way round a joint is counted no program sees: --watch shows the angles while a hand moves
    the joints, and which way the tool must go as each grows.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        override: Values that replace those of the configuration file.
        watch: Show the joints, torque off, until Ctrl-C: to check their directions by eye.
        duration: Ends by itself after this time [s]. Needs --watch.
    """
    if duration is not None and not watch:
        raise ConfigError("--duration belongs to --watch, which was not given")
    check_duration(duration)
    console, bad = Console(), 0
    read = override.load(arm)
    if watch:
        watch_joints(read, console, duration)
        return
    for finding in examine(read):
        bad += finding.level == "bad"
        console.print(
            f"{MARKS[finding.level]} [bold]{escape(finding.about)}[/]: {escape(finding.text)}",
            soft_wrap=True,
            highlight=False,
        )
    if bad:
        raise PliantError(f"not ready: {bad} {'problem' if bad == 1 else 'problems'} to fix")
    console.print("ready" if read.backend == "sim" else READY, highlight=False)
