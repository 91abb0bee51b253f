"""Construction of an `Arm` and its drive (servo bus or simulator) from a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

import numpy as np

from pliant._core import ArmPoints, ConfigError, OutOfRangeError, ServoError, ShapeError
from pliant._validation import real
from pliant.arm import Arm, Budget, GripperConfig
from pliant.arm._checks import posture, table_height, vector
from pliant.config._messages import suggest
from pliant.config.loader import load
from pliant.config.schema import (
    Config,
    calibrations,
    chain_servos,
    extra_servos,
    gripper_travel,
    servos,
    spec,
    zeros,
)
from pliant.servo import ServoBus, ServoSpec, get_model, serial_ports
from pliant.servo.eeprom import OVERLOAD_BIT

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike

    from pliant._core import Model, Servos
    from pliant.config.schema import Servo
    from pliant.drive import Drive
    from pliant.emulator import Mount
    from pliant.emulator.arm import ArmEmulator
    from pliant.servo.spec import Calibration
    from pliant.sim import Fixture, Friction, Hand, Overload, Plant, Tabletop


class ArmOptions(TypedDict, total=False):
    """Options of `pliant.Arm`; they override values of the configuration."""

    rest_q: ArrayLike | None
    on_exit: Literal["lower", "leave_enabled"]
    rate: float
    comm_timeout: float
    power_budget: Budget | None
    grippers: Mapping[str, GripperConfig] | None
    watchdog: float
    handle_signals: bool
    guardian: bool
    table: float | bool | None
    name: str | None


class ConnectOptions(ArmOptions, total=False):
    """Options of `connect`: of the arm, and with ``backend="sim"`` of `pliant.sim.Plant`."""

    servos: Servos | None
    extra_servos: Mapping[str, Servos] | None
    dt: float
    delay: tuple[int, int]
    encoder_step: ArrayLike
    encoder_flicker: int
    noise: ArrayLike
    deadband: ArrayLike
    read_loss: float
    write_loss: float
    bus_outage: tuple[float, float] | None
    kp_scale: ArrayLike
    friction_scale: ArrayLike
    damping_scale: ArrayLike
    payload: tuple[float, Sequence[float]] | None
    overload: Overload | None
    friction: Literal["coulomb"] | Friction
    friction_creep: float
    off_chain: Literal["held", "welded"]
    scene: Iterable[Hand | Fixture]
    seed: int


ARM_OPTIONS = frozenset(ArmOptions.__annotations__)
PLANT_OPTIONS = frozenset(ConnectOptions.__annotations__) - ARM_OPTIONS
#: Keyword arguments of `connect` that override keys of a configuration file.
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
    """Create the arm of a configuration; `with` enables the arm, and lowers it at the end.

    No port is opened before `with`. For a drive of your own, or a model without a configuration,
    construct `pliant.Arm(model, drive)`.

    Args:
        config: Name of a built-in arm (`pliant.config.list_arms()`), path of a TOML file, or a
            `Config`.
        backend: `"bus"`: real servos; `"emulator"`: emulated servos on a virtual serial port;
            `"sim"`: the simulator without a bus; None: the value in the file.
        port: Serial device, overrides the file; or `"auto"`.
        urdf: URDF file, overrides the file.
        calibration: LeRobot calibration file, overrides the file.
        q: Initial joint positions (n,) [rad] of a simulated or emulated arm; None: zero within the
            limits, or the rest pose if the arm would then be inside the table.
        real_time: True runs the simulator in real time, False as fast as possible.
        **options: Options of `pliant.Arm`, which override the file; with ``backend="sim"`` also of
            `pliant.sim.Plant` (``scene=[...]``). `table` is the height of the table [m], or False
            for none.

    Returns:
        The arm, with torque unchanged.

    Raises:
        ConfigError: A name or an option is unknown, the file is invalid, or options conflict.
        ServoError: The port is `auto`, and there is no serial port or more than one.

    Example:
        >>> with pliant.connect("so101", backend="sim") as arm:
        ...     state = arm.read()
    """
    check_options(options, ALL_OPTIONS)
    if isinstance(config, str | Path):
        config = load(config, port=port, backend=backend, urdf=urdf, calibration=calibration)
    elif not isinstance(config, Config):
        raise ConfigError(
            f"cannot connect to {config!r}: give the name of a ready arm, the path of a "
            "configuration file or a Config; with a model and a drive use pliant.Arm(model, drive)"
        )
    else:
        values = {"backend": backend, "port": port, "urdf": urdf, "calibration": calibration}
        for name, value in values.items():
            if value is not None:
                raise ConfigError(
                    f"{name}= replaces a value of a file, but a Config is given: give it to "
                    f"pliant.config.load(..., {name}=...)"
                )
    start: dict[str, Any] = {} if q is None else {"q": q}
    if real_time:
        start["real_time"] = True
    return make_arm(config, **start, **options)


def check_options(options: Iterable[str], known: Iterable[str]) -> None:
    """Check the names of options, before a port is opened.

    Raises:
        ConfigError: An option is unknown; the message lists the known options.
    """
    names = frozenset(known)
    for key in options:
        if key not in names:
            raise ConfigError(f"an arm has no option {key!r} here; {suggest(key, names)}")


#: Largest depth to which a simulated arm may start inside the table [m].
MAX_START_DEPTH = 0.001


def make_arm(config: Config, **options: Any) -> Arm:
    """Create the arm of a configuration; nothing moves before it is enabled.

    Args:
        config: The configuration.
        **options: Options of `pliant.Arm`, which override the file. `table` is the height of the
            table [m], or False for no table. Simulator and emulator also accept `q` (n,) [rad], the
            initial joint positions; the simulator also accepts `real_time` and the options of
            `pliant.sim.Plant`.

    Raises:
        ConfigError, UrdfError: An option is unknown; URDF, calibration and file do not match; or
            the rest pose is not valid.
        ServoError: The port is `auto`, and there is no serial port or more than one.
    """
    if "table" in options:
        config = _on_table(config, options.pop("table"))
    if "rate" in options:
        loop = config.loop.model_copy(update={"rate": real(options.pop("rate"), "rate")})
        config = config.model_copy(update={"loop": loop})
    backend_options = _backend_options(config, options)
    model = config.model()
    _check_rest(config, model)
    values = {
        "rest_q": config.life.rest_q,
        "on_exit": config.life.on_exit,
        "rate": config.loop.rate,
        "comm_timeout": config.loop.comm_timeout,
        "table": config.robot.table,
        "name": config.name,
        "guardian": config.life.guardian,
        # Backend "sim" does not simulate servo currents, so the supply current has no limit.
        "power_budget": Budget(supply=None if config.backend == "sim" else config.supply.current),
        "grippers": gripper_configs(config),
        **{key: value for key, value in options.items() if key not in backend_options},
    }
    drive = make_drive(config, model, **backend_options)
    if config.backend == "sim" and "grippers" not in options:
        values["grippers"] = _fixed(model, drive) | values["grippers"]
    return Arm(model, drive, **values)


def _fixed(model: Model, drive: Drive) -> dict[str, GripperConfig]:
    """Return gripper configurations, by name, that hold joints without limits in place.

    Joints of the controlled chain are left out.
    """
    known = {
        joint.name
        for joint in model.joints
        if all(end is not None and np.isfinite(end) for end in (joint.lower, joint.upper))
    }
    positions = zip(drive.names, drive.read().position.tolist(), strict=True)
    return {
        name: GripperConfig(opened=position, closed=position)
        for name, position in positions
        if name not in known and name not in model.joint_names
    }


def _on_table(config: Config, height: float | bool | None) -> Config:
    """Return a copy of the configuration with another table height [m]; False, None: no table."""
    if height is True:
        raise ConfigError("table is a height [m], or False for none; got True")
    table = None if height is None or height is False else table_height(height)
    robot = config.robot.model_copy(update={"table": table})
    return config.model_copy(update={"robot": robot})


def _backend_options(config: Config, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that are for the simulator or the emulator, not for `pliant.Arm`.

    Raises:
        ConfigError: The backend of the configuration does not have one of the options.
    """
    simulator_options = {"q", "real_time", *PLANT_OPTIONS}
    known = {"bus": set(), "emulator": {"q"}, "sim": simulator_options}[config.backend]
    for key in options:
        if key in simulator_options - known:
            raise ConfigError(
                f"{key!r} is an option of a simulated arm, but the backend is "
                f'{config.backend!r}: connect(..., backend="sim")'
            )
    check_options(options, ARM_OPTIONS | known)
    return {key: value for key, value in options.items() if key in known}


