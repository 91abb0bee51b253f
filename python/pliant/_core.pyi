"""The compiled part of `pliant`. Shapes: n joints, k axes of the task, N configurations."""

from collections.abc import Mapping, Sequence
from os import PathLike
from types import MappingProxyType
from typing import Any, Final, Literal, Protocol, TypeAlias, TypedDict, Unpack, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: Final[str]

__all__ = [
    "Axis",
    "BatchState",
    "Command",
    "Compensation",
    "ConfigError",
    "ContactEstimator",
    "Controller",
    "Diagnostics",
    "FeasibilityReport",
    "FrameNotFoundError",
    "IkResult",
    "Inertial",
    "Issue",
    "Joint",
    "Link",
    "Mimic",
    "Model",
    "NullSpace",
    "OutOfRangeError",
    "PaperOptions",
    "Payload",
    "PliantError",
    "Pose",
    "PoseReport",
    "ServoError",
    "ServoFaultError",
    "ServoTimeoutError",
    "Servos",
    "Settings",
    "ShapeError",
    "Task",
    "TorqueLimits",
    "Tracking",
    "UrdfError",
    "WrenchEstimate",
    "__version__",
    "activation",
    "adapt_target",
    "as_pose",
    "check_path",
    "compliance",
    "damped_pseudo_inverse",
    "holding_torque",
    "joint_torque_limits",
    "null_space_projector",
    "pose_error",
    "responsibility",
]

_Array: TypeAlias = NDArray[np.float64]
_Reference: TypeAlias = Literal["world_aligned", "local"]
_AxisName: TypeAlias = Literal["x", "y", "z", "roll", "pitch", "yaw"]

class _HasMatrix(Protocol):
    @property
    def matrix(self) -> ArrayLike: ...

class _HasMatrixMethod(Protocol):
    def matrix(self) -> ArrayLike: ...

class _HasAsMatrix(Protocol):
    def as_matrix(self) -> ArrayLike: ...

class _HasHomogeneous(Protocol):
    @property
    def homogeneous(self) -> ArrayLike: ...

class _HasA(Protocol):
    @property
    def A(self) -> ArrayLike: ...

#: A 4x4 array, a `Pose`, or any object with a 4x4 accessor; (3,) where the task has no rotations.
_PoseLike: TypeAlias = (
    ArrayLike | Pose | _HasMatrix | _HasMatrixMethod | _HasAsMatrix | _HasHomogeneous | _HasA
)

class PliantError(Exception):
    """Everything that pliant raises of its own."""

class UrdfError(PliantError, ValueError):
    """The robot description cannot be used.

    A file that does not exist is Python's own `FileNotFoundError`.

    Attributes:
        source: Path of the file, or `<string>`.
        line: Line of the fault, counted from one; None where it has no place.
        column: Column of the fault, counted from one.
    """

    source: str | None
    line: int | None
    column: int | None

class FrameNotFoundError(PliantError, LookupError):
    """A link of that name does not exist.

    Attributes:
        frame: The name asked for.
        available: The names there are.
    """

    frame: str | None
    available: tuple[str, ...] | None

class OutOfRangeError(PliantError, ValueError):
    """A number lies outside its bounds.

    Attributes:
        what: The quantity, e.g. ``q[3] (elbow_pitch)``.
        value: The number given.
        bound: The bound, and the remedy where there is one.
    """

    what: str | None
    value: float | None
    bound: str | None

class ShapeError(PliantError, ValueError):
    """An array has the wrong shape.

    Attributes:
        what: The argument.
        got: Its shape, as text.
        expected: The shape that fits, as text.
    """

    what: str | None
    got: str | None
    expected: str | None

class ConfigError(PliantError, ValueError):
    """Settings, servos and model do not go together, or a name is not known.

    Attributes:
        key: The setting, e.g. ``axes.y.adaptation``.
    """

    key: str | None

class ServoError(PliantError):
    """A servo or its bus did not do what was asked; the message says what to do."""

class ServoTimeoutError(ServoError, TimeoutError):
    """A servo did not answer in time."""

class ServoFaultError(ServoError):
    """A servo reports a fault of its own."""

@final
class Pose:
    """Pose of one frame in another; of a tool, `base_from_tool`. Immutable.

    Args:
        matrix: (4, 4), or anything `as_pose` takes; None is the identity.

    Raises:
        ShapeError: Not 4x4.
        ConfigError: No rotation, or a last row other than 0 0 0 1.
        OutOfRangeError: A position beyond 100 m or not finite.
    """

    def __new__(cls, matrix: _PoseLike | None = None) -> Pose: ...
    @staticmethod
    def from_matrix(matrix: _PoseLike) -> Pose:
        """From a homogeneous matrix (4, 4)."""

    @staticmethod
    def from_wxyz(position: ArrayLike, quaternion: ArrayLike) -> Pose:
        """From a position (3,) [m] and a quaternion (4,), w first, of length 1 within 1e-3."""

    @staticmethod
    def from_xyzw(position: ArrayLike, quaternion: ArrayLike) -> Pose:
        """From a position (3,) [m] and a quaternion (4,), w last, of length 1 within 1e-3."""

    @staticmethod
    def from_rotvec(position: ArrayLike, rotvec: ArrayLike) -> Pose:
        """From a position (3,) [m] and a rotation vector (3,) [rad]: axis times angle."""

    @staticmethod
    def from_rpy(position: ArrayLike, rpy: ArrayLike) -> Pose:
        """From a position (3,) [m] and roll, pitch, yaw (3,) [rad] about fixed axes, as in URDF."""

    @property
    def matrix(self) -> _Array:
        """Homogeneous matrix (4, 4)."""

    @property
    def position(self) -> _Array:
        """Position (3,) [m]."""

    @property
    def rotation(self) -> _Array:
        """Rotation matrix (3, 3)."""

    @property
    def wxyz(self) -> _Array:
        """Quaternion (4,), w first, w >= 0."""

    @property
    def xyzw(self) -> _Array:
        """Quaternion (4,), w last, w >= 0."""

    @property
    def rotvec(self) -> _Array:
        """Rotation vector (3,) [rad], at most pi long."""

    def inverse(self) -> Pose:
        """`b_from_a` of `a_from_b`."""

    def __matmul__(self, other: Pose, /) -> Pose: ...
    def __rmatmul__(self, other: Pose, /) -> Pose: ...
    def __array__(self, dtype: Any | None = None, copy: bool | None = None) -> NDArray[Any]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs__(self) -> tuple[Any, ...]: ...

def as_pose(pose: _PoseLike, /) -> Pose:
    """Anything that says where a frame is, as a `Pose`.

    Args:
        pose: (4, 4), a `Pose`, a position (3,) (without rotation), or an object with `homogeneous`,
            `as_matrix`, `matrix` or `A`, as Pinocchio, SciPy, mink,
            pytransform3d and Spatial Math have them.

    Raises:
        ShapeError: Another shape. Seven numbers are refused: they do not say whether w comes first
            or last.
    """

@final
class Payload:
    """A point mass in the tool frame.

    Args:
        mass: Mass [kg].
        com: Centre of mass (3,) in the tool frame [m].
    """

    def __new__(cls, mass: float, com: ArrayLike = (0.0, 0.0, 0.0)) -> Payload: ...
    @property
    def mass(self) -> float:
        """Mass [kg]."""

    @property
    def com(self) -> _Array:
        """Centre of mass (3,) in the tool frame [m]."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs__(self) -> tuple[Any, ...]: ...

@final
class Inertial:
    """Mass, centre of mass and inertia of a link."""

    @property
    def mass(self) -> float:
        """Mass [kg]."""

    @property
    def com(self) -> _Array:
        """Centre of mass (3,) in the link's frame [m]."""

    @property
    def rotation(self) -> _Array:
        """Axes of the inertia (3, 3), `link_from_inertia`."""

    @property
    def inertia(self) -> _Array:
        """Inertia (3, 3) about the centre of mass in those axes [kg m^2]."""

@final
class Link:
    """A rigid body of the robot, or a mere frame."""

    @property
    def name(self) -> str:
        """Name in the description."""

    @property
    def parent_joint(self) -> int | None:
        """Index of the joint above it in `Model.joints`; None for the root."""

    @property
    def inertial(self) -> Inertial | None:
        """Mass and inertia; None for a massless link."""

@final
class Mimic:
    """How a joint follows another: ``multiplier * q + offset``."""

    @property
    def joint(self) -> int:
        """Index of the joint that leads in `Model.joints`."""

    @property
    def multiplier(self) -> float:
        """Ratio."""

    @property
    def offset(self) -> float:
        """Offset [rad or m]."""

@final
class Joint:
    """A joint of the robot, on the chain or beside it; limits that are not given are None."""

    @property
    def name(self) -> str:
        """Name in the description."""

    @property
    def kind(self) -> Literal["revolute", "continuous", "prismatic", "fixed", "other"]:
        """How it moves."""

    @property
    def parent(self) -> int:
        """Index of the link above in `Model.links`."""

    @property
    def child(self) -> int:
        """Index of the link below in `Model.links`."""

    @property
    def origin(self) -> Pose:
        """`parent_from_child` at zero."""

    @property
    def axis(self) -> _Array:
        """Unit axis (3,) in the joint's frame."""

    @property
    def lower(self) -> float | None:
        """Lower position limit [rad or m]."""

    @property
    def upper(self) -> float | None:
        """Upper position limit [rad or m]."""

    @property
    def velocity(self) -> float | None:
        """Speed limit [rad/s or m/s]."""

    @property
    def effort(self) -> float | None:
        """Torque or force limit [N m or N]."""

    @property
    def damping(self) -> float | None:
        """Damping [N m s/rad or N s/m]."""

    @property
    def friction(self) -> float | None:
        """Dry friction [N m or N]."""

    @property
    def mimic(self) -> Mimic | None:
        """The joint it follows."""

    @property
    def q_index(self) -> int | None:
        """Coordinate of the chain that moves it, itself or by mimic."""

    @property
    def locked_at(self) -> float | None:
        """Where it is held [rad or m], for actuated joints that no coordinate moves."""

@final
class IkResult:
    """The closest joint positions found, and how close they are; true when converged."""

    @property
    def q(self) -> _Array:
        """Joint positions (n,) inside the limits [rad or m]."""

    @property
    def converged(self) -> bool:
        """Whether both errors are within tolerance."""

    @property
    def iterations(self) -> int:
        """Iterations in all."""

    @property
    def position_error(self) -> float:
        """Distance to the target over the axes asked for [m]."""

    @property
    def rotation_error(self) -> float:
        """Angle to the target over the axes asked for [rad]."""

    @property
    def reason(self) -> str:
        """Why the search ended."""

    def __bool__(self) -> bool: ...

