"""From a name, a description or parts to an arm."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pliant._core import ConfigError, Model

if TYPE_CHECKING:
    from pliant.arm import Arm
    from pliant.arm.drive import Drive
    from pliant.config import Config

#: Arguments that belong to the arm, whatever drives it.
OF_THE_ARM = frozenset(
    (
        "rest_q",
        "on_exit",
        "rate",
        "comm_timeout",
        "budget",
        "grippers",
        "watchdog",
        "signals",
        "table",
    )
)

#: Arguments that replace words of a configuration file.
OF_THE_FILE = frozenset(("port", "backend", "urdf", "calibration"))


def connect(
    what: str | Path | Config | Mapping[str, Any] | Model,
    drive: Drive | None = None,
    **options: Any,
) -> Arm:
    """Make an arm; `with` then enables it, and lowers it at the end.

    Args:
        what: Path of a configuration file, or the name of a ready one
            (`pliant.config.names()`); ``"sim"`` with ``robot=``, or ``"sim:arm7"``: a built-in arm
            on the simulator; the same as a mapping, ``{"kind": "sim", "robot": "arm7"}``; a
            `Config`; or a model, with its drive.
        drive: What moves the joints of a model.
        **options: Those of `pliant.arm.Arm`. For a file also `port`, `backend`, `urdf` and
            `calibration`, as for `pliant.config.load`, and `table`: the height of its table [m], or
            False for none. For a simulated arm `q` (n,) [rad], where it stands (default: near zero
            for a file, else the middle of its ranges), `real_time`, and those of
            `pliant.sim.Plant`; for an emulated arm `q`. ``"sim:..."`` has no table.

    Returns:
        The arm, with torque as it was.

    Raises:
        ConfigError: A name or an option is not known, or a file is wrong; says what is right.
        ServoError: The file leaves the port open and there is none, or a choice.

    Example:
        >>> with pliant.connect("sim:arm7") as arm:
        ...     state = arm.read()
    """
    if isinstance(what, Model):
        if drive is None:
            raise ConfigError("connect(model, drive) needs the drive that moves the joints")
        from pliant.arm import Arm

        check_options(options, OF_THE_ARM)
        return Arm(what, drive, **options)
    if drive is not None:
        raise ConfigError("a drive goes with a model: connect(model, drive)")
    if isinstance(what, str | Path) and str(what).partition(":")[0] != "sim":
        from pliant.config import load

        known = OF_THE_ARM | OF_THE_FILE
        check_options(options, known | {"q", "real_time", *plant_options()})
        return load(what, **{k: options.pop(k) for k in OF_THE_FILE & set(options)}).arm(**options)
    if isinstance(what, str | Path):
        # `kind` is an option of the plant too: the kind of its servos.
        _, _, robot = str(what).partition(":")
        return _simulated(**{**({"robot": robot} if robot else {}), **options})
    if not isinstance(what, Mapping):
        if not hasattr(what, "arm"):
            raise ConfigError(
                f"cannot connect to {what!r}: give the path of a configuration file, the name of a "
                "ready one, 'sim:arm7', or a model and a drive"
            )
        return what.arm(**options)
    own = dict(what)
    kind = own.pop("kind", None)
    if kind != "sim":
        raise ConfigError(f"no arm of kind {kind!r}; there is 'sim', or give a model and a drive")
    return _simulated(**{**own, **options})


def check_options(options: Iterable[str], known: Iterable[str]) -> None:
    """See that there are such options, before anything is opened.

    Raises:
        ConfigError: There is none of that name; the message has the nearest and all.
    """
    names = frozenset(known)
    for key in options:
        if key not in names:
            from pliant.config.messages import suggest

            raise ConfigError(f"an arm has no option {key!r} here; {suggest(key, names)}")


def plant_options() -> frozenset[str]:
    """Names of the options of `pliant.sim.Plant`; empty where the simulator is not installed."""
    try:
        from pliant.sim import Plant
    except ImportError:
        return frozenset()
    return frozenset(signature(Plant).parameters) - {"model"}


def _simulated(
    *, robot: str | Model = "arm7", q: Any = None, real_time: bool = False, **options: Any
) -> Arm:
    """A built-in arm, or any model, on the simulator."""
    from pliant import robots
    from pliant.arm import Arm
    from pliant.arm.simulated import SimDrive
    from pliant.sim import Plant

    if isinstance(robot, str) and robot not in robots.names():
        from pliant.config import names

        if robot in names():
            raise ConfigError(
                f"'sim:{robot}' is no built-in model; its ready file runs on the simulator as "
                f'connect("{robot}", backend="sim")'
            )
    model = robots.load(robot) if isinstance(robot, str) else robot
    of_the_arm = {key: value for key, value in options.items() if key in OF_THE_ARM}
    if wrong := sorted(OF_THE_FILE & set(options)):
        from pliant.config import names

        other = f', or connect("{robot}", backend="sim")' if robot in names() else ""
        raise ConfigError(
            f"{wrong[0]!r} is for the file of an arm, and this is a simulated arm without a file: "
            f"leave it out{other}"
        )
    check_options(options, {"robot", "q", "real_time", *plant_options(), *OF_THE_ARM})
    plant = Plant(model, **{k: v for k, v in options.items() if k not in OF_THE_ARM or k == "rate"})
    if q is not None:
        plant.reset(q)
    return Arm(model, SimDrive(plant, real_time=real_time), **of_the_arm)