def _check_rest(config: Config, model: Model) -> None:
    """Check that `life.rest_q` of the file has one entry per joint, within the joint limits."""
    if config.life.rest_q is None:
        return
    try:
        posture(model, config.life.rest_q, "life.rest_q")
    except (OutOfRangeError, ShapeError) as error:
        raise ConfigError(f"{config.source}: {error}") from error


def make_drive(
    config: Config,
    model: Model,
    *,
    q: ArrayLike | None = None,
    real_time: bool = False,
    **plant: Any,
) -> Drive:
    """Create the drive for the backend in the file: servo bus, emulated bus, or simulator."""
    if config.backend == "sim":
        return make_simulated(config, model, q=q, real_time=real_time, **plant)
    if config.backend == "emulator":
        return EmulatedBus(config, model, q=q)
    return make_bus(config, port_paths(config))


def make_simulated(
    config: Config, model: Model, *, q: ArrayLike | None, real_time: bool, **plant: Any
) -> Drive:
    """Create the drive of a simulated arm, with the servos and the table of the file."""
    from pliant.sim import Plant, SimDrive
    from pliant.sim._checks import STEP, physics_steps

    # The error of `Plant` would name its own argument, not the key of the file.
    physics_steps(plant.get("dt", STEP), plant.get("rate", config.loop.rate), name="loop.rate")
    options: dict[str, Any] = {"rate": config.loop.rate}
    if config.servo:
        options |= {
            "extra_servos": extra_servos(config, model),
            "encoder_step": chain_servos(config, model).encoder_step,
        }
    options |= plant
    options["scene"] = [*table_fixtures(config), *options.get("scene", ())]
    simulated = Plant(model, **options)
    simulated.reset(start_pose(config, model) if q is None else vector(model, q, "q"))
    check_above_table(simulated)
    # The controller gets the file's servo parameters, even if options change the simulated servos.
    return SimDrive(simulated, servos=model.servos if config.servo else None, real_time=real_time)


