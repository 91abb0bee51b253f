"""`pliant_leader`: a leader arm that is weightless in the hand."""

import logging
import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import pliant
from lerobot_robot_pliant._approach import Approach
from lerobot_robot_pliant._calibration import load_file
from lerobot_robot_pliant._control_thread import RATE, ControlThread, send
from pliant.config import motor_units
from pliant.teleop import JointFollower

LOG = logging.getLogger(__name__)

#: Joint speed while the arm approaches the first target of a policy [rad/s].
APPROACH_SPEED = 0.5
#: Longest duration of the oscillation in which hand guiding measures the friction [s].
SWING_TIMEOUT = 30.0
#: Speed of a fictitious hand motion [rad/s] from the last position of hand guiding to the position
#: to which a policy has moved the arm; `HandGuiding` follows it (0.25 m/s at the tool).
CATCH_UP_SPEED = 0.25
#: Time at rest at the end of the fictitious hand motion [s].
CATCH_UP_REST = 0.3


@TeleoperatorConfig.register_subclass("pliant_leader")
@dataclass(kw_only=True)
class PliantLeaderConfig(TeleoperatorConfig):
    """Configuration of `PliantLeader`.

    Attributes:
        arm: Ready arm (so101, so100, koch) or the path of an arm.toml.
        port: Serial port; None: as in the file.
        backend: `bus`; `emulator` or `sim` need no arm; None: as in the file.
        calibration: LeRobot's calibration file; None: that of LeRobot's own leader with this id.
        follow_force: Largest force along x, y, z while the arm follows a policy, that is between
            `enable_torque` and `disable_torque` [N].
        on_exit: `lower` the arm at the end, or `leave_enabled`.
        use_degrees: Joints in degrees; False: -100 to 100 over the calibrated range.
    """

    arm: str = "so101"
    port: str | None = None
    backend: str | None = None
    calibration: Path | None = None
    follow_force: float = 4.0
    on_exit: str = "lower"
    use_degrees: bool = True


