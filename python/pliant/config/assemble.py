"""From a configuration to an arm that can be enabled."""

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

#: How deep in the table a simulated arm may start [m].
INSIDE = 0.001


def arm(config: Config, **options: Any) -> Arm:
    """Make the arm that a configuration describes; nothing moves before it is enabled.

    Args:
        config: The configuration.
        **options: Those of `pliant.Arm`, in place of the file's; on the simulator and the
            emulator `q` (n,) [rad], where the arm stands first; `table`, the height of its table
            in place of the file's [m], or False for none; on the simulator `real_time` and
            those of `pliant.sim.Plant`.

    Raises:
        ConfigError, UrdfError: There is no such option; URDF, calibration and file do not go
            together, or the rest pose is none of this arm.
        ServoError: `auto` finds no port, or several.
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
        # The simulator alone knows no currents.
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
    """Joints beside the chain to which the model gives no ends: they stay where they are."""
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
    """The same arm on a table of another height [m], or on none (False, None)."""
    if height is True:
        raise ConfigError("table is a height [m], or False for none; got True")
    there = None if height is None or height is False else real(height, "table [m]")
    robot = config.robot.model_copy(update={"table": there})
    return config.model_copy(update={"robot": robot})


def _beside(config: Config, options: dict[str, Any]) -> dict[str, Any]:
    """Options that belong to what stands in for the arm, not to the arm.

    Raises:
        ConfigError: There is no such option on this backend.
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
    """Whether the file's rest pose is a pose of this arm."""
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
    """What moves the joints: the bus, its emulation, or the simulator alone.

    Args:
        config: The configuration.
        model: Its model.
        q: Where a simulated or emulated arm stands first (n,) [rad].
        real_time: Let simulated time be real time.
        **plant: Of `pliant.sim.Plant`, in place of what the file says.
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
    """The arm on the simulator: servos by the file, on its table."""
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
    # What the arm believes is the file's, whatever servos the caller gives the plant.
    return SimDrive(made, servos=model.servos if config.servo else None, real_time=real_time)


def tabletop(config: Config) -> list[Tabletop]:
    """The table that the file's arm stands on, for a scene; none without."""
    if config.robot.table is None:
        return []
    from pliant.sim import Tabletop

    return [Tabletop(height=config.robot.table)]


def above_table(plant: Plant) -> None:
    """See that a simulated arm starts above its table.

    Raises:
        ConfigError: It stands in it.
    """
    from pliant.sim import Tabletop

    for fixture in plant.fixtures:
        if isinstance(fixture, Tabletop) and fixture.clearance() < -INSIDE:
            raise ConfigError(
                f"the arm would start {-fixture.clearance():.3f} m inside its table: give another "
                "q, or table=False"
            )


def chain(config: Config, ports: dict[str, str]) -> ServoBus:
    """The servos on these ports: name in the file to path."""
    bauds = {ports[port.name]: port.baud for port in config.port}
    loop = config.loop
    return ServoBus(specs(config, ports), baudrate=bauds, rate=loop.rate, patience=loop.patience)


def specs(config: Config, ports: dict[str, str]) -> list[ServoSpec]:
    """How each joint hangs on its servo."""
    files = build.calibrations(config)
    return [
        build.spec(joint, servo, port=ports[servo.port], calibration=files.get(joint))
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


def grippers(config: Config) -> dict[str, GripperConfig]:
    """The grippers, by joint; a simulated arm has those of its model."""
    gripper = config.gripper
    if gripper is None:
        return {}
    jaw = GripperConfig(
        opened=gripper.opened, closed=gripper.closed, limit=gripper.limit, lever=gripper.lever
    )
    return {gripper.joint: jaw}


def start(config: Config, model: Model) -> Any:
    """Where a simulated or emulated arm stands first (n,) [rad]: near zero, else its rest pose.

    The zero of the ready arms is a pose to work from. Where it is in the table, the arm begins in
    its rest pose.
    """
    zero = np.clip(np.zeros(model.n), model.lower, model.upper)
    table, rest = config.robot.table, config.life.rest_q
    if rest is None or len(rest) != model.n:
        return zero
    if table is None or Points(model)(zero).position[:, 2].min() >= table:
        return zero
    return np.array(rest)
