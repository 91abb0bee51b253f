"""Schema of a configuration file: its tables, and the validation of each table.

Angles are in radians, torques in N·m, and positions of servos in encoder counts.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    field_validator,
    model_validator,
)

from pliant import robots
from pliant._core import ConfigError, FrameNotFoundError, Model, Servos
from pliant._core import Payload as ToolPayload
from pliant._servo_tables import take
from pliant.arm._checks import MAX_COMM_TIMEOUT, MAX_TABLE_HEIGHT
from pliant.config._messages import suggest
from pliant.config._settings_table import check_preset, resolve
from pliant.config._toml import toml_key
from pliant.config.lerobot import read_calibration
from pliant.servo._transactions import MAX_REPLY_TIMEOUT_MIN
from pliant.servo.models import get_model
from pliant.servo.spec import ServoSpec, Units, servos_from_units

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pliant._core import Settings
    from pliant.servo.spec import Calibration


#: Largest joint angle that a file may give [rad], two turns: a larger number is in degrees.
MAX_ANGLE = 4.0 * math.pi
#: Largest gravity that a file may give [m/s²]: a larger number is not in m/s².
MAX_GRAVITY = 30.0
# `strict=True` rejects a string that looks like a number, such as "0.5".
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, strict=True)]
Number = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Vector3 = tuple[Number, Number, Number]
Id = Annotated[int, Field(ge=0, le=252, strict=True)]
#: Torque [N·m], stiffness [N·m/rad] and gear ratio of a servo; the bounds are far above real ones.
Torque = Annotated[float, Field(gt=0.0, le=1e4, allow_inf_nan=False, strict=True)]
Stiffness = Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False, strict=True)]
Ratio = Annotated[float, Field(gt=0.0, le=1e3, allow_inf_nan=False, strict=True)]
#: Largest value of the P gain register of Feetech servos.
MAX_GAIN = 254


def _not_bool(value: object) -> object:
    """Reject a bool, because ``True == 1`` and the validation of literals compares values."""
    if isinstance(value, bool):
        raise ValueError(f"must be 1 or -1, got {str(value).lower()}")
    return value


Sign = Annotated[Literal[1, -1], BeforeValidator(_not_bool)]


class StrictModel(BaseModel):
    """Base class of all tables of a configuration file; rejects unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Payload(StrictModel):
    """Table of a load at the tool.

    Attributes:
        mass: Mass [kg].
        com: Centre of mass in the tool frame [m].
    """

    mass: NotNegative
    com: Vector3 = (0.0, 0.0, 0.0)


class Robot(StrictModel):
    """Table of the robot model; exactly one of `urdf` and `builtin` is given.

    Attributes:
        urdf: Path of a URDF file, relative to the configuration file.
        builtin: Name of an arm that ships with the package.
        base, tip: First and last link of the controlled chain; default: the root link, and the only
            link without a child.
        payload: Load at the tool.
        gravity: Gravity vector in base axes [m/s²].
        locked: Fixed angles by name of joints outside the controlled chain [rad].
        limits: Position limits by joint name, in place of those of the URDF [rad].
        table: Height of the table under the arm, in base axes [m]; None: no table. Simulated arms
            collide with the table, and the path to the rest pose stays above it.
    """

    urdf: Path | None = None
    builtin: str | None = None
    base: str | None = None
    tip: str | None = None
    payload: Payload | None = None
    gravity: Vector3 = (0.0, 0.0, -9.81)
    locked: dict[str, Number] = {}
    limits: dict[str, tuple[Number, Number]] = {}
    table: Annotated[Number, Field(ge=-MAX_TABLE_HEIGHT, le=MAX_TABLE_HEIGHT)] | None = None

    @field_validator("gravity")
    @classmethod
    def _in_metres(cls, gravity: Vector3) -> Vector3:
        if (size := math.hypot(*gravity)) > MAX_GRAVITY:
            raise ValueError(
                f"{size:g} m/s² is above {MAX_GRAVITY:g}: gravity is in m/s², 9.81 on Earth"
            )
        return gravity

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.urdf is None) == (self.builtin is None):
            present = "both" if self.urdf else "none of them"
            raise ValueError(f"takes one of urdf and builtin, got {present}")
        return self


