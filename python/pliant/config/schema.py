"""Schema of a configuration file: its tables, and the checks within each table.

Angles are in radians and torques in N·m, as in the whole package; counts are those of the servo.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, field_validator, model_validator

from pliant import robots
from pliant._core import ConfigError, Model, Servos
from pliant._core import Payload as ToolPayload
from pliant._servo_tables import take
from pliant.arm._checks import MAX_COMM_TIMEOUT
from pliant.config._messages import suggest
from pliant.config._settings_table import check_preset, resolve
from pliant.config.lerobot import read_calibration
from pliant.servo._transactions import MAX_REPLY_TIMEOUT_MIN
from pliant.servo.models import get_model
from pliant.servo.spec import ServoSpec, Units, servos_from_units

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pliant._core import Settings
    from pliant.servo.spec import Calibration


# Strict: a number in quotes is an error.
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, strict=True)]
Number = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Vector3 = tuple[Number, Number, Number]
Id = Annotated[int, Field(ge=0, le=252, strict=True)]


class StrictModel(BaseModel):
    """A table that rejects unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Payload(StrictModel):
    """A load in the tool frame.

    Attributes:
        mass: [kg]
        com: Centre of mass in the tool frame [m].
    """

    mass: NotNegative
    com: Vector3 = (0.0, 0.0, 0.0)


class Robot(StrictModel):
    """Source of the kinematics: one of `urdf` and `builtin`.

    Attributes:
        urdf: Path of a URDF file, relative to the configuration file.
        builtin: Name of an arm that ships with the package.
        base, tip: Ends of the chain; optional if there is only one choice.
        payload: Load at the tool.
        gravity: Vector in base axes [m/s²].
        locked: Fixed angles of joints off the chain [rad].
        limits: Position limits by joint, override the URDF's [rad].
        table: Height of the table under the arm, in base axes [m]; None: no table. Simulated and
            emulated arms touch it, and the path to the rest pose stays above it.
    """

    urdf: Path | None = None
    builtin: str | None = None
    base: str | None = None
    tip: str | None = None
    payload: Payload | None = None
    gravity: Vector3 = (0.0, 0.0, -9.81)
    locked: dict[str, Number] = {}
    limits: dict[str, tuple[Number, Number]] = {}
    table: Number | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.urdf is None) == (self.builtin is None):
            present = "both" if self.urdf else "none of them"
            raise ValueError(f"takes one of urdf and builtin, got {present}")
        return self


class Port(StrictModel):
    """A serial port.

    Attributes:
        name: Name that servos refer to.
        path: Device, or `auto` for the only serial port.
        baud: [bit/s]
    """

    name: str = "main"
    path: str = "auto"
    baud: Annotated[int, Field(ge=9600, le=4_500_000, strict=True)] = 1_000_000


class Secondary(StrictModel):
    """A second servo that drives the same joint; its zero is found at open.

    Attributes:
        id: Its id on the same port.
        sign: +1 if its counts rise with the joint angle.
    """

    id: Id
    sign: Literal[1, -1] = -1


class Servo(StrictModel):
    """One servo of one joint.

    Attributes:
        model: Row of the servo table, e.g. `STS3215-7.4V` or `XM430-W350`.
        id: Its id on the port.
        port: Name of the port.
        sign: +1 if counts rise with the joint angle.
        zero: Count at zero joint angle; None: from the calibration file, else the middle of the
            servo's range.
        gear_ratio: Turns of the servo per turn of the joint.
        secondary: A second servo on the same joint.
        lower, upper: Software position limits [rad]; None: those of the servo.
        stall: Stall torque at the rated voltage, overrides the table [N·m].
        torque_offset: Torque loss in the gears, subtracted from that of the register [N·m].
        gain: P gain register, for the simulator and the emulator; only for servos that store it
            without power (Feetech); None: the maker's default. On the bus it is read from the
            servo.
        kp: Identified stiffness [N·m/rad], overrides that of the gain register.
        friction: Identified dry friction, overrides the table's [N·m].
        damping: Identified viscous damping of the gears, overrides the table's [N·m·s/rad].
    """

    model: str
    id: Id
    port: str = "main"
    sign: Literal[1, -1] = 1
    zero: Number | None = None
    gear_ratio: Positive = 1.0
    secondary: Secondary | None = None
    lower: Number | None = None
    upper: Number | None = None
    stall: Positive | None = None
    torque_offset: NotNegative = 0.0
    gain: Annotated[int, Field(ge=1, le=16383, strict=True)] | None = None
    kp: Positive | None = None
    friction: NotNegative | None = None
    damping: NotNegative | None = None

    @field_validator("model")
    @classmethod
    def _known(cls, name: str) -> str:
        try:
            get_model(name)
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return name

    @model_validator(mode="after")
    def _keeps_its_gain(self) -> Self:
        if self.gain is not None and get_model(self.model).family.status != "feetech":
            raise ValueError(
                f"gain: {self.model} starts with the maker's gain whenever it is switched on; "
                "leave it out"
            )
        return self


