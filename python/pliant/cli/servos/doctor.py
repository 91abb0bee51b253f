"""`pliant servos doctor`: check an arm's configuration, ports and servos."""

from __future__ import annotations

from pathlib import Path

from rich.markup import escape

from pliant._core import ConfigError, PliantError
from pliant.cli._console import Console, Keyboard, print_line
from pliant.cli._flags import ArmName, ConfigFlags, File, Seconds, check_duration
from pliant.cli._measurements import Measurements
from pliant.cli.servos._joint_monitor import watch as watch_joints
from pliant.cli.servos._measure import Session
from pliant.config import connect
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
    measure: bool = False,
    report: File = None,
) -> None:
    """Check files, ports, servos and this machine; nothing is written and nothing moves.

    The sign of a joint needs a check by eye: --watch shows the angles while a hand moves the
    joints, and the direction in which the tool must move as each angle grows.

    --measure moves the arm. In a session of 5 minutes with a kitchen scale and a weight, it
    measures servos, forces, latencies and the descent, compares them with the assumed values, and
    writes the file of --report.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        override: Values that replace those of the configuration file.
        watch: Show the joint angles until Ctrl-C, with torque off.
        duration: Time after which the command ends [s]. Needs --watch.
        measure: Measure the arm with the help of a person, who answers questions.
        report: Measurements file (JSON) to write or to continue, ready to be sent in. Needs
            --measure; by default measurements.json.
    """
    if duration is not None and not watch:
        raise ConfigError("--duration belongs to --watch, which was not given")
    if watch and measure:
        raise ConfigError("--watch needs torque off, and --measure switches it on: give one")
    if report is not None and not measure:
        raise ConfigError("--report belongs to --measure, which was not given")
    check_duration(duration)
    console, problem_count = Console(), 0
    arm_config = override.load(arm)
    if measure:
        path = Path("measurements.json") if report is None else report
        file = Measurements(path, override.inputs(arm, arm_config))
        try:
            session = Session(
                connect(arm_config), arm_config, file, Keyboard(), lambda s: print_line(s, console)
            )
            session.run()
        finally:
            if file.steps:
                console.print(file.table())
                print_line(f"{path}: {', '.join(file.steps)}", console)
        return
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