@final
class Model:
    """One kinematic chain with every body it carries. Immutable; controllers share it.

    Made by `Model.from_urdf`, `Model.from_urdf_str`, or a function of `pliant.robots`. A pickle
    holds the URDF text and the options.
    """

    @staticmethod
    def from_urdf(
        source: str | PathLike[str],
        *,
        base: str | None = None,
        tip: str | None = None,
        locked: Mapping[str, float] | None = None,
        payload: Payload | tuple[float, ArrayLike] | None = None,
        gravity: ArrayLike | None = (0.0, 0.0, -9.81),
        limits: Mapping[str, tuple[float, float]] | None = None,
        servos: Servos | None = None,
    ) -> Model:
        """Read a URDF file. Meshes are never opened.

        Args:
            source: Path.
            base: Link in which poses are given; may be left out when it is the root.
            tip: The tool frame; may be left out when only one link carries no other.
            locked: Joint name to position [rad or m] of joints that are held; actuated joints
                beside the chain that are not named rest at 0, or at the limit nearest to it. Their
                mass counts.
            payload: What the tool holds: a `Payload`, or mass [kg] and centre of mass (3,) [m] in
                the tool frame.
            gravity: Gravity (3,) in the base [m/s^2].
            limits: Joint name to position limits [rad or m], in place of the file's.
            servos: What drives the joints; a `Controller` takes them from here.

        Raises:
            FileNotFoundError: No such file.
            UrdfError: Everything wrong in the text, with file, line and column.
            FrameNotFoundError: `base` or `tip` is no link; lists those there are.
            ConfigError: Several links could be the tip, a joint is not known, too many joints, an
                unknown keyword.
            OutOfRangeError: A number that cannot be one.
        """

    @staticmethod
    def from_urdf_str(
        text: str,
        *,
        base: str | None = None,
        tip: str | None = None,
        locked: Mapping[str, float] | None = None,
        payload: Payload | tuple[float, ArrayLike] | None = None,
        gravity: ArrayLike | None = (0.0, 0.0, -9.81),
        limits: Mapping[str, tuple[float, float]] | None = None,
        servos: Servos | None = None,
    ) -> Model:
        """Read URDF text; arguments and errors as `from_urdf`."""

    @property
    def source(self) -> tuple[str, dict[str, Any]]:
        """URDF text and options: `Model.from_urdf_str(text, **options)` makes the same model."""

    def __copy__(self) -> Model: ...
    def __deepcopy__(self, memo: dict[int, Any], /) -> Model: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @property
    def name(self) -> str:
        """Name of the robot."""

    @property
    def n(self) -> int:
        """Number of independent joints."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the independent joints, base to tip."""

    @property
    def lower(self) -> _Array:
        """Lower position limits (n,) [rad or m], -inf for continuous joints; read-only."""

    @property
    def upper(self) -> _Array:
        """Upper position limits (n,) [rad or m], inf for continuous joints; read-only."""

    @property
    def velocity_limit(self) -> _Array:
        """Speed limits (n,) [rad/s or m/s], nan where the description has none; read-only."""

    @property
    def effort_limit(self) -> _Array:
        """Torque limits (n,) [N m or N], nan where the description has none; read-only."""

    @property
    def prismatic(self) -> tuple[bool, ...]:
        """Which independent joints slide."""

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all links; each can be base or tip."""

    @property
    def base(self) -> str:
        """Link in which poses are given."""

    @property
    def tip(self) -> str:
        """The tool frame."""

    @property
    def reach(self) -> float:
        """Distances between joint origins, summed out to the tool [m]."""

    @property
    def reach_from(self) -> _Array:
        """Where `reach` counts from: the first joint's origin at q = 0 (3,), in the base [m]."""

    @property
    def gravity_vector(self) -> _Array:
        """Gravity (3,) in the base [m/s^2]; read-only."""

    @property
    def payload(self) -> Payload | None:
        """What the tool holds."""

    @property
    def servos(self) -> Servos | None:
        """What drives the joints, one entry per joint."""

    def with_servos(self, servos: Servos) -> Model:
        """The same robot, driven by other servos.

        Raises:
            ShapeError: `servos` has neither one entry nor one per joint.
        """

    @property
    def links(self) -> tuple[Link, ...]:
        """All links of the robot, for simulators."""

    @property
    def joints(self) -> tuple[Joint, ...]:
        """All joints of the robot, for simulators."""

    @overload
    def kinematics(
        self, q: ArrayLike, reference: _Reference = "world_aligned", out: None = None
    ) -> tuple[_Array, _Array]:
        """Pose `base_from_tool` (4, 4) and Jacobian (6, n) at the tool, linear rows first.

        Args:
            q: Joint positions (n,) [rad or m]. Position limits are not enforced.
            reference: Axes of the Jacobian's rows: those of the base, or `"local"`: of the tool.
            out: Two writable float64 arrays (4, 4) and (6, n) to fill instead of new ones.

        Raises:
            ShapeError: Wrong length of `q`, or shape of an array in `out`.
            OutOfRangeError: An entry of `q` that is not finite or beyond 1e6.
            TypeError: `q` does not hold numbers, or `out` cannot be written.
        """

    @overload
    def kinematics(
        self, q: ArrayLike, reference: _Reference = "world_aligned", *, out: tuple[_Array, _Array]
    ) -> tuple[_Array, _Array]: ...
    def forward_kinematics(self, q: ArrayLike) -> _Array:
        """Pose `base_from_tool` (4, 4) at `q` (n,); errors as `kinematics`."""

    def jacobian(self, q: ArrayLike, reference: _Reference = "world_aligned") -> _Array:
        """Geometric Jacobian (6, n) at the tool, linear rows first; errors as `kinematics`."""

    def gravity(self, q: ArrayLike) -> _Array:
        """Torques (n,) [N m or N] that hold the arm at rest; errors as `kinematics`."""

    def inverse_kinematics(
        self,
        target: _PoseLike,
        q0: ArrayLike,
        *,
        axes: str = "xyz rpy",
        position_tolerance: float = 1e-08,
        rotation_tolerance: float = 1e-08,
        max_iterations: int = 100,
        restarts: int = 8,
    ) -> IkResult:
        """Joint positions that bring the tool to `target`, searched from `q0` inside the limits.

        Damped least squares: a convenience beside the control step. Not converging is no error:
        read `converged` and `reason`.

        Args:
            target: Pose of the tool in the base; a position (3,) where `axes` has no rotation.
            q0: Where the search starts (n,) [rad or m].
            axes: Axes of the base that must match, e.g. ``"xyz"``.
            position_tolerance: Error to reach [m].
            rotation_tolerance: Error to reach [rad].
            max_iterations: Most iterations from one start.
            restarts: Further starts, from fixed points inside the limits.

        Raises:
            ShapeError, OutOfRangeError, ConfigError: An argument that cannot be used.
        """

    def check_target(self, target: _PoseLike) -> None:
        """Check that a pose may be a target: not in millimetres, not far out of reach.

        `Controller.step` checks the same for tasks with translations.

        Args:
            target: Pose of the tool in the base, or a position (3,) [m].

        Raises:
            OutOfRangeError: It is farther from the first joint than 2 times `reach` and 0.1 m.
            ShapeError, ConfigError, TypeError: It is no pose.
        """

    def check_joint_target(self, q: ArrayLike) -> None:
        """Check that joint positions (n,) [rad or m] may be a target: not in degrees.

        `Controller.step_joints` checks the same.

        Raises:
            OutOfRangeError: A joint is beyond its limits by more than 0.2 rad, or a tenth of its
                travel.
            ShapeError, TypeError: They are not n numbers.
        """

    def kinematics_batch(
        self,
        Q: ArrayLike,
        reference: _Reference = "world_aligned",
        out: tuple[_Array, _Array] | None = None,
    ) -> tuple[_Array, _Array]:
        """Poses (N, 4, 4) and Jacobians (N, 6, n) of `Q` (N, n).

        Eight configurations at a time, large batches on every core; other Python threads run
        meanwhile and must not write into the arrays. Each row has the bits of the single call.

        Args:
            Q: Configurations (N, n) [rad or m]; a plain float64 array is read in place.
            reference: Axes of the Jacobians' rows.
            out: Arrays (N, 4, 4) and (N, 6, n) to write into: new memory costs up to a fifth.

        Raises:
            ShapeError, OutOfRangeError, TypeError, ValueError: An argument that cannot be used;
                `out` may then hold anything.
        """

    def forward_kinematics_batch(self, Q: ArrayLike, out: _Array | None = None) -> _Array:
        """Poses (N, 4, 4) of configurations `Q` (N, n), as `kinematics_batch`."""

    def jacobian_batch(
        self, Q: ArrayLike, reference: _Reference = "world_aligned", out: _Array | None = None
    ) -> _Array:
        """Jacobians (N, 6, n) of configurations `Q` (N, n), as `kinematics_batch`."""

    def gravity_batch(self, Q: ArrayLike, out: _Array | None = None) -> _Array:
        """Holding torques (N, n) of configurations `Q` (N, n), as `kinematics_batch`."""

class _ServoFields(TypedDict, total=False):
    kp: ArrayLike
    max_torque: ArrayLike
    friction: ArrayLike
    load_friction: ArrayLike
    stribeck: ArrayLike
    load_stribeck: ArrayLike
    stribeck_speed: ArrayLike
    damping: ArrayLike
    kv: ArrayLike
    armature: ArrayLike
    encoder_step: ArrayLike
    limit_type: Literal["current", "pwm"]
    no_load_speed: ArrayLike | None
    stiffness_known: bool

