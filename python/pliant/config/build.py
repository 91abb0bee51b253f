"""Construction of model, settings and servos from a configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pliant
from pliant import ConfigError
from pliant.arm.tables import take
from pliant.config import fields
from pliant.config.lerobot import read_calibration
from pliant.config.messages import suggest
from pliant.servo.models import find
from pliant.servo.spec import ServoSpec
from pliant.servo.table import servos as servos_of
from pliant.servo.units import Units

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pliant import Model, Settings
    from pliant.config.schema import Config, Servo
    from pliant.servo.calibration import Calibration


def check(config: Config) -> None:
    """Check conditions across the tables of a configuration.

    Raises:
        ValueError: One sentence for each error, a line each.
    """
    wrong = [*_ports(config), *_ids(config)]
    if config.backend != "sim" and not config.servo:
        wrong.append(f"servo is missing: backend {config.backend!r} needs a servo for every joint")
    if wrong:
        raise ValueError("\n".join(wrong))


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
        own = [servo.id] if servo.secondary is None else [servo.id, servo.secondary.id]
        for number in own:
            other = seen.setdefault((servo.port, number), joint)
            if other != joint or own.count(number) > 1:
                out.append(
                    f"servo.{joint} and servo.{other} have the same id {number} on port "
                    f"{servo.port!r}; every servo on a port needs an id of its own"
                )
    return list(dict.fromkeys(out))


def servos(config: Config) -> dict[str, Servo]:
    """Return all servos of the file by joint name."""
    out = dict(config.servo)
    if config.gripper is not None:
        out[config.gripper.joint] = config.gripper.servo
    return out


def model(config: Config) -> Model:
    """Return the kinematic model; see `Config.model`."""
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
    return out.with_servos(chain_servos(config, out)) if config.servo else out


def spec(
    joint: str, servo: Servo, *, port: str, calibration: Calibration | None = None
) -> ServoSpec:
    """Return the `ServoSpec` of a joint; a calibration gives its zero."""
    return ServoSpec(
        name=joint,
        zero=servo.zero if calibration is None else calibration.middle,
        port=port,
        calibration=calibration,
        secondary=None if servo.secondary is None else (servo.secondary.id, servo.secondary.sign),
        **servo.model_dump(exclude={"zero", "port", "secondary", "gain"}),
    )


def servo_table(config: Config) -> tuple[tuple[str, ...], pliant.Servos]:
    """Return the joints of the file's servos, the gripper last, and their parameters (N,).

    They equal those read from the registers on a bus, at the file's supply voltage and gains.
    """
    own = servos(config)
    units = [
        Units.of(spec(joint, servo, port=servo.port), config.supply.voltage)
        for joint, servo in own.items()
    ]
    gains = [servo.gain or find(servo.model).gain_default for servo in own.values()]
    return tuple(own), servos_of(units, gains, [unit.full for unit in units])


def chain_servos(config: Config, model: Model) -> pliant.Servos:
    """Return the servos (n,) of the chain; `stiffness_known` if the file gives every `kp`."""
    names, table = servo_table(config)
    known = all(config.servo[joint].kp is not None for joint in model.joint_names)
    places = [names.index(joint) for joint in model.joint_names]
    return take(table, len(names), places).replace(stiffness_known=known)


def extra_servos(config: Config, model: Model) -> dict[str, pliant.Servos]:
    """Return the servo parameters of joints off the chain, one entry each, by name."""
    names, table = servo_table(config)
    return {
        name: take(table, len(names), [i])
        for i, name in enumerate(names)
        if name not in model.joint_names
    }


def _match(config: Config, model: Model) -> None:
    """Check that the joints of the chain and the servos of the file are the same."""
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
    """Return the controller settings; see `Config.settings`."""
    made, wrong = fields.resolve(config.fields, config.preset, config.loop.rate)
    if made is None:
        raise ConfigError("; ".join(wrong))
    return made


def zeros(config: Config) -> dict[str, float | None]:
    """Return the count at zero angle of each joint, `gripper` included; None: mid-range.

    Raises:
        ConfigError: The calibration file cannot be read, lacks a joint, or has another id or an
            impossible range for its servo.
    """
    own = calibrations(config)
    return {
        joint: own[joint].middle if joint in own else servo.zero
        for joint, servo in servos(config).items()
    }


def calibrations(config: Config) -> dict[str, Calibration]:
    """Return the calibration of each joint that takes its zero from the calibration file.

    Raises:
        ConfigError: As `zeros`.
    """
    if config.calibration is None:
        return {}
    table: Mapping[str, Calibration] = read_calibration(inside(config, config.calibration))
    out: dict[str, Calibration] = {}
    for joint, servo in servos(config).items():
        if servo.zero is not None:
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
        out[joint] = entry
    return out


def inside(config: Config, path: Path | None) -> Path:
    """Resolve a path of the file relative to its folder."""
    assert path is not None
    path = path.expanduser()
    return path if path.is_absolute() else config.folder / path