class Port(StrictModel):
    """Table of a serial port.

    Attributes:
        name: Name that servos refer to.
        path: Path of the device, or `auto` for the only serial port.
        baud: Baud rate [bit/s], 9600 to 4 500 000.
    """

    name: str = "main"
    path: str = "auto"
    baud: Annotated[int, Field(ge=9600, le=4_500_000, strict=True)] = 1_000_000


class Secondary(StrictModel):
    """Table of a second servo on a joint; its zero count is determined when the bus is opened.

    Attributes:
        id: Id of the second servo, on the same port as the first servo.
        sign: +1 if the counts of the second servo rise with the joint angle, else -1.
    """

    id: Id
    sign: Sign = -1


class Servo(StrictModel):
    """Table of the servo of a joint.

    Attributes:
        model: Name of a servo model, e.g. `STS3215-7.4V` or `XM430-W350`.
        model_number: Content of the register Model Number, if the servo is not in the table of
            models but has the control table of `model`; None: the number of `model`.
        no_load: No-load speed at the rated voltage [rpm]; None: that of the servo model.
        voltage: Lowest and highest supply voltage [V]; None: those of the servo model.
        id: Id of the servo on its port.
        port: Name of the port.
        sign: +1 if encoder counts rise with the joint angle, else -1.
        zero: Encoder count at zero joint angle; None: from the calibration file, or without one the
            middle of the servo's range.
        gear_ratio: Turns of the servo per turn of the joint.
        secondary: Second servo on the same joint.
        lower, upper: Software position limits [rad], which narrow those of the model; None: the
            limits of the servo.
        stall: Stall torque at the rated voltage [N·m]; None: that of the servo model.
        torque_offset: Torque loss in the gears [N·m], subtracted from the torque of the torque
            limit register.
        gain: Value of the P gain register in the simulator and the emulator, only for servos that
            keep it without power (Feetech); None: the maker's default. The gain of a real servo is
            read from the servo.
        kp: Identified stiffness at this gain [N·m/rad]; it is scaled in proportion if the servo has
            another gain. None: the stiffness is computed from the gain register.
        friction: Identified dry friction [N·m]; None: that of the servo model.
        damping: Identified viscous damping of the gears [N·m·s/rad]; None: that of the servo model.
    """

    model: str
    model_number: Annotated[int, Field(ge=1, le=65535, strict=True)] | None = None
    no_load: Positive | None = None
    voltage: tuple[Positive, Positive] | None = None
    id: Id
    port: str = "main"
    sign: Sign = 1
    zero: Number | None = None
    gear_ratio: Ratio = 1.0
    secondary: Secondary | None = None
    lower: Number | None = None
    upper: Number | None = None
    stall: Torque | None = None
    torque_offset: NotNegative = 0.0
    gain: Annotated[int, Field(ge=1, strict=True)] | None = None
    kp: Stiffness | None = None
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
        if self.gain is not None and self.gain > MAX_GAIN:
            raise ValueError(f"gain: {self.model} takes 1 to {MAX_GAIN}, got {self.gain}")
        return self