def table_fixtures(config: Config) -> list[Tabletop]:
    """Return the objects of the simulated scene that the file defines: its table, or none."""
    if config.robot.table is None:
        return []
    from pliant.sim import Tabletop

    return [Tabletop(height=config.robot.table)]


def check_above_table(plant: Plant) -> None:
    """Check that a simulated arm starts above its table.

    Raises:
        ConfigError: The arm starts inside the table.
    """
    from pliant.sim import Tabletop

    for fixture in plant.fixtures:
        if isinstance(fixture, Tabletop) and fixture.clearance() < -MAX_START_DEPTH:
            raise ConfigError(
                f"the arm would start {-fixture.clearance():.3f} m inside its table: give another "
                "q, or table=False"
            )


def make_bus(config: Config, ports: dict[str, str]) -> ServoBus:
    """Create the servo bus; `ports` maps port names of the file to device paths."""
    return ServoBus(**_bus_options(config, ports))


def _bus_options(
    config: Config, ports: dict[str, str], reply_timeout_min: float = 0.0
) -> dict[str, Any]:
    """Return the arguments of `ServoBus`; its reply timeout is at least `reply_timeout_min` [s]."""
    return {
        "specs": servo_specs(config, ports),
        "baudrate": {ports[port.name]: port.baud for port in config.port},
        "rate": config.loop.rate,
        "reply_timeout_min": max(reply_timeout_min, config.loop.reply_timeout_min),
    }


