"""`pliant_follower`: an arm that follows LeRobot's joint targets softly."""

import logging
import math
import threading
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import pliant
from lerobot_robot_pliant._approach import Approach
from lerobot_robot_pliant._calibration import load_file
from lerobot_robot_pliant._control_thread import RATE, ControlThread, send
from pliant.config import motor_units
from pliant.teleop import JointFollower

LOG = logging.getLogger(__name__)

#: Axes of the base along which forces are bounded and observed.
AXES = ("x", "y", "z")
#: Pause between two actions above which the arm approaches the new target slowly, as at the start,
#: because the leader may have moved meanwhile [s].
PAUSE = 1.0
#: LeRobot's rollout passes on only numbers whose names end in `.pos` or `.vel`, and sends `.pos`
#: back to the arm at its end; forces, deviations and caps are therefore called `.vel`.
SUFFIX = ".vel"
#: Motors of LeRobot's own SO-101, SO-100 and Koch arms.
STOCK_MOTORS = frozenset(
    {"shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"}
)
#: Prefix of the entries of an action that give the largest force of an axis.
CAP = "cap_"


@dataclass(kw_only=True)
class PliantFollowerOptions:
    """Options of one arm.

    Attributes:
        arm: Ready arm (so101, so100, koch) or the path of an arm.toml.
        port: Serial port, as `/dev/ttyACM0`; None: as in the file, by default the only one.
        backend: `bus`; `emulator` or `sim` need no arm; None: as in the file.
        calibration: LeRobot's calibration file; None: that of LeRobot's own follower with this id.
        soft: Largest force of the tool along the axes of the base [N]: `x=4 y=4 z=4`; empty: the
            servos' full torque. Each joint may exert the torque that the strongest of the axes that
            it moves needs, so an axis much softer than the others gets more force than given here.
        grip: Largest force at the fingers [N]; None: the gripper's default.
        max_tool_speed: Speed limit of the tool [m/s].
        max_joint_speed: Speed limit of each joint [rad/s].
        approach_speed: Joint speed at the start and after a pause [rad/s].
        observe: `force`: external force on the tool [N]; `deviation`: distance of the target from
            the tool [m]. Both along x, y, z as `force_x.vel` and `deviation_x.vel`.
        soft_action: Axes x, y, z whose largest force [N] is part of the action, as `cap_z.vel`.
        on_exit: `lower` the arm at the end, or `leave_enabled`.
        rest_q: Pose to which the arm is lowered (n,) [rad]; None: as in the file.
        use_degrees: Joints in degrees; False: -100 to 100 over the calibrated range.
        cameras: As in LeRobot.
        log: MCAP file of the control loop; None: no log.
    """

    arm: str = "so101"
    port: str | None = None
    backend: str | None = None
    calibration: Path | None = None
    soft: str = "x=4 y=4 z=4"
    grip: float | None = None
    max_tool_speed: float = 0.6
    max_joint_speed: float = 4.0
    approach_speed: float = 0.5
    observe: list[str] = field(default_factory=list)
    soft_action: list[str] = field(default_factory=list)
    on_exit: str = "lower"
    rest_q: list[float] | None = None
    use_degrees: bool = True
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    log: Path | None = None


@RobotConfig.register_subclass("pliant_follower")
@dataclass(kw_only=True)
class PliantFollowerConfig(PliantFollowerOptions, RobotConfig):
    """Configuration of `PliantFollower`."""


@dataclass(frozen=True)
class Target:
    """Target of the control loop.

    Attributes:
        q: Joint positions (n,) [rad].
        extra: Positions of joints off the chain by name [rad].
        max_force: Largest force along x, y, z [N].
        pause_count: Number of pauses between actions; the arm approaches slowly after each.
    """

    q: np.ndarray
    extra: Mapping[str, float]
    max_force: tuple[float, ...]
    pause_count: int = 0


