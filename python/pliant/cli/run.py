"""`pliant run`: hold an arm compliantly, or let it follow targets, with a live table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.live import Live
from rich.table import Table

from pliant._core import Command, Controller, Model
from pliant._validation import AXES
from pliant.cli._console import print_line
from pliant.cli._flags import (
    ArmName,
    Axes,
    ConfigFlags,
    File,
    Seconds,
    apply_soft,
    check_duration,
    check_log,
    recorder_of,
)
from pliant.cli._targets import Targets, open_targets
from pliant.config import connect
from pliant.loop import Loop

if TYPE_CHECKING:
    from pliant._typing import Array
    from pliant.arm import Arm
    from pliant.loop import Tick

#: Refresh rate of the table [Hz].
FRAMES = 5.0
#: Time for which the last target is held without --duration [s].
LINGER = 2.0
#: Final distance to the target that is reported [m], and distance to a joint limit [rad].
MISSED, AT_LIMIT = 0.02, 0.05


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

    A line of targets is a JSON object: {"position": [x, y, z]} in metres, base axes, with
    "wxyz": [w, x, y, z] or "xyzw" if it shall turn too; or {"q": [...]} in rad.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        soft: Axes that yield: "y yaw" with the arm's own caps, "y=2 z=5" capped at 2 and 5 N (N·m
            for roll, pitch, yaw). The other axes stay as the file has them.
        targets: Where targets come from: a file with one a line, as {"position": [0.2, 0, 0.2]}
            [m] or {"q": [0, 0.1, ...]} [rad], played at the loop's rate; - for standard input;
            udp:PORT for datagrams on this machine. Nothing: the arm holds.
        duration: Ends by itself after this time [s].
        override: Values that replace those of the configuration file.
        log: MCAP file to write (extra log).
        quiet: No table.
    """
    read = override.load(arm)
    check_log(log, [*override.inputs(arm, read), targets])
    settings = read.settings()
    check_duration(duration)
    model = read.model()
    settings = apply_soft(settings, soft, model, holds=False)
    connected = connect(read)
    # Check the settings before torque comes on.
    Controller(connected.model, settings, connected.servos)
    made: list[tuple[Arm, Loop, list[str]]] = []
    try:
        with open_targets(targets, model) as source, connected as live:
            controller = Controller(live.model, settings, live.servos)
            rate = controller.settings.rate
            recorder = None if log is None else recorder_of(log, config=read)
            loop = Loop(live, controller, rate=rate, duration=duration, recorder=recorder)
            _follow(made, live, loop, source=source, quiet=quiet)
    finally:
        # After the descent, also after Ctrl-C: a terminal may block.
        for ended in made:
            _summary(*ended)


def _follow(
    made: list[tuple[Arm, Loop, list[str]]],
    arm: Arm,
    loop: Loop,
    *,
    source: Targets,
    quiet: bool,
) -> None:
    """Follow the targets; append the loop to `made` for the summary."""
    notes: list[str] = []
    made.append((arm, loop, notes))
    every = max(round(1.0 / (FRAMES * loop.period)), 1)
    pose: Array | None = None
    last_target, is_led = 0.0, False
    with Live(console=Console(), auto_refresh=False, transient=True) as live:
        for tick in loop:
            here = arm.model.forward_kinematics(tick.q)
            pose = here if pose is None else pose
            target = source.latest()
            if target is not None:
                pose = target.pose(arm.model, pose)
                last_target, is_led = tick.time, True
            if source.done and loop.duration is None and tick.time - last_target > LINGER:
                break
            command = tick.step(pose)
            if not quiet and tick.index % every == 0:
                live.update(_table(arm, loop.controller, tick, command, here), refresh=True)
    if is_led and pose is not None:
        notes += _missed(arm.model, tick.q, pose)


def _missed(model: Model, q: Array, target: Array) -> list[str]:
    """Return a sentence on a missed target, with the joints at their limits."""
    off = float(np.linalg.norm((model.forward_kinematics(q) - target)[:3, 3]))
    if off <= MISSED:
        return []
    room = np.minimum(q - model.lower, model.upper - q)
    names = [name for name, left in zip(model.joint_names, room, strict=True) if left < AT_LIMIT]
    why = (
        f"; at their limits: {', '.join(names)}. The tool goes straight to its target and looks "
        "for no way round: begin in another pose"
    )
    return [f"the tool is {off * 1e3:.0f} mm off its last target{why if names else ''}"]


def _summary(arm: Arm, loop: Loop, notes: list[str]) -> None:
    for note in notes:
        print_line(note)
    counts = ", ".join(f"{name} {count}" for name, count in arm.counters.items() if count)
    Console().print(
        f"{len(loop.lateness)} ticks, late by {loop.lateness}; {loop.missed} missed; bus: {counts}",
        highlight=False,
    )


def _table(
    arm: Arm,
    controller: Controller,
    tick: Tick,
    command: Command,
    here: Array,
) -> Table:
    """Return the table: tool, compliance of each axis, torque limits, temperatures."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title=f"{arm.model.name}, {tick.time:.0f} s")
    for name in ("axis", "tool", "off by", "softness", "joint", "q", "limit", "of usable", "heat"):
        table.add_column(name, justify="left" if name in {"axis", "joint"} else "right")
    axes = controller.settings.task.names
    last = controller.diagnostics
    error, softness = last.deviation, last.softness
    limit, usable, heat = command.torque_limit, np.asarray(arm.servos.max_torque), arm.heat
    for row in range(max(len(axes), arm.model.n)):
        cells = [""] * 9
        if row < len(axes):
            place = AXES.index(axes[row])
            unit = "mm" if place < 3 else "mrad"
            cells[0] = axes[row]
            cells[1] = f"{here[place, 3] * 1e3:.0f} mm" if place < 3 else ""
            cells[2] = f"{error[row] * 1e3:+.1f} {unit}"
            cells[3] = f"{softness[row]:.2f}"
        if row < arm.model.n:
            name = arm.model.joint_names[row]
            cells[4:] = [
                name,
                f"{tick.q[row]:+.3f}",
                f"{limit[row]:.2f} N·m",
                f"{limit[row] / usable[row]:.0%}",
                f"{heat[name]:.0%}",
            ]
        table.add_row(*cells)
    return table
