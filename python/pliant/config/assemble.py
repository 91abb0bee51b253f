"""Construction of an arm, its drive and its grippers from a configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant import ConfigError, OutOfRangeError, ServoError, ShapeError
from pliant._connect import ARM_OPTIONS, PLANT_OPTIONS, check_options
from pliant.arguments import real
from pliant.arm import Arm, Budget, GripperConfig
from pliant.arm.checks import posture, vector
from pliant.arm.points import Points
from pliant.config import build
from pliant.servo import ServoBus, ServoSpec, serial_ports

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant import Model
    from pliant.arm.drive import Drive
    from pliant.config.schema import Config
    from pliant.sim import Plant, Tabletop

#: Largest depth in the table at which a simulated arm may start [m].
INSIDE = 0.001


def arm(config: Config, **options: Any) -> Arm:
    """Create the arm of a configuration; nothing moves before it is enabled.

    Args:
        config: The configuration.
        **options: Options of `pliant.Arm`, which override the file. On the simulator and the
            emulator also `q` (n,) [rad], the initial joint positions; `table`, the height of its
            table [m], or False for none; on the simulator also `real_time` and the options of
            `pliant.sim.Plant`.

    Raises:
        ConfigError, UrdfError: Unknown option; URDF, calibration and file do not match; or the rest
            pose is not valid.
        ServoError: The port is `auto`, and there is no serial port or more than one.
    """
    if "table" in options:
        config = _on_table(config, options.pop("table"))
    beside = _beside(config, options)
    model = config.model()
    _check_rest(config, model)
    given = {
        "rest_q": config.life.rest_q,
        "on_exit": config.life.on_exit,
        "rate": config.loop.rate,
        "comm_timeout": config.loop.comm_timeout,
        "table": config.robot.table,
        # The simulator without a bus has no currents.
        "budget": Budget(supply=None if config.backend == "sim" else config.supply.current),
        "grippers": grippers(config),
        **{key: value for key, value in options.items() if key not in beside},
    }
    if config.backend == "sim":
        beside.setdefault("rate", given["rate"])
    made = drive(config, model, **beside)
    if config.backend == "sim" and "grippers" not in options:
        given["grippers"] = _fixed(model, made) | given["grippers"]
    return Arm(model, made, **given)


def _fixed(model: Model, made: Drive) -> dict[str, GripperConfig]:
    """Return joints off the chain whose travel the model does not give; they are held in place."""
    known = {joint.name for joint in model.joints if _has_ends(joint.lower, joint.upper)}
    places = zip(made.names, made.read().position.tolist(), strict=True)
    return {
        name: GripperConfig(opened=place, closed=place)
        for name, place in places
        if name not in known and name not in model.joint_names
    }


def _has_ends(*ends: float | None) -> bool:
    return all(end is not None and np.isfinite(end) for end in ends)


def _on_table(config: Config, height: float | bool | None) -> Config:
    """Return the configuration with another table height [m], or without a table (False, None)."""
    if height is True:
        raise ConfigError("table is a height [m], or False for none; got True")
    there = None if height is None or height is False else real(height, "table [m]")
    robot = config.robot.model_copy(update={"table": there})
    return config.model_copy(update={"robot": robot})


def _beside(config: Config, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options for the simulator or the emulator, which are not options of the arm.

    Raises:
        ConfigError: Unknown option on this backend.
    """
    of_the_sim = {"q", "real_time", *PLANT_OPTIONS} - ARM_OPTIONS
    known = {"bus": set(), "emulator": {"q"}, "sim": of_the_sim}[config.backend]
    for key in options:
        if key in of_the_sim - known:
            raise ConfigError(
                f"{key!r} is an option of a simulated arm, and this one has backend "
                f'{config.backend!r}: connect(..., backend="sim")'
            )
    check_options(options, ARM_OPTIONS | known)
    return {key: value for key, value in options.items() if key in known}


def _check_rest(config: Config, model: Model) -> None:
    """Check that the file's rest pose is a pose of this arm."""
    if config.life.rest_q is None:
        return
    try:
        posture(model, config.life.rest_q, "life.rest_q")
    except (OutOfRangeError, ShapeError) as error:
        raise ConfigError(f"{config.source}: {error}") from error