class PliantLeader(Teleoperator):
    """A leader arm whose servos carry its weight, so that it stays where it is left.

    `connect` swings the arm by a few degrees to measure its friction: keep the hands off until it
    returns. The torque limit of the gripper is 0. `enable_torque`, `send_feedback` and
    `disable_torque` let a policy move the arm and hand it back; the arm approaches the policy's
    first target slowly.
    """

    config_class = PliantLeaderConfig
    name = "pliant_leader"

    def __init__(self, config: PliantLeaderConfig) -> None:
        """Read the arm's file and its calibration; nothing is opened.

        Raises:
            ConfigError: An option is wrong, or LeRobot has no calibration for this arm.
        """
        super().__init__(config)
        self.config = config
        self._file = load_file(self, "teleoperators")
        self._model = self._file.model()
        self._units = motor_units(self._file, self._model, use_degrees=config.use_degrees)
        if config.on_exit not in ("lower", "leave_enabled"):
            raise pliant.ConfigError(
                f"on_exit {config.on_exit!r}; choose from lower, leave_enabled"
            )
        self._lock = threading.Lock()
        self._session: _Session | None = None

    def __str__(self) -> str:
        """Return the id in LeRobot, if there is one, and the name of the class."""
        return " ".join(filter(None, (self.id, type(self).__name__)))

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Positions of all motors."""
        return {f"{name}.pos": float for name in self._units}

    @property
    def feedback_features(self) -> dict[str, type]:
        """Targets of all motors, which the arm follows while torque is enabled."""
        return self.action_features

    @property
    def is_connected(self) -> bool:
        """True until `disconnect`, also after a failure of the control loop."""
        return self._session is not None

    @property
    def is_calibrated(self) -> bool:
        """True: an arm without a calibration is rejected when this object is created."""
        return True

    def calibrate(self) -> None:
        """Log how to calibrate; pliant uses LeRobot's calibration of the stock leader."""
        LOG.info(
            "%s uses LeRobot's calibration: lerobot-calibrate --teleop.type=so101_leader (or "
            "koch_leader) --teleop.id=%s",
            self.name,
            self.id,
        )

    def configure(self) -> None:
        """Do nothing: nothing is stored in the servos."""

    def connect(self, calibrate: bool = True) -> None:
        """Switch torque on in the present pose, and measure friction; then the arm is weightless.

        Raises:
            DeviceAlreadyConnectedError: The arm is connected; `disconnect` first.
            DeviceNotConnectedError: A joint did not follow the oscillation.
            ConfigError, ServoError: As `pliant.connect` and `Arm.enable`.
        """
        if self._session is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        options: dict[str, Any] = {"on_exit": self.config.on_exit}
        if self._file.backend == "sim":
            options["real_time"] = True
        arm = pliant.connect(self._file, **options)
        try:
            arm.enable()
            LOG.info("%s swings by a few degrees: hands off", self)
            self._session = self._start(arm)
        except BaseException:
            arm.close()
            raise
        LOG.info("%s is connected, and weightless", self)

    def _start(self, arm: pliant.Arm) -> "_Session":
        """Start the control loop of an enabled arm; return once its friction is measured."""
        guiding = _Guiding(pliant.HandGuiding(arm.model, arm.servos, rate=RATE))
        following = JointFollower(arm.model, arm.servos, max_force=self.config.follow_force)
        behavior = _LeaderBehavior(arm, following)
        control = ControlThread(arm, guiding, behavior, name=str(self), on_exit=self.config.on_exit)
        try:
            control.start()
            # Return only when the oscillation is over: a follower would copy it.
            end = time.monotonic() + SWING_TIMEOUT
            while not guiding.ready:
                control.snapshot()
                if time.monotonic() > end:
                    raise DeviceNotConnectedError(f"{self}: no swing within {SWING_TIMEOUT:g} s")
                time.sleep(0.05)
        except BaseException:
            control.stop()
            raise
        return _Session(arm, control, behavior)

    def get_action(self) -> dict[str, float]:
        """Return the positions of the last tick in LeRobot's units, by `NAME.pos`.

        Raises:
            DeviceNotConnectedError: The arm is not connected, or the control loop has ended.
        """
        positions = self._connected().control.snapshot().positions
        return {f"{name}.pos": unit.value(positions[name]) for name, unit in self._units.items()}

    def enable_torque(self) -> None:
        """Follow the targets of `send_feedback` from now on; the first is the present pose."""
        session = self._connected()
        with self._lock:
            if session.behavior.target is None:
                session.behavior.target = dict(session.control.snapshot().positions)

    def disable_torque(self) -> None:
        """Make the arm weightless again; its torque stays on, because it would fall otherwise."""
        session = self._connected()
        with self._lock:
            session.behavior.target = None

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Set the targets of motors, `NAME.pos`; ignored while the arm is weightless.

        Raises:
            ValueError: A value is not finite; the target is unchanged.
            DeviceNotConnectedError: The arm is not connected, or the control loop has ended.
        """
        session = self._connected()
        session.control.snapshot()
        values = {
            k.removesuffix(".pos"): float(v) for k, v in feedback.items() if k.endswith(".pos")
        }
        for name, value in values.items():
            if not np.isfinite(value):
                raise ValueError(f"feedback {name}.pos is {value}: it must be a finite number")
        positions = {n: self._units[n].position(v) for n, v in values.items() if n in self._units}
        with self._lock:
            if session.behavior.target is not None:
                session.behavior.target = session.behavior.target | positions

    def disconnect(self) -> None:
        """Lower the arm, or leave it enabled, as `on_exit` says.

        Raises:
            DeviceNotConnectedError: The arm is not connected.
            ServoError: The arm could not be lowered.
        """
        session = self._connected()
        try:
            session.control.stop()
        finally:
            self._session = None
            session.arm.close()

    def _connected(self) -> "_Session":
        session = self._session
        if session is None:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first")
        return session


class _LeaderBehavior:
    """Behavior of a leader: weightless, or following a policy.

    Attributes:
        target: Joint targets by name [rad]; None: weightless.
    """

    def __init__(self, arm: pliant.Arm, following: JointFollower) -> None:
        self.target: dict[str, float] | None = None
        self._names, self._grippers = arm.model.joint_names, dict(arm.grippers)
        self._following = following
        self._approach: Approach | None = None

    def step(self, tick: pliant.Tick, controller: "_Guiding") -> dict[str, float]:
        """Send goals that follow the hand while weightless, else the policy's targets."""
        target = self.target
        if target is None:
            if self._approach is not None:
                self._approach = None
                controller.reset(tick.q)
            extra = {name: (position, 0.0) for name, position in tick.state.extra.items()}
            send(tick, controller.step(tick.q, dt=tick.dt), extra)
            return {}
        if self._approach is None:
            self._approach = Approach(tick.q, APPROACH_SPEED)
            self._following.reset(tick.q)
        q = self._approach.step(np.array([target[name] for name in self._names]), tick.dt)
        extra = {name: (target[name], jaw.limit) for name, jaw in self._grippers.items()}
        send(tick, self._following.step(tick.q, q, dt=tick.dt), extra)
        return {}


class _Guiding:
    """Hand guiding that measures the friction at its first start only; a reset keeps the result.

    A second measurement would oscillate the joints while a hand is on the arm.
    """

    def __init__(self, guiding: pliant.HandGuiding) -> None:
        self._guiding = guiding
        self._q: np.ndarray | None = None

    @property
    def ready(self) -> bool:
        """True once the friction is measured."""
        return self._guiding.ready

    def capture_gravity(self, q: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Measure how the arm is held, as `HandGuiding.capture_gravity`."""
        return self._guiding.capture_gravity(q, goal)

    def reset(self, q: np.ndarray) -> None:
        """Continue at q (n,) [rad], wherever other commands have moved the arm."""
        if self._q is None or not self._guiding.ready:
            self._guiding.reset(q)
            return
        # Step the law as if a hand had moved the arm from its last position to q, and held it.
        period = 1.0 / RATE
        steps = math.ceil(float(np.abs(q - self._q).max()) / (CATCH_UP_SPEED * period))
        for share in np.linspace(0.0, 1.0, steps + 1):
            self._guiding.step(self._q + share * (q - self._q), dt=period)
        for _ in range(round(CATCH_UP_REST / period)):
            self._guiding.step(q, dt=period)
        self._q = q.copy()

    def step(self, q: np.ndarray, *, dt: float) -> pliant.Command:
        """Return goals and torque limits, as `HandGuiding.step`."""
        self._q = q.copy()
        return self._guiding.step(q, dt=dt)


@dataclass
class _Session:
    """A connected arm with its control loop."""

    arm: pliant.Arm
    control: ControlThread
    behavior: _LeaderBehavior