class Gripper(StrictModel):
    """Table of a gripper: a joint outside the controlled chain that opens and closes.

    Attributes:
        servo: Servo of the gripper.
        joint: Joint name; the model may have a joint of this name.
        opened, closed: Joint positions when open and when closed [rad]; None: the upper and the
            lower position limit of the joint in the model.
        limit: Default torque limit [N·m]; None: the smaller of 30 % of the usable torque and 90 %
            of the servo's overload threshold.
        lever: Distance from the joint axis to the middle of the finger [m]; if given, grip forces
            can be set in newtons at the finger.
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
    """Table of the control loop.

    Attributes:
        rate: Rate of the loop [Hz].
        comm_timeout: Time without new positions or without commands after which `pliant.Loop`
            raises an error [s], at most 60.
        reply_timeout_min: Minimum time to wait for the reply of a servo [s], at most 1; increase it
            on a busy computer.
    """

    rate: Annotated[float, Field(gt=0.0, le=2000.0, strict=True)] = 100.0
    comm_timeout: Annotated[float, Field(gt=0.0, le=MAX_COMM_TIMEOUT, strict=True)] = 0.5
    reply_timeout_min: Annotated[float, Field(gt=0.0, le=MAX_REPLY_TIMEOUT_MIN, strict=True)] = 0.01


class Life(StrictModel):
    """Table of the arm's behaviour at the end of its `with` block.

    Attributes:
        rest_q: Joint positions (n,) [rad] in which the arm rests without torque; the arm moves
            there before torque off. None: the arm is lowered straight down.
        on_exit: `lower`: lower the arm, then torque off; `leave_enabled`: torque stays on.
        guardian: True: a separate process performs `on_exit` if the program is killed, crashes or
            hangs; only with real servos.
    """

    rest_q: list[Number] | None = None
    on_exit: Literal["lower", "leave_enabled"] = "lower"
    guardian: Annotated[bool, Field(strict=True)] = True


class Supply(StrictModel):
    """Power supply of the servos.

    Attributes:
        voltage: Nominal voltage [V] for simulated and emulated servos; real servos measure it.
            None: the rated voltage of each model.
        current: Largest current of the supply [A]; None: no limit. Only for servos that limit
            their current; no effect on the backend `sim`.
    """

    voltage: Positive | None = None
    current: Positive | None = None


class Config(StrictModel):
    """Configuration of an arm; `pliant.config.load` reads it from a TOML file.

    Attributes:
        backend: `bus`: real servos; `emulator`: an emulated bus with simulated physics; `sim`:
            simulated physics without a bus.
        robot: Robot model, and table under the arm.
        port: Serial ports.
        servo: Servo of each joint of the controlled chain, by joint name.
        gripper: The gripper; None: the arm has no gripper.
        supply: Voltage and current of the power supply.
        calibration: LeRobot's calibration file, relative to the configuration file; `~` is the home
            folder.
        loop: Rate and timeouts of the control loop.
        life: Behaviour of the arm at the end of its `with` block.
        preset: Preset of `pliant.Settings`: a name such as `"door"`, or a table with name and
            arguments, `{ name = "soft", axes = "y yaw" }`.
        fields: The table `settings` with fields of `pliant.Settings`; its key `axes` is a table
            with one entry per task axis.
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

    #: Folder that relative paths start from, name of the configuration in error messages, and name
    #: of the arm in messages.
    _folder: Path = PrivateAttr(default=Path())
    _source: str = PrivateAttr(default="configuration")
    _name: str | None = PrivateAttr(default=None)

    @field_validator("preset", mode="before")
    @classmethod
    def _exists(cls, preset: Any) -> Any:
        if preset is not None and not isinstance(preset, str | dict):
            raise ValueError(
                f'takes a name, as "door", or a table, as {{ name = "wipe" }}, got {preset!r}'
            )
        check_preset(preset)
        return preset

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        errors = [*_ports(self), *_ids(self), *_supply(self)]
        if self.backend != "sim" and not self.servo:
            backend = f"backend {self.backend!r}"
            errors.append(f"servo is missing: {backend} needs a servo for every joint")
        if errors:
            raise ValueError("\n".join(errors))
        return self

    @property
    def folder(self) -> Path:
        """Folder that relative paths in the configuration start from."""
        return self._folder

    @property
    def source(self) -> str:
        """Name of the configuration in error messages, usually the path of its file."""
        return self._source

    @property
    def name(self) -> str | None:
        """Name of the arm in messages: that of the built-in arm, or of the file without `.toml`.

        None: the configuration is from no file.
        """
        return self._name

    def at(self, folder: Path, source: str, name: str | None = None) -> Self:
        """Return a copy with relative paths from `folder`, named `source` in error messages.

        `name` is the name of the arm in messages; None: that of the model.
        """
        out = self.model_copy()
        out._folder, out._source, out._name = folder, source, name
        return out

    def model(self) -> Model:
        """Return the robot model: kinematics, masses and servo parameters of the chain.

        Raises:
            UrdfError: The URDF is not usable.
            ConfigError: There is no such URDF file, the joints of the chain do not match the servos
                of the file, or an angle can only be in degrees.
        """
        robot = self.robot
        load = robot.payload
        options: dict[str, Any] = {
            "base": robot.base,
            "tip": robot.tip,
            "gravity": robot.gravity,
            "locked": robot.locked or None,
            "limits": robot.limits or None,
            "payload": None if load is None else ToolPayload(load.mass, load.com),
        }
        options = {key: value for key, value in options.items() if value is not None}
        out = self._load(options)
        _match(self, out)
        _check_angles(self, out)
        if narrowed := _software_limits(self, out):
            out = self._load({**options, "limits": {**robot.limits, **narrowed}})
        return out.with_servos(chain_servos(self, out)) if self.servo else out

    def _load(self, options: dict[str, Any]) -> Model:
        """Return the built-in model or that of the URDF, with these options of `Model.from_urdf`.

        Raises:
            UrdfError: The URDF is not usable.
            ConfigError: There is no such URDF file or link, or an option is not valid.
        """
        try:
            if self.robot.builtin is not None:
                return robots.load(self.robot.builtin, **options)
            assert self.robot.urdf is not None
            path = resolve_path(self, self.robot.urdf)
            if not path.is_file():
                raise ConfigError(
                    f"robot.urdf: there is no file {path}; give the path of this arm's URDF, in "
                    "the file or by --urdf"
                )
            return Model.from_urdf(str(path), **options)
        except FrameNotFoundError as error:
            name = str(error.frame)
            key = "base" if name == options.get("base") else "tip"
            known = suggest(name, error.available or ())
            raise ConfigError(f"robot.{key}: there is no link {name!r}; {known}") from None

    def settings(self) -> Settings:
        """Return the settings of the controller, validated by `pliant.Settings`.

        Raises:
            ConfigError: Fields or values are invalid; the message lists all errors.
        """
        settings, errors = resolve(self.fields, self.preset, self.loop.rate)
        if settings is None:
            raise ConfigError("; ".join(errors))
        return settings

    def __repr__(self) -> str:
        """Return a description of the configuration in one line."""
        robot = self.robot.builtin or self.robot.urdf
        return f"<Config of {robot}, {len(self.servo)} servos, backend {self.backend!r}>"

    __str__ = __repr__