def drive(
    config: Config,
    model: Model,
    *,
    q: ArrayLike | None = None,
    real_time: bool = False,
    **plant: Any,
) -> Drive:
    """Create the drive: the bus, its emulation, or the simulator alone.

    Args:
        config: The configuration.
        model: Its model.
        q: Initial joint positions of a simulated or emulated arm (n,) [rad].
        real_time: Whether simulated time runs in real time.
        **plant: Options of `pliant.sim.Plant`, which override the file.
    """
    if config.backend == "sim":
        return simulated(config, model, q=q, real_time=real_time, **plant)
    if config.backend == "emulator":
        from pliant.config.emulation import EmulatedChain

        return EmulatedChain(config, model, q=q)
    return chain(config, paths(config))


def simulated(
    config: Config, model: Model, *, q: ArrayLike | None, real_time: bool, **plant: Any
) -> Drive:
    """Create the simulated arm with the file's servos, on its table."""
    from pliant.sim import Plant, SimDrive

    options: dict[str, Any] = {"rate": config.loop.rate}
    if config.servo:
        options |= {
            "extra_servos": build.extra_servos(config, model),
            "count": build.chain_servos(config, model).encoder_step,
        }
    options |= plant
    options["scene"] = [*tabletop(config), *options.get("scene", ())]
    made = Plant(model, **options)
    made.reset(start(config, model) if q is None else vector(model, q, "q"))
    above_table(made)
    # The arm assumes the file's servos, even if the caller gives the plant other ones.
    return SimDrive(made, servos=model.servos if config.servo else None, real_time=real_time)


def tabletop(config: Config) -> list[Tabletop]:
    """Return the table of the file's arm as scene objects; empty without a table."""
    if config.robot.table is None:
        return []
    from pliant.sim import Tabletop

    return [Tabletop(height=config.robot.table)]


def above_table(plant: Plant) -> None:
    """Check that a simulated arm starts above its table.

    Raises:
        ConfigError: It starts inside the table.
    """
    from pliant.sim import Tabletop

    for fixture in plant.fixtures:
        if isinstance(fixture, Tabletop) and fixture.clearance() < -INSIDE:
            raise ConfigError(
                f"the arm would start {-fixture.clearance():.3f} m inside its table: give another "
                "q, or table=False"
            )


def chain(config: Config, ports: dict[str, str]) -> ServoBus:
    """Create the servo bus; `ports` maps port names of the file to paths."""
    bauds = {ports[port.name]: port.baud for port in config.port}
    loop = config.loop
    return ServoBus(specs(config, ports), baudrate=bauds, rate=loop.rate, patience=loop.patience)


def specs(config: Config, ports: dict[str, str]) -> list[ServoSpec]:
    """Return the servo of each joint."""
    files = build.calibrations(config)
    return [
        build.spec(joint, servo, port=ports[servo.port], calibration=files.get(joint))
        for joint, servo in build.servos(config).items()
    ]


def paths(config: Config) -> dict[str, str]:
    """Return the path of every port of the file; `auto` stands for the only serial port.

    Raises:
        ServoError: There is no serial port, or more than one.
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


def grippers(config: Config) -> dict[str, GripperConfig]:
    """Return the gripper configuration of the file by joint; empty without a gripper."""
    gripper = config.gripper
    if gripper is None:
        return {}
    jaw = GripperConfig(
        opened=gripper.opened, closed=gripper.closed, limit=gripper.limit, lever=gripper.lever
    )
    return {gripper.joint: jaw}


def start(config: Config, model: Model) -> Any:
    """Return the initial positions (n,) [rad] of a simulated or emulated arm: near zero.

    If that pose is inside the table and there is a rest pose, return the rest pose.
    """
    zero = np.clip(np.zeros(model.n), model.lower, model.upper)
    table, rest = config.robot.table, config.life.rest_q
    if rest is None or len(rest) != model.n:
        return zero
    if table is None or Points(model)(zero).position[:, 2].min() >= table:
        return zero
    return np.array(rest)
