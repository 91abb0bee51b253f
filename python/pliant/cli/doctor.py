"""`pliant doctor`: what stands between a configuration and a soft arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from pliant import ConfigError, config
from pliant.config.doctor import examine

MARKS = {"good": "[green]ok  [/]", "note": "[yellow]note[/]", "bad": "[red]bad [/]"}


def run(
    arm: Annotated[str, tyro.conf.Positional],
    *,
    port: str | None = None,
    backend: str | None = None,
    urdf: Path | None = None,
    calibration: Path | None = None,
) -> None:
    """Look at files, ports, servos and this machine; nothing is written and nothing moves.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        port: Device in place of the file's.
        backend: bus, emulator or sim in place of the file's.
        urdf: URDF in place of the file's.
        calibration: LeRobot's calibration file in place of the file's.
    """
    console, bad = Console(), 0
    read = config.load(arm, port=port, backend=backend, urdf=urdf, calibration=calibration)
    for finding in examine(read):
        bad += finding.level == "bad"
        console.print(
            f"{MARKS[finding.level]} [bold]{escape(finding.about)}[/]: {escape(finding.text)}",
            highlight=False,
        )
    if bad:
        raise ConfigError(f"{bad} to be mended")
    console.print("ready")
