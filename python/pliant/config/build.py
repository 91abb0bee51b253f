"""From a configuration to the objects that work: model, settings, servos."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pliant
from pliant import ConfigError
from pliant.config import fields
from pliant.config.lerobot import Calibration, read_calibration
from pliant.config.messages import suggest
from pliant.servo.models import find

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pliant import Model, Settings
    from pliant.config.schema import Config, Servo


def check(config: Config) -> None:
    """What no table can check by itself.

    Raises:
        ValueError: Several sentences, joined.
    """
    wrong = [*_ports(config), *_ids(config)]
    if config.backend != "sim" and not config.servo:
        wrong.append(f"servo is missing: backend {config.backend!r} needs a servo for every joint")
    if wrong:
        raise ValueError("; ".join(wrong))


def _ports(config: Config) -> list[str]:
    names = [port.name for port in config.port]
    out = [f"port {name!r} is there twice" for name in sorted(set(names)) if names.count(name) > 1]
    for joint, servo in servos(config).items():
        if servo.port not in names:
            out.append(f"servo.{joint}.port: no port {servo.port!r}; {suggest(servo.port, names)}")
    return out


def _ids(config: Config) -> list[str]:
    seen: dict[tuple[str, int], str] = {}
    out = []
    for joint, servo in servos(config).items():
        own = [servo.id] if servo.twin is None else [servo.id, servo.twin.id]
        for number in own:
            other = seen.setdefault((servo.port, number), joint)
            if other != joint or own.count(number) > 1:
                out.append(
                    f"servo.{joint} and servo.{other} have the same id {number} on port "
                    f"{servo.port!r}; every servo on a port needs an id of its own"
                )
    return list(dict.fromkeys(out))


def servos(config: Config) -> dict[str, Servo]:
    """All servos of the file by the name of their joint."""
    out = dict(config.servo)
    if config.gripper is not None:
        out[config.gripper.joint] = config.gripper.servo
    return out


def model(config: Config) -> Model:
    """The kinematic model; see `Config.model`."""
    robot = config.robot
    options: dict[str, Any] = {
        "base": robot.base,
        "tip": robot.tip,
        "gravity": robot.gravity,
        "locked": robot.locked or None,
        "limits": robot.limits or None,
    }
    if robot.payload is not None:
        options["payload"] = pliant.Payload(robot.payload.mass, robot.payload.com)
    options = {key: value for key, value in options.items() if value is not None}
    if robot.builtin is not None:
        out = pliant.robots.load(robot.builtin, **options)
    else:
        path = inside(config, robot.urdf)
        if not path.is_file():
            raise ConfigError(
                f"robot.urdf: there is no file {path}; give the path of this arm's URDF, in the "
                "file or by --urdf"
            )
        out = pliant.Model.from_urdf(str(path), **options)
    _match(config, out)
    return out


def _match(config: Config, model: Model) -> None:
    """Joints of the chain and servos of the file are the same."""
    if not config.servo:
        return
    chain, named = set(model.joint_names), set(config.servo)
    lacking = [joint for joint in model.joint_names if joint not in named]
    strange = [joint for joint in config.servo if joint not in chain]
    if not (lacking or strange):
        return
    parts = []
    if lacking:
        parts.append(f"no servo for {', '.join(lacking)}")
    if strange:
        parts.append(f"no joint for the servos {', '.join(strange)}")
    raise ConfigError(
        f"file and URDF disagree on the joints from {model.base} to {model.tip}: "
        f"{'; '.join(parts)}. The chain has {', '.join(model.joint_names)}"
    )


def settings(config: Config) -> Settings:
    """The controller's settings; see `Config.settings`."""
    made, wrong = fields.resolve(config.fields, config.preset, config.loop.rate)
    if made is None:
        raise ConfigError("; ".join(wrong))
    return made


def zeros(config: Config) -> dict[str, float | None]:
    """Count at which each joint's angle is 0, `gripper` included; None: the middle of the servo.

    Raises:
        ConfigError: The calibration file cannot be read, does not know a joint or its id, or has a
            range that its servo cannot have.
    """
    table: Mapping[str, Calibration] = {}
    if config.calibration is not None:
        table = read_calibration(inside(config, config.calibration))
    out: dict[str, float | None] = {}
    for joint, servo in servos(config).items():
        if servo.zero is not None or not table:
            out[joint] = servo.zero
            continue
        if joint not in table:
            raise ConfigError(
                f"{config.calibration} has no motor {joint!r}; {suggest(joint, table)}"
            )
        entry = table[joint]
        if entry.id != servo.id:
            raise ConfigError(
                f"{config.calibration} says {joint} has id {entry.id}, the configuration says "
                f"{servo.id}: one of them is of another arm"
            )
        try:
            entry.check_range(joint, find(servo.model))
        except ConfigError as error:
            raise ConfigError(f"{config.calibration}: {error}") from error
        out[joint] = entry.middle
    return out


def inside(config: Config, path: Path | None) -> Path:
    """A path of the file, from its folder."""
    assert path is not None
    path = path.expanduser()
    return path if path.is_absolute() else config.folder / path
