"""`pliant teach`: record a motion while a hand guides the arm."""

from __future__ import annotations

import os
import shlex
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NoReturn

import tyro

from pliant import teach
from pliant._core import ConfigError, PliantError
from pliant.cli._console import Console, Keyboard, print_line
from pliant.cli._flags import (
    ArmName,
    ConfigFlags,
    Duration,
    MotionFile,
    check_duration,
    check_writable,
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
    scripted_hand: bool = False,
    bounds: Annotated[
        tuple[float, float, float] | None, tyro.conf.arg(metavar="SPEED ACCELERATION JERK")
    ] = None,
    note: str = "",
    override: ConfigFlags,
) -> None:
    """Make the arm weightless, record its motion by hand, lower the arm, and write the motion.

    The arm first swings a little to measure its payload: do not touch it meanwhile. After Ctrl-C,
    the motion recorded so far is written.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        motion: Motion file. The command writes it; its name ends with .json.
        by: Start and end of the recording. rest: it starts as soon as the arm is ready, and ends
            when the arm has rested for 3 s. enter: at the Enter key. gripper: when a hand presses
            the gripper shut.
        duration: Time after which the command ends [s]. It counts from the start of the recording.
        scripted_hand: On a simulated arm (sim, emulator), let a scripted hand lead the tool.
        bounds: Maximum speed [rad/s], acceleration [rad/s²] and jerk [rad/s³] of every joint (needs
            ruckig). Default: the motion is only smoothed.
        note: Comment to store in the file.
        override: Values that replace those of the configuration file.
    """
    from dataclasses import replace

    if motion.suffix != ".json":
        raise ConfigError(f"a motion file ends with .json, got {motion}")
    check_duration(duration)
    if bounds is not None:
        import_ruckig(bounds)
    arm_config = override.load(arm)
    check_writable(motion, "motion", override.inputs(arm, arm_config))
    if by == "gripper" and arm_config.gripper is None:
        raise ConfigError(f"{arm} names no gripper: use --by enter or rest")
    if scripted_hand and arm_config.backend == "bus":
        raise ConfigError(
            "--scripted-hand leads simulated arms only: add --backend sim or emulator"
        )
    console = Console()
    keys = Keyboard() if by == "enter" else None

    def should_toggle(teacher: Teacher, state: State) -> bool:
        return teacher.gripper_pressed(state) if keys is None else keys.pressed()

    def on_status(line: str) -> None:
        console.print(line, highlight=False, markup=False)
        if line == RECORDING:
            start_hand()

    def save(recorded: Motion) -> None:
        recorded = replace(recorded, note=note)
        # Save before `retime` applies the bounds: after an error there, the motion is not lost.
        try:
            recorded.save(motion)
        except (ConfigError, OSError) as error:
            _save_elsewhere(recorded, motion, error)
        if bounds is not None:
            teach.retime(recorded, bounds).save(motion)
        files = map(shlex.quote, (arm, str(motion)))
        again = " ".join(["pliant replay", *files, *override.as_arguments()])
        print_line(f"{motion}: {recorded.duration:.1f} s; {again}", console)

    motions: list[Motion] = []
    interrupted: list[Motion] = []
    live = connect(arm_config)
    start_hand = prepare(live) if scripted_hand else lambda: None
    try:
        with live:
            try:
                motions.append(
                    teach.record(
                        live,
                        seconds=duration,
                        should_toggle=None if by == "rest" else should_toggle,
                        on_status=on_status,
                        on_interrupt=interrupted.append,
                    )
                )
            except PliantError as error:
                # Print it before the descent, which the user may leave by Ctrl-C.
                on_status(f"not taught: {error}")
                raise
    finally:
        # Write files only after the arm is lowered: a slow disk must not delay the descent.
        motions.extend(motion.trimmed().smoothed().for_model(live.model) for motion in interrupted)
        for recorded in motions:
            save(recorded)


def _save_elsewhere(recorded: Motion, file: Path, error: Exception) -> NoReturn:
    """Save a motion whose file cannot be written to the folder for temporary files.

    Raises:
        PliantError: Always; the text says where the motion is.
    """
    other = Path(tempfile.gettempdir()) / f"{file.stem}-{os.getpid()}.json"
    reason = f"{file}: {error.strerror}" if isinstance(error, OSError) else str(error)
    try:
        recorded.save(other)
    except (ConfigError, OSError):
        raise error from None
    raise PliantError(f"{reason}. The motion is in {other}: move it from there") from error