def _ports(config: Config) -> list[str]:
    names = [port.name for port in config.port]
    out = [f"port {name!r} is there twice" for name in sorted(set(names)) if names.count(name) > 1]
    for joint, servo in servos(config).items():
        if servo.port not in names:
            remedy = suggest(servo.port, names)
            out.append(f"servo.{toml_key(joint)}.port: no port {servo.port!r}; {remedy}")
    return out


def _ids(config: Config) -> list[str]:
    owners: dict[tuple[str, int], str] = {}
    out = []
    for joint, servo in servos(config).items():
        ids = [servo.id] if servo.secondary is None else [servo.id, servo.secondary.id]
        for number in ids:
            other = owners.setdefault((servo.port, number), joint)
            if other != joint or ids.count(number) > 1:
                out.append(
                    f"servo.{toml_key(joint)} and servo.{toml_key(other)} have the same id "
                    f"{number} on port {servo.port!r}; every servo on a port needs an id of its own"
                )
    return list(dict.fromkeys(out))


def _supply(config: Config) -> list[str]:
    volts, out = config.supply.voltage, []
    unknown: list[str] = []
    for joint, servo in servos(config).items():
        row = get_model(servo.model)
        low, high = servo.voltage or row.voltage
        if volts is not None and not low <= volts <= high:
            out.append(
                f"supply.voltage: {servo.model} of {joint} takes {low:g} to {high:g} V, got "
                f"{volts:g} V; leave it out if the servos have different supplies: each model then "
                "has its rated voltage"
            )
        if not math.isfinite(row.stall_current):  # set for servos that limit their current
            unknown.append(f"{joint} ({servo.model})")
    # Backend "sim" does not simulate servo currents, so the supply current has no limit.
    if config.supply.current is not None and config.backend != "sim" and unknown:
        out.append(
            f"supply.current: {', '.join(unknown)} cannot limit their current, so the current of "
            "the supply cannot be kept; leave it out"
        )
    return out


def servos(config: Config) -> dict[str, Servo]:
    """Return all servos of the file by joint name, including the servo of the gripper."""
    out = dict(config.servo)
    if config.gripper is not None:
        out[config.gripper.joint] = config.gripper.servo
    return out


