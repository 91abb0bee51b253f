"""Types of the flags that several commands share, so that their help calls them alike."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

#: A configuration file, or the name of a ready one.
ArmName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ARM")]
#: A motion of `pliant teach`, or a log.
MotionFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MOTION")]
LogFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
#: A file that need not be given.
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
Device = Annotated[str | None, tyro.conf.arg(metavar="DEVICE")]
Backend = Annotated[str | None, tyro.conf.arg(metavar="bus|emulator|sim")]
#: A time that need not be given [s].
Seconds = Annotated[float | None, tyro.conf.arg(metavar="SECONDS")]
#: Names of task axes.
Axes = Annotated[str, tyro.conf.arg(metavar="AXES")]
OtherAxes = Annotated[str | None, tyro.conf.arg(metavar="AXES")]
#: An arm in place of the usual one.
OtherArm = Annotated[str | None, tyro.conf.arg(metavar="ARM")]
#: A frame of a URDF.
Frame = Annotated[str | None, tyro.conf.arg(metavar="FRAME")]