class Gripper(StrictModel):
    """A gripper: a joint off the chain that opens and closes.

    Attributes:
        servo: Its servo.
        joint: Joint name; if the model has this joint, it gives the gripper's weight and place.
        opened, closed: Angles of the two ends [rad]; None: the limits of the model's joint.
        limit: Default torque limit [N·m]; None: the lesser of 30 % of the largest torque and 0.9 of
            the servo's overload threshold.
        lever: Distance from its axis to the middle of the finger [m]; forces are then in newtons
            at the finger.
    """

    servo: Servo
    joint: str = "gripper"
    opened: Number | None = None
    closed: Number | None = None
    limit: NotNegative | None = None
    lever: Positive | None = None

    @model_validator(mode="after")
    def _two_ends(self) -> Self:
        if self.opened is not None and self.opened == self.closed:
            raise ValueError(f"opened and closed are the same angle, {self.opened:g} rad")
        return self


class Loop(StrictModel):
    """The control loop.

    Attributes:
        rate: [Hz]
        comm_timeout: Time without positions or without commands after which `pliant.Loop` raises
            [s], at most 60.
        reply_timeout_min: Minimum reply timeout [s], at most 1; use more than the default on a busy
            computer.
    """

    rate: Annotated[float, Field(gt=0.0, le=2000.0, strict=True)] = 100.0
    comm_timeout: Annotated[float, Field(gt=0.0, le=MAX_COMM_TIMEOUT, strict=True)] = 0.5
    reply_timeout_min: Annotated[float, Field(gt=0.0, le=MAX_REPLY_TIMEOUT_MIN, strict=True)] = 0.01


class Life(StrictModel):
    """Ending of the arm: behaviour at the end of `with`.

    Attributes:
        rest_q: Pose to move to first (n,) [rad]; None: straight down.
        on_exit: Action on leaving.
    """

    rest_q: list[Number] | None = None
    on_exit: Literal["lower", "leave_enabled"] = "lower"


class Supply(StrictModel):
    """Power supply of the servos.

    Attributes:
        voltage: Nominal voltage [V], for the emulator and `doctor`; an arm measures its own.
        current: Largest current of the supply [A]; None: no limit.
    """

    voltage: Positive | None = None
    current: Positive | None = None