def spec(
    joint: str,
    servo: Servo,
    *,
    port: str,
    zero: float | None = None,
    calibration: Calibration | None = None,
) -> ServoSpec:
    """Return the `ServoSpec` of a joint.

    `zero` is the encoder count at joint angle 0; None: the middle of the servo's range.
    """
    return ServoSpec(
        name=joint,
        zero=zero,
        port=port,
        calibration=calibration,
        secondary=None if servo.secondary is None else (servo.secondary.id, servo.secondary.sign),
        **servo.model_dump(exclude={"zero", "port", "secondary"}),
    )


def servo_table(config: Config) -> tuple[tuple[str, ...], Servos]:
    """Return the names of the N joints with a servo, the gripper last, and the servo parameters.

    The parameters (N,) follow from the servo models, the supply voltage and the gains in the file.
    """
    by_joint = servos(config)
    units = [
        Units.of(spec(joint, servo, port=servo.port), config.supply.voltage)
        for joint, servo in by_joint.items()
    ]
    gains = [servo.gain or get_model(servo.model).gain_default for servo in by_joint.values()]
    return tuple(by_joint), servos_from_units(units, gains, [unit.full for unit in units])


def chain_servos(config: Config, model: Model) -> Servos:
    """Return the servo parameters (n,) of the controlled chain.

    `stiffness_known` is True if the file gives `kp` for every joint of the chain.
    """
    names, table = servo_table(config)
    known = all(config.servo[joint].kp is not None for joint in model.joint_names)
    indices = [names.index(joint) for joint in model.joint_names]
    return take(table, len(names), indices).replace(stiffness_known=known)


def extra_servos(config: Config, model: Model) -> dict[str, Servos]:
    """Return, by joint name, the servo parameters of each joint outside the controlled chain."""
    names, table = servo_table(config)
    return {
        name: take(table, len(names), [i])
        for i, name in enumerate(names)
        if name not in model.joint_names
    }


def _match(config: Config, model: Model) -> None:
    """Check that the file has one servo for each joint of the chain, and no other servos."""
    if not config.servo:
        return
    chain, named = set(model.joint_names), set(config.servo)
    missing = [joint for joint in model.joint_names if joint not in named]
    unknown = [joint for joint in config.servo if joint not in chain]
    if not (missing or unknown):
        return
    parts = []
    if missing:
        parts.append(f"no servo for {', '.join(missing)}")
    if unknown:
        parts.append(f"no joint for the servos {', '.join(unknown)}")
    raise ConfigError(
        f"file and URDF disagree on the joints from {model.base} to {model.tip}: "
        f"{'; '.join(parts)}. The chain has {', '.join(model.joint_names)}"
    )


def _check_angles(config: Config, model: Model) -> None:
    """Check that the joint angles of the file can be radians, except for sliding joints.

    Raises:
        ConfigError: An angle is beyond `MAX_ANGLE`.
    """
    sliding = {joint.name for joint in model.joints if joint.kind == "prismatic"}
    for key, joint, angle in _angles(config, model):
        if joint not in sliding and abs(angle) > MAX_ANGLE:
            raise ConfigError(
                f"{key}: {angle:g} is beyond ±{MAX_ANGLE:.2f} rad, two turns either way: angles of "
                f"the file are in radians, and {angle:g}° are {math.radians(angle):.4g} rad"
            )


def _angles(config: Config, model: Model) -> Iterator[tuple[str, str, float]]:
    """Yield key, joint name and value of every joint angle in the file."""
    robot, gripper = config.robot, config.gripper
    for joint, ends in robot.limits.items():
        yield from ((f"robot.limits.{toml_key(joint)}", joint, end) for end in ends)
    for joint, angle in robot.locked.items():
        yield f"robot.locked.{toml_key(joint)}", joint, angle
    for joint, servo in servos(config).items():
        key = f"servo.{toml_key(joint)}" if joint in config.servo else "gripper.servo"
        for name, end in (("lower", servo.lower), ("upper", servo.upper)):
            if end is not None:
                yield f"{key}.{name}", joint, end
    if gripper is not None:
        for name, end in (("opened", gripper.opened), ("closed", gripper.closed)):
            if end is not None:
                yield f"gripper.{name}", gripper.joint, end