@final
class Servos:
    """What the controller believes about the servos. Frozen; one number per joint, or one for all.

    Units are N m and rad; N and m for prismatic joints.

    Args:
        kp: Stiffness of the position loop [N m/rad] > 0.
        max_torque: Usable torque at the present voltage [N m] > 0: the ceiling of every torque
            limit.
        friction: Dry friction of gears and motor [N m].
        load_friction: Dry friction in addition, per N m that the joint carries [1].
        stribeck: Dry friction in addition at rest [N m], gone in fast motion.
        load_stribeck: The same per N m that the joint carries [1].
        stribeck_speed: Speed at which a third of the friction at rest is left [rad/s] > 0.
        damping: Damping of gears and back-EMF outside the torque limit [N m s/rad].
        kv: Damping of the servo's own loop, inside the torque limit [N m s/rad].
        armature: Rotor inertia seen at the joint [kg m^2]: contacts, descents and
            simulators use it.
        encoder_step: One encoder count [rad]; 0 when it does not matter.
        limit_type: What the limit register limits: `"current"`, hence torque, or `"pwm"`, whose
            torque falls with speed.
        no_load_speed: Speed without load [rad/s], needed for `"pwm"`.
        stiffness_known: Whether `kp` is known within 10 %.

    Raises:
        OutOfRangeError: A value outside its bounds. ShapeError: Lists of different lengths.
            ConfigError: A field is missing, not known, or of the wrong type.
    """

    def __new__(
        cls,
        *,
        kp: ArrayLike,
        max_torque: ArrayLike,
        friction: ArrayLike = 0.0,
        load_friction: ArrayLike = 0.0,
        stribeck: ArrayLike = 0.0,
        load_stribeck: ArrayLike = 0.0,
        stribeck_speed: ArrayLike = 1.0,
        damping: ArrayLike = 0.0,
        kv: ArrayLike = 0.0,
        armature: ArrayLike = 0.0,
        encoder_step: ArrayLike = 0.0,
        limit_type: Literal["current", "pwm"] = "current",
        no_load_speed: ArrayLike | None = None,
        stiffness_known: bool = False,
    ) -> Servos: ...
    @property
    def kp(self) -> _Array:
        """Stiffness (n,) [N m/rad]; this and the other arrays are read-only."""

    @property
    def max_torque(self) -> _Array:
        """Usable torque (n,) [N m]."""

    @property
    def friction(self) -> _Array:
        """Dry friction (n,) [N m]."""

    @property
    def load_friction(self) -> _Array:
        """Dry friction per N m carried (n,) [1]."""

    @property
    def stribeck(self) -> _Array:
        """Dry friction in addition at rest (n,) [N m]."""

    @property
    def load_stribeck(self) -> _Array:
        """Dry friction in addition at rest, per N m carried (n,) [1]."""

    @property
    def stribeck_speed(self) -> _Array:
        """Speed at which a third of the friction at rest is left (n,) [rad/s]."""

    @property
    def damping(self) -> _Array:
        """Damping outside the torque limit (n,) [N m s/rad]."""

    @property
    def kv(self) -> _Array:
        """Damping inside the torque limit (n,) [N m s/rad]."""

    @property
    def armature(self) -> _Array:
        """Rotor inertia (n,) [kg m^2]."""

    @property
    def encoder_step(self) -> _Array:
        """Encoder count (n,) [rad]."""

    @property
    def limit_type(self) -> Literal["current", "pwm"]:
        """What the limit limits."""

    @property
    def no_load_speed(self) -> _Array | None:
        """Speed without load (n,) [rad/s]."""

    @property
    def stiffness_known(self) -> bool:
        """Whether `kp` is known within 10 %."""

    @staticmethod
    def of(
        models: Sequence[str],
        *,
        voltage: float | None = None,
        gains: Sequence[int | None] | None = None,
    ) -> Servos:
        """Servos from the tables of `pliant.servo`, one model per joint.

        Args:
            models: Servo models base to tip, as `pliant.servo.names()` lists them.
            voltage: Supply voltage [V]; default each model's rated one.
            gains: Gain registers; None where the maker's setting stands.

        Raises:
            ConfigError: A model is not known (the nearest names are given), the voltage is outside
                its range, or the gains are not one per model.
        """

    def replace(self, **changes: Unpack[_ServoFields]) -> Servos:
        """Return a copy with some fields changed."""

    def __len__(self) -> int: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

class _TaskFields(TypedDict, total=False):
    axes: str
    frame: Literal["base", "tool"] | ArrayLike
    length: float | None

@final
class Task:
    """Which axes are controlled, and in which frame. Frozen.

    Args:
        axes: Axis key: names apart by spaces, one word of the letters x y z, ``"rpy"``, ``"xyz
            rpy"``, ``"all"``.
        frame: `"base"`, `"tool"` (turning with it), or a rotation matrix (3, 3) whose columns are
            the task's axes in the base.
        length: Length [m] that counts as much as one radian; needed only with more axes than
            joints.

    Raises:
        ConfigError: A key that is not understood, or no rotation matrix. OutOfRangeError: The
            length.
    """

    def __new__(
        cls,
        axes: str = "xyz rpy",
        *,
        frame: Literal["base", "tool"] | ArrayLike = "base",
        length: float | None = None,
    ) -> Task: ...
    @property
    def axes(self) -> str:
        """Axis key."""

    @property
    def names(self) -> tuple[_AxisName, ...]:
        """Names of the axes, in the order of every array per axis."""

    @property
    def frame(self) -> str | _Array:
        """`"base"`, `"tool"`, or a rotation matrix (3, 3)."""

    @property
    def length(self) -> float | None:
        """Length [m] that counts as much as one radian."""

    def replace(self, **changes: Unpack[_TaskFields]) -> Task:
        """Return a copy with some fields changed."""

    def __len__(self) -> int: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

class _AxisFields(TypedDict, total=False):
    soft: float | tuple[float, float] | None
    firm: float | tuple[float, float] | None
    hold: float | None
    stiffness: float | tuple[float, float] | None
    damping: float | tuple[float, float] | None
    yields: Literal["both", "+", "-", "none"] | None
    adaptation: float
    soft_until: float | None
    firm_from: float | None
    profile: Literal["hardening", "constant", "softening"]
    max_velocity: float | None
    soft_step_limit: float | None
    deviation_limit: float | None
    on_deviation_limit: Literal["yield", "wait"]

@final
class Axis:
    """What is asked of one task axis. Frozen; None takes the default.

    Default strengths depend on law and arm. They are forces [N] ([N m] for rotations) under the
    laws `"cap"` and `"impedance"`, torque budgets [N m] under law `"paper"`. A pair is (pushed
    toward -, pushed toward +).

    Args:
        soft: Strength of the yielding axis at a small deviation, tau- of (9).
        firm: Strength of the yielding axis at a large deviation, tau+ of (9).
        hold: Strength where the axis does not yield.
        stiffness: Law impedance: spring [N/m or N m/rad]; default 0 toward a side that yields,
            else from the arm (`arm7`: 800 N/m, 20 N m/rad).
        damping: Law impedance: damper [N s/m or N m s/rad]; default 0.
        yields: Pushes it gives way to; by default both where `soft` or `firm` is given, else none.
        adaptation: Target adaptation of (12), 0 <= eta < 1.
        soft_until: Deviation below which compliance is full, (8) [m or rad]; default 0.01 m, 0.04
            rad.
        firm_from: Deviation above which compliance is none, (8) [m or rad]; default 0.10 m, 0.40
            rad.
        profile: `"hardening"`: soft to firm with the deviation; `"constant"`: soft; `"softening"`:
            firm to soft.
        max_velocity: Most commanded velocity while stiff [m/s, rad/s]; default 0.4 m/s, 2 rad/s;
            inf for none. Law impedance has none.
        soft_step_limit: The same while it yields; default none, under law `"paper"` 0.1 m/s, 0.5
            rad/s.
        deviation_limit: Largest deviation toward a side that does not yield [m or rad]; None: any.
        on_deviation_limit: What happens there. `"yield"`: the target lets this axis go, the arm
            gives way with the force of the limit, and is led back at the tool's speed when it is
            let go. `"wait"`: the target waits, all of it, until the axis is within its limit again.

    Raises:
        OutOfRangeError: A value outside its bounds. ConfigError: A field that is not known or
            makes no sense.
    """

    def __new__(
        cls,
        *,
        soft: float | tuple[float, float] | None = None,
        firm: float | tuple[float, float] | None = None,
        hold: float | None = None,
        stiffness: float | tuple[float, float] | None = None,
        damping: float | tuple[float, float] | None = None,
        yields: Literal["both", "+", "-", "none"] | None = None,
        adaptation: float = 0.0,
        soft_until: float | None = None,
        firm_from: float | None = None,
        profile: Literal["hardening", "constant", "softening"] = "hardening",
        max_velocity: float | None = None,
        soft_step_limit: float | None = None,
        deviation_limit: float | None = None,
        on_deviation_limit: Literal["yield", "wait"] = "yield",
    ) -> Axis: ...
    @property
    def soft(self) -> tuple[float, float] | None:
        """Strength at a small deviation, pushed toward -, +."""

    @property
    def firm(self) -> tuple[float, float] | None:
        """Strength at a large deviation, pushed toward -, +."""

    @property
    def hold(self) -> float | None:
        """Strength where the axis does not yield."""

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """Spring of law impedance, pushed toward -, + [N/m or N m/rad]."""

    @property
    def damping(self) -> tuple[float, float] | None:
        """Damper of law impedance, pushed toward -, + [N s/m or N m s/rad]."""

    @property
    def yields(self) -> Literal["both", "+", "-", "none"] | None:
        """Pushes it gives way to."""

    @property
    def adaptation(self) -> float:
        """Target adaptation."""

    @property
    def soft_until(self) -> float | None:
        """Deviation below which compliance is full [m or rad]."""

    @property
    def firm_from(self) -> float | None:
        """Deviation above which compliance is none [m or rad]."""

    @property
    def profile(self) -> Literal["hardening", "constant", "softening"]:
        """How the strength changes with the deviation."""

    @property
    def max_velocity(self) -> float | None:
        """Most commanded velocity while stiff [m/s, rad/s]."""

    @property
    def soft_step_limit(self) -> float | None:
        """Most commanded velocity while it yields [m/s, rad/s]."""

    @property
    def deviation_limit(self) -> float | None:
        """Largest deviation toward a side that does not yield [m or rad]."""

    @property
    def on_deviation_limit(self) -> Literal["yield", "wait"]:
        """What the target does beyond it."""

    def replace(self, **changes: Unpack[_AxisFields]) -> Axis:
        """Return a copy with some fields changed."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

_Law: TypeAlias = Literal["cap", "impedance", "paper"]
_Speeds: TypeAlias = float | tuple[float | None, float | None] | None
_Damping: TypeAlias = float | tuple[float, float, float] | None

class _TrackingFields(TypedDict, total=False):
    gain: ArrayLike
    damping: _Damping
    velocity_filter: float
    goal_slew: float | None
    joint_speed: ArrayLike | None
    integrate: float

@final
class Tracking:
    """How the stiff axes follow the target. Frozen; `replace` makes variants.

    Given to `Settings`, a preset or `replace`, it changes the fields that were given to it; the
    others keep their values.

    Args:
        gain: Gain K_x of (5) [1/s]: a number, or one per axis of the task.
        damping: Damping of the inverse: None: from the arm; a number: lambda; or (lambda_0,
            sigma_0, lambda_max).
        velocity_filter: Time constant of the velocity filter [s].
        goal_slew: Most speed of the goals [rad/s]; None for no limit. All go the same share of
            their ways, the weight that they carry apart and first.
        joint_speed: Joint speed limits (n,) [rad/s]; None: the model's.
        integrate: Rate at which the goal of stiff axes integrates [1/s]; 0 for none.

    Raises:
        OutOfRangeError: A value outside its bounds. ShapeError: A list of the wrong shape.
            ConfigError: A field or word that is not known, with a suggestion.
    """

    def __new__(
        cls,
        *,
        gain: ArrayLike = 4.0,
        damping: _Damping = None,
        velocity_filter: float = 0.02,
        goal_slew: float | None = 1.0,
        joint_speed: ArrayLike | None = None,
        integrate: float = 0.0,
    ) -> Tracking: ...
    @property
    def gain(self) -> float | list[float]: ...
    @property
    def damping(self) -> float | tuple[float, float, float] | None: ...
    @property
    def velocity_filter(self) -> float: ...
    @property
    def goal_slew(self) -> float: ...
    @property
    def joint_speed(self) -> _Array | None: ...
    @property
    def integrate(self) -> float: ...
    def replace(self, **changes: Unpack[_TrackingFields]) -> Tracking:
        """Return a copy with some fields changed."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

class _NullSpaceFields(TypedDict, total=False):
    posture: ArrayLike | None
    gain: float | None
    max_torque: float | None
    stiffness: float | None
    max_speed: float | None
    limit_avoidance: float
    projector: Literal["exact", "paper"]

