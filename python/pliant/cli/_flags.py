"""Command-line flags that several commands share, and checks of their values."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from pliant import config
from pliant._core import ConfigError
from pliant._files import check_output
from pliant.cli._console import Console, print_line

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pliant.config import Config
    from pliant.log import Recorder


#: Maximum TCP port number.
MAX_PORT = 65535
#: Path of an arm's configuration file, or the name of a configuration file in the package.
ArmName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ARM")]
#: Path of a motion file written by `pliant teach`, or of a log.
MotionFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MOTION")]
#: Path of a log (MCAP file).
LogFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
#: Optional path of a file to read or write.
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
#: TCP port of a server.
HttpPort = Annotated[int, tyro.conf.arg(metavar="PORT")]
#: Present and new id of a servo, as text "OLD:NEW"; None: no id is changed.
Ids = Annotated[str | None, tyro.conf.arg(metavar="OLD:NEW")]
#: Path of a serial port; None: the default of the command.
Device = Annotated[str | None, tyro.conf.arg(metavar="DEVICE")]
#: Backend that replaces the one in the configuration; None: no replacement.
Backend = Annotated[str | None, tyro.conf.arg(metavar="bus|emulator|sim")]
#: Duration [s]; None: no limit.
Seconds = Annotated[float | None, tyro.conf.arg(metavar="SECONDS")]
#: Duration [s], for a flag with a default.
Duration = Annotated[float, tyro.conf.arg(metavar="SECONDS")]
#: Names of task axes, separated by spaces.
Axes = Annotated[str, tyro.conf.arg(metavar="AXES")]
#: Name of a frame of the URDF; None if the flag is not given.
Frame = Annotated[str | None, tyro.conf.arg(metavar="FRAME")]


@dataclass(frozen=True)
class FileFlags:
    """Flags that replace files named by a configuration.

    Attributes:
        urdf: URDF in place of the one in the configuration; an error if the arm has a built-in
            model.
        calibration: LeRobot calibration file in place of the one in the configuration.
    """

    urdf: File = None
    calibration: File = None

    def load(self, arm: str, backend: str | None = None) -> config.Config:
        """Load the configuration of an arm; values of the flags replace values of its file."""
        return config.load(arm, **({"backend": backend} | vars(self)))

    def inputs(self, arm: str, arm_config: config.Config) -> list[Path]:
        """Return the input files of a configuration, which a command must not overwrite."""
        named = [arm_config.robot.urdf, arm_config.calibration]
        files = [arm_config.folder / path.expanduser() for path in named if path is not None]
        flags = [path for path in (self.urdf, self.calibration) if path is not None]
        return [Path(arm).expanduser(), *files, *flags]

    def as_arguments(self) -> list[str]:
        """Return the flags that are set, with their values, as command-line words for a shell."""
        flags = {name: value for name, value in vars(self).items() if value is not None}
        return [f"--{name} {shlex.quote(str(value))}" for name, value in flags.items()]


@dataclass(frozen=True)
class BusFlags(FileFlags):
    """Flags of commands that talk to servos.

    Attributes:
        port: Serial port. Default: the port in the configuration.
    """

    port: Device = None


@dataclass(frozen=True)
class ConfigFlags(BusFlags):
    """Flags of commands that run on real or simulated servos.

    Attributes:
        backend: bus, emulator or sim, in place of the backend in the configuration.
    """

    backend: Backend = None


def check_duration(seconds: float | None) -> None:
    """Check the value of `--duration`.

    Raises:
        ConfigError: The duration is not above 0 s.
    """
    if seconds is not None and not seconds > 0.0:
        raise ConfigError(f"--duration must be above 0 s, got {seconds:g}")


def check_port(port: int) -> None:
    """Check the value of `--http-port`.

    Raises:
        ConfigError: The value is not a TCP port.
    """
    if not 1 <= port <= MAX_PORT:
        raise ConfigError(f"--http-port is a port from 1 to {MAX_PORT}, got {port}")


def check_writable(path: Path, kind: str, inputs: Iterable[Path | str | None] = ()) -> None:
    """Check that a file can be written; print a warning if an existing file will be replaced.

    Raises:
        ConfigError: The file cannot be written, is one of the inputs, or exists and is not of this
            kind.
    """
    if check_output(path, kind, inputs):
        text = f"{path}: the {kind} that is there will be replaced"
        print_line(text, Console(stderr=True))


def check_log(path: Path | None, inputs: Iterable[Path | str | None] = ()) -> None:
    """Check that the file of `--log` can be written; called before torque is switched on.

    Raises:
        ConfigError: The name does not end in .mcap, or the file cannot be written.
        ImportError: The extra `log` of the package is not installed.
    """
    if path is not None:
        import pliant.log  # noqa: F401 - raises early if the extra is missing

        check_writable(path, "log", inputs)
        if path.suffix != ".mcap":
            raise ConfigError(f"--log {path}: a log ends with .mcap: {path.with_suffix('.mcap')}")


def make_recorder(path: Path, *, config: Config, note: str = "") -> Recorder:
    """Return a recorder that writes the log of a command to `path`; needs the extra `log`."""
    from pliant.log import Recorder

    return Recorder(path, config=config, note=note)
