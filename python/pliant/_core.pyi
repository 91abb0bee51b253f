"""Compiled part of `pliant`. Shapes: n joints of the chain, k task axes, N rows of a batch."""

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from types import MappingProxyType
from typing import (
    Any,
    Final,
    Literal,
    Protocol,
    Self,
    TypeAlias,
    TypedDict,
    Unpack,
    final,
    overload,
)

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import disjoint_base

from pliant.drive import Clock, Drive, ServoStatus

__version__: Final[str]

__all__ = [
    "SUPPORT",
    "ArmCycle",
    "ArmPoints",
    "Axis",
    "AxisReport",
    "BatchState",
    "BusCycle",
    "BusStatus",
    "Command",
    "CommandLimiter",
    "Compensation",
    "ConfigError",
    "ContactEstimator",
    "Controller",
    "Diagnostics",
    "ExclusiveAccess",
    "FeasibilityReport",
    "FrameNotFoundError",
    "HandGuidingLaw",
    "IkResult",
    "Inertial",
    "Issue",
    "Joint",
    "JointFollower",
    "JointReadings",
    "JointStop",
    "Link",
    "Lowering",
    "Mimic",
    "Model",
    "NullSpace",
    "OutOfRangeError",
    "PaperOptions",
    "Payload",
    "PliantError",
    "PortState",
    "Pose",
    "PoseReport",
    "PositionFilter",
    "SerialPort",
    "ServoCodec",
    "ServoError",
    "ServoFaultError",
    "ServoGroup",
    "ServoTimeoutError",
    "Servos",
    "Settings",
    "ShapeError",
    "State",
    "Task",
    "ThermalModel",
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
    "torque_margin",
    "update_contacts",
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

#: A 4x4 array, a `Pose`, or an object with a 4x4 accessor; for a task without rotations also (3,).
_PoseLike: TypeAlias = (
    ArrayLike | Pose | _HasMatrix | _HasMatrixMethod | _HasAsMatrix | _HasHomogeneous | _HasA
)

class PliantError(Exception):
    """Base class of all exceptions of this package."""

class UrdfError(PliantError, ValueError):
    """The robot description is invalid.

    A file that does not exist raises the built-in `FileNotFoundError`.

    Attributes:
        source: Path of the file, or `<string>`.
        line: Line of the error, counted from 1; None if unknown.
        column: Column of the error, counted from 1; None if unknown.
    """

    source: str | None
    line: int | None
    column: int | None

class FrameNotFoundError(PliantError, LookupError):
    """No link has the requested name.

    Attributes:
        frame: Requested name.
        available: Names of the existing links.
    """

    frame: str | None
    available: tuple[str, ...] | None

class OutOfRangeError(PliantError, ValueError):
    """A number is outside its bounds.

    Attributes:
        what: Quantity, e.g. ``q[3] (elbow_pitch)``.
        value: Value given.
        bound: Bound, and the remedy if there is one.
    """

    what: str | None
    value: float | None
    bound: str | None

class ShapeError(PliantError, ValueError):
    """An array has the wrong shape.

    Attributes:
        what: Name of the argument.
        got: Shape of the argument, as text.
        expected: Expected shape, as text.
    """

    what: str | None
    got: str | None
    expected: str | None

class ConfigError(PliantError, ValueError):
    """Settings, servos and model are inconsistent, or a name is unknown.

    Attributes:
        key: Name of the setting or argument, e.g. ``axes.y.adaptation``.
    """

    key: str | None

class ServoError(PliantError):
    """A servo or its bus failed to do what was requested; the message names the remedy."""

class ServoTimeoutError(ServoError, TimeoutError):
    """A servo did not answer in time."""

class ServoFaultError(ServoError):
    """A servo reports a hardware fault."""

@final
class Pose:
    """Pose of one frame in another, e.g. `base_from_tool` of a tool. Immutable.

    Args:
        matrix: Homogeneous matrix (4, 4), or another argument of `as_pose`; None: identity.

    Raises:
        ShapeError: The matrix is not 4x4.
        ConfigError: The rotation is invalid, or the last row is not 0 0 0 1.
        OutOfRangeError: The position is beyond 100 m or not finite.
    """

    def __new__(cls, matrix: _PoseLike | None = None) -> Pose: ...
    @staticmethod
    def from_matrix(matrix: _PoseLike) -> Pose:
        """Create a pose from a homogeneous matrix (4, 4)."""

    @staticmethod
    def from_wxyz(position: ArrayLike, quaternion: ArrayLike) -> Pose:
        """Create a pose from position (3,) [m] and unit quaternion (4,) (within 1e-3), w first."""

    @staticmethod
    def from_xyzw(position: ArrayLike, quaternion: ArrayLike) -> Pose:
        """Create a pose from position (3,) [m] and unit quaternion (4,) (within 1e-3), w last."""

    @staticmethod
    def from_rotvec(position: ArrayLike, rotvec: ArrayLike) -> Pose:
        """Create a pose from a position (3,) [m] and a rotation vector (3,) [rad]."""

    @staticmethod
    def from_rpy(position: ArrayLike, rpy: ArrayLike) -> Pose:
        """Create a pose from a position (3,) [m] and roll, pitch, yaw (3,) [rad] as in URDF."""

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
        """Rotation vector (3,) [rad], with a norm of at most pi."""

    def inverse(self) -> Pose:
        """Return the inverse pose: `b_from_a` for a pose `a_from_b`."""

    def __matmul__(self, other: Pose, /) -> Pose: ...
    def __rmatmul__(self, other: Pose, /) -> Pose: ...
    def __array__(self, dtype: Any | None = None, copy: bool | None = None) -> NDArray[Any]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __getnewargs__(self) -> tuple[Any, ...]: ...

def as_pose(pose: _PoseLike, /) -> Pose:
    """Convert an array or an object of another library to a `Pose`.

    Args:
        pose: A matrix (4, 4), a `Pose`, a position (3,) (without rotation), or an object with
            `homogeneous`, `as_matrix`, `matrix` or `A`, as in Pinocchio, SciPy, mink, pytransform3d
            and Spatial Math.

    Raises:
        ShapeError: `pose` has another shape. Seven numbers are rejected, since the order of a
            quaternion is ambiguous.
        ConfigError, OutOfRangeError: As for `Pose`.
        TypeError: `pose` is none of these.
    """

@final
class Payload:
    """A point mass in the tool frame.

    Args:
        mass: Mass [kg].
        com: Centre of mass (3,) in the tool frame [m].

    Raises:
        OutOfRangeError, ShapeError, ConfigError: An argument is invalid.
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
        """Rotation matrix `link_from_inertia` (3, 3)."""

    @property
    def inertia(self) -> _Array:
        """Inertia (3, 3) about the centre of mass, in the axes of `rotation` [kg m^2]."""

@final
class Link:
    """A rigid body of the robot, or a frame without mass."""

    @property
    def name(self) -> str:
        """Name in the URDF."""

    @property
    def parent_joint(self) -> int | None:
        """Index of the parent joint in `Model.joints`; None for the root."""

    @property
    def inertial(self) -> Inertial | None:
        """Mass and inertia; None for a massless link."""

@final
class Mimic:
    """Coupling to a driving joint at position q: the joint is at ``multiplier * q + offset``."""

    @property
    def joint(self) -> int:
        """Index of the driving joint in `Model.joints`."""

    @property
    def multiplier(self) -> float:
        """Ratio to the position of the driving joint."""

    @property
    def offset(self) -> float:
        """Position of the joint when the driving joint is at 0 [rad or m]."""

@final
class Joint:
    """A joint of the robot, on the chain or beside it."""

    @property
    def name(self) -> str:
        """Name in the URDF."""

    @property
    def kind(self) -> Literal["revolute", "continuous", "prismatic", "fixed", "other"]:
        """Type of the joint."""

    @property
    def parent(self) -> int:
        """Index of the parent link in `Model.links`."""

    @property
    def child(self) -> int:
        """Index of the child link in `Model.links`."""

    @property
    def origin(self) -> Pose:
        """Pose `parent_from_child` when the joint is at 0."""

    @property
    def axis(self) -> _Array:
        """Unit axis (3,) in the joint's frame."""

    @property
    def lower(self) -> float | None:
        """Lower position limit [rad or m]; None without one."""

    @property
    def upper(self) -> float | None:
        """Upper position limit [rad or m]; None without one."""

    @property
    def velocity(self) -> float | None:
        """Speed limit [rad/s or m/s]; None without one."""

    @property
    def effort(self) -> float | None:
        """Torque or force limit [N·m or N]; None without one."""

    @property
    def damping(self) -> float | None:
        """Damping [N·m s/rad or N s/m]; None if the URDF gives none."""

    @property
    def friction(self) -> float | None:
        """Dry friction [N·m or N]; None if the URDF gives none."""

    @property
    def mimic(self) -> Mimic | None:
        """Coupling to the driving joint; None if the joint is independent."""

    @property
    def q_index(self) -> int | None:
        """Index in `q` of the independent joint that moves this one; None if nothing moves it.

        An independent joint has its own index, a mimic joint the index of its driving joint.
        """

    @property
    def locked_at(self) -> float | None:
        """Position [rad or m] at which an actuated joint is locked; None if it is not locked."""

@final
class IkResult:
    """Result of an inverse-kinematics search; its truth value is `converged`."""

    @property
    def q(self) -> _Array:
        """Closest joint positions found (n,), inside the limits [rad or m]."""

    @property
    def converged(self) -> bool:
        """True if `position_error` and `rotation_error` are within their tolerances."""

    @property
    def iterations(self) -> int:
        """Number of iterations, summed over all starts."""

    @property
    def position_error(self) -> float:
        """Distance to the target along the selected axes [m]."""

    @property
    def rotation_error(self) -> float:
        """Angle to the target about the selected axes [rad]."""

    @property
    def reason(self) -> str:
        """Reason why the search ended, as text."""

    def __bool__(self) -> bool: ...

@final
class Model:
    """A kinematic chain with all bodies that move with it. Immutable; controllers can share it.

    Create it with `Model.from_urdf`, `Model.from_urdf_str` or a function of `pliant.robots`. A
    pickle contains the URDF text and the options.
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
        """Read a URDF file. Meshes are not opened.

        Args:
            source: Path of the file.
            base: Link in which poses are given; default: the root.
            tip: Tool frame; optional if only one link has no child.
            locked: Positions [rad or m] of locked joints by name. Other actuated joints beside the
                chain are locked at 0, or at the limit nearest to 0. Locked joints keep their mass.
            payload: Payload of the tool: a `Payload`, or mass [kg] and centre of mass (3,) [m] in
                the tool frame.
            gravity: Gravity (3,) in the base [m/s^2].
            limits: Position limits [rad or m] by joint name, in place of those of the file.
            servos: Servos of the joints, which `Controller` uses by default.

        Raises:
            FileNotFoundError: The file does not exist.
            UrdfError: The text is invalid; with file, line and column.
            FrameNotFoundError: `base` or `tip` is not a link; lists the links.
            ConfigError: Ambiguous tip, unknown joint, too many joints, or unknown keyword.
            OutOfRangeError: A number is outside its bounds.
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
        """Create a model from URDF text; options and exceptions as in `from_urdf`."""

    @property
    def source(self) -> tuple[str, dict[str, Any]]:
        """URDF text and options: `Model.from_urdf_str(text, **options)` creates the same model."""

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
        """Speed limits (n,) [rad/s or m/s], NaN where the URDF has none; read-only."""

    @property
    def effort_limit(self) -> _Array:
        """Torque limits (n,) [N·m or N], NaN where the URDF has none; read-only."""

    @property
    def prismatic(self) -> tuple[bool, ...]:
        """True for each independent joint that is prismatic."""

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all links; each can be base or tip."""

    @property
    def base(self) -> str:
        """Name of the link in which poses are given."""

    @property
    def tip(self) -> str:
        """Name of the tool frame."""

    @property
    def reach(self) -> float:
        """Sum of distances from the first joint origin to the tool, plus prismatic travel [m]."""

    @property
    def reach_origin(self) -> _Array:
        """Origin (3,) of the first joint at q = 0, in the base [m]: the centre of `reach`."""

    @property
    def gravity_vector(self) -> _Array:
        """Gravity (3,) in the base [m/s^2]; read-only."""

    @property
    def payload(self) -> Payload | None:
        """Payload of the tool; None without one."""

    @property
    def servos(self) -> Servos | None:
        """Servos with one entry per joint; None if none were given."""

    def with_servos(self, servos: Servos) -> Model:
        """Return a copy of the model with other servos.

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
        """Compute the pose `base_from_tool` (4, 4) and the Jacobian (6, n), linear rows first.

        Args:
            q: Joint positions (n,) [rad or m]. Position limits are not enforced.
            reference: Axes of the Jacobian's rows: `"world_aligned"`: those of the base;
                `"local"`: those of the tool.
            out: Two writable float64 arrays (4, 4) and (6, n) for the results.

        Raises:
            ShapeError: `q` or an array of `out` has the wrong shape.
            OutOfRangeError: An entry of `q` is not finite or beyond 1e6.
            TypeError: `q` is not numeric, or `out` is not writable.
        """

    @overload
    def kinematics(
        self, q: ArrayLike, reference: _Reference = "world_aligned", *, out: tuple[_Array, _Array]
    ) -> tuple[_Array, _Array]: ...
    def forward_kinematics(self, q: ArrayLike) -> _Array:
        """Compute the pose `base_from_tool` (4, 4) at `q` (n,) [rad or m]; see `kinematics`."""

    def jacobian(self, q: ArrayLike, reference: _Reference = "world_aligned") -> _Array:
        """Compute the Jacobian (6, n) of the tool at `q` (n,) [rad or m], linear rows first.

        The rows refer to the axes of the base, or with ``reference="local"`` to those of the tool.
        See `kinematics`.
        """

    def gravity(self, q: ArrayLike) -> _Array:
        """Compute the torques (n,) [N·m or N] that hold the arm at rest at q; see `kinematics`."""

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
        """Search joint positions inside the limits that bring the tool to `target`.

        Damped least squares. A search that does not converge is not an error: see `converged` and
        `reason`.

        Args:
            target: Pose of the tool in the base; a position (3,) if `axes` has no rotation.
            q0: Start of the search (n,) [rad or m].
            axes: Axes of the base that must match, e.g. ``"xyz"``.
            position_tolerance: Position error to reach [m].
            rotation_tolerance: Rotation error to reach [rad].
            max_iterations: Maximum number of iterations per start.
            restarts: Number of further starts, from fixed points inside the limits.

        Raises:
            ShapeError, OutOfRangeError, ConfigError: An argument is invalid.
        """

    def check_target(self, target: _PoseLike) -> None:
        """Check that a pose is a plausible target: in metres, and not far out of reach.

        `Controller.step` makes the same check for tasks with translations.

        Args:
            target: Pose of the tool in the base, or a position (3,) [m].

        Raises:
            OutOfRangeError: The distance from `reach_origin` exceeds 2 times `reach` plus 0.1 m.
            ShapeError, ConfigError, TypeError: The target is not a pose.
        """

    def check_joint_target(self, q: ArrayLike) -> None:
        """Check that joint positions (n,) [rad or m] are a plausible target: not in degrees.

        `Controller.step_joints` makes the same check.

        Raises:
            OutOfRangeError: A joint is beyond its limits by more than 0.2 rad, or a tenth of its
                travel if prismatic.
            ShapeError, TypeError: `q` is not n numbers.
        """

    def kinematics_batch(
        self,
        Q: ArrayLike,
        reference: _Reference = "world_aligned",
        out: tuple[_Array, _Array] | None = None,
    ) -> tuple[_Array, _Array]:
        """Compute poses (N, 4, 4) and Jacobians (N, 6, n) of configurations (N, n).

        Large batches run on all cores with the GIL released; other threads must not write to the
        arrays meanwhile. Each row is bit-identical to the result of `kinematics`.

        Args:
            Q: Configurations (N, n) [rad or m]; a C-ordered float64 array is not copied.
            reference: Axes of the Jacobians' rows: `"world_aligned"`: those of the base;
                `"local"`: those of the tool.
            out: Arrays (N, 4, 4) and (N, 6, n) for the results; saves up to a fifth of the time.

        Raises:
            ShapeError, OutOfRangeError, TypeError, ValueError: An argument is invalid; the contents
                of `out` are then undefined.
        """

    def forward_kinematics_batch(self, Q: ArrayLike, out: _Array | None = None) -> _Array:
        """Compute poses (N, 4, 4) of configurations `Q` (N, n) [rad or m].

        See `kinematics_batch` for arguments and exceptions.
        """

    def jacobian_batch(
        self, Q: ArrayLike, reference: _Reference = "world_aligned", out: _Array | None = None
    ) -> _Array:
        """Compute Jacobians (N, 6, n) of configurations `Q` (N, n) [rad or m].

        See `kinematics_batch` for arguments and exceptions.
        """

    def gravity_batch(self, Q: ArrayLike, out: _Array | None = None) -> _Array:
        """Compute the torques (N, n) [N·m or N] that hold the arm at rest in `Q` (N, n) [rad or m].

        See `kinematics_batch` for arguments and exceptions.
        """

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
    """Servo parameters that the controller assumes: one number per joint, or one for all. Frozen.

    Units are N·m and rad; N and m for prismatic joints.

    Args:
        kp: Stiffness of the position loop [N·m/rad] > 0.
        max_torque: Usable torque at the present voltage [N·m] > 0: ceiling of every torque limit.
        friction: Dry friction of gears and motor [N·m].
        load_friction: Additional dry friction per N·m of load torque [1].
        stribeck: Additional dry friction at rest [N·m]; it vanishes in fast motion.
        load_stribeck: Additional dry friction at rest per N·m of load torque [1].
        stribeck_speed: Speed at which a third of the additional friction at rest is left [rad/s] >
            0.
        damping: Damping of gears and back-EMF [N·m s/rad], which the torque limit does not bound.
        kv: Derivative gain of the position loop [N·m s/rad]; the torque limit includes its torque.
        armature: Rotor inertia at the joint [kg m^2]; used by `ContactEstimator`, `Lowering` and
            simulators.
        encoder_step: Angle of one encoder count [rad]; 0 to neglect it.
        limit_type: Quantity that the limit register limits: `"current"`, which limits the torque,
            or `"pwm"`, with which the available torque decreases with speed.
        no_load_speed: Speed without load [rad/s]; required for `"pwm"`.
        stiffness_known: True if `kp` is known within 10 %, and friction and damping are measured;
            if False, half of their feed-forward needs an opposing force of a yielding axis, or a
            moving reference of a stiff one.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: A field is missing, unknown or invalid.
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
        """Stiffness of the position loop (n,) [N·m/rad]; read-only, as the other arrays."""

    @property
    def max_torque(self) -> _Array:
        """Usable torque at the present voltage (n,) [N·m]: ceiling of every torque limit."""

    @property
    def friction(self) -> _Array:
        """Dry friction of gears and motor (n,) [N·m]."""

    @property
    def load_friction(self) -> _Array:
        """Additional dry friction per N·m of load torque (n,) [1]."""

    @property
    def stribeck(self) -> _Array:
        """Additional dry friction at rest (n,) [N·m]; it vanishes in fast motion."""

    @property
    def load_stribeck(self) -> _Array:
        """Additional dry friction at rest per N·m of load torque (n,) [1]."""

    @property
    def stribeck_speed(self) -> _Array:
        """Speed at which a third of the additional friction at rest is left (n,) [rad/s]."""

    @property
    def damping(self) -> _Array:
        """Damping of gears and back-EMF (n,) [N·m s/rad], which the torque limit does not bound."""

    @property
    def kv(self) -> _Array:
        """Derivative gain of the position loop (n,) [N·m s/rad]; within the torque limit."""

    @property
    def armature(self) -> _Array:
        """Rotor inertia at the joint (n,) [kg m^2]."""

    @property
    def encoder_step(self) -> _Array:
        """Angle of one encoder count (n,) [rad]; 0: neglected."""

    @property
    def limit_type(self) -> Literal["current", "pwm"]:
        """Quantity that the limit register limits: `"current"` or `"pwm"`."""

    @property
    def no_load_speed(self) -> _Array | None:
        """Speed without load (n,) [rad/s]; None if unknown."""

    @property
    def stiffness_known(self) -> bool:
        """True if `kp` is known within 10 %."""

    @staticmethod
    def of(
        models: Sequence[str],
        *,
        voltage: float | None = None,
        gains: Sequence[int | None] | None = None,
    ) -> Servos:
        """Create servos from the tables of `pliant.servo`, one model per joint.

        Args:
            models: Servo models, base to tip; names as in `pliant.servo.list_models()`.
            voltage: Supply voltage [V]; default: the rated one of each model.
            gains: Values of the gain registers; None: the factory setting.

        Raises:
            ConfigError: A model is unknown (the message suggests names), the voltage is outside its
                range, or there is not one gain per model.
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
    """Controlled axes and their frame. Frozen.

    Args:
        axes: Axis key: words separated by spaces, each the name of an axis, letters of x y z,
            ``"rpy"`` or ``"all"``; e.g. ``"xyz rpy"`` or ``"xz yaw"``.
        frame: `"base"`, `"tool"` (moving with it), or a rotation matrix (3, 3) whose columns are
            the task's axes in the base.
        length: Length [m] that weighs as much as one radian; needed only with more axes than
            joints.

    Raises:
        ConfigError, OutOfRangeError: The key, the rotation matrix or the length is invalid.
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
        """Axis key, e.g. ``"xyz rpy"``."""

    @property
    def names(self) -> tuple[_AxisName, ...]:
        """Names of the axes, in the order of all arrays per axis."""

    @property
    def frame(self) -> str | _Array:
        """Frame of the axes: `"base"`, `"tool"`, or a rotation matrix `base_from_task` (3, 3)."""

    @property
    def length(self) -> float | None:
        """Length [m] that weighs as much as one radian; None without one."""

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
    """Settings of one task axis. Frozen; None selects the default.

    A strength (`soft`, `firm`, `hold`) is a force [N] ([N·m] for rotations) under the laws `"cap"`
    and `"impedance"`, a torque budget [N·m] under law `"paper"`; its default depends on law and
    arm. A pair is (pushed toward -, pushed toward +).

    Args:
        soft: Strength of the yielding axis at a small deviation; tau- in eq. (9) of the paper.
        firm: Strength of the yielding axis at a large deviation; tau+ in eq. (9) of the paper.
        hold: Strength of a side that does not yield.
        stiffness: Law impedance: spring [N/m or N·m/rad]; default 0 for a side that yields, else
            derived from the arm (`arm7`: 800 N/m, 20 N·m/rad).
        damping: Law impedance: damper [N s/m or N·m s/rad]; default 0.
        yields: Sides that yield, by the direction of the push; default `"both"` if `soft` or `firm`
            is given, else `"none"`.
        adaptation: Share eta of the deviation by which the target follows the tool, 0 <= eta < 1;
            eq. (12) of the paper.
        soft_until: Deviation below which compliance is 1 [m or rad]; default 0.01 m, 0.04 rad.
        firm_from: Deviation above which compliance is 0 [m or rad], at most 5; default 0.10 m, 0.40
            rad.
        profile: Strength for deviations from `soft_until` to `firm_from`: `"hardening"`: from soft
            to firm; `"constant"`: soft; `"softening"`: from firm to soft.
        max_velocity: Largest commanded velocity while the axis is stiff [m/s, rad/s]; default 0.4
            m/s, 2 rad/s; inf: no limit. Law impedance has no limit.
        soft_step_limit: Largest commanded velocity while the axis yields [m/s, rad/s]; default no
            limit, under law `"paper"` 0.1 m/s, 0.5 rad/s.
        deviation_limit: Largest deviation toward a side that does not yield [m or rad], at most 5;
            None: no limit.
        on_deviation_limit: Behaviour of the target beyond `deviation_limit`. `"yield"`: the target
            of this axis follows the tool, the arm gives way with the force of the limit, and the
            target returns at the tool's speed after the release. `"wait"`: the whole target waits
            until the axis is within its limit again.

    Raises:
        ConfigError, OutOfRangeError: A field is unknown, invalid or without effect.
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
        """Strength at a small deviation, pushed toward (-, +) [N, N·m]; None: default."""

    @property
    def firm(self) -> tuple[float, float] | None:
        """Strength at a large deviation, pushed toward (-, +) [N, N·m]; None: default."""

    @property
    def hold(self) -> float | None:
        """Strength of a side that does not yield [N, N·m]; None: default."""

    @property
    def stiffness(self) -> tuple[float, float] | None:
        """Spring of law impedance, pushed toward (-, +) [N/m or N·m/rad]; None: default."""

    @property
    def damping(self) -> tuple[float, float] | None:
        """Damper of law impedance, pushed toward (-, +) [N s/m or N·m s/rad]; None: 0."""

    @property
    def yields(self) -> Literal["both", "+", "-", "none"] | None:
        """Sides that yield, by the direction of the push; None: default."""

    @property
    def adaptation(self) -> float:
        """Share eta of the deviation by which the target follows the tool, 0 <= eta < 1."""

    @property
    def soft_until(self) -> float | None:
        """Deviation below which compliance is 1 [m or rad]; None: default."""

    @property
    def firm_from(self) -> float | None:
        """Deviation above which compliance is 0 [m or rad]; None: default."""

    @property
    def profile(self) -> Literal["hardening", "constant", "softening"]:
        """Strength as a function of the deviation, from `soft_until` to `firm_from`."""

    @property
    def max_velocity(self) -> float | None:
        """Largest commanded velocity while the axis is stiff [m/s, rad/s]; None: default."""

    @property
    def soft_step_limit(self) -> float | None:
        """Largest commanded velocity while the axis yields [m/s, rad/s]; None: default."""

    @property
    def deviation_limit(self) -> float | None:
        """Largest deviation toward a side that does not yield [m or rad]; None: no limit."""

    @property
    def on_deviation_limit(self) -> Literal["yield", "wait"]:
        """Behaviour of the target beyond `deviation_limit`."""

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
    """Tracking of the target by the stiff axes. Frozen; `replace` makes variants.

    Fields not given keep the values of the preset or of the replaced settings.

    Args:
        gain: Gain K_x [1/s], eq. (5) of the paper: a number, or one per axis of the task.
        damping: Damping of the inverse kinematics: lambda, or (lambda_0, sigma_0, lambda_max);
            None: derived from the arm.
        velocity_filter: Time constant of the velocity filter [s].
        goal_slew: Speed limit of the goals [rad/s]; None: no limit. If it acts, the part of the
            goals that holds the arm against gravity moves first; within the rest of the limit, all
            goals move by the same share of their remaining distances.
        joint_speed: Joint speed limits (n,) [rad/s]; None: those of the model.
        integrate: Rate of the integral action [1/s]: the lead goal - q of the stiff axes
            accumulates in the goal; 0: no integral action.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: A field is unknown or invalid.
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
    """Motion of the joints that leaves the task unchanged. Frozen; `replace` makes variants.

    Fields not given keep the values of the preset or of the replaced settings.

    Args:
        posture: Rest posture (n,) [rad]; None: q at reset.
        gain: Gain alpha of the null-space motion [1/s]; None: the largest `Tracking.gain`.
        max_torque: Largest torque of the null-space motion, summed over all joints [N·m]; None: 2
            if the arm is redundant for the task, else 0.
        stiffness: Law impedance: stiffness of the null-space motion [N·m/rad] instead of `gain`;
            None: use `gain`.
        max_speed: Speed limit of the null-space motion [rad/s]; None: no limit.
        limit_avoidance: Weight of the joint-limit cost ``sum(((q - mid) / half_range)^2) / 2``.
        projector: `"exact"`: orthogonal, faded close to singular poses; `"paper"`: I - J+ J with
            the damped J+, eq. (4) of the paper.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: A field is unknown or invalid.
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

    Fields not given keep the values of the preset or of the replaced settings.

    Args:
        friction: Share of the friction that the feed-forward compensates.
        damping: Share of the damping that the feed-forward compensates.
        delay: Share of the delay that the prediction compensates.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: A field is unknown or invalid.
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
    """Joint torque limits sent to the servos. Frozen; `replace` makes variants.

    Fields not given keep the values of the preset or of the replaced settings.

    Args:
        margin: Margin of the limits over the demand, as a share of the usable torque; it is at
            least twice the friction.
        floor: Minimum of the torque limits (n,) [N·m]; None: the servos' friction.
        stiffening_time: Time in which a limit may rise from zero to its ceiling [s]; 0: no bound.
        max_host_loss_force: Largest force on a hand along the task's translations after a host loss
            [N]; None: no bound. To keep it, a step reduces first the margin of the limits, then the
            part beyond the arm's weight. It takes about 0.3 ms longer, 1 ms if it reduces limits.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: A field is unknown or invalid.
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

    Exported as `pliant.functional.PaperOptions`; the field `paper_options` of `Settings`. Fields
    that are not given keep the values of the preset or of the replaced settings.

    Args:
        follow: `"free"`: the inverse kinematics leave out yielding axes, which exert exactly their
            force; `"hold"`: they contain all axes; None: `"hold"` under law paper, else `"free"`.
            Law impedance has no inverse kinematics.
        limits: Torque limits under the laws cap and impedance: `"demand"`: the torque that the law
            demands in the present step; `"sum"`: the sum over all axes of their largest demands.
        horizon: Horizon h of the goal q + h dq [s].
        kq: Law paper: gain K_q, eq. (5) of the paper: a number, one per joint, or a matrix.
        joint_weights: Law paper: weight of each joint in J+ (n,); None: 1.
        posture_weights: Weight of each joint in the posture cost (n,); None: 1.
        manipulability: Weight of the manipulability cost.
        gravity_use: Places in which the gravity model is used if `Settings.gravity` is True.
        gravity_scale: Factor on the gravity torques in the torque limits.
        friction_speed: Speed at which the friction feed-forward saturates [rad/s].
        direction_band: Half-width of a band around deviation zero in which an axis blends between
            the parameters of its sides, as a share of `soft_until`; None: 0.1, law paper 0.
        raw_deviation: Compute the compliance from the raw instead of the adapted deviation.
        budget_on_goal: Law paper: clamp the step of each axis to its budget.
        lead_limit: Law paper: largest lead goal - q [rad]; None: slightly more than the lead at
            which the servo reaches its torque limit; inf: no limit.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: A field is unknown or invalid.
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

    In a group such as `tracking`, fields that are not given keep the default, or the value of the
    preset or of the replaced settings: ``Settings.door(null_space=NullSpace(max_torque=1.0))``
    keeps the preset's `null_space.gain`. Presets and `replace` raise the errors of the class.

    Args:
        task: Controlled axes and their frame: a `Task`, or its axis key.
        axes: `Axis` by axis key, e.g. ``{"y": Axis(soft=4.0), "xz": Axis(hold=40.0)}``; the other
            axes are stiff.
        law: `"cap"`: force caps per axis; `"impedance"`: a spring and a damper per axis, with force
            caps; `"paper"`: equations (3) to (12) of the paper, torque budgets per axis.
        rate: Nominal control rate [Hz]: the default `dt` of a step is 1 / rate.
        delay: Time from reading the positions to the arrival of the goal [s].
        gravity: Use the gravity model in goals and limits.
        max_tool_speed: Speed limit of `Diagnostics.reference` [m/s], or a pair [m/s, rad/s], at
            most (20, 80); a single number implies 4 rad/s per m/s; None: no limit. A tool that
            friction has held back can be faster by up to 0.1 m/s, along soft axes near a singular
            pose by more: from 0.08 m/s (0.3 rad/s) above the limit on, laws cap and impedance
            reduce the forces that accelerate the tool.
        max_tool_acceleration: Acceleration limit of `Diagnostics.reference` [m/s^2], or a pair
            [m/s^2, rad/s^2]; a single number implies 4 rad/s^2 per m/s^2; None: no limit.
        accept_high_adaptation: Accept an `Axis.adaptation` above 0.95 if the servos' stiffness is
            not known within 10 %, so that a gravity error can make the arm drift away.
        accept_high_stiffness: Law impedance: accept springs and dampers above the bounds from rate
            and delay, at which the arm may oscillate.
        tracking: Tracking of the target by the stiff axes.
        null_space: Motion of the joints that leaves the task unchanged.
        compensation: Shares of friction, damping and delay that are compensated.
        torque_limits: Joint torque limits sent to the servos.
        paper_options: Options for studies of the published law; not needed to run an arm.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: A field is unknown, or values are invalid or
            inconsistent.
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
        """Preset for the paper's figures: no gravity model, only the paper's limits, no soft axis.

        Budgets [N·m]: soft 0.5, firm = hold = 10, null space 2. In all presets, `axes` changes only
        the named axes, and a group such as `tracking` only the given fields.
        """

    @classmethod
    def soft(cls, axes: str, /, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Preset in which the named axes yield both ways: default strengths, `adaptation` 0.9."""

    @classmethod
    def firm(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Preset in which no axis yields."""

    @classmethod
    def door(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Preset for doors: y and yaw follow the handle (`adaptation` 0.999).

        The posture task is weak.
        """

    @classmethod
    def drawer(
        cls, *, axis: str = "x", pull: float | None = None, **overrides: Unpack[_SettingsFields]
    ) -> Settings:
        """Preset for drawers: pull and push along a base axis; other translations follow the slide.

        Args:
            axis: `"x"`, `"y"` or `"z"`.
            pull: Largest force along `axis` [N]; None: the default `Axis.firm` of the arm.
            **overrides: Further settings.
        """

    @classmethod
    def wipe(
        cls, *, press: float | None = None, axis: str = "z", **overrides: Unpack[_SettingsFields]
    ) -> Settings:
        """Preset for wiping: press on a surface with a constant force and tilt with it.

        Args:
            press: Force on the surface [N], if the target is far enough behind it; None: the
                default `Axis.soft` of the arm.
            axis: Normal of the surface, `"x"`, `"y"` or `"z"`.
            **overrides: Further settings.
        """

    @classmethod
    def hand_over(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Preset for handing over: firm near the target, soft once a hand pulls the object."""

    @classmethod
    def plug(
        cls, *, axis: str = "-z", push: float | None = None, **overrides: Unpack[_SettingsFields]
    ) -> Settings:
        """Preset for inserting a plug: limited force; soft across the hole and in rotation.

        Args:
            axis: Direction of insertion with its sign, `"-z"`, `"x"`, ...; pulling out may use all
                of `Axis.hold`.
            push: Largest force of insertion [N]; None: the default `Axis.firm` of the arm.
            **overrides: Further settings.
        """

    @classmethod
    def hand_guiding(cls, **overrides: Unpack[_SettingsFields]) -> Settings:
        """Preset for hand guiding: all axes yield (`adaptation` 0.95), with a weak posture task."""

    def raise_soft(
        self, model: Model, path: ArrayLike | None = None, *, servos: Servos | None = None
    ) -> Settings:
        """Return settings with `soft` of yielding axes raised to three times their static friction.

        At this strength, the tracking error of a sinusoid is below a tenth of its amplitude if
        friction is known within 30 % and the delay is one tick each way. A softer axis may not
        start or reverse. A larger `soft` is kept; `firm` and `hold` are raised to at least `soft`.

        Args:
            model: The arm.
            path: Postures (n,) or (N, n) [rad]; the largest friction in them is used. None: the
                median friction over the joint space.
            servos: Servo parameters; None: those of the model.

        Raises:
            ShapeError, OutOfRangeError, ConfigError: An argument is invalid.
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
    """Goals and limits of the servos for one tick; constant unless passed to a step as `out`.

    Args:
        goal: Goals of the position servos (n,) [rad].
        torque_limit: Largest torque of each servo in either direction (n,) [N·m].
        speed_limit: Speed for the servos' speed register (n,) [rad/s]; None: no limit.

    Raises:
        ShapeError, TypeError: An argument is invalid.
    """

    def __new__(
        cls, goal: ArrayLike, torque_limit: ArrayLike, speed_limit: ArrayLike | None = None
    ) -> Command: ...
    def __getnewargs__(self) -> tuple[_Array, _Array, _Array]: ...
    @property
    def goal(self) -> _Array:
        """Goals of the position servos (n,) [rad]."""

    @property
    def torque_limit(self) -> _Array:
        """Largest torque of each servo in either direction (n,) [N·m]."""

    @property
    def speed_limit(self) -> _Array:
        """Speed for the servos' speed register (n,) [rad/s].

        The largest speed at which this joint alone keeps the tool within `Settings.max_tool_speed`,
        but at least `Tracking.goal_slew`: a slower servo would lag behind its goals and exert an
        unintended force. inf if neither tool nor joint has a speed limit.
        """

@final
class BatchState:
    """State of many arms between batch steps; created by `Controller.batch_state`.

    Any controller of an arm with the same number of joints can continue from it. It can be copied,
    and pickled for the same version. Concurrent calls must not share it. `len` is the number of
    arms.

    Args:
        n: Number of joints of an arm.
        numbers: Contents, as in a pickle: 52 + 7 n numbers per arm.
    """

    def __new__(cls, n: int, numbers: ArrayLike) -> BatchState: ...
    def __len__(self) -> int: ...
    def __getnewargs__(self) -> tuple[int, _Array]: ...
    @property
    def n(self) -> int:
        """Number of joints of an arm."""

    def reset(self, indices: ArrayLike | slice | None = None, Q: ArrayLike | None = None) -> None:
        """Reset some arms, e.g. at the start of an episode.

        Args:
            indices: Arms, by NumPy indices: numbers, a mask (N,), a slice; None: all.
            Q: Initial positions (count, n), or (n,) for all [rad]; None: those of the next step.

        Raises:
            IndexError: An index is out of range.
            ShapeError, OutOfRangeError: `Q` is invalid; nothing has changed.
        """

@final
class JointStop:
    """First position limit that a joint meets when the arm is pushed along one axis."""

    @property
    def joint(self) -> str:
        """Name of the joint."""

    @property
    def distance(self) -> float:
        """Displacement of the axis at which the limit is met [m, rad].

        Beyond it, the stop supports part of a push, so the push can exceed the axis' force cap.
        """

    @property
    def margin(self) -> float:
        """Present distance of the joint from its limit [rad or m]."""

    @property
    def friction(self) -> float:
        """Friction of the other joints along the axis at the stop [N, N·m].

        inf if they cannot move the axis: the stop then supports all force above the cap.
        """

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class AxisReport:
    """Capabilities along one task axis.

    Forces in N, for rotations N·m; displacements in m or rad. Pairs are (pushed toward -, pushed
    toward +).
    """

    @property
    def name(self) -> _AxisName:
        """Name of the axis."""

    @property
    def static_force(self) -> tuple[float, float]:
        """Largest static push that the arm resists with the present torque limits [N, N·m].

        Negative if the arm cannot hold its own weight.
        """

    @property
    def capacity(self) -> tuple[float, float]:
        """Largest static push that the arm resists with the servos' full torque [N, N·m]."""

    @property
    def yields(self) -> tuple[bool, bool]:
        """True for sides that yield: pushed toward (-, +)."""

    @property
    def yield_force(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Static push at which the axis starts to yield, without joint friction [N, N·m].

        One pair per direction of the push (-, +): the force at the lower and at the upper deviation
        of `thresholds`, which are bounded here to 0.15 m or 0.4 rad.
        """

    @property
    def thresholds(self) -> tuple[float, float]:
        """Deviations between which the strength changes [m, rad]: d-/(1 - eta), d+/(1 - eta).

        d- is `Axis.soft_until`, d+ is `Axis.firm_from`, eta is `Axis.adaptation`.
        """

    @property
    def friction(self) -> float:
        """Dry friction along the axis [N, N·m], which a push from rest must also overcome."""

    @property
    def friction_left(self) -> float:
        """Friction along the axis in motion that the feed-forward does not compensate [N, N·m].

        The axis keeps moving only if its strength exceeds this friction.
        """

    @property
    def coupling(self) -> tuple[float, float]:
        """Strength that would remain if the strength of this axis were 0 [N, N·m].

        The other axes cause it, because they raise the torque limits of the same joints.
        """

    @property
    def coupled_to(self) -> tuple[_AxisName | None, _AxisName | None]:
        """Other axis that contributes most to `coupling`; None if there is none."""

    @property
    def hold(self) -> float:
        """Largest force against pushes to which the axis does not yield [N, N·m]."""

    @property
    def default_hold(self) -> float | None:
        """Default of `hold` before `soft` or `firm` raised it [N, N·m]; None if they did not."""

    @property
    def host_loss_force(self) -> tuple[float, float]:
        """Largest force on a hand that pushes along the axis if the host is lost now [N, N·m].

        Includes gear friction and damping. The push starts at the arm's equilibrium and moves 0.15
        m at 25 mm/s, or 0.4 rad at 0.067 rad/s. inf if the arm cannot be moved so far, because it
        is stretched out or at position limits.
        """

    @property
    def stop(self) -> tuple[JointStop | None, JointStop | None]:
        """First position limit that a push along the axis reaches; the other axes are fixed.

        None on a side on which no joint meets one within 0.15 m or 0.4 rad.
        """

    @property
    def path_friction(self) -> tuple[float, float]:
        """Largest joint friction along the axis during a push of 0.15 m or 0.4 rad [N, N·m].

        The push ends at the first stop. Many times `friction` if it passes a singular pose.
        """

    @property
    def path_sigma(self) -> tuple[float, float]:
        """Smallest singular value, as `PoseReport.sigma_min`, where `path_friction` occurs."""

    @property
    def path_distance(self) -> tuple[float, float]:
        """Displacement of the axis where `path_friction` occurs [m, rad]."""

    @property
    def deviation_limit(self) -> tuple[float, float]:
        """Deviation [m, rad] beyond which the target waits or follows the tool; inf: no limit."""

    @property
    def on_deviation_limit(self) -> Literal["yield", "wait"]:
        """Behaviour of the target beyond `deviation_limit`, as `Axis.on_deviation_limit`."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class PoseReport:
    """Capabilities of the arm in one pose under the present settings.

    Arrays have one row per joint. `str` returns a table and the sentences of `summary`.
    """

    @property
    def axes(self) -> dict[str, AxisReport]:
        """Capabilities along each task axis, in the order of the task."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def q(self) -> _Array:
        """Joint positions of the report (n,) [rad]."""

    @property
    def torque_limit(self) -> _Array:
        """Torque limits in this pose (n,) [N·m]."""

    @property
    def gravity_margin(self) -> _Array:
        """Torque limit minus and plus gravity torque (n, 2) [N·m]; negative: the joint sinks."""

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of the task Jacobian.

        Its rows of translations are divided by the arm's length.
        """

    @property
    def condition(self) -> float:
        """Condition number: largest singular value over the smallest."""

    @property
    def sigma_0(self) -> float:
        """Singular value below which the damping of the inverse kinematics grows."""

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """True for joints whose torque limit is at its ceiling (n,)."""

    @property
    def locked(self) -> NDArray[np.bool_]:
        """True for joints at a position limit, removed from the inverse kinematics (n,)."""

    @property
    def max_host_loss_force(self) -> float | None:
        """Bound on the `host_loss_force` of translations [N], from the settings; None: no bound."""

    @property
    def gain_factor(self) -> float:
        """Factor <= 1 on the gain K_x, required by the delay.

        Under law impedance, it is a factor on the stiffness, required by delay and pose.
        """

    @property
    def damping_factor(self) -> float:
        """Factor <= 1 on the damping of law impedance; 1 under other laws."""

    def summary(self) -> list[str]:
        """Return sentences: strength of each axis, problems, forces after a host loss."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Issue:
    """A requirement of the settings that the arm cannot meet in a pose, or a note."""

    @property
    def pose(self) -> int:
        """Index of the pose on the path in which the requirement is missed most."""

    @property
    def about(self) -> str:
        """Subject: an axis with its side, e.g. `+y`, a joint, the singular value or the target."""

    @property
    def required(self) -> bool:
        """True if the path is not achievable because of it; False for a note, e.g. on a default."""

    @property
    def reason(self) -> str:
        """Required and available value, as text."""

    @property
    def setting(self) -> str | None:
        """Setting to change, e.g. `axes.y.firm`; None if no setting helps."""

    @property
    def value(self) -> float | None:
        """Nearest value of `setting` that works; None if there is none."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class FeasibilityReport:
    """Result of a feasibility check; its truth value is `achievable`. `str` lists the issues."""

    @property
    def achievable(self) -> bool:
        """True if the arm can realize all values that the settings give explicitly."""

    @property
    def poses(self) -> int:
        """Number of poses checked."""

    @property
    def issues(self) -> tuple[Issue, ...]:
        """Requirements that are not met, and notes; those with `Issue.required` come first."""

    @property
    def axes(self) -> tuple[_AxisName, ...]:
        """Names of the task's axes."""

    @property
    def capacity(self) -> _Array:
        """Smallest `AxisReport.capacity` of the poses (k, 2), pushed toward (-, +) [N, N·m]."""

    @property
    def worst_pose(self) -> list[tuple[int, int]]:
        """Index of the pose with the smallest `capacity`: per axis, pushed toward (-, +)."""

    @property
    def friction_left(self) -> _Array:
        """Largest `AxisReport.friction_left` of the poses (k,) [N, N·m].

        A yielding axis with a smaller `Axis.soft` cannot keep moving.
        """

    @property
    def stop_distance(self) -> _Array:
        """Smallest `JointStop.distance` of the poses (k, 2) [m, rad], pushed toward (-, +).

        inf if no joint meets a limit within 0.15 m or 0.4 rad, and for sides that do not yield.
        """

    @property
    def sigma_min(self) -> float:
        """Smallest `PoseReport.sigma_min` of the poses; small near a singular pose."""

    @property
    def sigma_pose(self) -> int:
        """Index of the pose with the smallest singular value `sigma_min`."""

    @property
    def path_sigma(self) -> _Array:
        """Smallest `AxisReport.path_sigma` of the poses (k, 2); inf for sides that do not yield."""

    def __bool__(self) -> bool: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class Controller:
    """Compliant task-space controller: joint goals and torque limits from positions alone.

    Do not share it between threads: a concurrent call raises `RuntimeError`. Arrays per axis have
    one entry per task axis, in the order of the task. A controller can be copied, and pickled for
    the same version. The copy has the same state, payload, gravity and delay; an unpickled
    controller lacks the diagnostics of the last step.

    Args:
        model: The arm.
        settings: None: the defaults.
        servos: None: those of the model; law paper without gravity needs none.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: Settings, servos and model are inconsistent; the
            message names the setting to change.
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
        """Run one control step toward a pose of the tool.

        The first step resets the controller to `q`. Fastest with float64 arrays in C order; other
        array-likes give the same numbers. Allocates nothing if the caller keeps no results.

        Args:
            q: Measured joint positions (n,) [rad].
            target: Pose `base_from_tool`: (4, 4), `Pose`, or an object with a 4x4 accessor; for a
                task without rotations also (3,). The arm stretches toward a pose out of reach,
                which `check` reports. A distance from `Model.reach_origin` above 2 times
                `Model.reach` plus 0.1 m is an error.
            dt: Time since the last step [s], at most 1; None: 1 / settings.rate.
            dq: Joint velocity (n,) [rad/s] instead of the filtered one.
            twist: Velocity of the target (6,) [m/s, rad/s], base axes: the step aims at where the
                target will be after the delay. Law `paper` adds it to the task velocity instead.
            gradient: Gradient (n,) of an additional cost, which the null-space motion reduces.
            out: Command to overwrite, including arrays that are still referenced.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError: An input is invalid; the message
                names it. The controller has not changed.
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
        """Run one control step toward joint positions (n,); other arguments as in `step`.

        The tool pose of `q_target` is the target, and `q_target` is the rest posture.

        Raises:
            OutOfRangeError: As `step`, and for a target beyond a joint's limits by more than 0.2
                rad, or a tenth of its travel if prismatic; up to there, goals end at the limits.
        """

    def step_batch(
        self,
        Q: ArrayLike,
        targets: _PoseLike | ArrayLike,
        *,
        state: BatchState | None = None,
        dt: float | None = None,
        dq: ArrayLike | None = None,
        caps: ArrayLike | None = None,
        adaptation: ArrayLike | None = None,
        invalid: Literal["raise", "nan"] = "raise",
        out: Command | tuple[_Array, _Array, _Array] | None = None,
    ) -> Command:
        """Run one control step of N arms, on all cores and with the GIL released.

        With a state, each row is bit-identical to `step` of a separate controller. Without one,
        each row is the first step of a controller just reset to its q, with infinite `goal_slew`
        and `max_tool_speed`, bit for bit: goals may jump, so do not use it for a real arm. The
        state and diagnostics of this controller do not change. `RAYON_NUM_THREADS` sets the number
        of threads.

        Args:
            Q: Measured joint positions (N, n) [rad]; a C-ordered float64 array is not copied.
            targets: Poses (N, 4, 4), positions (N, 3) for a task without rotations, or one target
                of `step` for all arms.
            state: State from `batch_state(N)`; changed in place.
            dt: Time since the last step of all arms [s], at most 1; None: 1 / settings.rate.
            dq: Joint velocities (N, n) [rad/s] instead of the filtered ones.
            caps: Force caps (N, 6) of the axes `AXES` in each row [N, N·m; N·m under law `paper`],
                from 0 to the axis' `hold`; NaN for axes that do not yield. A row equals `step` with
                settings whose yielding axes have these values as `soft` and `firm`. None: the caps
                of the settings.
            adaptation: Adaptation eta (N, 6) of these axes in each row; NaN for axes that do not
                yield. None: that of the settings.
            invalid: Handling of rows with an invalid q, target, dq, cap or adaptation:
                ``"raise"``: an error names the first one before any arm is stepped; ``"nan"``:
                their command is NaN, their state does not change, and the others are stepped.
            out: Command of a batch, or arrays (N, n) for goals, torque limits and speed limits;
                saves up to a fifth of the time.

        Returns:
            Command with arrays (N, n); `out` if it is a command.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError, ValueError: An argument or a row is
                invalid; the message names it. `state` has not changed, `out` is undefined. Only a
                non-finite command is detected later, when other arms have already been stepped.
        """

    def batch_state(self, count: int) -> BatchState:
        """Return an initial state of `count` arms for `step_batch`.

        The first step of an arm resets it to its positions. A state has 8 (52 + 7 n) bytes per arm:
        0.81 GB for a million arms of seven joints. Raises `OutOfRangeError` if memory is too small.
        """

    def reset(self, q: ArrayLike) -> None:
        """Reset the state to an arm at rest at `q` (n,) [rad]: the goals start there.

        `q` becomes the rest posture unless the settings have one. A captured gravity offset stays.

        Raises:
            ShapeError, OutOfRangeError: `q` is invalid; nothing has changed.
        """

    def update(self, settings: Settings) -> None:
        """Replace the settings while running; the goals continue from their present values.

        If an axis would exert more force at its present deviation than before, e.g. because it
        becomes stiff, its reference restarts nearer to the tool, where the force is unchanged. From
        there it approaches the target at no more than `Settings.max_tool_speed`, as after a step of
        the target. With an infinite limit there is no reference, and the new force acts at once.

        Raises:
            ConfigError, OutOfRangeError, ShapeError: As the class; nothing has changed.
        """

    @property
    def payload(self) -> Payload | None:
        """Payload of `set_payload`, or else of the model."""

    def set_payload(self, mass: float, com: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Set the payload: mass [kg], 0 for none; centre of mass (3,) in the tool frame [m].

        Before the first step, the change is immediate. Later it takes half a second, so that a
        wrong or mistimed payload does not make the arm jump.

        Raises:
            OutOfRangeError: The payload is invalid. Or, if gravity is compensated: the servos
                cannot hold it in any sampled posture, or it needs more than twice their torque at
                the present goals.
            ShapeError: `com` has another shape.
        """

    def set_gravity(self, vector: ArrayLike) -> None:
        """Set the gravity vector (3,) [m/s^2] in base axes, for a base that tilts.

        Raises:
            OutOfRangeError, ShapeError: A component is beyond 100 m/s^2, or there are not three.
        """

    def set_delay(self, delay: float) -> None:
        """Set the measured delay [s]; may reduce the gain, see `Diagnostics.gain_factor`.

        Raises:
            OutOfRangeError: The delay is not within 0 to 0.5 s.
        """

    def capture_gravity(self, q: ArrayLike, goal: ArrayLike) -> _Array:
        """Measure the stiffness for the gravity offset while the goals hold the arm still.

        Set `Tracking.integrate` above 0 before, so that the arm has come to rest at its target.

        Args:
            q: Joint positions (n,) [rad].
            goal: Goals that hold the arm there (n,) [rad].

        Returns:
            Stiffness k_g (n,) [N·m/rad], used for the gravity offset from now on.

        Raises:
            ConfigError: There are no servo parameters.
            ShapeError, OutOfRangeError: `q` or `goal` is invalid.
        """

    def report(self, q: ArrayLike | None = None) -> PoseReport:
        """Report the forces per axis and side, the torque margins and the forces after a host loss.

        Args:
            q: Posture (n,) [rad], for an arm at rest at its target; None: pose and torque limits of
                the last step.

        Raises:
            ConfigError: `q` is None before the first step.
            ShapeError, OutOfRangeError: `q` is invalid.
        """

    def check(
        self, path_or_pose: _PoseLike | ArrayLike, *, q0: ArrayLike | None = None
    ) -> FeasibilityReport:
        """Check that the arm can realize these settings along a path or in a pose.

        Args:
            path_or_pose: One posture (n,) or a path (N, n) [rad]; or a pose `base_from_tool` as in
                `step`, as a matrix (4, 4) with the last row 0 0 0 1. For a task without rotations
                also a position (3,) [m]; for an arm of three joints, (3,) is read as a posture.
            q0: Joint positions (n,) [rad] at which the search for a pose starts; None: mid-range.

        Returns:
            Report with the issues and the settings to change; true if the path is achievable.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError: An input is invalid; the message
                names it.
        """

    @property
    def model(self) -> Model:
        """The arm."""

    @property
    def settings(self) -> Settings:
        """Present settings."""

    @property
    def servos(self) -> Servos | None:
        """Servos, one entry per joint; None without servos."""

    @property
    def axes(self) -> dict[_AxisName, Axis]:
        """Axes of the task, with all defaults that depend on law and arm filled in."""

    @property
    def diagnostics(self) -> Diagnostics:
        """Snapshot of intermediate values of the last step."""

    @property
    def simd_level(self) -> str:
        """Instruction set of the steps: ``"baseline"``, ``"avx2"`` or ``"avx512"``.

        The widest set of the processor, or the set named by the environment variable
        ``PLIANT_INSTRUCTIONS``. Results differ between sets by rounding, below 1e-11 of their size
        away from singular poses, and are bit-identical within a set.
        """

    @property
    def commands_made(self) -> int:
        """Number of commands allocated so far; stays at 3 in a loop that keeps none."""

@final
class Diagnostics:
    """Intermediate values of a controller's last step; created by `Controller.diagnostics`.

    A snapshot: later steps do not change it. k is the number of task axes.
    """

    @property
    def deviation(self) -> _Array:
        """Deviation of the actual pose from `reference` (k,) [m, rad]: reference - actual."""

    @property
    def adapted_deviation(self) -> _Array:
        """Adapted deviation (1 - eta w) e (k,) [m, rad], with `softness` w and `deviation` e."""

    @property
    def task_velocity(self) -> _Array:
        """Task velocity (k,) [m/s, rad/s]: K_x `adapted_deviation`, within its limits.

        Under law `paper` with `twist` added.
        """

    @property
    def softness(self) -> _Array:
        """Softness w (k,): 1 for an axis that yields to its present push, 0 for a stiff one."""

    @property
    def compliance(self) -> _Array:
        """Compliance c (k,), eq. (8) of the paper: 1 at a small deviation, 0 at a large one."""

    @property
    def axis_strength(self) -> _Array:
        """Strength (k,): the force cap [N, N·m]; under law paper tau^x of eq. (9) [N·m]."""

    @property
    def wrench(self) -> _Array:
        """Wrench that the arm exerts under the law (k,) [N, N·m]; 0 under law paper."""

    @property
    def activation(self) -> _Array:
        """Activation matrix A (n, k + 1), eq. (10) of the paper, the null-space column last."""

    @property
    def responsibility(self) -> _Array:
        """Responsibility R (n, k + 1), eqs. (6), (7) of the paper, the null-space column last."""

    @property
    def task_jacobian(self) -> _Array:
        """Task Jacobian (k, n) in the task frame; columns of locked joints are zero."""

    @property
    def singular_values(self) -> _Array:
        """Singular values of the task Jacobian, largest first.

        Its rows of translations are divided by the arm's length.
        """

    @property
    def q_predicted(self) -> _Array:
        """Predicted positions at the arrival of the goal (n,) [rad]."""

    @property
    def velocity(self) -> _Array:
        """Filtered joint velocity (n,) [rad/s]."""

    @property
    def gravity(self) -> _Array:
        """Torques that hold the arm at rest at `q_predicted` (n,) [N·m]."""

    @property
    def feed_forward(self) -> _Array:
        """Feed-forward of friction and damping (n,) [N·m]."""

    @property
    def gradient(self) -> _Array:
        """Gradient of the null-space cost (n,)."""

    @property
    def sigma_min(self) -> float:
        """Smallest of `singular_values`; computed on request if the step does not use it."""

    @property
    def sigma_max(self) -> float:
        """Largest of `singular_values`; computed on request if the step does not use it."""

    @property
    def damping(self) -> float:
        """Damping lambda of the inverse kinematics in this step."""

    @property
    def damping_constants(self) -> tuple[float, float, float]:
        """Constants (lambda_0, sigma_0, lambda_max) of the damping, see `Tracking.damping`."""

    @property
    def gain_factor(self) -> float:
        """Factor <= 1 on the gain K_x, required by the delay.

        Under law impedance, it is a factor on the stiffness, required by delay and pose.
        """

    @property
    def gamma(self) -> float:
        """Factor on feed-forward and prediction, 0.5 to 1; smaller near singular poses."""

    @property
    def factors(self) -> tuple[float, float, float]:
        """Scale factors (0 to 1) of the null-space, soft and stiff parts of the motion.

        They keep the motion within the torque and speed limits.
        """

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """True for joints whose torque limit is at its ceiling (n,)."""

    @property
    def deviation_limited(self) -> NDArray[np.bool_]:
        """True for task axes at their `deviation_limit` (k,)."""

    @property
    def reference(self) -> _Array:
        """Pose that the arm tracks, `base_from_tool` (4, 4): the target within its limits.

        The limits are those on tool speed, acceleration and deviation.
        """

    @property
    def locked(self) -> NDArray[np.bool_]:
        """True for joints at a position limit, removed from the inverse kinematics (n,)."""

@final
class WrenchEstimate:
    """Estimated external wrench at the tool, and its uncertainty.

    Forces [N] and torques [N·m] that the surroundings exert at the tool point: a push toward + is
    positive. `str` returns one line.
    """

    @property
    def force(self) -> _Array:
        """Force and torque (6,) [N, N·m] along the axes of the task frame; 0 if not estimated."""

    @property
    def uncertainty(self) -> _Array:
        """Bound (6,) [N, N·m] on the error of `force`, if the options hold; inf: unknown."""

    @property
    def force_base(self) -> _Array:
        """Force and torque (6,) along base axes [N, N·m]."""

    @property
    def uncertainty_base(self) -> _Array:
        """Bound (6,) on the error of `force_base` [N, N·m]; inf: unknown."""

    @property
    def torque_residual(self) -> _Array:
        """Torque that the surroundings exert on each joint (n,) [N·m], low-passed."""

    @property
    def torque_uncertainty(self) -> _Array:
        """Bound (n,) [N·m] on the error of `torque_residual`, without `payload_error`."""

    @property
    def residual_ratio(self) -> float:
        """Largest |residual| / uncertainty of the joints; above 1 something pushes on the arm."""

    @property
    def torque(self) -> _Array:
        """Torque of each servo (n,) [N·m], computed from lead and limit or measured."""

    @property
    def velocity(self) -> _Array:
        """Joint velocity that the estimate used (n,) [rad/s]."""

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """True for joints whose servo is at its torque limit (n,)."""

    @property
    def touch(self) -> NDArray[np.bool_]:
        """True for axes with a touch event (6,)."""

    @property
    def stop(self) -> NDArray[np.bool_]:
        """True for axes with a stop event (6,)."""

    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...

@final
class ContactEstimator:
    """Estimates the external wrench at the tool from joint positions and commands.

    The external joint torques r are the residual of the torque balance, with gravity g, mass matrix
    M, friction t_f that saturates at the speed v0, damping d and the torque of the servos:
    `J' F = r = g + M q'' + t_f tanh(v / v0) + d v - clip(k_p (goal - q) - k_v v, +-limit)`. With an
    error bound u_i on each r_i, the estimate is `F = G r` with `G = (J W J' + P)^-1 J W`,
    `W = diag(1/u^2)`, `P = diag(1/max_wrench^2)`, and its bound `|G| u + |G J' - I| max_wrench`: a
    direction that no joint senses has the uncertainty `max_wrench`.

    Call `update` once per tick, before the controller's `step`. Errors are relative: 0.3 is 30 %.

    Args:
        controller: Controller that supplies model, payload, gravity, delay, task frame and
            commands.
        axes: Axes of the task frame to estimate; the wrench along the others is assumed zero. None:
            all six with six joints or more, else those of the task.
        filter: Time constant of the low-pass [s]; 0: no filter.
        friction_error: Error of friction and damping; at rest, dry friction counts as unknown.
        kp_error: Error of k_p and torque limits; None: 0.1 if `stiffness_known`, else 0.25.
        gravity_error: Error of the gravity torques.
        payload_error: Possible unknown mass at the tool [kg].
        inertia_error: Error of the acceleration torques, computed with point masses.
        load_error: Error of a measured load or current.
        torque_constant: Torque per current (n,) [N·m/A]; required if a current is given.
        max_wrench: Largest plausible force [N] and torque [N·m].
        touch, stop: Thresholds [N, N·m] of these events by axis key, e.g. `{"xyz": 8.0}`. A
            threshold is raised to `guard` times the present uncertainty.
        hysteresis: Share of the threshold by which a force must fall below it to end an event.
        min_time: Minimum time beyond a threshold before an event begins or ends [s].
        guard: Lower bound on thresholds as a share of the uncertainty. At 1 each event proves a
            contact; 0.6 gave no false alarm in an hour (docs/contact.md).
        accept_thresholds: Accept thresholds below the uncertainty, without `guard`.

    Raises:
        OutOfRangeError: An option is out of range; or a threshold is below the uncertainty of the
            arm at rest in a typical pose, which the message gives.
        ConfigError, ShapeError: No servos, unknown axes, or constants of another length.
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
        max_wrench: tuple[float, float] = (100.0, 20.0),
        touch: Mapping[str, float] | None = None,
        stop: Mapping[str, float] | None = None,
        hysteresis: float = 0.3,
        min_time: float = 0.02,
        guard: float = 1.0,
        accept_thresholds: bool = False,
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
        """Process one reading, before the controller's step of the same tick.

        Without `load` or `current`, the force is 0 and the uncertainty inf until the command that
        was in force at the time of the reading is known.

        Args:
            q: Measured joint positions (n,) [rad].
            dt: Time since the last reading [s], at most 1; None: 1 / rate of the controller's
                settings.
            dq: Joint velocity (n,) [rad/s] instead of the filtered one.
            load: Torques reported by the servos (n,) [N·m], instead of lead and limit.
            current: Motor currents (n,) [A]; requires `torque_constant`.
            sent: Goals (n,) [rad] and torque limits (n,) [N·m] sent last; None: the controller's.

        Raises:
            ShapeError, OutOfRangeError, ConfigError: An input is invalid; nothing has changed.
        """

    def update_series(
        self,
        Q: ArrayLike,
        *,
        dt: float | None = None,
        dq: ArrayLike | None = None,
        load: ArrayLike | None = None,
        current: ArrayLike | None = None,
        sent: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> WrenchEstimate:
        """Process several readings at equal intervals; return the estimate of the last one.

        Gives the numbers of one `update` per reading, in less time: without `touch` and `stop`, the
        wrench is computed for the last reading only.

        Args:
            Q: Measured joint positions (T, n) [rad].
            dt: Time between readings [s], as for `update`.
            dq: Joint velocities (T, n) [rad/s], as for `update`.
            load: Torques reported by the servos (T, n) [N·m], as for `update`.
            current: Motor currents (T, n) [A], as for `update`.
            sent: Goals and limits (T, n) sent last before each reading; None: the controller's last
                command, at all readings.

        Raises:
            ShapeError, OutOfRangeError, ConfigError: An input is invalid; the estimate has not
                changed, the stored commands are cleared.
        """

    def uncertainty_at(self, q: ArrayLike) -> _Array:
        """Compute the error bound (6,) [N, N·m] for the arm at rest at `q` (n,) [rad].

        Raises:
            ShapeError, OutOfRangeError: `q` is invalid.
        """

    def typical_uncertainty(self) -> _Array:
        """Compute the median of `uncertainty_at` over 64 postures (6,) [N, N·m]; takes 1 ms."""

    def reset(self) -> None:
        """Clear velocity, filters, stored commands and events; keep the tare."""

    def tare(self) -> None:
        """Define the present force as zero; later estimates are relative to it.

        Errors of k_p, gravity and payload then count relative to this state, plus the dry friction
        that the tare may contain.

        Raises:
            ConfigError: There is no estimate yet.
        """

    def clear_tare(self) -> None:
        """Remove the tare: later estimates are absolute again."""

    @property
    def tared(self) -> bool:
        """True while a tare is set."""

    @property
    def estimate(self) -> WrenchEstimate:
        """Estimate of the last `update`."""

    @property
    def guard(self) -> float:
        """Lower bound on thresholds as a share of the uncertainty; 0 with `accept_thresholds`."""

    @property
    def latency(self) -> float:
        """Time from a contact to its event [s]: controller's delay + low-pass + `min_time`."""

    @property
    def axes(self) -> tuple[_AxisName, ...]:
        """Names of the estimated axes."""

    @property
    def controller(self) -> Controller:
        """Controller that supplies model, payload, delay, task frame and commands."""

def update_contacts(
    contacts: Sequence[ContactEstimator | None],
    Q: _Array,
    *,
    dt: float,
    sent: tuple[_Array, _Array],
    out: tuple[_Array, _Array, _Array],
) -> None:
    """Process several readings of several arms, each as `ContactEstimator.update_series` does.

    Runs without the interpreter lock.

    Args:
        contacts: Estimators of the arms (N,); the rows of None are skipped.
        Q: Measured joint positions (N, T, n) [rad].
        dt: Time between readings [s].
        sent: Goals [rad] and torque limits [N·m] (N, T, n) sent last before each reading.
        out: Arrays for velocity (N, n), force (N, 6) and uncertainty (N, 6) of the last estimates.

    Raises:
        ShapeError, OutOfRangeError: An input is invalid; estimators before the invalid row have
            changed.
        ValueError, RuntimeError: Arrays share memory, or an estimator is in use by another call or
            listed twice; nothing has changed.
    """

def damped_pseudo_inverse(J: ArrayLike, damping: float) -> _Array:
    """Compute the damped pseudo-inverse J^T (J J^T + lambda^2 I)^-1, shape (n, k).

    Equation (3) of the paper.

    Args:
        J: Jacobian (k, n), at most six rows and sixteen columns.
        damping: lambda, not squared; 0: the Moore-Penrose inverse, also of rank-deficient matrices.

    Raises:
        ShapeError, OutOfRangeError: J is too large, an entry is not finite, or lambda < 0.
    """

def null_space_projector(
    J: ArrayLike, damping: float = 0.0, kind: Literal["exact", "paper"] = "exact"
) -> _Array:
    """Compute the null-space projector (n, n) of J.

    Args:
        J: Jacobian (k, n).
        damping: lambda of J+, for `kind="paper"` only.
        kind: `"exact"`: the orthogonal projector, faded close to singular J; `"paper"`: I - J+ J.

    Raises:
        ShapeError, OutOfRangeError: As `damped_pseudo_inverse`.
        ConfigError: `kind` is unknown.
    """

def responsibility(
    J_pinv: ArrayLike, dx: ArrayLike, N: ArrayLike, gradient: ArrayLike, alpha: float
) -> _Array:
    """Compute the responsibility R (n, k + 1): |J+ diag(dx)|, then |alpha N gradient|.

    Equations (6), (7) of the paper.

    Args:
        J_pinv: Pseudo-inverse (n, k).
        dx: Task velocity (k,) [m/s, rad/s].
        N: Null-space projector (n, n).
        gradient: Gradient of the null-space cost (n,).
        alpha: Gain of the null-space motion [1/s].

    Raises:
        ShapeError, OutOfRangeError: Sizes are inconsistent, or an entry is not finite.
    """

def activation(J_pinv: ArrayLike, N: ArrayLike, gradient: ArrayLike | None = None) -> _Array:
    """Compute the activation matrix A (n, k + 1): columns of |J+| over their sums, null space last.

    Equation (10) of the paper.

    Args:
        J_pinv: Pseudo-inverse (n, k).
        N: Null-space projector (n, n).
        gradient: Gradient of the null-space cost (n,); without it, or if N gradient is zero, the
            last column has the row norms of N.

    Raises:
        ShapeError, OutOfRangeError: Sizes are inconsistent, or an entry is not finite.
    """

def check_path(
    model: Model,
    settings: Settings,
    path_or_pose: _PoseLike | ArrayLike,
    *,
    servos: Servos | None = None,
    q0: ArrayLike | None = None,
) -> FeasibilityReport:
    """Check that an arm can realize the settings along a path or in a pose.

    Equivalent to `Controller(model, settings, servos).check(path_or_pose, q0=q0)`.

    Args:
        model: The arm.
        settings: Settings to check.
        path_or_pose: One posture (n,) or a path (N, n) [rad]; or a pose `base_from_tool`, as a
            (4, 4) matrix with last row 0 0 0 1 or another form that `as_pose` accepts. For a task
            without rotations also a position (3,) [m]; for an arm of three joints, (3,) is read as
            a posture.
        servos: Servos of the joints; None: those of the model.
        q0: Joint positions (n,) [rad] at which the search for a pose starts; None: mid-range.

    Returns:
        Report with the issues and the settings to change; true if the path is achievable. A pose
            out of reach is an issue, not an error.

    Raises:
        ConfigError, OutOfRangeError, ShapeError: Settings, servos and model are inconsistent, or a
            path or pose is invalid; the message names it.
        TypeError: An argument has the wrong type.
    """

@overload
def compliance(deviation: float, soft_until: float, firm_from: float) -> float:
    """Compute the compliance: 1 for |deviation| <= `soft_until`, 0 from `firm_from` on.

    Linear between; equation (8) of the paper.

    Args:
        deviation: Deviation (k,) [m or rad], or a number.
        soft_until: Deviation below which compliance is 1 (k,), or one for all.
        firm_from: Deviation above which compliance is 0 (k,), or one for all.

    Returns:
        Compliance (k,), 0 to 1; a number if `deviation` is one.

    Raises:
        ShapeError, OutOfRangeError: Lengths differ, or not 0 <= soft_until < firm_from.
    """

@overload
def compliance(deviation: ArrayLike, soft_until: ArrayLike, firm_from: ArrayLike) -> _Array: ...
@overload
def holding_torque(c: float, soft: float, firm: float, hold: float, compliant: bool) -> float:
    """Compute the holding torque: c soft + (1 - c) firm if compliant, else hold.

    Equation (9) of the paper.

    Args:
        c: Compliance (k,), 0 to 1, or a number.
        soft: Strength at compliance 1 (k,), or one for all.
        firm: Strength at compliance 0 (k,), or one for all.
        hold: Strength of axes that are not compliant (k,), or one for all.
        compliant: True for compliant axes (k,), or one for all.

    Returns:
        Holding torques (k,) [N·m]; a number if `c` is one.

    Raises:
        ShapeError, OutOfRangeError: Lengths differ, c is outside [0, 1], or a value is not finite.
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
    """Compute the joint torque limits A strength (n,) [N·m]; equation (11) of the paper.

    Args:
        A: Activation matrix (n, k + 1).
        strength: Holding torques (k + 1,) [N·m], the null space last.

    Raises:
        ShapeError, OutOfRangeError: Sizes are inconsistent, or an entry is not finite.
    """

def adapt_target(
    actual: _PoseLike,
    target: _PoseLike,
    eta: float,
    compliant: str | bool | Sequence[bool] | NDArray[np.bool_],
) -> _Array:
    """Compute the intermediate target as a pose (4, 4); equation (12) of the paper.

    It is target + eta (actual - target) on the compliant axes, target on the others, in base axes.
    For rotations, eta scales the components of the rotation vector.

    Args:
        actual: Actual pose of the tool.
        target: Target pose of the tool.
        eta: Adaptation, 0 to 1.
        compliant: Axis key such as ``"y yaw"``, or six flags.

    Raises:
        ShapeError, OutOfRangeError, ConfigError, TypeError: An argument is invalid.
    """

def pose_error(actual: _PoseLike, target: _PoseLike) -> _Array:
    """Compute target - actual (6,) in base axes: translation [m], then rotation vector [rad].

    Raises the exceptions of `as_pose`.
    """

@final
class ArmPoints:
    """Motion of m points of an arm: the origins of the joints from base to tip, and the tool.

    Joints off the chain are locked at the model's values. The payload is a point mass.

    Args:
        model: The arm.
        armature: Inertia of the servos' rotors at the joints (n,) [kg m^2]; None: 0.
    """

    def __new__(cls, model: Model, armature: ArrayLike | None = None) -> ArmPoints: ...
    def position(self, q: ArrayLike) -> _Array:
        """Return the positions (m, 3) [m] at q (n,) [rad], base axes."""

    def velocity(self, q: ArrayLike, dq: ArrayLike) -> _Array:
        """Return the velocities (m, 3) [m/s] for joint velocities dq (n,) [rad/s], base axes."""

    def inertia(self, q: ArrayLike) -> _Array:
        """Return the joint-space inertia matrix (n, n) [kg m^2], including the rotors."""

    def effective_mass(self, q: ArrayLike, dq: ArrayLike) -> _Array:
        """Return the mass (m,) [kg] of each point along its velocity; 0 for a point at rest.

        ``1 / (d' J M^-1 J' d)`` with d the direction of the velocity (Khatib 1995).
        """

@final
class Lowering:
    """Controlled descent of an arm from its present pose until the torque limits are zero.

    Goals start at their present values and move toward the joints, in proportion to the measured
    lead goal - q, so the arm descends without an exact stiffness or payload. Phases:

    - `rest`: first reduce each lead that is larger than its torque limit allows until its joint
      begins to sink; then move toward the rest pose, if there is one;
    - `down`: descend until no joint holds a load;
    - `ramp`: reduce the torque limits to zero, and wait until the arm stands still.

    If positions no longer arrive, positions computed with the model replace them. See
    `docs/lifecycle.md` for the equations.

    Args:
        model: The arm; its `gravity` gives the downward direction of each joint.
        servos: Its servo parameters, n entries.
        q: Last valid joint positions (n,) [rad].
        goal: Last goals sent (n,) [rad]; None: q plus gravity torque divided by k_p.
        limit: Last torque limits sent (n,) [N·m], clamped to the usable torque; None: 1.1 times
            the gravity torque plus `torque_margin`.
        rest: Rest pose (n,) [rad]; None: do not move to a rest pose first.
        speed: Largest speed of any point of the arm [m/s].

    Raises:
        ShapeError: A vector does not have n entries.
        OutOfRangeError: A number is not finite, or `speed` is not above 0.
        ConfigError: The servos do not fit the model.
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
        """True if positions have been missing for so long that modelled ones replace them."""

    def skip_rest(self) -> None:
        """End the motion toward the rest pose: the arm descends from where it is."""

    def take_over(
        self,
        joints: Sequence[bool] | NDArray[np.bool_],
        q: ArrayLike,
        goal: ArrayLike,
        limit: ArrayLike,
    ) -> None:
        """Take over joints whose servos had not answered before; begin the present phase again.

        The other joints keep their goals and limits. If limits were falling, the descent goes back
        to the phase `down`.

        Args:
            joints: Mask of the joints (n,).
            q: Positions (n,) [rad]; like those of `goal` and `limit`, entries of other joints are
                ignored, but must be finite.
            goal: Goals in the servos (n,) [rad].
            limit: Torque limits in the servos (n,) [N·m], clamped to the usable torque.

        Raises:
            ShapeError: A vector does not have n entries; nothing has changed.
            OutOfRangeError: A number is not finite; nothing has changed.
        """

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
            limits are finite for joints whose goals were computed while `blind`, until they have a
            position again, so that a joint that missed packets does not jump to a later goal.

        Raises:
            ShapeError: `q` or `ok` does not have n entries; nothing has changed.
        """

if sys.platform != "win32":
    @final
    class SerialPort:
        """Open serial port with servos of Protocol 1.0.

        Requests release the interpreter lock. Threads may use a port at the same time: each request
        waits for the end of the previous one.

        Args:
            descriptor: File descriptor of the port; its owner closes it after `close`.
        """

        def __new__(cls, descriptor: int) -> SerialPort: ...
        @property
        def closed(self) -> bool:
            """True after `close`."""

        def close(self) -> None:
            """Wait until no request uses the port; later ones raise `OSError`."""

        def exchange(
            self,
            instruction: int,
            ids: Sequence[int],
            block: tuple[int, int],
            data: list[bytes] | None,
            timeout: float,
        ) -> list[tuple[bytes, int]] | bytes:
            """Send a request and return the replies.

            Bytes received before a request with replies are discarded.

            Args:
                instruction: Read (2), sync read (130) or sync write (131).
                ids: Ids of the servos, in the order in which they reply.
                block: Address of the first register, and number of bytes.
                data: Bytes to write to each servo, which then do not reply; None: read.
                timeout: Longest silence before the replies and within them [s].

            Returns:
                Pairs of data and status byte, one per servo; or the bytes received so far, if a
                servo has not sent a valid packet of the expected size.

            Raises:
                OSError: The port has vanished, or is closed.
                ValueError: The request is longer than the protocol allows, or data do not have the
                    size of the block.
            """

    @final
    class ServoGroup:
        """Servos on one port whose registers a single request of Protocol 1.0 reads or writes.

        Args:
            port: The port.
            codec: Codec of the servos.
            servos: Their indices in the codec.
            ids: Their ids on the bus.
        """

        def __new__(
            cls, port: SerialPort, codec: ServoCodec, servos: Sequence[int], ids: Sequence[int]
        ) -> ServoGroup: ...
        def read(
            self, block: tuple[int, int], timeout: float, time: float, longest: float, usual: bool
        ) -> (
            JointReadings
            | tuple[list[tuple[bytes, int]] | bytes, list[tuple[int, bool | None]]]
            | None
        ):
            """Make a sync read, and store the readings.

            Args:
                block: Address and size of the registers.
                timeout: Longest silence [s].
                time: Time of the request [s].
                longest: Age of the previous reading above which a new one is not stored [s].
                usual: True: return readings instead of bytes if no reading needs attention (see
                    `ServoCodec.decode`) and `ServoCodec.has_command` is True for all servos.

            Returns:
                The results of `SerialPort.exchange` and `ServoCodec.decode`. Nothing is stored
                unless all replies are valid. Instead of bytes, see `usual`: the readings of all
                joints, or None if the codec has further servos.

            Raises:
                OSError: The port has vanished, or is closed.
            """

        def write(
            self,
            blocks: Sequence[tuple[int, int]],
            timeout: float,
            goal: ArrayLike,
            limit: ArrayLike,
            velocity: ArrayLike | None,
            max_speed: float,
        ) -> None:
            """Encode a command, make a sync write per block, and record the command.

            Args:
                blocks: Address and size of each packet.
                timeout: Longest time in which the port takes no bytes [s].
                goal: See `ServoCodec.encode`, as for limit, velocity and max_speed.
                limit: Torque limits (n,) [N·m].
                velocity: Largest speeds (n,) [rad/s].
                max_speed: Upper bound of the speeds [rad/s].

            Raises:
                ShapeError, OutOfRangeError: See `ServoCodec.encode`; nothing was sent.
                ValueError: A block has another size than the packet; nothing is recorded.
                TimeoutError, OSError: The port takes no bytes, has vanished or is closed; nothing
                    is recorded.
            """

@final
class State:
    """State of an arm in one control cycle; the n joints are those of the chain, base to tip.

    `dq`, `load` and `current` are None if the servos do not report them.

    Args:
        q: Joint positions (n,) [rad]; a joint without a new reading keeps its last position.
        dq: Joint velocities as the servos report them (n,) [rad/s].
        time: Sample time of the oldest of the positions, on the arm's clock [s].
        fresh: True if the positions of all joints were read in this cycle.
        extra: Positions by name of the joints outside the chain, such as a gripper [rad]; None:
            there are none.
        age: Time since each position was sampled (n,) [s]; None: 0.
        load: Torque as each servo estimates it (n,) [N·m].
        current: Current of each servo (n,) [A].
        voltage: Supply voltage at each servo (n,) [V]; NaN before the first reading.
        temperature: Temperature of each servo (n,) [deg C]; NaN before the first reading.
        faults: Present faults, one sentence each; empty if healthy.
    """

    def __new__(
        cls,
        q: _Array,
        dq: _Array | None = None,
        time: float = 0.0,
        fresh: bool = True,
        extra: Mapping[str, float] | None = None,
        age: _Array | None = None,
        load: _Array | None = None,
        current: _Array | None = None,
        voltage: _Array | None = None,
        temperature: _Array | None = None,
        faults: tuple[str, ...] | None = None,
    ) -> State: ...
    @property
    def q(self) -> _Array: ...
    @property
    def dq(self) -> _Array | None: ...
    @property
    def time(self) -> float: ...
    @property
    def fresh(self) -> bool: ...
    @property
    def extra(self) -> Mapping[str, float]: ...
    @property
    def age(self) -> _Array: ...
    @property
    def load(self) -> _Array | None: ...
    @property
    def current(self) -> _Array | None: ...
    @property
    def voltage(self) -> _Array | None: ...
    @property
    def temperature(self) -> _Array | None: ...
    @property
    def faults(self) -> tuple[str, ...]:
        """Present faults, one sentence each; empty if healthy."""

    def replace(self, **changes: Any) -> State:
        """Return a state with these attributes changed."""

@final
class JointReadings:
    """One reading of all N joints of a drive, in the order of `Drive.names`.

    In `velocity`, `load` and `current`, NaN marks a servo that does not report the value.

    Args:
        position: Positions (N,) [rad]; undefined where `ok` is False.
        ok: Mask (N,) of the positions that were read in this cycle.
        time: Sample times on the drive's clock [s]: (N,), or one number for all.
        velocity: Velocities as the servos report them (N,) [rad/s]; None: not reported.
        load: Torques that the servos estimate from PWM duty or current (N,) [N·m]; None: not
            reported.
        current: Motor currents (N,) [A]; None: not reported.
    """

    def __new__(
        cls,
        position: _Array,
        ok: NDArray[np.bool_],
        time: _Array | float,
        velocity: _Array | None = None,
        load: _Array | None = None,
        current: _Array | None = None,
    ) -> JointReadings: ...
    @property
    def position(self) -> _Array: ...
    @property
    def ok(self) -> NDArray[np.bool_]: ...
    @property
    def time(self) -> _Array | float: ...
    @property
    def velocity(self) -> _Array | None: ...
    @property
    def load(self) -> _Array | None: ...
    @property
    def current(self) -> _Array | None:
        """Motor currents (N,) [A]; None: not reported."""

    def replace(self, **changes: Any) -> JointReadings:
        """Return a reading with these attributes changed."""

#: Ratio of the torque limit to the gravity torque of an arm that is held without a controller.
SUPPORT: Final[float]

def torque_margin(servos: Servos, gravity: ArrayLike) -> _Array:
    """Return the margin (n,) [N·m] of torque limits that hold an arm with `gravity` (n,) [N·m].

    It is the largest of 10 % of the usable torque, twice the friction and 30 % of the gravity
    torque.
    """

@final
class HandGuidingLaw:
    """Goals that follow an arm guided by hand, so that it feels weightless.

    Before, the caller moves the joints slowly up and down (the swing), which measures the friction
    and the lead that holds the arm against gravity. `pliant.HandGuiding` runs swing and law.

    Args:
        model: The arm.
        servos: Assumed servo parameters, n entries.
        q: Positions at the end of the swing (n,) [rad].
        goal: Goals at the end of the swing (n,) [rad].
        swung: True for joints that moved in the swing (n,).
        lead: Mean of the leads goal - q in the motions up and down (n,) [rad].
        friction: Half the difference of these leads (n,) [rad].
        damping: Sum of viscous damping, derivative gain and back-EMF (n,) [N·m s/rad].
        stiffness_error: Factor by which k_p may be wrong in either direction, at least 1.
        delay: Time from the reading to the arrival of the goal [s], at most 0.5.
        torque_share: Torque limit beyond what gravity requires, as a share of the usable torque.
        payload_moments: Mass [kg] and mass times centre of mass in the tool frame [kg m] (4,) of a
            payload in addition to that of the model.
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
        """Lower and upper bounds on k_p (2, n) [N·m/rad], narrowed whenever the arm rests."""

    @property
    def play(self) -> _Array:
        """Present distance that a joint can move before its goal follows (n,) [rad]."""

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
class JointFollower:
    """Follows joint targets of a leader arm or a policy, with the force at the tool bounded.

    Unlike with `Controller.step_joints`, every joint follows its own target, also near a singular
    pose; only the torque limits make the arm soft. They allow for the weight and `max_force`. The
    goal of a blocked joint stays near it, so a released arm returns at the speed limits. Per joint,
    with the reference r and its speed v, gravity g, friction rho, v0 = 0.1 rad/s, damping d with
    back-EMF and the bounds F_a on the force along base axes (f, limit: at most the usable torque):
    `f = max_a F_a max(|J_a|, 0.1 m |J_wa|) + rho`, `r = clip(r moved to q_target, q -+ f / k_p)`,
    `goal = r + (g + 0.8 d v + 0.8 rho tanh(v / v0)) / k_p`, `limit = |g| + f + 0.8 |d v|`.

    Args:
        model: The arm.
        servos: Assumed servo parameters; None: those of the model.
        max_force: Largest force at the tool along x, y, z of the base [N], without gear friction: a
            number, or one per axis. Each joint may exert the torque of the axis that loads it most,
            so the force along other axes may exceed theirs; one inf lifts all bounds.
        max_tool_speed: Speed limit of the tool [m/s]; inf for none.
        max_joint_speed: Speed limit of each joint [rad/s]; inf for none.

    Raises:
        ConfigError: There are no servo parameters.
        OutOfRangeError, ShapeError: An argument is invalid.

    Example:
        >>> follower = pliant.teleop.JointFollower(arm.model, arm.servos, max_force=4.0)
        >>> for tick in pliant.Loop(arm, follower, rate=100.0):
        ...     tick.step(leader.read().q)
    """

    def __new__(
        cls,
        model: Model,
        servos: Servos | None = None,
        *,
        max_force: ArrayLike,
        max_tool_speed: float = 0.6,
        max_joint_speed: float = 4.0,
    ) -> JointFollower: ...
    @property
    def max_force(self) -> _Array:
        """Largest force along x, y, z of the base (3,) [N]; can be set while running."""

    @max_force.setter
    def max_force(self, value: ArrayLike) -> None: ...
    def reset(self, q: ArrayLike) -> None:
        """Restart at rest at joint positions q (n,) [rad].

        Raises:
            ShapeError, OutOfRangeError: `q` does not have n finite entries.
        """

    def step(self, q: ArrayLike, q_target: ArrayLike, *, dt: float) -> Command:
        """Return goals and torque limits for measured positions and targets (n,) [rad] after dt.

        Targets are clipped to the position limits. The first step starts from `q`.

        Raises:
            ShapeError: A vector does not have n entries. OutOfRangeError: A number is not finite,
                or `dt` is not above 0 [s]. Nothing has changed.
        """

@final
class PositionFilter:
    """Filter that rejects implausible positions of N joints.

    A position is accepted if it was read in this cycle, is finite, and lies within
    ``2 v_max dt + 0.2 rad`` of the joint's last accepted position. v_max is the largest speed of
    the joint [rad/s], dt the time since that position [s]. After an implausible position, only gaps
    of more than 0.1 s between readings count as part of dt: a lasting jump of an encoder thus stays
    rejected. The first position of a joint is always accepted. The filter also catches late replies
    of earlier cycles if the position has changed much since then; some servo protocols have no
    sequence numbers to detect such replies.

    Args:
        max_speed: Largest speeds of the joints (N,) [rad/s].

    Raises:
        OutOfRangeError: A speed is negative or not finite.
    """

    def __new__(cls, max_speed: ArrayLike) -> PositionFilter: ...
    @property
    def position(self) -> _Array:
        """Last accepted positions (N,) [rad]; NaN before the first."""

    @property
    def time(self) -> _Array:
        """Sample times of the last accepted positions (N,) [s]; -inf before the first."""

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Mask (N,) of the joints whose position the last `update` has accepted."""

    @property
    def jumps(self) -> int:
        """Number of positions rejected so far, as too far from the last accepted one."""

    def update(
        self, position: ArrayLike, ok: NDArray[np.bool_], time: ArrayLike
    ) -> NDArray[np.bool_]:
        """Store the plausible positions, and return the mask (N,) of their joints.

        Args:
            position: Positions (N,) [rad]; any number where `ok` is False.
            ok: Mask (N,) of the positions that were read in this cycle.
            time: Sample times [s]: (N,), or one number for all.

        Raises:
            ShapeError: An array does not have N entries.
        """

    def assume(self, position: ArrayLike, time: float) -> None:
        """Store assumed positions for the joints that have not been read yet.

        The first reading of a joint replaces its assumed position, however far it lies from it.

        Args:
            position: Positions (N,) [rad]; any number for joints that have been read.
            time: Time of the assumption [s].

        Raises:
            ShapeError: The array does not have N entries.
        """

    def implausible(self, count: int) -> list[tuple[int, float]]:
        """Return the joints whose last `count` or more positions in a row were implausible.

        Each is a pair of the index and the distance [rad] of the last such position from the
        accepted one.
        """

    def reset(self) -> None:
        """Discard all positions: the next position of each joint is then accepted in any case."""

@final
class ServoCodec:
    """Converts registers of servos to values of the joints (n,), and commands to registers.

    A position is accepted if it lies within ``2 v dt + 0.1 rad`` of the last accepted one, with the
    joint's speed without load v [rad/s] and the time dt since that position [s]. After an
    implausible position, only gaps of more than 0.1 s between readings count as part of dt.
    `configure` must be called for each servo.

    Args:
        servos: Number of servos; the servos of one joint have consecutive indices.
        joints: Number of joints n.
    """

    def __new__(cls, servos: int, joints: int) -> ServoCodec: ...
    def configure(self, servo: int, joint: int, numbers: ArrayLike) -> None:
        """Set joint, registers and units of a servo.

        Args:
            servo: Index of the servo.
            joint: Index of the joint.
            numbers: 54 numbers. Address, size and sign of 10 registers: position, speed, load,
                current, voltage, temperature, goal, limit, speed cap, torque enable (size 0: there
                is none; sign 0: unsigned, -1: two's complement, else value of the sign bit).
                Address and size of 2 packets (size 0: there is none). 20 units and bounds: position
                at angle 0 [counts]; sign; angle of a count [rad]; velocity of a unit [rad/s];
                measured torque of a unit, torque lost in the gears [N·m]; 1 if the current measures
                the torque, else 0; current of a unit [A]; limit of a unit, torque lost in the gears
                [N·m]; largest limit and its torque [N·m]; largest speed cap; speed without load
                [rad/s]; smallest and largest goal, largest position, turn (0: no wrap-around)
                [counts]; 1 if goals may exceed a turn, else 0; voltage register below which a
                reading needs attention.

        Raises:
            ShapeError, OutOfRangeError: Not 54 numbers, or no such servo or joint.
        """

    def decode(
        self,
        servos: Sequence[int],
        answers: list[tuple[bytes, int]],
        address: int,
        time: float,
        longest: float,
    ) -> list[tuple[int, bool | None]]:
        """Store readings of servos, and return those that need attention.

        Args:
            servos: Indices of the servos.
            answers: Bytes from `address` on, and status byte, of each servo.
            address: Address of the first byte.
            time: Time of the request [s].
            longest: Age of the previous reading above which the new one is not stored [s].

        Returns:
            Place in `servos` and a value, for servos that need attention. True: the reading was
            stored; status or turns are not 0, voltage or temperature has changed, the voltage is
            too low, or the reading is the first or follows `accept_any`. False: the position is
            implausible, and the reading was not stored. None: the previous reading is too old, and
            the new one was not stored.

        Raises:
            ShapeError: The bytes do not contain the position.
        """

    def joints(self, read: Sequence[int]) -> JointReadings:
        """Return the readings of all joints; `ok` is True if all servos of a joint are in `read`.

        For a joint with two servos, position and velocity are those of the first servo, time is the
        older one, load the mean and current the sum.
        """

    def encode(
        self,
        servos: Sequence[int],
        goal: ArrayLike,
        limit: ArrayLike,
        velocity: ArrayLike | None,
        max_speed: float,
    ) -> tuple[list[int], list[int], list[int], list[bytes], list[bytes]]:
        """Return goal, limit and speed cap registers, and the first and second packet, by servo.

        A goal is clamped to the range; a limit is rounded down and clamped to the largest limit; a
        speed is rounded down, but at least 1 unit. A single-turn servo past the end of its encoder
        gets the nearer end of the range as goal: it would reach other goals the long way round. For
        a multi-turn servo outside its range, the range is extended to its position.

        Args:
            servos: Indices of the servos.
            goal: Goals (n,) [rad].
            limit: Torque limits (n,) [N·m], at least 0.
            velocity: Largest speeds (n,) [rad/s], at least 0; None or inf: no limit.
            max_speed: Upper bound of the speeds [rad/s]; 0: the joint's speed without load.

        Raises:
            ShapeError: A vector is not (n,).
            OutOfRangeError: A number is negative or not finite, also of a joint without a servo
                among `servos`.
        """

    def has_command(self, servo: int, data: bytes, address: int) -> bool:
        """Return False if a servo's registers show that torque is off, or another command.

        The result is True if `data` does not contain the register Torque Enable. Otherwise it is
        True if that register is 1 and `data` contains the first packet of the last command; False
        if that packet is unknown.

        Args:
            servo: Index of the servo.
            data: Bytes from `address` on.
            address: Address of the first byte.

        Raises:
            OutOfRangeError: There is no such servo.
        """

    def record_sent(self, servo: int, goal: int | None, limit: int, packet: bytes) -> None:
        """Record that a command was sent to a servo.

        Args:
            servo: Index of the servo.
            goal: Value of the goal register; None: no goal was sent yet.
            limit: Value of the limit register.
            packet: Bytes written to the first block of registers; empty if unknown.

        Raises:
            ShapeError, OutOfRangeError: The packet is longer than 32 bytes, or no such servo.
        """

    def sent(self, servo: int) -> tuple[int | None, int, int, bytes]:
        """Return the last command that was sent to a servo.

        It consists of goal and limit register as in `record_sent` (None and 0 before the first
        command), the number of commands so far, and the packet.
        """

    def reading(self, servo: int) -> _Array:
        """Return the last accepted reading of a servo: 8 numbers, NaN if not read.

        The numbers are: position without wrap-around [counts], turns, time [s]; registers of
        voltage and temperature; time of the last voltage that was not too low [s]; number of
        implausible positions since that reading, and distance of the last one [rad].
        """

    def accept_any(self, servo: int, position: float, turns: float, time: float) -> None:
        """Accept any position in the next reading of a servo.

        Unless `position` [counts] is NaN, store it with turns and time [s] as the last reading.
        """

@disjoint_base
class PortState:
    """State of the requests on one serial port; `TransactionGuard` makes most of them.

    Attributes:
        is_dirty: True if the last request has failed, so that the line must be drained.
        is_gone: True if the port has vanished; every request then fails immediately.
        is_relaxed: True outside of control cycles.
        deadline: Time at which the control cycle ends [s].
        transactions: Number of requests sent.
        missing: Missing replies by servo id, see `PendingReplies`.
        clock: Function that returns the time for timeouts [s].
        sample_clock: Function that returns the time of readings [s].
    """

    is_dirty: bool
    is_gone: bool
    is_relaxed: bool
    deadline: float
    transactions: int
    clock: Callable[[], float]
    sample_clock: Callable[[], float]
    def __new__(cls, *_args: Any, **_options: Any) -> Self: ...
    @property
    def missing(self) -> dict[int, Any]: ...

@final
class BusStatus:
    """Record of the status readings of all servos on a bus, and of changes of their status.

    Results that depend on them stay valid while the numbers of changes are the same.

    Args:
        matched: For each servo, last time at which a reading of all servos showed that its status
            registers were as written [s].
        is_new: For each servo, see `has_new`; None: False.
        torque_changes: Number of changes of `Device.enabled`.
        changes: Number of changes of torque, status or faults.
        next_step: Next step of `StatusPoller`.
    """

    torque_changes: int
    changes: int
    next_step: int
    def __new__(
        cls,
        matched: Sequence[float],
        is_new: Sequence[bool] | None = None,
        torque_changes: int = 0,
        changes: int = 0,
        next_step: int = 0,
    ) -> BusStatus: ...
    def __getnewargs__(self) -> tuple[list[float], list[bool], int, int, int]: ...
    def has_new(self, servo: int) -> bool:
        """Return True if a reading contained the status and `StatusPoller` has not taken it."""

    def set_new(self, servo: int, is_new: bool) -> None:
        """Set the value of `has_new`."""

    def matched(self, servo: int) -> float:
        """Return the last time at which the status registers of a servo were as written [s]."""

@disjoint_base
class BusCycle:
    """Control cycle of a servo bus: each request in one call while nothing needs attention.

    Otherwise the methods `_read_each`, `_write_each`, `_poll_each`, `_finish_read` and
    `_finish_write` of the subclass act.
    """

    def __new__(cls, *_args: Any, **_options: Any) -> Self: ...
    def read(self) -> JointReadings:
        """Read all joints; a joint without a reply has `ok` False and keeps its last position.

        Raises:
            ServoError: All ports are gone. If only some ports are gone, their joints have a fault.
        """

    def write(self, goal: ArrayLike, limit: ArrayLike, velocity: ArrayLike | None = None) -> None:
        """Send goal and limit of all enabled joints, in one packet per port and kind of servo.

        Args:
            goal: Joint goals (n,) [rad]; clamped to the joint's range.
            limit: Torque limits (n,) [N·m], at least 0; rounded down to the register, clamped to
                the servo's ceiling.
            velocity: Largest joint speeds (n,) [rad/s], at least 0; the argument `speed` of the bus
                bounds them, and is the default.

        Raises:
            ShapeError, ConfigError: A vector is not (n,), or a number is not finite or negative,
                also of a joint that is not enabled. Nothing is sent.
            ServoError: All ports are gone. Other packets that cannot be sent are counted, and the
                last goal and limit stay in force.
        """

    def poll_status(self) -> ServoStatus | None:
        """Read status registers of one servo, in turn.

        Return voltage, temperature and faults of its joint as last read; None if no reply came, or
        if the torque state of a port's servos was read instead. Call this method once per cycle,
        after `read` and `write`.

        Raises:
            ServoError: All ports are gone.
        """

    def end_cycles(self) -> None:
        """Forget how to read, write and poll; the methods of the subclass act from now on."""

    if sys.platform != "win32":
        def set_reading(
            self,
            port: PortState,
            status: BusStatus,
            group: ServoGroup,
            misses: dict[int, int],
            numbers: ArrayLike,
        ) -> None:
            """Set how to read all servos with one request, and forget how to write and poll.

            Args:
                port: State of the port.
                status: Record of the status readings.
                group: All servos of the bus.
                misses: Numbers of missed readings of silent servos.
                numbers: 9 numbers. Address and size of the registers of a reading without status,
                    and of one with it; timeouts of these requests [s]; servo whose status is taken
                    last; age of the last readings above which new ones are not stored [s]; time
                    after which a cycle makes no further request [s].

            Raises:
                ShapeError: Not 9 numbers.
            """

        def set_writing(
            self,
            group: ServoGroup,
            blocks: Sequence[tuple[int, int]],
            numbers: ArrayLike,
            torque_changes: int,
        ) -> None:
            """Set how to write, as long as `BusStatus.torque_changes` has this value.

            Args:
                group: All servos of the bus.
                blocks: Address and size of each packet.
                numbers: 3 numbers. Timeouts of a packet in a control cycle and outside [s]; upper
                    bound of the speeds [rad/s].
                torque_changes: The present value of `BusStatus.torque_changes`.

            Raises:
                ShapeError: Not 3 numbers.
            """

        def set_polling(
            self, servos: Sequence[int], statuses: tuple[ServoStatus, ...], changes: int
        ) -> None:
            """Set servo and status of each step, as long as `BusStatus.changes` has this value."""

@disjoint_base
class ExclusiveAccess:
    """Lock of an arm, and the time of the last access to it.

    As a context, it is held during one access to the drive. If `reason` is set, the method `check`
    of the subclass is called before and after the lock is taken; in a forked process, only before.

    Args:
        lock: Lock that the thread with access to the drive holds.
        not_forked: Memory whose first byte is 0 in a forked process.
        clock: Function that returns the time [s].

    Attributes:
        reason: Reason for which no access is possible; None: access is possible.
        last_call: Time of the end of the last access [s].
        heartbeat: Memory of two times [s], see `Supervisor`.
    """

    reason: str | None
    last_call: float
    def __new__(cls, lock: Any, not_forked: Any, clock: Callable[[], float]) -> Self: ...
    @property
    def lock(self) -> threading.RLock: ...
    @property
    def heartbeat(self) -> memoryview[float]: ...
    @heartbeat.setter
    def heartbeat(self, memory: memoryview[float]) -> None: ...
    def __enter__(self) -> None:
        """Take the lock for one access to the drive."""

    def __exit__(self, *_exception: object) -> None:
        """Note the time, and release the lock."""

@disjoint_base
class ArmCycle:
    """Readings and commands of all N joints of a drive, as far as every control cycle needs them.

    The subclass `ArmIO` adds the methods that are called rarely.

    Attributes:
        drive: The drive.
        clock: Its clock.
        limiter: Limits of commands.
        positions: Filter with the last plausible positions.
        readings: Last reading of all joints.
        goals: Last goals (N,) [rad].
        limits: Last torque limits (N,) [N·m].
        is_sent: True once goals and limits were sent.
        orders: Last goal [rad] and limit [N·m] of each joint off the chain, by name.
        reported: Faults that the servos report, by name of the joint.
        ramp_start: Time at which the ramp of the torque limits began [s].
        ramp_time: Duration of that ramp [s].
        min_limit: Lower bound of that ramp at its start (n,) [N·m].
        watchdog_time: Bus silence after which servos stop [s]; 0: never.
        last_update: Time of the last reading [s]; NaN before the first.
        last_access: Time of the last access to the drive [s].
        last_write: Time of the last write that the drive accepted [s]; -inf before the first.
    """

    drive: Drive
    clock: Clock
    limiter: CommandLimiter
    positions: PositionFilter
    readings: JointReadings
    goals: _Array
    limits: _Array
    is_sent: bool
    orders: dict[str, tuple[float, float]]
    ramp_start: float
    ramp_time: float
    min_limit: _Array
    watchdog_time: float
    last_update: float
    last_access: float
    last_write: float
    def __new__(cls, *_args: Any, **_options: Any) -> Self: ...
    @property
    def reported(self) -> dict[str, tuple[str, ...]]: ...
    def read(self) -> State:
        """Read all joints, update filter and heat, and return the state of the arm.

        Raises:
            ServoError: The connection to the drive is lost.
        """

    def write(
        self,
        goal: ArrayLike,
        limit: ArrayLike | None,
        extra: Mapping[str, tuple[float, float]] | None,
        *,
        lead: bool,
        velocity: ArrayLike | None = None,
    ) -> None:
        """Validate, clip and send goals and limits; `Arm.write` documents the arguments."""

    def transmit(self, goals: _Array, limits: _Array, speeds: _Array | None) -> None:
        """Send goals [rad], torque limits [N·m] and largest speeds [rad/s] of all joints (N,)."""

@final
class CommandLimiter:
    """Limits goals and torque limits before they are sent to the N joints of a drive.

    The limits are position limits, the thermal and the supply budget, and a ramp of the torque
    limits after torque on. The chain has n of the joints. With gravity torque g, usable torque
    tau_max, stiffness k_p and `torque_margin` m, per joint of the chain:

    ``goal = clip(goal, lower - lead, upper + lead)``, where the lead is ``tau_max / k_p``, or the
    lead that g needs on that side; ``holding = min(max(1.1 |g| + m, ramp_start), tau_max)``;
    ``limit = min(limit, holding + ramp (tau_max - holding), max(thermal ceiling, 1.1 |g|))``.

    Limits are then reduced to the current of the supply, but not below 1.1 |g|.

    Args:
        model: The robot, with the position limits.
        servos: Servo parameters of the chain, n entries.
        thermal: Thermal model of the N servos.
        chain: Index in the drive of each joint of the chain (n,).
        extra: Names of the other joints (N - n,).
        kp: Stiffness of all joints (N,) [N·m/rad].
        max_torque: Usable torques of all joints (N,) [N·m].
        max_jumps: Number of implausible positions in a row from which on a joint is faulty.
        max_heat: Heat above which a servo is too hot.

    Raises:
        ShapeError, ConfigError: Lengths differ, an index is invalid, or a stiffness is not above 0.
    """

    def __new__(
        cls,
        model: Model,
        servos: Servos,
        thermal: ThermalModel,
        *,
        chain: Sequence[int],
        extra: tuple[str, ...],
        kp: ArrayLike,
        max_torque: ArrayLike,
        max_jumps: int,
        max_heat: float,
    ) -> CommandLimiter: ...
    def set_supply(self, voltage: _Array, temperature: _Array) -> None:
        """Set supply voltages (n,) [V] and temperatures (n,) [deg C] of the next states."""

    def unreachable(self, goal: ArrayLike) -> int | None:
        """Return the index of a joint whose goal is so far outside that its unit must be wrong.

        `goal` (n,) [rad] then exceeds the position limits by more than 1 rad plus the lead at full
        torque. None: there is no such joint.
        """

    def limit(
        self,
        goal: ArrayLike,
        limit: ArrayLike,
        velocity: ArrayLike | None,
        positions: PositionFilter,
        off_chain: Sequence[tuple[float, float]],
        ramp: float,
        ramp_start: ArrayLike,
        *,
        lead: bool,
    ) -> tuple[_Array, _Array, _Array | None, _Array | None]:
        """Return goals [rad], torque limits [N·m] and largest speeds [rad/s] (N,) to send.

        The speeds of joints off the chain are inf; None without `velocity`. The last element is the
        array of gravity torques (n,) [N·m] at the present positions; None with `lead`.

        Args:
            goal: Requested goals (n,) [rad].
            limit: Requested torque limits (n,) [N·m].
            velocity: Largest speeds (n,) [rad/s]; None: not limited.
            positions: Filter of the N joints, with their positions.
            off_chain: Goal [rad] and limit [N·m] of each joint off the chain (N - n).
            ramp: Progress of the ramp from holding torque to usable torque, 0 to 1.
            ramp_start: Lower bound of the ramp (n,) [N·m].
            lead: True if goals may lie beyond the position limits to exert a force.

        Raises:
            ShapeError: An array has another shape.
            OutOfRangeError: A goal is `unreachable`, a number is not finite, or a torque limit or a
                speed is negative.
        """

    def update(
        self,
        positions: PositionFilter,
        readings: JointReadings,
        goal: ArrayLike,
        limit: ArrayLike,
        dt: float,
        now: float,
    ) -> tuple[State, bool]:
        """Filter the positions of a reading, and update the heat by the torques since the last one.

        Args:
            positions: Filter of the N joints, which gets the positions of the reading.
            readings: Reading of the N joints. Where its load is not finite, or None, the torque is
                estimated as ``min(k_p |goal - position|, limit)``.
            goal: Goals in the servos (N,) [rad].
            limit: Torque limits in the servos (N,) [N·m].
            dt: Time since the last update [s].
            now: Present time [s].

        Returns:
            The state with the last plausible positions, without faults; True if a joint is faulty
            or a servo is too hot. Its arrays are reused if nothing refers to them any more.

        Raises:
            ShapeError: An array has another shape.
        """

@final
class ThermalModel:
    """Thermal model of N servos, from which torque limits are computed.

    ``dh/dt = ((torque / max_torque)^2 / continuous^2 - h) / seconds``, where h is the share of the
    thermal budget in use; h = 1 in steady state at the continuous torque.

    Args:
        max_torque: Usable torques (N,) [N·m].
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
        """Used share of the thermal budget (N,); 1 in steady state at the continuous torque."""

    @property
    def temperature(self) -> _Array:
        """Last measured temperatures (N,) [deg C]; NaN before the first measurement."""

    @property
    def zero_torque_temperature(self) -> float:
        """Temperature at which the torque limit of a servo becomes zero [deg C]."""

    def is_too_hot(self, max_heat: float) -> bool:
        """Return True if a servo exceeds `max_heat`, or is so hot that its torque limit is zero."""

    def set_temperature(self, servo: int, temperature: float) -> None:
        """Store the measured temperature of a servo [deg C]; an index beyond N is ignored."""

    def update(self, torque: ArrayLike, dt: float) -> None:
        """Update the heat with torques (N,) [N·m] exerted over dt [s]."""

    def torque_ceiling(self) -> _Array:
        """Return the largest torque limits (N,) [N·m] at the present heat and temperature."""

    def limit_current(self, torque: ArrayLike, least: ArrayLike, limit: ArrayLike) -> _Array:
        """Return torque limits (N,) [N·m] that keep the current within the supply.

        They are ``least + s (limit - least)`` with the largest s in [0, 1] that the supply allows.

        Args:
            torque: Expected torques without limits (N,) [N·m].
            least: Limits (N,) [N·m] that are kept in any case, because the arm's weight needs them.
            limit: Requested limits (N,) [N·m].
        """

def _model(text: str, options: dict[str, Any]) -> Model:
    """Create a model from a pickle."""

def _controller(
    model: Model, settings: Settings, servos: Servos | None, numbers: tuple[Any, ...]
) -> Controller:
    """Create a controller from a pickle."""
