"""`pliant run`: let a compliant arm hold its pose or follow targets, and show a live table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from rich.live import Live

from pliant._core import Command, Controller, Model
from pliant._validation import AXES
from pliant.cli._console import Console, make_table, print_summary
from pliant.cli._control import check_settings, load, make_loop
from pliant.cli._flags import ArmName, Axes, ConfigFlags, File, Seconds
from pliant.cli._targets import Targets, open_targets
from pliant.config import connect

if TYPE_CHECKING:
    from rich.table import Table

    from pliant._typing import Array
    from pliant.arm import Arm
    from pliant.loop import Loop, Tick

#: Refresh rate of the live table [Hz].
TABLE_RATE = 5.0
#: Without --duration, the command ends this long after the last target [s].
HOLD_TIME = 2.0
#: Distance of the tool from the last target above which the target is reported as missed [m].
TARGET_TOLERANCE = 0.02
#: Distance from a position limit below which a joint counts as at its limit [rad].
LIMIT_MARGIN = 0.05


def run(
    arm: ArmName,
    *,
    soft: Axes = "",
    targets: Annotated[str, tyro.conf.arg(metavar="FILE|-|udp:PORT")] = "",
    duration: Seconds = None,
    override: ConfigFlags,
    log: File = None,
    quiet: bool = False,
) -> None:
    """Switch torque on, control the arm until Ctrl-C, and lower it.

    A target is one line of JSON: {"position": [x, y, z]} in m, base axes, and optionally the
    orientation as quaternion "wxyz" or "xyzw"; or joint positions {"q": [...]} in rad.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        soft: Axes that yield: "y yaw" with the arm's default caps, "y=2 z=5" with caps of 2 and 5 N
            (N·m for roll, pitch, yaw). The other axes keep their settings.
        targets: Source of targets: a file with one target per line and control cycle, - for
            standard input, or udp:PORT for datagrams on this machine. Default: the arm holds its
            pose.
        duration: Time after which the command ends [s].
        override: Values that replace those of the configuration file.
        log: MCAP file to write (needs the extra log).
        quiet: Do not show the table.
    """
    arm_config, settings = load(arm, override, soft, duration=duration, log=log, source=targets)
    connected = connect(arm_config)
    # Check the settings here, to raise errors before torque is on.
    check_settings(connected, settings)
    runs: list[tuple[Arm, Loop, list[str]]] = []
    try:
        with open_targets(targets, arm_config.model()) as source, connected as live:
            loop = make_loop(live, settings, arm_config, duration=duration, log=log)
            _follow(runs, live, loop, source=source, quiet=quiet)
    finally:
        # Print only after the arm is lowered: a blocked terminal must not delay the descent.
        for finished in runs:
            print_summary(*finished)


def _follow(
    runs: list[tuple[Arm, Loop, list[str]]],
    arm: Arm,
    loop: Loop,
    *,
    source: Targets,
    quiet: bool,
) -> None:
    """Run the control loop, in which the tool follows the targets.

    `runs` gets the tuple (arm, loop, notes) at the start, for a summary that is also printed after
    an error.
    """
    notes: list[str] = []
    runs.append((arm, loop, notes))
    ticks_per_refresh = max(round(1.0 / (TABLE_RATE * loop.period)), 1)
    pose: Array | None = None
    last_target, has_target = 0.0, False
    with Live(console=Console(), auto_refresh=False, transient=True) as live:
        for tick in loop:
            tool = arm.model.forward_kinematics(tick.q)
            pose = tool if pose is None else pose
            target = source.latest()
            if target is not None:
                pose = target.pose(arm.model, pose)
                last_target, has_target = tick.time, True
            if source.done and loop.duration is None and tick.time - last_target > HOLD_TIME:
                break
            command = tick.step(pose)
            if not quiet and tick.index % ticks_per_refresh == 0:
                live.update(_table(arm, loop.controller, tick, command, tool), refresh=True)
    if has_target and pose is not None:
        notes += _describe_target_error(arm.model, tick.q, pose)


def _describe_target_error(model: Model, q: Array, target: Array) -> list[str]:
    """Return a sentence in a list if the tool missed the target pose (4, 4), else an empty list."""
    distance = float(np.linalg.norm((model.forward_kinematics(q) - target)[:3, 3]))
    if distance <= TARGET_TOLERANCE:
        return []
    margin = np.minimum(q - model.lower, model.upper - q)
    names = [
        name
        for name, distance_to_limit in zip(model.joint_names, margin, strict=True)
        if distance_to_limit < LIMIT_MARGIN
    ]
    why = (
        f"; at their limits: {', '.join(names)}. The tool moves straight to its target and does "
        "not avoid position limits: start in another pose"
    )
    return [f"the tool is {distance * 1e3:.0f} mm off its last target{why if names else ''}"]


def _table(
    arm: Arm,
    controller: Controller,
    tick: Tick,
    command: Command,
    tool: Array,
) -> Table:
    """Return the live table: tool position, deviation and softness per task axis, joint states."""
    right = ("tool", "off by", "softness", "q", "limit", "of usable", "heat")
    title = f"{arm.name}, {tick.time:.0f} s"
    table = make_table("axis", *right[:3], "joint", *right[3:], right=right, title=title)
    axes = controller.settings.task.names
    last = controller.diagnostics
    error, softness = last.deviation, last.softness
    limit, max_torque, heat = command.torque_limit, np.asarray(arm.servos.max_torque), arm.heat
    for row in range(max(len(axes), arm.model.n)):
        cells = [""] * 9
        if row < len(axes):
            index = AXES.index(axes[row])
            unit = "mm" if index < 3 else "mrad"
            cells[0] = axes[row]
            cells[1] = f"{tool[index, 3] * 1e3:.0f} mm" if index < 3 else ""
            cells[2] = f"{error[row] * 1e3:+.1f} {unit}"
            cells[3] = f"{softness[row]:.2f}"
        if row < arm.model.n:
            name = arm.model.joint_names[row]
            cells[4:] = [
                name,
                f"{tick.q[row]:+.3f}",
                f"{limit[row]:.2f} N·m",
                f"{limit[row] / max_torque[row]:.0%}",
                f"{heat[name]:.0%}",
            ]
        table.add_row(*cells)
    return table
