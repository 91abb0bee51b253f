"""The tables of a configuration file, and what they must keep by themselves.

Angles are radians, torques N·m, as everywhere in the package; counts are the servo's own.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, model_validator

from pliant.config import build

if TYPE_CHECKING:
    from pliant import Model, Settings

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Triple = tuple[Number, Number, Number]
Id = Annotated[int, Field(ge=0, le=252)]


class Table(BaseModel):
    """A table that refuses keys it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Payload(Table):
    """A load in the tool frame.

    Attributes:
        mass: [kg]
        com: Its centre in the tool frame [m].
    """

    mass: NotNegative
    com: Triple = (0.0, 0.0, 0.0)


class Robot(Table):
    """Where the kinematics come from: one of `urdf` and `builtin`.

    Attributes:
        urdf: Path of a URDF file, relative to the configuration file.
        builtin: Name of an arm that ships with the package.
        base, tip: Ends of the chain; may be left out where there is only one choice.
        payload: What the tool carries.
        gravity: Vector in base axes [m/s²].
        locked: Angles at which joints off the chain stand [rad].
        limits: Position limits in place of the URDF's, by joint [rad].
    """

    urdf: Path | None = None
    builtin: str | None = None
    base: str | None = None
    tip: str | None = None
    payload: Payload | None = None
    gravity: Triple = (0.0, 0.0, -9.81)
    locked: dict[str, Number] = {}
    limits: dict[str, tuple[Number, Number]] = {}

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.urdf is None) == (self.builtin is None):
            given = "both" if self.urdf else "none of them"
            raise ValueError(f"takes one of urdf and builtin, got {given}")
        return self


class Port(Table):
    """A serial port.

    Attributes:
        name: What servos call it.
        path: Device, `auto` for the only one there is, or `emulator`.
        baud: [bit/s]; None: what the servo family is set to usually.
        return_delay: Of the servos as set in them [µs].
    """

    name: str = "main"
    path: str = "auto"
    baud: Annotated[int, Field(ge=9600, le=4_500_000)] | None = None
    return_delay: NotNegative = 0.0


class Twin(Table):
    """A second servo that drives the same joint.

    Attributes:
        id: Its id on the same port.
        sign: +1 where it counts up with the joint.
        zero: Its count where the joint's angle is 0; None: as calibrated, else the middle.
    """

    id: Id
    sign: Literal[1, -1] = -1
    zero: Number | None = None


class Servo(Table):
    """One servo of one joint.

    Attributes:
        model: Row of the servo table, e.g. `STS3215-C001` or `XM430-W350`.
        id: Its id on the port.
        port: Name of the port.
        sign: +1 where counts rise with the joint's angle.
        zero: Count at which the joint's angle is 0; None: from the calibration file, else the
            middle of the servo's range.
        gear: Turns of the servo per turn of the joint.
        twin: A second servo on the same joint.
        lower, upper: Position limits of the joint in place of the model's [rad].
        kp: Stiffness [N·m/rad] in place of what the gain register says.
        torque: Usable torque [N·m] in place of the table's.
        friction, damping: Of gears and motor [N·m, N·m·s/rad].
        current: Most continuous current, for the thermal budget [A].
    """

    model: str
    id: Id
    port: str = "main"
    sign: Literal[1, -1] = 1
    zero: Number | None = None
    gear: Positive = 1.0
    twin: Twin | None = None
    lower: Number | None = None
    upper: Number | None = None
    kp: Positive | None = None
    torque: Positive | None = None
    friction: NotNegative | None = None
    damping: NotNegative | None = None
    current: Positive | None = None


class Gripper(Table):
    """A gripper: a joint off the chain that opens and closes.

    Attributes:
        servo: Its servo.
        joint: The joint of the model that it moves, so that its weight is where it is; None where
            the model has none.
        open, closed: Angles of the two ends [rad].
        limit: Most torque as a share of the servo's [0, 1].
        arm_length: From its axis to where it grips, to turn a force into a torque [m].
    """

    servo: Servo
    joint: str | None = None
    open: Number
    closed: Number
    limit: Annotated[float, Field(gt=0.0, le=1.0)] = 0.3
    arm_length: Positive | None = None

    @model_validator(mode="after")
    def _two_ends(self) -> Self:
        if self.open == self.closed:
            raise ValueError(f"open and closed are the same angle, {self.open:g} rad")
        return self


class Loop(Table):
    """The control loop.

    Attributes:
        rate: [Hz]
        stale: For how long old samples may be used [s].
    """

    rate: Annotated[float, Field(gt=0.0, le=2000.0)] = 100.0
    stale: Positive = 0.05


class Life(Table):
    """How the arm is put down.

    Attributes:
        rest: Pose to park in (n,) [rad]; None: where it comes to rest by itself.
        exit: What leaving does.
    """

    rest: list[Number] | None = None
    exit: Literal["lower", "park", "hold"] = "lower"


class Supply(Table):
    """What feeds the servos.

    Attributes:
        voltage: Nominal voltage [V].
        current: Most current of the supply [A]; None: no limit.
    """

    voltage: Positive | None = None
    current: Positive | None = None


class Config(Table):
    """A whole arm. Read one with `pliant.config.load`.

    Attributes:
        backend: `bus`, the emulated bus with the arm's physics behind it, or `sim`, physics alone.
        robot: Kinematics.
        port: Serial ports.
        servo: Servo of each joint of the chain, by the joint's name.
        gripper: Gripper, if there is one.
        supply: Voltage and current of the supply.
        calibration: LeRobot's calibration file, relative to this one; `~` is the home folder.
        loop: Rate and deadlines.
        life: How it ends.
        preset: Name of a preset of `pliant.Settings`, e.g. `door` or `soft`.
        soft: Axes that the preset `soft` makes yield.
        fields: The table `settings`: fields of `pliant.Settings`; `axes` is a table by axis key.
        kp_known: Whether the servos' stiffness is known within 10 %.
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
    preset: str | None = None
    soft: str | None = None
    fields: dict[str, Any] = Field(default_factory=dict, alias="settings")
    kp_known: bool = False

    #: Folder that relative paths start from.
    _folder: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        build.check(self)
        return self

    @property
    def folder(self) -> Path:
        """Folder that relative paths start from."""
        return self._folder

    def at(self, folder: Path) -> Self:
        """The same with paths relative to `folder`."""
        out = self.model_copy()
        out._folder = folder
        return out

    def model(self) -> Model:
        """The kinematic model.

        Raises:
            UrdfError: The URDF cannot be used.
            ConfigError: Its joints are not those that have servos.
        """
        return build.model(self)

    def settings(self) -> Settings:
        """The controller's settings, validated by the same code as those made in Python.

        Raises:
            ConfigError: A field or value is wrong; LimitError, ShapeError alike.
        """
        return build.settings(self)

    def __repr__(self) -> str:
        """The arm in one line."""
        robot = self.robot.builtin or self.robot.urdf
        return f"<Config of {robot}, {len(self.servo)} servos, backend {self.backend!r}>"

    __str__ = __repr__