class Config(StrictModel):
    """Configuration of an arm. Read one with `pliant.config.load`.

    Attributes:
        backend: `bus`; `emulator`, an emulated bus with simulated physics; or `sim`, physics alone.
        robot: Kinematics.
        port: Serial ports.
        servo: Servo of each joint of the chain, by the joint's name.
        gripper: Gripper, if there is one.
        supply: Voltage and current of the supply.
        calibration: LeRobot's calibration file, relative to this one; `~` is the home folder.
        loop: Rate and deadlines.
        life: Descent at the end.
        preset: A preset of `pliant.Settings` by name, `"door"`, or with its arguments,
            `{ name = "soft", axes = "y yaw" }`.
        fields: The table `settings`: fields of `pliant.Settings`; `axes` is a table by axis key.
    """

    backend: Literal["bus", "emulator", "sim"] = "bus"
    robot: Robot
    port: list[Port] = [Port()]
    servo: dict[str, Servo] = {}
    gripper: Gripper | None = None
    supply: Supply = Supply()
    calibration: Path | None = None
    loop: Loop = Loop()
    life: Life = Life()
    preset: str | dict[str, Any] | None = None
    fields: dict[str, Any] = Field(default_factory=dict, alias="settings")

    #: Folder for relative paths, and name of the file in errors.
    _folder: Path = PrivateAttr(default=Path())
    _source: str = PrivateAttr(default="configuration")

    @field_validator("preset")
    @classmethod
    def _there_is_one(cls, preset: str | dict[str, Any] | None) -> str | dict[str, Any] | None:
        check_preset(preset)
        return preset

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_tables(self)
        return self

    @property
    def folder(self) -> Path:
        """Folder for relative paths."""
        return self._folder

    @property
    def source(self) -> str:
        """Name of the file in errors."""
        return self._source

    def at(self, folder: Path, source: str) -> Self:
        """Return a copy as if read from a file in `folder`, with the name `source` in errors."""
        out = self.model_copy()
        out._folder, out._source = folder, source
        return out

    def model(self) -> Model:
        """Return the kinematic model.

        Raises:
            UrdfError: The URDF is not usable.
            ConfigError: Its joints do not match the servos of the file.
        """
        robot = self.robot
        options: dict[str, Any] = {
            "base": robot.base,
            "tip": robot.tip,
            "gravity": robot.gravity,
            "locked": robot.locked or None,
            "limits": robot.limits or None,
        }
        if robot.payload is not None:
            options["payload"] = ToolPayload(robot.payload.mass, robot.payload.com)
        options = {key: value for key, value in options.items() if value is not None}
        if robot.builtin is not None:
            out = robots.load(robot.builtin, **options)
        else:
            path = inside(self, robot.urdf)
            if not path.is_file():
                raise ConfigError(
                    f"robot.urdf: there is no file {path}; give the path of this arm's URDF, in "
                    "the file or by --urdf"
                )
            out = Model.from_urdf(str(path), **options)
        _match(self, out)
        return out.with_servos(chain_servos(self, out)) if self.servo else out

    def settings(self) -> Settings:
        """Return the controller settings, validated by the same code as those created in Python.

        Raises:
            ConfigError: Invalid fields or values; the message lists all.
        """
        made, wrong = resolve(self.fields, self.preset, self.loop.rate)
        if made is None:
            raise ConfigError("; ".join(wrong))
        return made

    def __repr__(self) -> str:
        """Return a one-line description."""
        robot = self.robot.builtin or self.robot.urdf
        return f"<Config of {robot}, {len(self.servo)} servos, backend {self.backend!r}>"

    __str__ = __repr__


def check_tables(config: Config) -> None:
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
    owners: dict[tuple[str, int], str] = {}
    out = []
    for joint, servo in servos(config).items():
        own = [servo.id] if servo.secondary is None else [servo.id, servo.secondary.id]
        for number in own:
            other = owners.setdefault((servo.port, number), joint)
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


def servo_table(config: Config) -> tuple[tuple[str, ...], Servos]:
    """Return the joints of the file's servos, the gripper last, and their parameters (N,).

    They equal those read from the registers on a bus, at the file's supply voltage and gains.
    """
    own = servos(config)
    units = [
        Units.of(spec(joint, servo, port=servo.port), config.supply.voltage)
        for joint, servo in own.items()
    ]
    gains = [servo.gain or get_model(servo.model).gain_default for servo in own.values()]
    return tuple(own), servos_from_units(units, gains, [unit.full for unit in units])


def chain_servos(config: Config, model: Model) -> Servos:
    """Return the servos (n,) of the chain; `stiffness_known` if the file gives every `kp`."""
    names, table = servo_table(config)
    known = all(config.servo[joint].kp is not None for joint in model.joint_names)
    places = [names.index(joint) for joint in model.joint_names]
    return take(table, len(names), places).replace(stiffness_known=known)


def extra_servos(config: Config, model: Model) -> dict[str, Servos]:
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
            entry.check_range(joint, get_model(servo.model))
        except ConfigError as error:
            raise ConfigError(f"{config.calibration}: {error}") from error
        out[joint] = entry
    return out


def inside(config: Config, path: Path | None) -> Path:
    """Resolve a path of the file relative to its folder."""
    assert path is not None
    path = path.expanduser()
    return path if path.is_absolute() else config.folder / path