@final
class NullSpace:
    """Motion of the joints that the task leaves free. Frozen; `replace` makes variants.

    Given to `Settings`, a preset or `replace`, it changes the fields that were given to it; the
    others keep their values.

    Args:
        posture: Rest posture (n,) [rad]; None: q at reset.
        gain: Step of the null-space motion [1/s]; None: as `Tracking.gain`.
        max_torque: Most the null-space motion may ask of all joints together [N m]; None: 2 where
            the arm is redundant.
        stiffness: Law impedance: stiffness of the null-space motion [N m/rad], in place of `gain`;
            None: as `gain` has it.
        max_speed: Most speed of the null-space motion [rad/s]; None for no limit.
        limit_avoidance: Weight of the joint-limit cost.
        projector: `"exact"`, or `"paper"`: the printed I - J+ J with the damped J+.

    Raises:
        OutOfRangeError: A value outside its bounds. ShapeError: A list of the wrong shape.
            ConfigError: A field or word that is not known, with a suggestion.
    """

    def __new__(
        cls,
        *,
        posture: ArrayLike | None = None,
        gain: float | None = None,
        max_torque: float | None = None,
        stiffness: float | None = None,
        max_speed: float | None = None,
        limit_avoidance: float = 0.0,
        projector: Literal["exact", "paper"] = "exact",
    ) -> NullSpace: ...
    @property
    def posture(self) -> _Array | None: ...
    @property
    def gain(self) -> float | None: ...
    @property
    def max_torque(self) -> float | None: ...
    @property
    def stiffness(self) -> float | None: ...
    @property
    def max_speed(self) -> float: ...
    @property
    def limit_avoidance(self) -> float: ...
    @property
    def projector(self) -> Literal["exact", "paper"]: ...
    def replace(self, **changes: Unpack[_NullSpaceFields]) -> NullSpace:
        """Return a copy with some fields changed."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

class _CompensationFields(TypedDict, total=False):
    friction: float
    damping: float
    delay: float

@final
class Compensation:
    """Shares of friction, damping and delay that are compensated, 0 to 1. Frozen.

    Given to `Settings`, a preset or `replace`, it changes the fields that were given to it; the
    others keep their values.

    Args:
        friction: Share of the friction that is fed forward.
        damping: Share of the damping that is fed forward.
        delay: Share of the delay that is predicted over.

    Raises:
        OutOfRangeError: A value outside its bounds. ShapeError: A list of the wrong shape.
            ConfigError: A field or word that is not known, with a suggestion.
    """

    def __new__(
        cls,
        *,
        friction: float = 0.9,
        damping: float = 0.8,
        delay: float = 0.9,
    ) -> Compensation: ...
    @property
    def friction(self) -> float: ...
    @property
    def damping(self) -> float: ...
    @property
    def delay(self) -> float: ...
    def replace(self, **changes: Unpack[_CompensationFields]) -> Compensation:
        """Return a copy with some fields changed."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

class _TorqueLimitsFields(TypedDict, total=False):
    margin: float
    floor: ArrayLike | None
    stiffening_time: float
    max_host_loss_force: float | None

@final
class TorqueLimits:
    """Joint torque limits that go to the servos. Frozen; `replace` makes variants.

    Given to `Settings`, a preset or `replace`, it changes the fields that were given to it; the
    others keep their values.

    Args:
        margin: Margin of the limits as a share of the usable torque.
        floor: Floor of the torque limits (n,) [N m]; None: the servos' friction.
        stiffening_time: Time in which a limit may rise from zero to its ceiling [s]; 0 for no
            limit.
        max_host_loss_force: Most that a hand shall meet along the task's translations if the host
            dies [N]: the limits give up their margin first, then what they have beyond the arm's
            weight; None: no such bound. Costs some 0.3 ms a step, 1 ms where it acts.

    Raises:
        OutOfRangeError: A value outside its bounds. ShapeError: A list of the wrong shape.
            ConfigError: A field or word that is not known, with a suggestion.
    """

    def __new__(
        cls,
        *,
        margin: float = 0.1,
        floor: ArrayLike | None = None,
        stiffening_time: float = 0.2,
        max_host_loss_force: float | None = None,
    ) -> TorqueLimits: ...
    @property
    def margin(self) -> float: ...
    @property
    def floor(self) -> _Array | None: ...
    @property
    def stiffening_time(self) -> float: ...
    @property
    def max_host_loss_force(self) -> float | None: ...
    def replace(self, **changes: Unpack[_TorqueLimitsFields]) -> TorqueLimits:
        """Return a copy with some fields changed."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

class _PaperOptionsFields(TypedDict, total=False):
    follow: Literal["free", "hold"] | None
    limits: Literal["demand", "sum"]
    horizon: float
    kq: ArrayLike
    joint_weights: ArrayLike | None
    posture_weights: ArrayLike | None
    manipulability: float
    gravity_use: Literal["both", "goal", "limits"]
    gravity_scale: float
    friction_speed: float
    direction_band: float | None
    raw_deviation: bool
    budget_on_goal: bool
    lead_limit: float | None

@final
class PaperOptions:
    """Options of the published law, for studies; not needed to run an arm. Frozen.

    Exported as `pliant.functional.PaperOptions`; the field `paper_options` of `Settings`.

    Given to `Settings`, a preset or `replace`, it changes the fields that were given to it; the
    others keep their values.

    Args:
        follow: `"free"`: yielding axes leave the solve and exert exactly their force; `"hold"`: one
            solve for all; None: by law, hold for paper. Law impedance has no solve.
        limits: Rule for the joint torque limits, not law paper: what the law wants at this tick, or
            the `"sum"` over all axes of what each may ask for.
        horizon: Horizon h of the goal q + h dq [s].
        kq: Gain K_q of (5), law paper: a number, one per joint, or a matrix.
        joint_weights: Law paper: weight of each joint in J+ (n,); None: 1.
        posture_weights: Weight of each joint in the posture cost (n,); None: 1.
        manipulability: Weight of the manipulability cost.
        gravity_use: Where the gravity model is used if `Settings.gravity` is True: in goals and
            limits, or in one of them.
        gravity_scale: Factor on gravity in the limits.
        friction_speed: Speed at which the friction feed-forward saturates [rad/s].
        direction_band: Half-width of the band in which an axis that yields to one side changes
            over, as a share of `soft_until`; None: 0.1, under law paper 0.
        raw_deviation: Compliance from the raw instead of the adapted deviation.
        budget_on_goal: Law paper: clamp each axis' step to what its budget can do.
        lead_limit: Law paper: how far a goal may lead [rad]; None: what the limit can use; inf for
            no limit.

    Raises:
        OutOfRangeError: A value outside its bounds. ShapeError: A list of the wrong shape.
            ConfigError: A field or word that is not known, with a suggestion.
    """

    def __new__(
        cls,
        *,
        follow: Literal["free", "hold"] | None = None,
        limits: Literal["demand", "sum"] = "demand",
        horizon: float = 0.25,
        kq: ArrayLike = 1.0,
        joint_weights: ArrayLike | None = None,
        posture_weights: ArrayLike | None = None,
        manipulability: float = 0.0,
        gravity_use: Literal["both", "goal", "limits"] = "both",
        gravity_scale: float = 1.1,
        friction_speed: float = 0.05,
        direction_band: float | None = None,
        raw_deviation: bool = False,
        budget_on_goal: bool = False,
        lead_limit: float | None = None,
    ) -> PaperOptions: ...
    @property
    def follow(self) -> Literal["free", "hold"] | None: ...
    @property
    def limits(self) -> Literal["demand", "sum"]: ...
    @property
    def horizon(self) -> float: ...
    @property
    def kq(self) -> float | list[float] | list[list[float]]: ...
    @property
    def joint_weights(self) -> _Array | None: ...
    @property
    def posture_weights(self) -> _Array | None: ...
    @property
    def manipulability(self) -> float: ...
    @property
    def gravity_use(self) -> Literal["both", "goal", "limits"]: ...
    @property
    def gravity_scale(self) -> float: ...
    @property
    def friction_speed(self) -> float: ...
    @property
    def direction_band(self) -> float | None: ...
    @property
    def raw_deviation(self) -> bool: ...
    @property
    def budget_on_goal(self) -> bool: ...
    @property
    def lead_limit(self) -> float | None: ...
    def replace(self, **changes: Unpack[_PaperOptionsFields]) -> PaperOptions:
        """Return a copy with some fields changed."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

class _SettingsFields(TypedDict, total=False):
    task: Task | str
    axes: Mapping[str, Axis]
    law: _Law
    rate: float
    delay: float
    gravity: bool
    max_tool_speed: _Speeds
    max_tool_acceleration: _Speeds
    accept_high_adaptation: bool
    accept_high_stiffness: bool
    tracking: Tracking
    null_space: NullSpace
    compensation: Compensation
    torque_limits: TorqueLimits
    paper_options: PaperOptions