def _software_limits(config: Config, model: Model) -> dict[str, tuple[float, float]]:
    """Return the position limits [rad] of joints whose servo has `lower` or `upper`, by name.

    They are the limits of the model, narrowed by those of the servo: otherwise the servo bus would
    cut goals that the controller believes are followed.

    Raises:
        ConfigError: A servo leaves its joint no range.
    """
    out = {}
    ends = zip(model.joint_names, model.lower.tolist(), model.upper.tolist(), strict=True)
    for joint, lowest, highest in ends:
        servo = config.servo.get(joint)
        if servo is None or (servo.lower is None and servo.upper is None):
            continue
        lower = lowest if servo.lower is None else max(lowest, servo.lower)
        upper = highest if servo.upper is None else min(highest, servo.upper)
        if not lower < upper:
            key = toml_key(joint)
            bounds = [bound for bound in (servo.lower, servo.upper) if bound is not None]
            raise ConfigError(
                f"servo.{key}: lower and upper, here {', '.join(f'{b:g}' for b in bounds)} rad, "
                f"leave no range within {lowest:g} to {highest:g} rad, the limits of the model; "
                f"lower is below upper, and robot.limits.{key} replaces those of the model"
            )
        out[joint] = (lower, upper)
    return out


def zeros(config: Config) -> dict[str, float | None]:
    """Return the encoder count at zero angle of each joint, including the gripper.

    None means the middle of the servo's range. With a calibration file, the zero angle is at the
    middle of the calibrated range, as in LeRobot; a gripper is closed at one end of its range.

    Raises:
        ConfigError: The calibration file cannot be read, lacks a joint, or has a wrong id or an
            impossible range of a servo.
    """
    entries = calibrations(config)
    out = {
        joint: entries[joint].middle if joint in entries else servo.zero
        for joint, servo in servos(config).items()
    }
    gripper = config.gripper
    if gripper is not None and gripper.joint in entries:
        closed, opened = gripper_travel(config)
        unit = Units.of(spec(gripper.joint, gripper.servo, port=gripper.servo.port))
        entry = entries[gripper.joint]
        is_increasing = (opened > closed) == (unit.sign > 0)
        end = entry.range_min if is_increasing else entry.range_max
        out[gripper.joint] = end - unit.sign * closed / unit.count
    return out


def gripper_travel(config: Config) -> tuple[float, float]:
    """Return the positions of a file's gripper when closed and when opened [rad].

    The closed position and the direction come from the configuration or the model; the distance
    to the opened position comes from the calibration file, if there is one.

    Raises:
        ConfigError: The calibration is not usable; or neither the configuration nor the model gives
            the closed or the opened position.
    """
    gripper = config.gripper
    assert gripper is not None
    closed, opened = gripper.closed, gripper.opened
    if closed is None or opened is None:
        joint = next((j for j in config.model().joints if j.name == gripper.joint), None)
        closed = joint.lower if closed is None and joint is not None else closed
        opened = joint.upper if opened is None and joint is not None else opened
    if closed is None or opened is None or not math.isfinite(opened - closed):
        raise ConfigError(
            f"gripper {gripper.joint!r} has no limit in the model: give [gripper] `opened` and "
            "`closed` [rad]"
        )
    entry = calibrations(config).get(gripper.joint)
    if entry is not None:
        unit = Units.of(spec(gripper.joint, gripper.servo, port=gripper.servo.port))
        travel = (entry.range_max - entry.range_min) * unit.count
        opened = closed + math.copysign(travel, opened - closed)
    return closed, opened


def calibrations(config: Config) -> dict[str, Calibration]:
    """Return the calibration of each joint that takes its zero from the calibration file.

    Raises:
        ConfigError: The calibration file cannot be read, lacks a joint, or has a wrong id or an
            impossible range of a servo.
    """
    if config.calibration is None:
        return {}
    table: Mapping[str, Calibration] = read_calibration(resolve_path(config, config.calibration))
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


def resolve_path(config: Config, path: Path) -> Path:
    """Resolve a path in a configuration, where relative paths start from the folder of the file."""
    path = path.expanduser()
    return path if path.is_absolute() else config.folder / path
