"""`bi_pliant_follower`: two arms with the prefixes `left_` and `right_`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from lerobot.robots import Robot, RobotConfig
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_pliant.follower import (
    PliantFollower,
    PliantFollowerConfig,
    PliantFollowerOptions,
)

SIDES = ("left", "right")


@RobotConfig.register_subclass("bi_pliant_follower")
@dataclass(kw_only=True)
class BiPliantFollowerConfig(RobotConfig):
    """Options of the two arms; their ids in LeRobot are `ID_left` and `ID_right`.

    Attributes:
        left_arm_config, right_arm_config: Options of each arm, those of `pliant_follower`.
    """

    left_arm_config: PliantFollowerOptions = field(default_factory=PliantFollowerOptions)
    right_arm_config: PliantFollowerOptions = field(default_factory=PliantFollowerOptions)


class BiPliantFollower(Robot):
    """Two arms that follow joint targets and yield to a push."""

    config_class = BiPliantFollowerConfig
    name = "bi_pliant_follower"

    def __init__(self, config: BiPliantFollowerConfig) -> None:
        """Create both arms; nothing is opened."""
        super().__init__(config)
        self.config = config
        self._arms = {
            side: PliantFollower(
                PliantFollowerConfig(
                    **vars(getattr(config, f"{side}_arm_config")),
                    id=f"{config.id}_{side}" if config.id else None,
                    calibration_dir=config.calibration_dir,
                )
            )
            for side in SIDES
        }
        self.cameras = {
            f"{side}_{name}": camera
            for side, arm in self._arms.items()
            for name, camera in arm.cameras.items()
        }

    def __str__(self) -> str:
        """Return the id in LeRobot, if there is one, and the name of the class."""
        return " ".join(filter(None, (self.id, type(self).__name__)))

    @cached_property
    def observation_features(self) -> dict[str, type | tuple]:
        """Observations of both arms, with the prefix of the side."""
        return self._prefixed({s: arm.observation_features for s, arm in self._arms.items()})

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Entries of an action for both arms, with the prefix of the side."""
        return self._prefixed({s: arm.action_features for s, arm in self._arms.items()})

    @property
    def is_connected(self) -> bool:
        """True if at least one arm is connected; `disconnect` must then be called."""
        return any(arm.is_connected for arm in self._arms.values())

    @property
    def is_calibrated(self) -> bool:
        """True: an arm without a calibration is rejected when this object is created."""
        return True

    def calibrate(self) -> None:
        """Log how to calibrate each arm."""
        for arm in self._arms.values():
            arm.calibrate()

    def configure(self) -> None:
        """Do nothing."""

    def connect(self, calibrate: bool = True) -> None:
        """Connect both arms; if the second fails, the first is lowered."""
        left, right = self._arms.values()
        left.connect(calibrate)
        try:
            right.connect(calibrate)
        except BaseException:
            left.disconnect()
            raise

    def get_observation(self) -> dict[str, Any]:
        """Return the observations of both arms."""
        return self._prefixed({s: arm.get_observation() for s, arm in self._arms.items()})

    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Set the targets of both arms, or of neither if the action is invalid for one."""
        actions = {}
        for side, arm in self._arms.items():
            prefix = f"{side}_"
            entries = {k.removeprefix(prefix): v for k, v in action.items() if k.startswith(prefix)}
            actions[side] = arm._check_action(entries)
        return self._prefixed({s: self._arms[s]._set_target(a) for s, a in actions.items()})

    def disconnect(self) -> None:
        """Lower both arms, one after the other; the second is held meanwhile.

        Raises:
            DeviceNotConnectedError: The arms are not connected.
            ServoError: One arm could not be lowered; the other one was lowered.
        """
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected")
        left, right = self._arms.values()
        try:
            if left.is_connected:
                left.disconnect()
        finally:
            if right.is_connected:
                right.disconnect()

    def _prefixed(self, parts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """Return the entries of both sides with their prefixes."""
        return {f"{side}_{k}": v for side, part in parts.items() for k, v in part.items()}