@final
class Settings:
    """All settings of a controller. Frozen; `replace` makes variants, class methods presets.

    A group such as `tracking` changes the fields that were given to it and leaves the others as
    the default, the preset or the settings that are replaced have them:
    ``Settings.door(null_space=NullSpace(max_torque=1.0))`` keeps the preset's `null_space.gain`.

    Args:
        task: Controlled axes and their frame: a `Task`, or its axis key.
        axes: Axis key to `Axis`, e.g. ``{"y": Axis(soft=4.0), "xz": Axis(hold=40.0)}``; axes that
            are not named are stiff.
        law: `"cap"`: force caps per axis; `"impedance"`: a spring and a damper per axis, with force
            caps; `"paper"`: equations (3)-(12), torque budgets per axis.
        rate: Nominal control rate [Hz]: the default `dt` of a step is 1 / rate.
        delay: From reading to arrival of the goal [s].
        gravity: The gravity model is used, in goals and limits.
        max_tool_speed: Most speed of the target that the law sees, `reference` [m/s], or a pair
            [m/s, rad/s]; a single number takes 4 rad/s for each m/s; None for no limit. The tool
            is faster while it catches up, by up to 0.1 m/s where friction let it go late.
        max_tool_acceleration: The same for its acceleration [m/s^2, rad/s^2].
        accept_high_adaptation: Accept an `Axis.adaptation` above 0.95 though the servos' stiffness
            is not known within 10 %: a gravity error may walk the arm away.
        accept_high_stiffness: Law impedance: accept springs and dampers above what rate and delay
            allow: the arm may oscillate.
        tracking: How the stiff axes follow the target.
        null_space: Motion of the joints that the task leaves free.
        compensation: Shares of friction, damping and delay that are compensated.
        torque_limits: Joint torque limits that go to the servos.
        paper_options: Options for studies of the published law; not needed to run an arm.

    Raises:
        OutOfRangeError: A value outside its bounds. ShapeError: A list of the wrong shape.
            ConfigError: A field or word that is not known (with a suggestion), or values that do
                not go
            together.
    """

    def __new__(
        cls,
        *,
        task: Task | str = "xyz rpy",
        axes: Mapping[str, Axis] = ...,
        law: _Law = "cap",
        rate: float = 100.0,
        delay: float = 0.0,
        gravity: bool = True,
        max_tool_speed: _Speeds = (0.25, 1.0),
        max_tool_acceleration: _Speeds = (1.0, 4.0),
        accept_high_adaptation: bool = False,
        accept_high_stiffness: bool = False,
        tracking: Tracking = ...,
        null_space: NullSpace = ...,
        compensation: Compensation = ...,
        torque_limits: TorqueLimits = ...,
        paper_options: PaperOptions = ...,
    ) -> Settings: ...
    @classmethod
    def paper(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Law paper as printed: no gravity model, no limits beyond the paper's, nothing yields.

        Budgets [N m]: soft 0.5, firm = hold = 10, null space 2. In this and the other presets
        `axes` changes the axes it names, a group such as `tracking` the fields it was given; the
        others stay as the preset has them.
        """

    @classmethod
    def soft(cls, axes: str, /, **overrides: Unpack[_SettingsFields]) -> Settings:
        """The named axes yield both ways with default strengths and eta 0.9; the others hold."""

    @classmethod
    def firm(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Nothing yields."""

    @classmethod
    def door(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Opens and closes doors: y and yaw follow the handle, eta 0.999; null-space gain 1."""

    @classmethod
    def drawer(
        cls, *, axis: str = "x", pull: float | None = None, **overrides: Unpack[_SettingsFields]
    ) -> Settings:
        """Pulls and pushes a drawer along a base axis; the other translations follow the slide.

        Args:
            axis: `"x"`, `"y"` or `"z"`.
            pull: Most force along it [N]; None for the arm's `firm`.
            **overrides: Further settings.
        """

    @classmethod
    def wipe(
        cls, *, press: float | None = None, axis: str = "z", **overrides: Unpack[_SettingsFields]
    ) -> Settings:
        """Presses on a surface with one force while the tool moves along it; tilts with it.

        Args:
            press: Force on the surface [N], with a target that lies far enough behind it; None for
                the arm's `soft`.
            axis: Its normal, `"x"`, `"y"` or `"z"`.
            **overrides: Further settings.
        """

    @classmethod
    def hand_over(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Carries an object and gives way to the hand that takes it: firm near, soft when drawn."""

    @classmethod
    def plug(
        cls, *, axis: str = "-z", push: float | None = None, **overrides: Unpack[_SettingsFields]
    ) -> Settings:
        """Puts a plug into a hole: soft across and in rotation, pushed in with at most one force.

        Args:
            axis: Direction of insertion, `"-z"`, `"x"`, ...; pulling out may use all of `hold`.
            push: Most force of insertion [N]; None for the arm's `firm`.
            **overrides: Further settings.
        """

    @classmethod
    def hand_guiding(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """A hand leads the tool: all axes of the task yield with eta 0.95; null-space gain 1."""

    def raise_soft(
        self, model: Model, path: ArrayLike | None = None, *, servos: Servos | None = None
    ) -> Settings:
        """Settings whose `soft` is raised, where it is below, to three times the friction.

        With that, sinusoids are followed within a tenth of their amplitude where friction is known
        to 30 % and a tick late each way; softer, the joints' friction seen along the axis holds it
        back whenever it starts or reverses.

        Args:
            model: The arm.
            path: Postures (n,) or (N, n) [rad] of which the worst counts; None: the median over the
                joint space.
            servos: None for those of the model.
        """

    def replace(self, **changes: Unpack[_SettingsFields]) -> Settings:
        """Return a copy with some fields changed; `axes` replaces all axes."""

    @property
    def task(self) -> Task: ...
    @property
    def axes(self) -> MappingProxyType[_AxisName, Axis]: ...
    @property
    def law(self) -> _Law: ...
    @property
    def rate(self) -> float: ...
    @property
    def delay(self) -> float: ...
    @property
    def gravity(self) -> bool: ...
    @property
    def max_tool_speed(self) -> tuple[float, float]: ...
    @property
    def max_tool_acceleration(self) -> tuple[float, float]: ...
    @property
    def accept_high_adaptation(self) -> bool: ...
    @property
    def accept_high_stiffness(self) -> bool: ...
    @property
    def tracking(self) -> Tracking: ...
    @property
    def null_space(self) -> NullSpace: ...
    @property
    def compensation(self) -> Compensation: ...
    @property
    def torque_limits(self) -> TorqueLimits: ...
    @property
    def paper_options(self) -> PaperOptions: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]: ...

@final
class Command:
    """Goals and limits of the servos for one tick. Arrays of a stored command never change.

    Args:
        goal: Goals of the position servos (n,) [rad].
        torque_limit: Magnitude of the torque each servo may use (n,) [N m].
        speed_limit: Speed for a servo's speed register (n,) [rad/s]; None: no limit.
    """

    def __new__(
        cls, goal: ArrayLike, torque_limit: ArrayLike, speed_limit: ArrayLike | None = None
    ) -> Command: ...
    @property
    def goal(self) -> _Array:
        """Goals of the position servos (n,) [rad]."""

    @property
    def torque_limit(self) -> _Array:
        """Magnitude of the torque each servo may use (n,) [N m]."""

    @property
    def speed_limit(self) -> _Array:
        """Speed for a servo's speed register (n,) [rad/s].

        What keeps the tool within `max_tool_speed` by one joint alone, but no less than
        `goal_slew`: a profile slower than the goals falls behind them and exerts what nobody asked
        for. inf where neither tool nor joint has a speed limit.
        """

@final
class BatchState:
    """What many arms remember between batch steps; of `Controller.batch_state`.

    Any controller of arms with as many joints can go on with it. Can be copied and pickled, to be
    read by the same version; not to be used by two calls at once. `len` is the number of arms.

    Args:
        n: Joints of an arm.
        numbers: What a pickle holds of them.
    """

    def __new__(cls, n: int, numbers: ArrayLike) -> BatchState: ...
    def __len__(self) -> int: ...
    def __getnewargs__(self) -> tuple[int, _Array]: ...
    @property
    def n(self) -> int:
        """Number of joints of an arm."""

    def reset(self, indices: ArrayLike | slice | None = None, Q: ArrayLike | None = None) -> None:
        """Forget all of some arms: for episodes that begin.

        Args:
            indices: Which arms, as NumPy indexes: numbers, a mask (N,), a slice; None: all.
            Q: Positions to start from, (count, n) or (n,) for all [rad]; None: those of the next
                step.

        Raises:
            IndexError: No such arm. ShapeError, OutOfRangeError: `Q`; nothing is then changed.
        """

@final
class PoseReport:
    """What one pose can do under the settings in force.

    One row per axis of the task (k) or joint (n); pairs are (pushed toward -, pushed toward +).
    Forces in N, for rotations N m. `str` gives a table and the sentences.
    """

    @property
    def axes(self) -> tuple[_AxisName, ...]:
        """Names of the task's axes."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def q(self) -> _Array:
        """Positions that this is about (n,) [rad]."""

    @property
    def torque_limit(self) -> _Array:
        """Torque limits in force there (n,) [N m]."""

    @property
    def static_force(self) -> _Array:
        """Largest static force that these limits hold (k, 2); negative: cannot hold itself."""

    @property
    def capacity(self) -> _Array:
        """The same with all the torque that the servos have (k, 2)."""

    @property
    def gives_way(self) -> _Array:
        """Force of giving way, friction apart (k, 2, 2): [axis, side, small | large deviation]."""

    @property
    def yields(self) -> list[tuple[bool, bool]]:
        """Whether each axis yields, per side."""

    @property
    def friction(self) -> _Array:
        """Dry friction of the joints along each axis (k,): a push at rest meets it on top."""

    @property
    def friction_left(self) -> _Array:
        """What the feed-forward leaves of it in steady motion (k,): softer, nothing moves."""

    @property
    def coupling(self) -> _Array:
        """How firm an axis of strength 0 is by what the others ask of its joints (k, 2)."""

    @property
    def coupled_to(self) -> list[tuple[_AxisName | None, _AxisName | None]]:
        """The other axis that asks for most of that, per side."""

    @property
    def thresholds(self) -> _Array:
        """Deviations d-/(1 - eta), d+/(1 - eta) where the strength changes (k, 2)."""

    @property
    def gravity_margin(self) -> _Array:
        """L - g and L + g (n, 2) [N m]: what limits leave beside gravity; negative: falls."""

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of the task rows, translations over the arm's length."""

    @property
    def condition(self) -> float:
        """Largest over smallest singular value."""

    @property
    def sigma_0(self) -> float:
        """Singular value below which damping grows."""

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Joints whose limit is at the servo's ceiling (n,)."""

    @property
    def locked(self) -> NDArray[np.bool_]:
        """Joints at a position limit that left the inverse kinematics (n,)."""

    @property
    def host_loss_force(self) -> _Array:
        """Most that a hand meets on 0.15 m or 0.4 rad if the host dies now (k, 2) [N, N m].

        From where the arm then comes to rest, at 25 mm/s or 0.067 rad/s, the gears' friction and
        damping included; inf where the arm cannot be moved so far, because it is stretched out or
        its joints stand at their limits.
        """

    @property
    def max_host_loss_force(self) -> float | None:
        """What the settings allow of that along translations [N]."""

    @property
    def gain_factor(self) -> float:
        """Factor on K_x, under law impedance on the stiffness, that delay and pose demand."""

    @property
    def damping_factor(self) -> float:
        """The same on the damping of law impedance."""

    @property
    def stop_distance(self) -> _Array:
        """How far each axis can be pushed until a joint meets its limit (k, 2) [m, rad].

        The other axes in place; inf where no joint does on 0.15 m or 0.4 rad. From there on a cap
        is not kept: the stop takes what it gets of a push.
        """

    @property
    def stop_joint(self) -> list[tuple[str | None, str | None]]:
        """The joint that does, per side."""

    @property
    def stop_room(self) -> _Array:
        """How far that joint is from its limit now (k, 2) [rad or m]; inf for none."""

    @property
    def stop_friction(self) -> _Array:
        """What the joints that are left rub along the axis there, in place of `friction` (k, 2).

        inf where they cannot move the axis alone: then the stop takes everything above the cap.
        0 where no joint stops.
        """

    @property
    def way_friction(self) -> _Array:
        """What the joints rub along the axis where they rub most on the way of a push (k, 2).

        Over 0.15 m or 0.4 rad, or as far as a joint's position limit. [N, N m]; many times
        `friction` where the way passes a singular pose.
        """

    @property
    def way_sigma(self) -> _Array:
        """Smallest singular value there, as `sigma_min` (k, 2)."""

    @property
    def way_distance(self) -> _Array:
        """How far the axis is pushed there (k, 2) [m, rad]."""

    @property
    def deviation_limit(self) -> _Array:
        """Deviation beyond which the target waits or comes along (k, 2) [m, rad]; inf: none."""

    def summary(self) -> list[str]:
        """One plain sentence per axis, and per thing that is in the way."""

    def to_dict(self) -> dict[str, Any]:
        """Every figure as lists, numbers and words, and the sentences."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Issue:
    """One thing that a pose cannot do as asked."""

    @property
    def pose(self) -> int:
        """Index of the worst pose on the path."""

    @property
    def about(self) -> str:
        """Axis with its side, or joint."""

    @property
    def required(self) -> bool:
        """Whether the settings ask for it by name; a default that cannot be met is a note."""

    @property
    def reason(self) -> str:
        """What is asked, and what there is."""

    @property
    def setting(self) -> str | None:
        """Setting to change, e.g. `axes.y.firm`; None where none helps."""

    @property
    def value(self) -> float | None:
        """The nearest value that works."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class FeasibilityReport:
    """Whether a pose or a path can do what the settings ask; true if so. `str` says why not."""

    @property
    def achievable(self) -> bool:
        """Whether nothing that is asked for by name is missing."""

    @property
    def poses(self) -> int:
        """How many poses were looked at."""

    @property
    def findings(self) -> tuple[Issue, ...]:
        """What is missing, the required first."""

    @property
    def axes(self) -> tuple[_AxisName, ...]:
        """Names of the task's axes."""

    @property
    def capacity(self) -> _Array:
        """Least force that the servos' torque can answer (k, 2), per side [N, N m]."""

    @property
    def worst_pose(self) -> list[tuple[int, int]]:
        """Poses of those."""

    @property
    def friction_left(self) -> _Array:
        """Most friction left along each axis (k,): the least `soft` that can track."""

    @property
    def stop_distance(self) -> _Array:
        """Least distance to a position limit of a joint, pushed along a yielding axis (k, 2)."""

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of all poses: how near the path comes to a singular pose."""

    @property
    def sigma_pose(self) -> int:
        """The pose of that."""

    @property
    def way_sigma(self) -> _Array:
        """Least `PoseReport.way_sigma` of the poses (k, 2); inf for sides that do not yield."""

    def __bool__(self) -> bool: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Controller:
    """Compliant task-space controller: joint goals and torque limits from positions alone.

    Not to be shared between threads: a second call during a first one raises `RuntimeError`. Arrays
    per axis have one entry per axis of the task, in its order. Can be copied, and pickled to be
    read by the same version: the next step is then the one that it would have been, and so are
    payload, gravity and delay; what was read of the last step only a copy keeps.

    Args:
        model: The arm.
        settings: None for the defaults.
        servos: None for those of the model; law paper without gravity needs none.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: Settings, servos and model do not go together;
            says what to change.
    """

    def __new__(
        cls, model: Model, settings: Settings | None = None, servos: Servos | None = None
    ) -> Controller: ...
    def __copy__(self) -> Controller: ...
    def __deepcopy__(self, memo: dict[int, Any], /) -> Controller: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    def step(
        self,
        q: ArrayLike,
        target: _PoseLike,
        *,
        dt: float | None = None,
        dq: ArrayLike | None = None,
        twist: ArrayLike | None = None,
        gradient: ArrayLike | None = None,
        out: Command | None = None,
    ) -> Command:
        """One control step toward a pose of the tool.

        The first step resets to `q`. Fastest with float64 arrays in C order; everything else that
        NumPy takes gives the same numbers. Allocates nothing while nobody keeps the results.

        Args:
            q: Measured joint positions (n,) [rad].
            target: Pose `base_from_tool`: (4, 4), `Pose`, any object with a 4x4 accessor; (3,) for
                a task without rotations. Toward one out of reach the arm stretches, and `check`
                says that it is; farther from the first joint than 2 times `Model.reach` and
                0.1 m is an error.
            dt: Time since the last step [s], at most 1; None: 1 / settings.rate.
            dq: Joint velocity (n,) [rad/s] in place of the filtered one.
            twist: Velocity of the target (6,) [m/s, rad/s], base axes.
            gradient: Gradient (n,) of an own null-space cost, added to the others; the cost is
                descended.
            out: A command to overwrite, whoever holds its arrays.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError: An input that cannot be used, by
                name; the controller is then as before.
        """

    def step_joints(
        self,
        q: ArrayLike,
        q_target: ArrayLike,
        *,
        dt: float | None = None,
        dq: ArrayLike | None = None,
        twist: ArrayLike | None = None,
        gradient: ArrayLike | None = None,
        out: Command | None = None,
    ) -> Command:
        """One control step toward joint positions (n,): target and rest posture; else as `step`.

        Raises:
            OutOfRangeError: As `step`, and for a target beyond a joint's limits by more than 0.2
                rad, or a tenth of its travel; within that the goals end at the limits.
        """

    def step_batch(
        self,
        Q: ArrayLike,
        targets: _PoseLike | ArrayLike,
        *,
        state: BatchState | None = None,
        dt: float | None = None,
        dq: ArrayLike | None = None,
        invalid: Literal["raise", "nan"] = "raise",
        out: Command | tuple[_Array, _Array, _Array] | None = None,
    ) -> Command:
        """One control step of N arms, on every core while other Python threads run.

        With a state each row is what `step` of a controller of its own would give, bit for bit.
        Without one nothing is remembered: each row is the first step of a controller just reset to
        its q, with `goal_slew` and `max_tool_speed` infinite: goals may jump, so not for a real
        arm. Under law `paper` as printed, arms of at most 7 joints are then stepped side by side in
        the processor's registers, which changes results by rounding. This controller's own memory
        and readings stay as they are. `RAYON_NUM_THREADS` says
        how many threads there are.

        Args:
            Q: Measured joint positions (N, n) [rad]; a plain float64 array is read in place.
            targets: Poses (N, 4, 4), or positions (N, 3) for a task without rotations; or one for
                all: whatever `step` takes.
            state: What the arms remember, of `batch_state(N)`; changed in place.
            dt: Time since the last step of all arms [s], at most 1; None: 1 / settings.rate.
            dq: Joint velocities (N, n) [rad/s] in place of the filtered ones.
            invalid: What becomes of rows whose q, target or dq cannot be used: ``"raise"`` an error
                that names the first one before any arm is stepped, or ``"nan"``: their command is
                NaN, their memory stays, and the others are stepped.
            out: A command of a batch, or arrays (N, n) for goal, torque limit and velocity, to
                write into: new memory costs up to a fifth.

        Returns:
            Command with arrays (N, n): `out` if it is one.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError, ValueError: An argument or a row
                that cannot be used, by name; `state` is then as before, `out` may hold anything.
                Only a
                command that comes out not finite is found underway: others have then been stepped.
        """

    def batch_state(self, count: int) -> BatchState:
        """What `count` arms remember between calls of `step_batch`, of which nothing is known yet.

        The first step of an arm resets it to its positions. 8 (52 + 7 n) bytes an arm: a million
        arms of seven joints take 0.81 GB.
        """

    def reset(self, q: ArrayLike) -> None:
        """Forget velocity, slew and gamma; goals start from `q` (n,).

        `q` is the rest posture unless one is set. A captured gravity offset stays.
        """

    def update(self, settings: Settings) -> None:
        """Take new settings while running: goals go on from where they are."""

    def set_payload(self, mass: float, com: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Take another payload: mass [kg], 0 for none; centre (3,) in the tool frame [m].

        Before the first step at once; in an arm that is controlled within half a second, so that
        one that is told too early, too late or wrongly does not make it jump.
        """

    def set_gravity(self, vector: ArrayLike) -> None:
        """Take another gravity vector (3,) [m/s^2], base axes: for a base that tilts."""

    def set_delay(self, delay: float) -> None:
        """Take the measured delay [s]; derates the stiff axes where it must: `gain_factor`."""

    def capture_gravity(self, q: ArrayLike, goal: ArrayLike) -> _Array:
        """Take the gravity offset from an arm held still by an integrating goal.

        Args:
            q: Where it stands (n,) [rad].
            goal: Goals that hold it there (n,) [rad].

        Returns:
            Stiffness k_g (n,) [N m/rad] that serves the gravity offset from now on.

        Raises:
            ConfigError: The controller knows no `kp`.
        """

    def report(self, q: ArrayLike | None = None) -> PoseReport:
        """Forces per axis and side that a pose allows, margins, and the force of a host loss.

        Args:
            q: Posture (n,) [rad], the arm at rest on its target; None: pose and limits of the last
                step.

        Raises:
            ConfigError: Neither `q` nor a step so far.
        """

    def check(
        self, path_or_pose: _PoseLike | ArrayLike, *, q0: ArrayLike | None = None
    ) -> FeasibilityReport:
        """Whether these settings can be met, and which to change to what if not.

        Args:
            path_or_pose: Postures (n,) or (N, n) [rad]; or a pose of the tool as `step` takes it,
                (4, 4) with the last row 0 0 0 1; a position (3,) [m] for a task without rotations,
                where the arm has not three joints.
            q0: Where the search for a pose starts (n,) [rad]; None: mid-range.

        Returns:
            Verdict and findings; true where all can be met.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError: An input that cannot be used, by
                name.
        """

    @property
    def model(self) -> Model:
        """The arm."""

    @property
    def settings(self) -> Settings:
        """The settings in force."""

    @property
    def servos(self) -> Servos | None:
        """The servos, one entry per joint."""

    @property
    def axes(self) -> dict[_AxisName, Axis]:
        """Axes of the task, with every default that depends on law and arm filled in."""

    @property
    def diagnostics(self) -> Diagnostics:
        """Intermediate values of the last step, as a snapshot."""

    @property
    def instructions(self) -> str:
        """Instructions that steps run on: ``"baseline"``, ``"avx2"`` or ``"avx512"``.

        The widest that the processor has, or the set that the environment variable
        ``PLIANT_INSTRUCTIONS`` names. Results differ between sets by rounding, below 1e-11 of
        their size; on one set they repeat bit for bit.
        """

    @property
    def commands_made(self) -> int:
        """How many commands had to be allocated: stays at 3 in a loop that keeps none."""

@final
class Diagnostics:
    """Intermediate values of a controller's last step; made by `Controller.diagnostics`.

    A snapshot: it keeps its values when the controller goes on. k is the number of task axes.
    """

    @property
    def deviation(self) -> _Array:
        """Deviation `reference` - actual (k,) [m, rad]."""

    @property
    def adapted_deviation(self) -> _Array:
        """Adapted deviation (1 - eta w) e (k,) [m, rad]."""

    @property
    def task_velocity(self) -> _Array:
        """Task velocity K_x e + twist within its per-axis limits (k,) [m/s, rad/s]."""

    @property
    def softness(self) -> _Array:
        """Softness w (k,), 0 to 1, for the side each axis is pushed from."""

    @property
    def compliance(self) -> _Array:
        """Compliance c of (8) (k,), 0 to 1."""

    @property
    def axis_strength(self) -> _Array:
        """Strength (k,): tau^x of (9) [N m] under law paper, else the cap [N, N m]."""

    @property
    def wrench(self) -> _Array:
        """Wrench on the target (k,) [N, N m], not under law paper."""

    @property
    def activation(self) -> _Array:
        """Activation matrix A of (10) (n, k + 1), the null-space column last."""

    @property
    def responsibility(self) -> _Array:
        """Responsibility R of (6), (7) (n, k + 1)."""

    @property
    def task_jacobian(self) -> _Array:
        """Task rows as solved (k, n), in the task frame; columns of locked joints are zero."""

    @property
    def singular_values(self) -> _Array:
        """Singular values of those rows, translations over the arm's length, largest first."""

    @property
    def q_predicted(self) -> _Array:
        """Positions predicted over the delay (n,) [rad]."""

    @property
    def velocity(self) -> _Array:
        """Filtered velocity (n,) [rad/s]."""

    @property
    def gravity(self) -> _Array:
        """Torques that hold the arm (n,) [N m]."""

    @property
    def feed_forward(self) -> _Array:
        """Feed-forward of friction and damping (n,) [N m]."""

    @property
    def gradient(self) -> _Array:
        """Gradient of the null-space cost (n,)."""

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of the scaled rows; where a step needs none, found when read."""

    @property
    def sigma_max(self) -> float:
        """Largest singular value, as `sigma_min`."""

    @property
    def damping(self) -> float:
        """Damping lambda."""

    @property
    def damping_constants(self) -> tuple[float, float, float]:
        """lambda_0, sigma_0, lambda_max in force."""

    @property
    def gain_factor(self) -> float:
        """Factor <= 1 on K_x that the delay demands; law impedance: on the stiffness, last step."""

    @property
    def gamma(self) -> float:
        """How much of feed-forward and prediction is used, 0.5 to 1."""

    @property
    def factors(self) -> tuple[float, float, float]:
        """Factors that scaled null-space, soft and stiff part to torque and speed limits."""

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Joints whose limit is at its ceiling (n,)."""

    @property
    def deviation_limited(self) -> NDArray[np.bool_]:
        """Task axes at which the target met its `deviation_limit` (k,)."""

    @property
    def reference(self) -> _Array:
        """Target as far as tool speed and deviation limits let it, `base_from_tool` (4, 4)."""

    @property
    def locked(self) -> NDArray[np.bool_]:
        """Joints at a position limit that left the inverse kinematics (n,)."""

@final
class WrenchEstimate:
    """What pushes at the tool, and how sure that is.

    Forces [N] and torques [N m] of the surroundings on the tool, taken at the tool: a push toward +
    is positive. `str` gives one line.
    """

    @property
    def force(self) -> _Array:
        """Force and torque (6,) along the axes of the task frame; 0 along axes not looked at."""

    @property
    def uncertainty(self) -> _Array:
        """`|force - truth|` (6,) is at most this if the options tell the truth; inf: not known."""

    @property
    def force_base(self) -> _Array:
        """Force and torque (6,) in base axes."""

    @property
    def uncertainty_base(self) -> _Array:
        """Bound (6,) of those in base axes."""

    @property
    def torque_residual(self) -> _Array:
        """What the surroundings add to each joint (n,) [N m], behind the low-pass."""

    @property
    def torque_uncertainty(self) -> _Array:
        """How far that can be off (n,) [N m]; a payload nobody knows of is counted above only."""

    @property
    def residual_ratio(self) -> float:
        """Largest of |residual| / uncertainty over the joints: above 1 something pushes."""

    @property
    def torque(self) -> _Array:
        """Torque of each servo (n,) [N m], from lead and limit or as measured."""

    @property
    def velocity(self) -> _Array:
        """Joint velocity that the estimate used (n,) [rad/s]."""

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Joints whose servo is at its limit (n,): their torque is the limit."""

    @property
    def touch(self) -> NDArray[np.bool_]:
        """Axes that are touched (6,)."""

    @property
    def stop(self) -> NDArray[np.bool_]:
        """Axes whose force asks for a stop (6,)."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class ContactEstimator:
    """Feels what pushes at the tool of an arm without force sensors.

    What the servos exert beyond gravity, friction and acceleration, the surroundings must exert:
    `J' F = r = g + M q'' + t_f tanh(v / v0) + d v - clip(k_p (goal - q) - k_v v, +-limit)`. With
    `|error of r_i| <= u_i`, `F = (J W J' + P)^-1 J W r`, `W = diag(1/u^2)`, `P = diag(1/most^2)`,
    and the bound is `|G| u + |G J' - I| most`: what no joint feels is uncertain by `most`.

    Call `update` once per tick, before the controller's `step`. Shares are of the quantity's own
    size: 0.3 is 30 %.

    Args:
        controller: Whose model, payload, gravity, delay, task frame and commands are used.
        axes: Axes of the task frame along which the surroundings can push; along the others nothing
            is taken to push. None: all six with six joints or more, else those of the task.
        filter: Time constant of the low-pass [s]; 0 for none.
        friction_error: How wrong friction and damping may be. At rest dry friction is open anyway.
        kp_error: How wrong k_p and torque limits may be; None: 0.1 if `stiffness_known`, else 0.25.
        gravity_error: How wrong gravity torques may be.
        payload_error: Mass at the tool that may be there unknown [kg].
        inertia_error: How wrong the torques of acceleration may be (groups are point masses).
        load_error: How wrong a measured load or current may be.
        torque_constant: Torque per current (n,) [N m/A], needed where a current is given.
        most: Largest force [N] and torque [N m] thought possible.
        touch, stop: Thresholds [N, N m] by axis key, e.g. `{"xyz": 8.0}`. In force is the larger of
            threshold and `guard` times the present uncertainty.
        hysteresis: Share of its threshold by which a force must fall to end an event.
        min_time: How long a threshold must be passed before an event begins or ends [s].
        guard: At 1 an event is proven; 0.6 has given no false alarm in an hour (docs/contact.md).
        accept: `("thresholds",)` takes thresholds below the uncertainty as they are, unguarded.

    Raises:
        OutOfRangeError: An option out of range; a threshold below what this arm at rest can tell
            from a contact in the median pose, with that number.
        ConfigError, ShapeError: No servos, unknown axes, constants of another length.
    """

    def __new__(
        cls,
        controller: Controller,
        *,
        axes: str | None = None,
        filter: float = 0.04,
        friction_error: float = 0.3,
        kp_error: float | None = None,
        gravity_error: float = 0.05,
        payload_error: float = 0.0,
        inertia_error: float = 0.3,
        load_error: float = 0.2,
        torque_constant: ArrayLike | None = None,
        most: tuple[float, float] = (100.0, 20.0),
        touch: Mapping[str, float] | None = None,
        stop: Mapping[str, float] | None = None,
        hysteresis: float = 0.3,
        min_time: float = 0.02,
        guard: float = 1.0,
        accept: Sequence[str] = (),
    ) -> ContactEstimator: ...
    def update(
        self,
        q: ArrayLike,
        *,
        dt: float | None = None,
        dq: ArrayLike | None = None,
        load: ArrayLike | None = None,
        current: ArrayLike | None = None,
        sent: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> WrenchEstimate:
        """Take one reading; before the controller's step of this tick.

        Until a command that was in force is known, and no load is given, nothing is felt: force 0,
        uncertainty inf.

        Args:
            q: Measured joint positions (n,) [rad].
            dt: Time since the last reading [s], at most 1; None: 1 / rate of the controller's
                settings.
            dq: Joint velocity (n,) [rad/s] in place of the filtered one.
            load: Torques that the servos say they exert (n,) [N m], in place of lead and limit.
            current: Currents of the motors (n,) [A]; needs `torque_constant`.
            sent: Goals and limits (n,) that were sent last, where not the controller's command.

        Raises:
            ShapeError, OutOfRangeError, ConfigError: An input that cannot be used; nothing has
                changed.
        """

    def uncertainty_at(self, q: ArrayLike) -> _Array:
        """Bound (6,) [N, N m] for the arm at rest in q (n,) [rad], holding its weight."""

    def typical_uncertainty(self) -> _Array:
        """Median (6,) of `uncertainty_at` over 64 poses of the joint space (a millisecond)."""

    def reset(self) -> None:
        """Forget velocity, filter, commands and events; a tare stays."""

    def tare(self) -> None:
        """Take the present force for zero: from now on the change is felt.

        Errors of k_p, gravity and payload count from here only; what dry friction may have hidden
        in the tare counts in addition.

        Raises:
            ConfigError: Nothing has been felt yet.
        """

    def clear_tare(self) -> None:
        """Undo a tare."""

    @property
    def tared(self) -> bool:
        """Whether a tare is in force."""

    @property
    def estimate(self) -> WrenchEstimate:
        """The last estimate."""

    @property
    def guard(self) -> float:
        """Share of the uncertainty that a force must exceed to count."""

    @property
    def latency(self) -> float:
        """What an event lags by design [s]: delay of the controller, low-pass, shortest time."""

    @property
    def axes(self) -> tuple[_AxisName, ...]:
        """Axes looked at."""

    @property
    def controller(self) -> Controller:
        """The controller."""

def damped_pseudo_inverse(J: ArrayLike, damping: float) -> _Array:
    """Damped pseudo-inverse of (3): J^T (J J^T + lambda^2 I)^-1, shape (n, k).

    Args:
        J: Jacobian (k, n), at most six rows and sixteen columns.
        damping: lambda, not squared; 0 gives the Moore-Penrose inverse, of rank-deficient matrices
            too.

    Raises:
        ShapeError: More rows or columns. OutOfRangeError: An entry that is not finite, or lambda <
            0.
    """

def null_space_projector(
    J: ArrayLike, damping: float = 0.0, kind: Literal["exact", "paper"] = "exact"
) -> _Array:
    """Null-space projector of J, (n, n).

    Args:
        J: Jacobian (k, n).
        damping: lambda of J+, for `kind="paper"` only.
        kind: `"exact"`: the orthogonal projector, faded close to singular J; `"paper"`: I - J+ J.

    Raises:
        ShapeError, OutOfRangeError: As `damped_pseudo_inverse`. ConfigError: Another kind.
    """

def responsibility(
    J_pinv: ArrayLike, dx: ArrayLike, N: ArrayLike, gradient: ArrayLike, alpha: float
) -> _Array:
    """Responsibility R of (6), (7), (n, k + 1): |J+ diag(dx)|, then |alpha N gradient|.

    Args:
        J_pinv: Pseudo-inverse (n, k).
        dx: Task velocity (k,) [m/s, rad/s].
        N: Null-space projector (n, n).
        gradient: Gradient of the null-space cost (n,).
        alpha: Step of the null-space motion [1/s].

    Raises:
        ShapeError: Sizes that do not go together. OutOfRangeError: An entry that is not finite.
    """

def activation(J_pinv: ArrayLike, N: ArrayLike, gradient: ArrayLike | None = None) -> _Array:
    """Activation matrix A of (10), (n, k + 1): columns of |J+| over their sums, null space last.

    Args:
        J_pinv: Pseudo-inverse (n, k).
        N: Null-space projector (n, n).
        gradient: Gradient of the null-space cost (n,); where N gradient vanishes, and without it,
            the last column is made of the row norms of N.

    Raises:
        ShapeError: Sizes that do not go together. OutOfRangeError: An entry that is not finite.
    """

def check_path(
    model: Model,
    settings: Settings,
    path_or_pose: _PoseLike | ArrayLike,
    *,
    servos: Servos | None = None,
    q0: ArrayLike | None = None,
) -> FeasibilityReport:
    """Whether settings can be met on a path or in a pose, and which to change to what if not.

    The same as `Controller(model, settings, servos).check(path_or_pose, q0=q0)`.

    Args:
        model: The arm.
        settings: What it shall do.
        path_or_pose: Postures (n,) or (N, n) [rad]; or a pose of the tool `base_from_tool`: (4, 4)
            with the last row 0 0 0 1, `Pose`, any object with a 4x4 accessor; a position (3,) [m]
            for a task without rotations, where the arm has not three joints.
        servos: None for those of the model.
        q0: Where the search for a pose starts (n,) [rad]; None: mid-range.

    Returns:
        Verdict and findings; true where all can be met. Out of reach is a finding, no error.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: Settings, servos and model do not go together, or
            a path or pose that cannot be used, by name.
        TypeError: An argument of another kind.
    """

@overload
def compliance(deviation: float, soft_until: float, firm_from: float) -> float:
    """Compliance c of (8) for |deviation|: 1 below `soft_until`, 0 above `firm_from`.

    Args:
        deviation: Deviation (k,) [m or rad], or one.
        soft_until: Deviation below which compliance is full (k,), or one for all.
        firm_from: Deviation above which compliance is none (k,), or one for all.

    Returns:
        (k,), or a number for a number.

    Raises:
        ShapeError: Lists of different lengths. OutOfRangeError: Unless 0 <= soft_until < firm_from.
    """

@overload
def compliance(deviation: ArrayLike, soft_until: ArrayLike, firm_from: ArrayLike) -> _Array: ...
@overload
def holding_torque(c: float, soft: float, firm: float, hold: float, compliant: bool) -> float:
    """Holding torque of (9): c soft + (1 - c) firm where the axis is compliant, else hold.

    Args:
        c: Compliance (k,), 0 to 1, or one.
        soft: Strength at full compliance (k,), or one for all.
        firm: Strength at no compliance (k,), or one for all.
        hold: Strength of axes that are not compliant (k,), or one for all.
        compliant: Which are (k,), or one for all.

    Returns:
        (k,), or a number for a number.

    Raises:
        ShapeError: Lists of different lengths. OutOfRangeError: c outside [0, 1], or a strength
            that is not finite.
    """

@overload
def holding_torque(
    c: ArrayLike,
    soft: ArrayLike,
    firm: ArrayLike,
    hold: ArrayLike,
    compliant: bool | Sequence[bool] | NDArray[np.bool_],
) -> _Array: ...
def joint_torque_limits(A: ArrayLike, strength: ArrayLike) -> _Array:
    """Joint torque limits of (11), A strength (n,) [N m].

    Args:
        A: Activation matrix (n, k + 1).
        strength: Holding torques (k + 1,) [N m], that of the null space last.

    Raises:
        ShapeError: Sizes that do not go together. OutOfRangeError: An entry that is not finite.
    """

def adapt_target(
    actual: _PoseLike,
    target: _PoseLike,
    eta: float,
    compliant: str | bool | Sequence[bool] | NDArray[np.bool_],
) -> _Array:
    """The intermediate target of (12) as a pose (4, 4).

    target + eta (actual - target) on the compliant axes, in the base. Rotations scale the
    components of the rotation vector; angles are never blended.

    Args:
        actual: Pose of the tool.
        target: Pose it should have.
        eta: Adaptation, 0 to 1.
        compliant: Axis key such as ``"y yaw"``, or six flags.
    """

def pose_error(actual: _PoseLike, target: _PoseLike) -> _Array:
    """Deviation target - actual (6,), base axes [m, rad]; rotation vector of R_d R^T."""

@final
class ArmPoints:
    """Origins of the joints between base and tip, and the tool: m points, base to tip.

    Joints off the chain are fixed at the model's values. The payload is a point mass.

    Args:
        model: The arm.
        armature: Inertia of the servos' rotors at the joints (n,) [kg m^2]; None: 0.
    """

    def __new__(cls, model: Model, armature: ArrayLike | None = None) -> ArmPoints: ...
    def position(self, q: ArrayLike) -> _Array:
        """Return the positions (m, 3) [m] at q (n,) [rad], base axes."""

    def velocity(self, q: ArrayLike, dq: ArrayLike) -> _Array:
        """Return the velocities (m, 3) [m/s] for joint velocities dq (n,) [rad/s]."""

    def inertia(self, q: ArrayLike) -> _Array:
        """Return the joint-space inertia matrix with the rotors (n, n) [kg m^2]."""

    def effective_mass(self, q: ArrayLike, dq: ArrayLike) -> _Array:
        """Return the mass (m,) [kg] of each point along its velocity; 0 for a point at rest.

        ``1 / (d' J M^-1 J' d)`` with d the direction of the velocity (Khatib 1995).
        """

@final
class Lowering:
    """One descent, from the present pose until the torque limits are zero.

    The goals start at their present values and move toward the joints, in proportion to the
    measured distance between them, so the arm descends without an exact stiffness or payload:

    - `rest`: if there is a rest pose, move toward it first;
    - `down`: descend until no joint carries a load;
    - `ramp`: reduce the limits to zero, and wait while anything moves.

    If positions no longer arrive, a model of the arm replaces the measured one. See
    `docs/lifecycle.md` for the equations.

    Args:
        model: The arm; its `gravity` gives the downward direction of each joint.
        servos: Its servo parameters, n entries.
        q: Last good joint positions (n,) [rad].
        goal: Last goals sent (n,) [rad]; None: holding goals by the servo table.
        limit: Last limits sent (n,) [N m]; None: the weight and a margin.
        rest: Rest pose (n,) [rad]; None: straight down.
        speed: Largest speed of any point of the arm [m/s].

    Raises:
        ShapeError: A vector does not have n entries. OutOfRangeError: A number is not finite, or
            `speed` is not above 0. ConfigError: The servos do not fit the model.
    """

    def __new__(
        cls,
        model: Model,
        servos: Servos,
        q: ArrayLike,
        *,
        goal: ArrayLike | None = None,
        limit: ArrayLike | None = None,
        rest: ArrayLike | None = None,
        speed: float = 0.15,
    ) -> Lowering: ...
    @property
    def phase(self) -> Literal["rest", "down", "ramp", "done"]:
        """Present phase; `done`: the arm rests and torque can be switched off."""

    @property
    def blind(self) -> bool:
        """True if positions have been missing for so long that the model's replace them."""

    def step(
        self,
        q: ArrayLike,
        ok: Sequence[bool] | NDArray[np.bool_] | None = None,
        *,
        dt: float,
        age: float = 0.0,
    ) -> Command | None:
        """Compute goals, torque limits and speed limits of one tick.

        Args:
            q: Joint positions (n,) [rad]; NaN and inf count as lost.
            ok: Mask of the new positions (n,); None: all.
            dt: Time since the last tick [s], at most 0.1.
            age: Age of the goals that were in force when q was sampled [s].

        Returns:
            The command to write; None if the arm rests and torque can be switched off. Its speed
            limits are finite only while blind, so that a joint does not jump to a goal after lost
            packets.

        Raises:
            ShapeError: `q` or `ok` does not have n entries; nothing has changed.
        """

#: Holding torque over gravity torque, wherever an arm is held without a controller.
SUPPORT: Final[float]

def torque_margin(servos: Servos, gravity: ArrayLike) -> _Array:
    """Return the torque margin (n,) [N m] of joints over their gravity torque (n,) [N m]."""

@final
class HandGuidingLaw:
    """Goals that follow a weightless arm after its first swing; see `pliant.HandGuiding`.

    Args:
        model: The arm.
        servos: Assumed servo parameters, n entries.
        q: Positions at the end of the swing (n,) [rad].
        goal: Goals at the end of the swing (n,) [rad].
        swung: Joints that swung (n,).
        lead: Mean of the leads that move a joint up and down (n,) [rad].
        friction: Half the difference of these leads (n,) [rad].
        damping: Viscous damping, derivative gain and back-EMF together (n,) [N m s/rad].
        stiffness_error: Factor by which k_p may be wrong in either direction, at least 1.
        delay: Time from the reading to the arrival of the goal [s].
        torque_share: Torque allowed on top of gravity, as a share of the usable torque.
        payload_moments: Mass [kg] and mass times centre in the tool frame [kg m] (4,) of a payload
            in addition to the model's.
    """

    def __new__(
        cls,
        model: Model,
        servos: Servos,
        *,
        q: ArrayLike,
        goal: ArrayLike,
        swung: Sequence[bool],
        lead: ArrayLike,
        friction: ArrayLike,
        damping: ArrayLike,
        stiffness_error: float,
        delay: float,
        torque_share: float,
        payload_moments: Sequence[float],
    ) -> HandGuidingLaw: ...
    @property
    def stiffness(self) -> _Array:
        """Interval of k_p after all rests so far (2, n) [N m/rad]."""

    @property
    def play(self) -> _Array:
        """Play of each joint in this tick (n,) [rad]."""

    @property
    def speed(self) -> _Array:
        """Filtered joint speeds (n,) [rad/s]."""

    def step(self, q: ArrayLike, *, dt: float) -> Command:
        """Return goals and torque limits for measured positions q (n,) [rad] after dt [s].

        Raises:
            ShapeError: `q` does not have n entries. OutOfRangeError: A number is not finite, or
                `dt` is not above 0. Nothing has changed.
        """

@final
class ThermalModel:
    """Thermal model of N servos, and the torque limits that follow from it.

    ``dh/dt = ((torque / max_torque)^2 / continuous^2 - h) / seconds``, where h is the share of the
    thermal budget in use; h = 1 in steady state at the continuous torque.

    Args:
        max_torque: Usable torques (N,) [N m].
        stall_current: Currents at these torques (N,) [A]; None: unknown.
        continuous: Share of the usable torque that a servo can exert continuously, in (0, 1].
        seconds: Thermal time constant of the winding [s].
        supply: Largest current of the supply [A]; None: no limit.
        hottest: Temperature at which the servos switch off [deg C].

    Raises:
        ConfigError: An option is out of range, or a supply is given and the currents are unknown.
    """

    def __new__(
        cls,
        max_torque: Sequence[float] | _Array,
        stall_current: Sequence[float] | _Array | None = None,
        *,
        continuous: float,
        seconds: float,
        supply: float | None,
        hottest: float,
    ) -> ThermalModel: ...
    @property
    def heat(self) -> _Array:
        """Share of the thermal budget in use (N,)."""

    @property
    def temperature(self) -> _Array:
        """Last known temperatures (N,) [deg C]; NaN where unknown."""

    @property
    def last_temperature(self) -> float:
        """Temperature at which a torque limit reaches zero [deg C]."""

    def set_temperature(self, servo: int, temperature: float) -> None:
        """Store the measured temperature of a servo [deg C]."""

    def update(self, torque: ArrayLike, dt: float) -> None:
        """Update the heat with torques (N,) [N m] exerted over dt [s]."""

    def torque_ceiling(self) -> _Array:
        """Return the largest torque limits (N,) [N m] at the present heat and temperature."""

    def limit_current(self, torque: ArrayLike, least: ArrayLike, limit: ArrayLike) -> _Array:
        """Return torque limits (N,) [N m] that keep the current within the supply.

        ``least + s (limit - least)`` with the largest s in [0, 1] that the supply allows.

        Args:
            torque: Expected torques without limits (N,) [N m].
            least: Limits that are never reduced (N,) [N m]: those of the arm's weight.
            limit: Requested limits (N,) [N m].
        """

def _model(text: str, options: dict[str, Any]) -> Model:
    """What a pickle of a model calls."""

def _controller(
    model: Model, settings: Settings, servos: Servos | None, numbers: tuple[Any, ...]
) -> Controller:
    """What a pickle of a controller calls."""