class PliantFollower(Robot):
    """An arm that follows joint targets and yields to a push.

    A thread runs a `pliant.teleop.JointFollower` at 100 Hz, and holds the last target until the
    next action. `disconnect` lowers the arm. If the control loop fails, the thread lowers the arm
    immediately, and the next call raises an error.
    """

    config_class = PliantFollowerConfig
    name = "pliant_follower"

    def __init__(self, config: PliantFollowerConfig) -> None:
        """Read the arm's file and its calibration; nothing is opened.

        Raises:
            ConfigError: An option is wrong, or LeRobot has no calibration for this arm.
        """
        super().__init__(config)
        self.config = config
        self._file = load_file(self, "robots")
        self._model = self._file.model()
        self._units = motor_units(self._file, self._model, use_degrees=config.use_degrees)
        self._max_force = parse_forces(config.soft)
        self._check_options()
        self.cameras = make_cameras_from_configs(config.cameras)
        self._lock = threading.Lock()
        self._session: _Session | None = None

    def __str__(self) -> str:
        """Return the id in LeRobot, if there is one, and the name of the class."""
        return " ".join(filter(None, (self.id, type(self).__name__)))

    def _check_options(self) -> None:
        """Check options that would otherwise fail in the control loop.

        Raises:
            ConfigError: An option is invalid.
        """
        config = self.config
        for axis in config.soft_action:
            if axis not in AXES:
                raise pliant.ConfigError(f"soft_action {axis!r}; choose from {', '.join(AXES)}")
        if config.soft_action and not config.soft:
            raise pliant.ConfigError("soft_action needs initial forces: soft='x=4 y=4 z=4'")
        for name in config.observe:
            if name not in ("force", "deviation"):
                raise pliant.ConfigError(f"observe {name!r}; choose from force, deviation")
        for name in ("max_tool_speed", "max_joint_speed", "approach_speed"):
            if not (speed := getattr(config, name)) > 0.0:
                raise pliant.ConfigError(f"{name} must be above 0, got {speed!r}")
        if config.on_exit not in ("lower", "leave_enabled"):
            raise pliant.ConfigError(
                f"on_exit {config.on_exit!r}; choose from lower, leave_enabled"
            )
        if config.grip is not None and self._file.gripper is None:
            raise pliant.ConfigError(f"grip: {config.arm} has no [gripper] table")
        if config.grip is not None and not 0.0 <= config.grip < math.inf:
            raise pliant.ConfigError(f"grip must be a force from 0 N up, got {config.grip!r}")

    @cached_property
    def observation_features(self) -> dict[str, type | tuple]:
        """Types of joint positions, observed forces and deviations; shapes of camera images."""
        motors: dict[str, type | tuple] = {f"{name}.pos": float for name in self._units}
        for what in self.config.observe:
            motors |= {f"{what}_{axis}{SUFFIX}": float for axis in AXES}
        return motors | self._camera_features

    @property
    def _camera_features(self) -> dict[str, tuple]:
        features: dict[str, tuple] = {}
        for name, camera in self.cameras.items():
            if has_color(camera):
                features[name] = (camera.height, camera.width, 3)
            if has_depth(camera):
                features[f"{name}_depth"] = (camera.height, camera.width, 1)
        return features

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Types of the joint targets, and of the largest force of each axis of `soft_action`."""
        motors: dict[str, type] = {f"{name}.pos": float for name in self._units}
        return motors | {f"{CAP}{axis}{SUFFIX}": float for axis in self.config.soft_action}

    @property
    def is_connected(self) -> bool:
        """True until `disconnect`, also after a failure of the control loop or of a camera."""
        return self._session is not None

    @property
    def is_calibrated(self) -> bool:
        """True: an arm without a calibration is rejected when this object is created."""
        return True

    def calibrate(self) -> None:
        """Log how to calibrate; pliant uses LeRobot's calibration of the stock follower."""
        LOG.info(
            "%s uses LeRobot's calibration: lerobot-calibrate --robot.type=so101_follower (or "
            "koch_follower) --robot.id=%s",
            self.name,
            self.id,
        )

    def configure(self) -> None:
        """Do nothing: limits and goals are sent in every tick, and nothing is stored in servos."""

    def connect(self, calibrate: bool = True) -> None:
        """Open the cameras, switch torque on in the present pose, and start the control loop.

        Raises:
            DeviceAlreadyConnectedError: `disconnect` first.
            ConfigError, ServoError: As `pliant.connect` and `Arm.enable`.
            ConfigError, OSError, ImportError: As `pliant.log.Recorder`.
        """
        if self._session is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        if not STOCK_MOTORS.issuperset(self._units):
            LOG.warning(
                "%s has the motors %s: a leader, policy or dataset must use the same names",
                self,
                ", ".join(self._units),
            )
        arm = pliant.connect(self._file, **self._arm_options())
        try:
            # Log and cameras first: one that fails after torque on would make the arm descend.
            recorder = self._recorder()
            for camera in self.cameras.values():
                camera.connect()
            arm.enable()
            self._session = self._start(arm, recorder)
        except BaseException:
            self._close(arm)
            raise
        LOG.info("%s is connected, soft: %s", self, self.config.soft or "nothing")

    def _arm_options(self) -> dict[str, Any]:
        """Return the options of `pliant.connect`."""
        options: dict[str, Any] = {"on_exit": self.config.on_exit}
        if self.config.rest_q is not None:
            options["rest_q"] = self.config.rest_q
        if self._file.backend == "sim":
            options["real_time"] = True
        return options

    def _recorder(self) -> Any | None:
        """Return the recorder of the option `log`; None: no log."""
        if self.config.log is None:
            return None
        from pliant.log import Recorder

        return Recorder(self.config.log, config=self._file)

    def _start(self, arm: pliant.Arm, recorder: Any | None) -> "_Session":
        """Start the control loop of an enabled arm."""
        config = self.config
        follower = JointFollower(
            arm.model,
            arm.servos,
            max_force=self._max_force,
            max_tool_speed=config.max_tool_speed,
            max_joint_speed=config.max_joint_speed,
        )
        state = arm.read()
        behavior = _FollowerBehavior(
            arm,
            Target(state.q, dict(state.extra), self._max_force),
            approach_speed=config.approach_speed,
            observe=config.observe,
            gripper_torque=self._gripper_torque(),
        )
        control = ControlThread(
            arm, follower, behavior, name=str(self), on_exit=config.on_exit, recorder=recorder
        )
        try:
            control.start()
        except BaseException:
            control.stop()
            raise
        return _Session(arm, control, behavior)

    def _gripper_torque(self) -> float | None:
        """Return the torque of `grip` [N·m]; None: the gripper's default."""
        grip, gripper = self.config.grip, self._file.gripper
        return None if grip is None or gripper is None else grip * (gripper.lever or 1.0)

    def get_observation(self) -> dict[str, Any]:
        """Return the values of the last tick and the latest camera images, by feature name.

        The values are joint positions in LeRobot's units, observed forces [N] and deviations [m].

        Raises:
            DeviceNotConnectedError: The arm is not connected, or the control loop has ended.
        """
        snapshot = self._connected().control.snapshot()
        out: dict[str, Any] = {
            f"{name}.pos": unit.value(snapshot.positions[name])
            for name, unit in self._units.items()
        }
        out |= snapshot.extra
        for name, camera in self.cameras.items():
            if has_color(camera):
                out[name] = camera.read_latest()
            if has_depth(camera):
                out[f"{name}_depth"] = camera.read_latest_depth()
        return out

    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Set the target; the control loop moves there.

        Args:
            action: `NAME.pos` of any motors, and `cap_AXIS.vel` of any axes of `soft_action`. A
                missing entry keeps its target. Other names, such as observed forces, are ignored.

        Returns:
            The values that were set: positions within their limits, forces of at least 0 N.

        Raises:
            ValueError: A value is not finite, there is no such motor, or the force of an axis is
                not in `soft_action`; the target is unchanged.
            DeviceNotConnectedError: The arm is not connected, or the control loop has ended.
        """
        return self._set_target(self._check_action(action))

    def _check_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Check an action; return its entries for this arm as numbers."""
        self._connected().control.snapshot()
        motors = [key.removesuffix(".pos") for key in action if key.endswith(".pos")]
        if unknown := [name for name in motors if name not in self._units]:
            raise ValueError(
                f"{self}: no motor {', '.join(unknown)}; there are {', '.join(self._units)}, and "
                f"the action has {', '.join(motors)}. Take a leader with the joint names of "
                f"{self.config.arm} (--teleop.type=pliant_leader "
                f"--teleop.arm={self.config.arm}), or rename the servos and joints in that file"
            )
        return {name: _finite(name, value) for name, value in action.items() if self._takes(name)}

    def _set_target(self, action: Mapping[str, float]) -> dict[str, float]:
        """Set the target from a checked action; return the values that were set."""
        session, names = self._connected(), self._model.joint_names
        sent: dict[str, float] = {}
        with self._lock:
            target = session.behavior.target
            q, extra, max_force = target.q.copy(), dict(target.extra), list(target.max_force)
            for key, value in action.items():
                if key.startswith(CAP):
                    axis = key.removeprefix(CAP).removesuffix(SUFFIX)
                    max_force[AXES.index(axis)] = sent[key] = max(value, 0.0)
                    continue
                name = key.removesuffix(".pos")
                unit = self._units[name]
                position = unit.position(value)
                if name in names:
                    i = names.index(name)
                    q[i] = position = min(max(position, self._model.lower[i]), self._model.upper[i])
                else:
                    extra[name] = position
                sent[key] = unit.value(position)
            pause_count = target.pause_count + session.has_paused()
            session.behavior.target = Target(q, extra, tuple(max_force), pause_count)
        return sent

    def _takes(self, key: str) -> bool:
        """Return True if an entry of an action is for this arm.

        Raises:
            ValueError: The axis is not in `soft_action`.
        """
        if key in self.action_features:
            return True
        if key.startswith(CAP):
            axis = key.removeprefix(CAP).removesuffix(SUFFIX)
            raise ValueError(
                f"{self}: the action gives the force of axis {axis}, which would have no effect: "
                f"""add it, as in --robot.soft_action='["{axis}"]'"""
            )
        return False

    def disconnect(self) -> None:
        """Lower the arm, or leave it enabled, as `on_exit` says; then close the cameras.

        Raises:
            DeviceNotConnectedError: The arm is not connected.
            ServoError: The arm could not be lowered; ports and cameras are closed nevertheless.
        """
        session = self._connected()
        try:
            session.control.stop()
        finally:
            self._session = None
            self._close(session.arm)

    def _close(self, arm: pliant.Arm) -> None:
        """Lower and close the arm; then close the cameras, even after an error."""
        try:
            arm.close()
        finally:
            for camera in self.cameras.values():
                if camera.is_connected:
                    camera.disconnect()

    def _connected(self) -> "_Session":
        session = self._session
        if session is None:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first")
        return session


