"""From a configuration to an arm that can be enabled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant import ConfigError, LimitError, ServoError, ShapeError
from pliant.arm import Arm, Budget, Jaw
from pliant.arm.checks import posture
from pliant.arm.connect import OF_THE_ARM, check_options
from pliant.config import build
from pliant.servo import ServoChain, ServoSpec, serial_ports

if TYPE_CHECKING:
    from pliant import Model
    from pliant.arm.drive import Drive
    from pliant.config.schema import Config


def arm(config: Config, **options: Any) -> Arm:
    """Make the arm that a configuration describes; nothing moves before it is enabled.

    Args:
        config: The configuration.
        **options: Those of `pliant.arm.Arm`, in place of the file's.

    Raises:
        ConfigError, UrdfError: There is no such option; URDF, calibration and file do not go
            together, or the rest pose is none of this arm.
        ServoError: `auto` finds no port, or several.
    """
    check_options(options, OF_THE_ARM)
    model = config.model()
    _check_rest(config, model)
    given = {
        "rest": config.life.rest,
        "exit": config.life.exit,
        "rate": config.loop.rate,
        "hold_for": config.loop.hold_for,
        # The simulator alone knows no currents.
        "budget": Budget(supply=None if config.backend == "sim" else config.supply.current),
        "grippers": jaws(config),
        **options,
    }
    return Arm(model, drive(config, model), **given)


def _check_rest(config: Config, model: Model) -> None:
    """Whether the file's rest pose is a pose of this arm."""
    if config.life.rest is None:
        return
    try:
        posture(model, config.life.rest, "life.rest")
    except (LimitError, ShapeError) as error:
        raise ConfigError(f"{config.source}: {error}") from error


def drive(config: Config, model: Model) -> Drive:
    """What moves the joints: the bus, its emulation, or the simulator alone."""
    if config.backend == "sim":
        from pliant.arm.simulated import SimDrive
        from pliant.sim import Plant

        plant = Plant(model, rate=config.loop.rate)
        plant.reset(start(config, model))
        return SimDrive(plant)
    if config.backend == "emulator":
        from pliant.config.emulation import EmulatedChain

        return EmulatedChain(config, model)
    return chain(config, paths(config))


def chain(config: Config, ports: dict[str, str]) -> ServoChain:
    """The servos on these ports: name in the file to path."""
    bauds = {ports[port.name]: port.baud for port in config.port}
    loop = config.loop
    return ServoChain(specs(config, ports), baudrate=bauds, rate=loop.rate, patience=loop.patience)


def specs(config: Config, ports: dict[str, str]) -> list[ServoSpec]:
    """How each joint hangs on its servo."""
    zeros = build.zeros(config)
    return [
        ServoSpec(
            name=joint,
            zero=zeros[joint],
            port=ports[servo.port],
            twin=None if servo.twin is None else (servo.twin.id, servo.twin.sign),
            **servo.model_dump(exclude={"zero", "port", "twin"}),
        )
        for joint, servo in build.servos(config).items()
    ]


def paths(config: Config) -> dict[str, str]:
    """Path of every port of the file; `auto` is the only one there is.

    Raises:
        ServoError: There is none, or a choice.
    """
    out: dict[str, str] = {}
    for port in config.port:
        out[port.name] = _only_port(port.name) if port.path == "auto" else port.path
    return out


def _only_port(name: str) -> str:
    found = serial_ports()
    if len(found) == 1:
        return found[0]
    if found:
        raise ServoError(
            f"port {name!r} is 'auto' and there are {len(found)}: {', '.join(found)}. "
            "Write the path into the file, or give --port"
        )
    raise ServoError(
        f"port {name!r} is 'auto' and there is no serial port on this machine: plug the adapter in "
        "(Linux: it appears as /dev/ttyUSB0 or /dev/ttyACM0), or try backend 'emulator' or 'sim'"
    )


def jaws(config: Config) -> dict[str, Jaw]:
    """The grippers, by joint; a simulated arm has those of its model."""
    gripper = config.gripper
    if gripper is None:
        return {}
    jaw = Jaw(
        opened=gripper.opened, closed=gripper.closed, limit=gripper.limit, lever=gripper.lever
    )
    return {gripper.joint: jaw}


def start(config: Config, model: Model) -> Any:
    """Where a simulated or emulated arm stands first (n,) [rad]: its rest pose, else near zero."""
    if config.life.rest is not None:
        return np.array(config.life.rest)
    return np.clip(np.zeros(model.n), model.lower, model.upper)