def servo_specs(config: Config, ports: dict[str, str]) -> list[ServoSpec]:
    """Return the `ServoSpec` of each joint; `ports` maps port names of the file to device paths."""
    entries, counts = calibrations(config), zeros(config)
    return [
        spec(
            joint,
            servo,
            port=ports[servo.port],
            zero=counts[joint],
            calibration=entries.get(joint),
        )
        for joint, servo in servos(config).items()
    ]


def port_paths(config: Config) -> dict[str, str]:
    """Return device paths by port name; the path `auto` in the file means the only serial port.

    Raises:
        ServoError: There is no serial port, or more than one.
    """
    out: dict[str, str] = {}
    for port in config.port:
        out[port.name] = _single_port(port.name) if port.path == "auto" else port.path
    return out


def _single_port(name: str) -> str:
    ports = serial_ports()
    if len(ports) == 1:
        return ports[0]
    if ports:
        raise ServoError(
            f"port {name!r} is 'auto' and there are {len(ports)}: {', '.join(ports)}. "
            "Write the path into the file, or give --port"
        )
    raise ServoError(
        f"port {name!r} is 'auto' and there is no serial port on this machine: plug the adapter in "
        "(Linux: it appears as /dev/ttyUSB0 or /dev/ttyACM0), or try backend 'emulator' or 'sim'"
    )


def gripper_configs(config: Config) -> dict[str, GripperConfig]:
    """Return the `GripperConfig` of the file by joint name; an empty dict without a gripper."""
    gripper = config.gripper
    if gripper is None:
        return {}
    opened, closed = gripper.opened, gripper.closed
    if gripper.joint in calibrations(config):
        closed, opened = gripper_travel(config)
    limits = {"limit": gripper.limit, "lever": gripper.lever}
    return {gripper.joint: GripperConfig(opened=opened, closed=closed, **limits)}


def start_pose(config: Config, model: Model) -> Any:
    """Return the default initial positions (n,) [rad] of a simulated or emulated arm.

    The positions are zero, clipped to the joint limits. If the arm would then be inside the table
    and the file has a rest pose, they are the rest pose.
    """
    zero = np.clip(np.zeros(model.n), model.lower, model.upper)
    table, rest = config.robot.table, config.life.rest_q
    if rest is None or len(rest) != model.n:
        return zero
    if table is None or ArmPoints(model).position(zero)[:, 2].min() >= table:
        return zero
    return np.array(rest)


#: Minimum timeout for replies of emulated servos [s]; the emulator shares the CPU with the program.
REPLY_TIMEOUT_MIN = 0.05
#: Name in the emulator of each calibration register that has another name in the driver, for most
#: servos and for servos with Protocol 1.0.
REGISTERS = {"position_min": "min_position_limit", "position_max": "max_position_limit"}
REGISTERS_P1 = {"position_min": "cw_angle_limit", "position_max": "ccw_angle_limit"}


class EmulatedBus(ServoBus):
    """Servo bus with emulated servos; the emulator runs in a separate process.

    Attributes:
        emulator: The process; `emulator.call("faults.inject", …)` calls a method of the emulator.
    """

    def __init__(self, config: Config, model: Model, *, q: ArrayLike | None = None) -> None:
        """Start the emulator with the arm at q (n,) [rad]; None: the pose of `start_pose`."""
        from pliant.emulator.process import EmulatorProcess

        start = None if q is None else vector(model, q, "q").tolist()
        self.emulator = EmulatorProcess(make_emulator, config, q=start)
        super().__init__(**_bus_options(config, self.emulator.ports, REPLY_TIMEOUT_MIN))

    @property
    def outlives_program(self) -> bool:
        """False: the emulated servos end with the program."""
        return False

    def close(self) -> None:
        """Close the ports and end the process of the emulator."""
        super().close()
        self.emulator.stop()


