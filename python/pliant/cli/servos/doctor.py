"""`pliant servos doctor`: check an arm's configuration, ports and servos."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from pliant._core import ConfigError, PliantError
from pliant.cli._flags import ArmName, ConfigFlags, Seconds, check_duration
from pliant.cli.servos._joint_monitor import watch as watch_joints
from pliant.config.doctor import examine

#: Printed mark, with its colour, of each level of a finding.
MARKS = {"good": "[green]ok  [/]", "note": "[yellow]note[/]", "bad": "[red]bad [/]"}
#: Last line of the output if no problem was found on real or emulated servos.
READY = (
    "ready, except for a check by eye: does the angle of each joint grow in the right direction? "
    "Run the same command with --watch before the torque is switched on"
)


def run(
    arm: ArmName,
    *,
    override: ConfigFlags,
    watch: bool = False,
    duration: Seconds = None,
) -> None:
    """Check files, ports, servos and this machine; nothing is written and nothing moves.

    The sign of a joint needs a check by eye: --watch shows the angles while a hand moves the
    joints, and the direction in which the tool must move as each angle grows.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        override: Values that replace those of the configuration file.
        watch: Show the joint angles until Ctrl-C, with torque off.
        duration: Time after which the command ends [s]. Needs --watch.
    """
    if duration is not None and not watch:
        raise ConfigError("--duration belongs to --watch, which was not given")
    check_duration(duration)
    console, problem_count = Console(), 0
    arm_config = override.load(arm)
    if watch:
        watch_joints(arm_config, console, duration)
        return
    for finding in examine(arm_config):
        problem_count += finding.level == "bad"
        console.print(
            f"{MARKS[finding.level]} [bold]{escape(finding.about)}[/]: {escape(finding.text)}",
            soft_wrap=True,
            highlight=False,
        )
    if problem_count:
        raise PliantError(
            f"not ready: {problem_count} {'problem' if problem_count == 1 else 'problems'} to fix"
        )
    console.print("ready" if arm_config.backend == "sim" else READY, highlight=False)
