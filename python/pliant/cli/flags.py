"""The flags that several commands share: they mean the same, and their help calls them alike."""

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
#: A file that need not be given.
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
#: What a command writes.
Output = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
#: A port of this machine on which a page is served.
HttpPort = Annotated[int, tyro.conf.arg(metavar="PORT")]
#: An id and the one that is to take its place.
Ids = Annotated[str | None, tyro.conf.arg(metavar="OLD:NEW")]
Device = Annotated[str | None, tyro.conf.arg(metavar="DEVICE")]
Backend = Annotated[str | None, tyro.conf.arg(metavar="bus|emulator|sim")]
#: A time that need not be given [s].
Seconds = Annotated[float | None, tyro.conf.arg(metavar="SECONDS")]
#: A time that has a default [s].
Duration = Annotated[float, tyro.conf.arg(metavar="SECONDS")]
#: Names of task axes.
Axes = Annotated[str, tyro.conf.arg(metavar="AXES")]
OtherAxes = Annotated[str | None, tyro.conf.arg(metavar="AXES")]
#: An arm in place of the usual one.
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
        """The configuration with these in place of its own; see `pliant.config.load`."""
        return config.load(arm, **({"backend": backend} | vars(self)))

    def inputs(self, arm: str, read: config.Config) -> list[Path]:
        """Files that the configuration is read from: none of them may be written."""
        named = [read.robot.urdf, read.calibration]
        own = [read.folder / path.expanduser() for path in named if path is not None]
        given = [path for path in (self.urdf, self.calibration) if path is not None]
        return [Path(arm).expanduser(), *own, *given]

    def words(self) -> list[str]:
        """Those that were given, each with its value, as one would type them again."""
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
