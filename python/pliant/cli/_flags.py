"""Flags shared by several commands, with one meaning and one help text, and their checks."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from pliant import config
from pliant._core import Axis, ConfigError, Controller, Model, Settings, Task
from pliant._files import check_output
from pliant.cli._console import print_line

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pliant.config import Config
    from pliant.log import Recorder


#: A configuration file, or the name of a ready one.
ArmName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ARM")]
#: A motion of `pliant teach`, or a log.
MotionFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MOTION")]
LogFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
#: Optional file, to read or to write.
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
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
class FileFlags:
    """Flags that replace files named by a configuration.

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
        flags = [path for path in (self.urdf, self.calibration) if path is not None]
        return [Path(arm).expanduser(), *own, *flags]

    def words(self) -> list[str]:
        """Return the given flags with their values, as command-line words."""
        flags = {name: value for name, value in vars(self).items() if value is not None}
        return [f"--{name} {shlex.quote(str(value))}" for name, value in flags.items()]


@dataclass(frozen=True)
class BusFlags(FileFlags):
    """Flags of commands that talk to servos.

    Attributes:
        port: Serial port. In place of the file's.
    """

    port: Device = None


@dataclass(frozen=True)
class ConfigFlags(BusFlags):
    """Flags of commands that can run without servos.

    Attributes:
        backend: bus, emulator or sim in place of the file's.
    """

    backend: Backend = None


def check_duration(seconds: float | None) -> None:
    """Check `--duration`.

    Raises:
        ConfigError: It is not above 0 s.
    """
    if seconds is not None and not seconds > 0.0:
        raise ConfigError(f"--duration must be above 0 s, got {seconds:g}")


def check_soft(axes: str, task: Task, remedy: str) -> None:
    """Check that the task has the axes; `remedy` says in the error how to get another task.

    Raises:
        ConfigError: A word is no axis, or no axis of the task.
    """
    try:
        unknown = [name for name in Task(axes=axes).names if name not in task.names]
    except ConfigError as error:
        message = str(error).removeprefix("task.axes: ")
        raise ConfigError(f"--soft {axes!r}: {message}") from None
    if unknown:
        raise ConfigError(
            f"--soft {axes!r}: {', '.join(unknown)} is no axis of the task, which has "
            f"{', '.join(task.names)}; {remedy}"
        )


def parse_caps(soft: str, task: Task) -> dict[str, float | None]:
    """Parse `--soft`: words "y" or "y=2" to caps [N, N·m], None without a cap.

    Raises:
        ConfigError: A word is invalid, is no axis of the task, or repeats an axis.
    """
    found: dict[str, float | None] = {}
    for word in soft.replace(",", " ").split():
        name, has_cap, number = word.partition("=")
        check_soft(name, task, "task in [settings] of a file of your own")
        try:
            cap = float(number) if has_cap else None
        except ValueError:
            raise ConfigError(
                f"--soft takes axis or axis=newtons, e.g. 'y=2 z=5', got {word!r}"
            ) from None
        if cap is not None and not 0.0 <= cap < math.inf:
            raise ConfigError(f"--soft {word}: a cap is a number from 0 up, got {cap:g}")
        for axis in Task(axes=name).names:
            if axis in found:
                raise ConfigError(f"--soft {soft!r} names {axis} twice: one cap an axis")
            found[axis] = cap
    return found


def apply_soft(settings: Settings, soft: str, model: Model, *, holds: bool) -> Settings:
    """Return settings with the axes of `--soft` compliant.

    Args:
        settings: Settings of the configuration.
        soft: "y=2" caps y at 2 N (N·m for rotations), "y" takes the arm's own caps.
        model: The arm.
        holds: True: the other axes hold. False: they keep their settings.

    Raises:
        ConfigError: As `parse_caps`; or a cap is above the arm's holding force.
    """
    if not soft:
        return settings
    task = settings.task
    axes: dict[str, Axis] = {} if holds else dict(settings.axes.items())
    found = parse_caps(soft, task)
    strongest: dict[str, Axis] = dict(Controller(model, Settings.firm(task=task)).axes.items())
    preset: dict[str, Axis] = dict(Settings.soft(" ".join(found), task=task).axes.items())
    for name, cap in found.items():
        hold = strongest[name].hold
        if cap is not None and hold is not None and cap > hold:
            unit = "N" if name in "xyz" else "N·m"
            raise ConfigError(
                f"--soft {name}={cap:g}: this arm holds {name} with at most {hold:.3g} {unit}; a "
                "cap is at most that"
            )
        if cap is not None:
            axes[name] = Axis(soft=cap, profile="constant")
        else:
            axes[name] = Axis(yields="both") if holds else preset[name]
    return settings.replace(axes=axes)


def check_written(path: Path, kind: str, inputs: Iterable[Path | str | None] = ()) -> None:
    """Check that a file can be written, and warn if an existing one will be replaced.

    Raises:
        ConfigError: See `pliant._files.check_output`.
    """
    if check_output(path, kind, inputs):
        text = f"{path}: the {kind} that is there will be replaced"
        print_line(text, Console(stderr=True))


def check_log(path: Path | None, inputs: Iterable[Path | str | None] = ()) -> None:
    """Check that the requested log can be written, before torque comes on.

    Raises:
        ConfigError: The name does not end in .mcap, or see `check_written`.
        ImportError: The extra log is not installed.
    """
    if path is not None:
        import pliant.log  # noqa: F401 - raises early if the extra is missing

        check_written(path, "log", inputs)
        if path.suffix != ".mcap":
            raise ConfigError(f"--log {path}: a log ends with .mcap: {path.with_suffix('.mcap')}")


def recorder_of(path: Path, *, config: Config, note: str = "") -> Recorder:
    """Return the recorder of a command's log; import the extra only if needed."""
    from pliant.log import Recorder

    return Recorder(path, config=config, note=note)
