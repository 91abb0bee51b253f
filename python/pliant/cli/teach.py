"""`pliant teach`: record a motion by leading the arm by hand."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from pliant import teach
from pliant._core import ConfigError
from pliant.cli._console import EnterKey, print_line
from pliant.cli._flags import (
    ArmName,
    ConfigFlags,
    Duration,
    MotionFile,
    check_duration,
    check_written,
)
from pliant.config import connect
from pliant.teach._retiming import import_ruckig
from pliant.teach._scripted_hand import prepare
from pliant.teach.teacher import RECORDING

if TYPE_CHECKING:
    from pliant.arm import State
    from pliant.teach import Motion, Teacher


def run(
    arm: ArmName,
    motion: MotionFile,
    *,
    by: Literal["rest", "enter", "gripper"] = "rest",
    duration: Duration = 60.0,
    hand: bool = False,
    bounds: Annotated[
        tuple[float, float, float] | None, tyro.conf.arg(metavar="SPEED ACCELERATION JERK")
    ] = None,
    note: str = "",
    override: ConfigFlags,
) -> None:
    """Float the arm, record how it is led, trim and smooth it, and lower the arm.

    The arm first swings a little to find its weight: do not touch it meanwhile. Ctrl-C lowers
    the arm too, and what was led until then is written.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        motion: Motion file. It is written, and ends with .json.
        by: What starts and ends the recording: rest records at once and ends with a rest of 3 s;
            Enter; or the gripper pressed shut.
        duration: Ends by itself after this time [s]. It counts from the start of the recording.
        hand: Without an arm (sim, emulator): a scripted hand leads the tool aside and up.
        bounds: Speed [rad/s], acceleration [rad/s²] and jerk [rad/s³] that no joint of the motion
            may exceed (needs ruckig). Nothing: smoothed only.
        note: A line of your own.
        override: Values that replace those of the configuration file.
    """
    from dataclasses import replace

    if motion.suffix != ".json":
        raise ConfigError(f"a motion file ends with .json, got {motion}")
    check_duration(duration)
    if bounds is not None:
        import_ruckig(bounds)
    read = override.load(arm)
    check_written(motion, "motion", override.inputs(arm, read))
    if by == "gripper" and read.gripper is None:
        raise ConfigError(f"{arm} names no gripper: use --by enter or rest")
    if hand and read.backend == "bus":
        raise ConfigError("--hand leads simulated arms only: add --backend sim or emulator")
    console = Console()
    keys = EnterKey() if by == "enter" else None

    def should_toggle(teacher: Teacher, state: State) -> bool:
        return teacher.gripper_pressed(state) if keys is None else keys.pressed()

    def on_status(line: str) -> None:
        console.print(line, highlight=False, markup=False)
        if line == RECORDING:
            lead()

    def save(taken: Motion) -> None:
        taken = replace(taken, note=note)
        # Save the unbounded motion first, so that it is not lost if the bounds fail.
        taken.save(motion)
        if bounds is not None:
            teach.retime(taken, bounds).save(motion)
        files = map(shlex.quote, (arm, str(motion)))
        again = " ".join(["pliant replay", *files, *override.words()])
        print_line(f"{motion}: {taken.duration:.1f} s; {again}", console)

    made: list[Motion] = []
    cut: list[Motion] = []
    live = connect(read)
    lead = prepare(live) if hand else lambda: None
    try:
        with live:
            made.append(
                teach.record(
                    live,
                    seconds=duration,
                    should_toggle=None if by == "rest" else should_toggle,
                    on_status=on_status,
                    on_interrupt=cut.append,
                )
            )
    finally:
        # After the descent of the arm: writing a file can be slow.
        made.extend(motion.trimmed().smoothed().for_model(live.model) for motion in cut)
        for taken in made:
            save(taken)