class _FollowerBehavior:
    """Behaviour of a follower: one step per tick toward `target`.

    Args:
        arm: The arm, enabled.
        target: The present pose.
        approach_speed, observe: As in `PliantFollowerOptions`.
        gripper_torque: Largest torque of the grippers [N·m]; None: their default.
    """

    def __init__(
        self,
        arm: pliant.Arm,
        target: Target,
        *,
        approach_speed: float,
        observe: Collection[str],
        gripper_torque: float | None,
    ) -> None:
        self.target = target
        self._model, self._observed = arm.model, observe
        self._approach = Approach(target.q, approach_speed)
        self._pause_count = target.pause_count
        self._contact: pliant.ContactEstimator | None = None
        self._sent: tuple[np.ndarray, np.ndarray] | None = None
        if "force" in observe:
            settings = pliant.Settings.firm(task="xyz", rate=RATE)
            self._contact = pliant.ContactEstimator(
                pliant.Controller(arm.model, settings, arm.servos)
            )
        self._limits = {
            name: jaw.limit if gripper_torque is None else min(gripper_torque, jaw.max_limit)
            for name, jaw in arm.grippers.items()
        }

    def step(self, tick: pliant.Tick, controller: JointFollower) -> dict[str, float]:
        """Step toward the target, slowly at first; return the observed values."""
        target = self.target
        if target.pause_count != self._pause_count:
            self._pause_count, self._approach.is_slow = target.pause_count, True
        controller.max_force = target.max_force
        observed = self._observe(tick, target.q)
        command = controller.step(tick.q, self._approach.step(target.q, tick.dt), dt=tick.dt)
        extra = {name: (position, self._limits[name]) for name, position in target.extra.items()}
        send(tick, command, extra)
        self._sent = (command.goal.copy(), command.torque_limit.copy())
        return observed

    def _observe(self, tick: pliant.Tick, target_q: np.ndarray) -> dict[str, float]:
        """Return the observed forces [N] and deviations [m] by feature name."""
        out: dict[str, float] = {}
        if self._contact is not None:
            force = self._contact.update(tick.q, dt=tick.dt, sent=self._sent).force[:3]
            out |= _named("force", force)
        if "deviation" in self._observed:
            poses = (self._model.forward_kinematics(q) for q in (target_q, tick.q))
            target, tool = (np.asarray(pose)[:3, 3] for pose in poses)
            out |= _named("deviation", target - tool)
        return out