def make_emulator(config: Config, *, q: ArrayLike | None = None, **options: Any) -> ArmEmulator:
    """Create an emulator of the arm of a configuration; it is not started yet.

    The arm stands on the configuration's table, and is held in place until torque is switched on.
    The supply has the configuration's voltage, the servos on a port have its baud rate. `kp`,
    `friction` and `damping` of the file are those of the emulated joints; stall torque and speed
    are those of the emulated servo models.

    Args:
        config: The configuration.
        q: Initial joint positions (n,) [rad]; None: those of `start_pose`.
        **options: Options of `pliant.emulator.emulate`: `timing`, `faults`, `clock`, `plant`, ...
    """
    from pliant.emulator import emulate

    model = config.model()
    plant = dict(options.pop("plant", None) or {})
    plant["scene"] = [*table_fixtures(config), *plant.get("scene", ())]
    start = start_pose(config, model) if q is None else q
    options.setdefault("baud", {port.name: port.baud for port in config.port})
    bus = emulate(model, make_mounts(config), start, plant=plant, held=True, **options)
    check_above_table(bus.plant)
    if config.supply.voltage is not None:
        bus.supply(config.supply.voltage)
    return bus


def make_mounts(config: Config) -> list[Mount]:
    """Return the `Mount` (joint, id, sign, zero, gear ratio, ...) of each emulated servo."""
    from pliant.emulator import Mount

    counts, entries = zeros(config), calibrations(config)
    rows = [get_model(servo.model) for servo in servos(config).values()]
    has_current_limits = any(row.limit_type == "current" for row in rows)
    out = []
    for joint, servo in servos(config).items():
        zero = counts[joint]
        out.append(
            Mount(
                joint=joint,
                model=servo.model,
                id=servo.id,
                sign=servo.sign,
                zero=None if zero is None else round(zero),
                gear_ratio=servo.gear_ratio,
                secondary=None
                if servo.secondary is None
                else (servo.secondary.id, servo.secondary.sign),
                port=servo.port,
                registers=_as_set_up(servo) | _calibrated(entries.get(joint), servo),
                kp=servo.kp,
                gain=servo.gain,
                voltage=config.supply.voltage,
                friction=servo.friction,
                damping=_gear_damping(servo, with_back_emf=has_current_limits),
            )
        )
    return out


def _gear_damping(servo: Servo, *, with_back_emf: bool) -> float | None:
    """Return the damping of the gears alone [N·m·s/rad]; None: the file has none.

    In a chain with current limits, the damping of a PWM-limited joint includes its back-EMF
    (`servos_from_units`), which the emulator adds by itself.
    """
    from pliant.emulator import models

    if servo.damping is None or not with_back_emf:
        return servo.damping
    if get_model(servo.model).limit_type == "current":
        return servo.damping
    count = 1 if servo.secondary is None else 2
    back_emf = count * servo.gear_ratio**2 * models.find(servo.model).motor.slope
    return max(servo.damping - back_emf, 0.0)


def _as_set_up(servo: Servo) -> dict[str, int]:
    """Return initial EEPROM values by register, as after `pliant servos setup`, with the P gain."""
    from pliant.emulator import models

    row = get_model(servo.model)
    shutdown = {}
    if row.family.status != "feetech":
        factory_value = models.find(servo.model).table["shutdown"].initial
        shutdown = {"shutdown": factory_value & ~(1 << OVERLOAD_BIT)}
    mode = {"operating_mode": 5} if row.limit_type == "current" else {}
    gain = {} if servo.gain is None else {"p_coefficient": servo.gain}
    number = {} if servo.model_number is None else {"model_number": servo.model_number}
    return {"return_delay_time": 0, **shutdown, **mode, **gain, **number}


def _calibrated(entry: Calibration | None, servo: Servo) -> dict[str, int]:
    """Return the EEPROM values that LeRobot's calibration writes, by register of the emulator."""
    if entry is None:
        return {}
    family = get_model(servo.model).family
    names = REGISTERS_P1 if family.status == "p1" else REGISTERS
    written = entry.registers(family.registers)
    return {names.get(name, name): value for name, value in written.items()}
