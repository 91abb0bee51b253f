"""Flags shared by several commands, with one meaning and one help text."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from pliant import config

#: A configuration file, or the name of a ready one.
ArmName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ARM")]
#: A motion of `pliant teach`, or a log.
MotionFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MOTION")]
LogFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
#: Optional file.
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
#: Output file.
Output = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
#: Port of this machine for the page.
HttpPort = Annotated[int, tyro.conf.arg(metavar="PORT")]
#: Present id and new id.
Ids = Annotated[str | None, tyro.conf.arg(metavar="OLD:NEW")]
Device = Annotated[str | None, tyro.conf.arg(metavar="DEVICE")]
Backend = Annotated[str | None, tyro.conf.arg(metavar="bus|emulator|sim")]
#: Optional time [s].
Seconds = Annotated[float | None, tyro.conf.arg(metavar="SECONDS")]
#: Time with a default [s].
Duration = Annotated[float, tyro.conf.arg(metavar="SECONDS")]
#: Names of task axes.
Axes = Annotated[str, tyro.conf.arg(metavar="AXES")]
OtherAxes = Annotated[str | None, tyro.conf.arg(metavar="AXES")]
#: Arm that replaces the usual one.
OtherArm = Annotated[str | None, tyro.conf.arg(metavar="ARM")]
#: A frame of a URDF.
Frame = Annotated[str | None, tyro.conf.arg(metavar="FRAME")]


@dataclass(frozen=True)
class Files:
    """What a command takes in place of the files that a configuration names.

    Attributes:
        urdf: URDF in place of the file's, which must not be written for a built-in model.
        calibration: LeRobot's calibration file in place of the file's.
    """

    urdf: File = None
    calibration: File = None

    def load(self, arm: str, backend: str | None = None) -> config.Config:
        """Load the configuration with these replacements; see `pliant.config.load`."""
        return config.load(arm, **({"backend": backend} | vars(self)))

    def inputs(self, arm: str, read: config.Config) -> list[Path]:
        """Return the input files of the configuration: a command must not overwrite them."""
        named = [read.robot.urdf, read.calibration]
        own = [read.folder / path.expanduser() for path in named if path is not None]
        given = [path for path in (self.urdf, self.calibration) if path is not None]
        return [Path(arm).expanduser(), *own, *given]

    def words(self) -> list[str]:
        """Return the given flags with their values, as command-line words."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        return [f"--{name} {shlex.quote(str(value))}" for name, value in given.items()]


@dataclass(frozen=True)
class Wired(Files):
    """What a command that talks to servos takes in place of what a configuration says.

    Attributes:
        port: Serial port. In place of the file's.
    """

    port: Device = None


@dataclass(frozen=True)
class Override(Wired):
    """What a command that may run without servos takes in place of what a configuration says.

    Attributes:
        backend: bus, emulator or sim in place of the file's.
    """

    backend: Backend = None