def _named(what: str, values: np.ndarray) -> dict[str, float]:
    """Return values along x, y, z by feature name."""
    return {f"{what}_{axis}{SUFFIX}": float(v) for axis, v in zip(AXES, values, strict=True)}


def parse_forces(soft: str) -> tuple[float, ...]:
    """Return the largest forces along x, y, z [N] in a text such as "x=4 y=4 z=2"; "": all inf.

    Raises:
        ConfigError: A word is not an axis with a force, or repeats an axis; or an axis is missing.
    """
    forces: dict[str, float] = {}
    for word in soft.replace(",", " ").split():
        axis, _, number = word.partition("=")
        try:
            force = float(number)
        except ValueError:
            force = math.nan
        if axis not in AXES or axis in forces or not 0.0 <= force < math.inf:
            raise pliant.ConfigError(
                f"soft {word!r}: give each of {', '.join(AXES)} one force from 0 N up, as in "
                "'x=4 y=4 z=2'"
            )
        forces[axis] = force
    if missing := [axis for axis in AXES if forces and axis not in forces]:
        raise pliant.ConfigError(
            f"soft {soft!r} gives no force for {', '.join(missing)}: every joint moves the tool "
            "along several axes, so one axis without a bound would leave them all without one; "
            "give all three, as in 'x=4 y=4 z=2'"
        )
    return tuple(forces.get(axis, math.inf) for axis in AXES)


def _finite(name: str, value: Any) -> float:
    """Return a value of an action as a number; it may be a scalar of torch or NumPy."""
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"action {name} is {number}: it must be a finite number")
    return number


@dataclass
class _Session:
    """A connected arm with its control loop."""

    arm: pliant.Arm
    control: ControlThread
    behavior: _FollowerBehavior
    last_action: float | None = None

    def has_paused(self) -> bool:
        """Return True if an action at present comes after a pause; store the present time."""
        now, last = self.arm.clock.now(), self.last_action
        self.last_action = now
        return last is None or now - last > PAUSE


def has_color(camera: Any) -> bool:
    """Return True if a camera gives colour images; camera classes without `use_rgb` always do."""
    return getattr(camera, "use_rgb", True)


def has_depth(camera: Any) -> bool:
    """Return True if a camera gives depth images."""
    return getattr(camera, "use_depth", False)
