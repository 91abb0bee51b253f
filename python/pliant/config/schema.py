"""Schema of a configuration file: its tables, and the checks within each table.

Angles are in radians and torques in N·m, as in the whole package; counts are those of the servo.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, field_validator, model_validator

from pliant import ConfigError
from pliant.arm.checks import LONGEST_HOLD
from pliant.config import build
from pliant.config.fields import check_preset
from pliant.servo.models import find
from pliant.servo.wire import LONGEST_PATIENCE

if TYPE_CHECKING:
    from pliant import Model, Settings

# Strict: a number in quotes is an error.
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, strict=True)]
Number = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Triple = tuple[Number, Number, Number]
Id = Annotated[int, Field(ge=0, le=252, strict=True)]


class Table(BaseModel):
    """A table that rejects unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Payload(Table):
    """A load in the tool frame.

    Attributes:
        mass: [kg]
        com: Centre of mass in the tool frame [m].
    """

    mass: NotNegative
    com: Triple = (0.0, 0.0, 0.0)


class Robot(Table):
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
    gravity: Triple = (0.0, 0.0, -9.81)
    locked: dict[str, Number] = {}
    limits: dict[str, tuple[Number, Number]] = {}
    table: Number | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.urdf is None) == (self.builtin is None):
            given = "both" if self.urdf else "none of them"
            raise ValueError(f"takes one of urdf and builtin, got {given}")
        return self


class Port(Table):
    """A serial port.

    Attributes:
        name: Name that servos refer to.
        path: Device, or `auto` for the only serial port.
        baud: [bit/s]
    """

    name: str = "main"
    path: str = "auto"
    baud: Annotated[int, Field(ge=9600, le=4_500_000, strict=True)] = 1_000_000


class Secondary(Table):
    """A second servo that drives the same joint; its zero is found at open.

    Attributes:
        id: Its id on the same port.
        sign: +1 if its counts rise with the joint angle.
    """

    id: Id
    sign: Literal[1, -1] = -1


class Servo(Table):
    """One servo of one joint.

    Attributes:
        model: Row of the servo table, e.g. `STS3215-7.4V` or `XM430-W350`.
        id: Its id on the port.
        port: Name of the port.
        sign: +1 if counts rise with the joint angle.
        zero: Count at zero joint angle; None: from the calibration file, else the middle of the
            servo's range.
        gear: Turns of the servo per turn of the joint.
        secondary: A second servo on the same joint.
        lower, upper: Software position limits [rad]; None: those of the servo.
        stall: Stall torque at the rated voltage, overrides the table [N·m].
        torque_offset: Torque loss in the gears, subtracted from that of the register [N·m].
        gain: P gain register, for the simulator and the emulator; only for servos that store it
            without power (Feetech); None: the maker's default. On the bus it is read from the
            servo.
        kp: Identified stiffness [N·m/rad], overrides that of the gain register.
        friction, damping: Identified values of the gears, override the table's [N·m, N·m·s/rad].
    """

    model: str
    id: Id
    port: str = "main"
    sign: Literal[1, -1] = 1
    zero: Number | None = None
    gear: Positive = 1.0
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
            find(name)
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return name

    @model_validator(mode="after")
    def _keeps_its_gain(self) -> Self:
        if self.gain is not None and find(self.model).family.status != "feetech":
            raise ValueError(
                f"gain: {self.model} starts with the maker's gain whenever it is switched on; "
                "leave it out"
            )
        return self


class Gripper(Table):
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


class Loop(Table):
    """The control loop.

    Attributes:
        rate: [Hz]
        comm_timeout: Time without an answer from the bus or the program after which the arm is
            lowered [s], at most 60.
        patience: Minimum reply timeout [s], at most 1; use more than the default on a busy
            computer.
    """

    rate: Annotated[float, Field(gt=0.0, le=2000.0, strict=True)] = 100.0
    comm_timeout: Annotated[float, Field(gt=0.0, le=LONGEST_HOLD, strict=True)] = 0.5
    patience: Annotated[float, Field(gt=0.0, le=LONGEST_PATIENCE, strict=True)] = 0.01


class Life(Table):
    """Descent at the end.

    Attributes:
        rest_q: Pose to move to first (n,) [rad]; None: straight down.
        on_exit: Action on leaving.
    """

    rest_q: list[Number] | None = None
    on_exit: Literal["lower", "leave_enabled"] = "lower"


class Supply(Table):
    """Power supply of the servos.

    Attributes:
        voltage: Nominal voltage [V], for the emulator and `doctor`; an arm measures its own.
        current: Largest current of the supply [A]; None: no limit.
    """

    voltage: Positive | None = None
    current: Positive | None = None


class Config(Table):
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
        build.check(self)
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
        return build.model(self)

    def settings(self) -> Settings:
        """Return the controller settings, validated by the same code as those created in Python.

        Raises:
            ConfigError: Invalid fields or values; the message lists all.
        """
        return build.settings(self)

    def __repr__(self) -> str:
        """Return a one-line description."""
        robot = self.robot.builtin or self.robot.urdf
        return f"<Config of {robot}, {len(self.servo)} servos, backend {self.backend!r}>"

    __str__ = __repr__
