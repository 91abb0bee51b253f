"""`connect`: create an arm from a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

from pliant import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike

    from pliant import Servos
    from pliant.arm import Arm, Budget, GripperConfig
    from pliant.config import Config
    from pliant.sim import Fixture, Friction, Hand, Overload


class ArmOptions(TypedDict, total=False):
    """Options of `pliant.Arm`; they override the configuration."""

    rest_q: ArrayLike | None
    on_exit: Literal["lower", "leave_enabled"]
    rate: float
    comm_timeout: float
    budget: Budget | None
    grippers: Mapping[str, GripperConfig] | None
    watchdog: float
    signals: bool
    table: float | bool | None


class ConnectOptions(ArmOptions, total=False):
    """Options of `connect`: of the arm, and with ``backend="sim"`` of `pliant.sim.Plant`."""

    servos: Servos | None
    extra_servos: Mapping[str, Servos] | None
    dt: float
    delay: tuple[int, int]
    count: ArrayLike
    flicker: int
    noise: ArrayLike
    deadband: ArrayLike
    backlash: ArrayLike
    read_loss: float
    write_loss: float
    silent: tuple[float, float] | None
    kp_scale: ArrayLike
    friction_scale: ArrayLike
    damping_scale: ArrayLike
    payload: tuple[float, Sequence[float]] | None
    speed_limit: ArrayLike | None
    limit_type: Literal["current", "pwm"] | None
    overload: Overload | None
    friction: Literal["coulomb"] | Friction
    creep: float
    off_chain: Literal["held", "welded"]
    scene: Iterable[Hand | Fixture]
    seed: int


ARM_OPTIONS = frozenset(ArmOptions.__annotations__)
PLANT_OPTIONS = frozenset(ConnectOptions.__annotations__) - ARM_OPTIONS
#: Keywords of `connect` that override keys of a configuration file.
FILE_OPTIONS = frozenset(("backend", "port", "urdf", "calibration"))
ALL_OPTIONS = ARM_OPTIONS | PLANT_OPTIONS | FILE_OPTIONS | {"q", "real_time"}


def connect(
    config: str | Path | Config,
    *,
    backend: Literal["bus", "emulator", "sim"] | None = None,
    port: str | None = None,
    urdf: str | Path | None = None,
    calibration: str | Path | None = None,
    q: ArrayLike | None = None,
    real_time: bool = False,
    **options: Unpack[ConnectOptions],
) -> Arm:
    """Create the arm of a configuration. `with` enables it, and lowers it at the end.

    Nothing is opened or moved before `with`. To use your own drive, or a model without a
    configuration, construct `pliant.Arm(model, drive)`.

    Args:
        config: Name of a ready arm (`pliant.config.names()`), path of a TOML file, or a `Config`.
        backend: `"bus"`: real servos; `"emulator"`: emulated servos on a virtual serial port;
            `"sim"`: the simulator without a bus; None: as in the file.
        port: Serial device, overrides the file; or `"auto"`.
        urdf: URDF file, overrides the file.
        calibration: LeRobot calibration file, overrides the file.
        q: Initial joint positions (n,) [rad] of a simulated or emulated arm; None: near zero,
            clear of the table.
        real_time: Run the simulator in real time; otherwise as fast as it can.
        **options: Options of `pliant.Arm`, which override the file; with ``backend="sim"`` also of
            `pliant.sim.Plant` (``scene=[...]``). `table` is the height of the table [m], or False
            for none.

    Returns:
        The arm, with torque unchanged.

    Raises:
        ConfigError: Unknown name or option, with the nearest known one; invalid file; conflicting
            options.
        ServoError: The port is `auto`, and there is no serial port or more than one.

    Example:
        >>> with pliant.connect("so101", backend="sim") as arm:
        ...     state = arm.read()
    """
    from pliant.config import Config, assemble, load

    check_options(options, ALL_OPTIONS)
    if isinstance(config, str | Path):
        config = load(config, port=port, backend=backend, urdf=urdf, calibration=calibration)
    elif not isinstance(config, Config):
        raise ConfigError(
            f"cannot connect to {config!r}: give the name of a ready arm, the path of a "
            "configuration file or a Config; with a model and a drive use pliant.Arm(model, drive)"
        )
    else:
        given = {"backend": backend, "port": port, "urdf": urdf, "calibration": calibration}
        for name, value in given.items():
            if value is not None:
                raise ConfigError(
                    f"{name}= replaces a word of a file, and this is a Config: give it to "
                    f"pliant.config.load(..., {name}=...)"
                )
    start: dict[str, Any] = {} if q is None else {"q": q}
    if real_time:
        start["real_time"] = True
    return assemble.arm(config, **start, **options)


def check_options(options: Iterable[str], known: Iterable[str]) -> None:
    """Check option names before anything is opened.

    Raises:
        ConfigError: Unknown option; the message lists the nearest and all known ones.
    """
    names = frozenset(known)
    for key in options:
        if key not in names:
            from pliant.config.messages import suggest

            raise ConfigError(f"an arm has no option {key!r} here; {suggest(key, names)}")
