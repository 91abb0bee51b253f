"""`pliant_softness`: a key or pedal that switches the softness, added to any teleoperator."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import draccus
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig, make_teleoperator_from_config

from lerobot_robot_pliant.follower import AXES, CAP, SUFFIX

LOG = logging.getLogger(__name__)


@TeleoperatorConfig.register_subclass("pliant_softness")
@dataclass(kw_only=True)
class PliantSoftnessConfig(TeleoperatorConfig):
    """Configuration of `PliantSoftness`.

    Attributes:
        inner: Options of the teleoperator that moves the arm, as
            `{type: so101_leader, port: /dev/ttyACM1, id: blue}`.
        soft: Force of each axis while it is soft [N], by axis. The robot needs the same axes in
            `--robot.soft_action`.
        firm: Force of each axis while it is firm [N]; an axis without one has 10 N, about the
            strength of an SO-101.
        key: Key that switches between soft and firm, by its name in pynput (`space`, `f1`) or as a
            character. Foot pedals for computers send such a key.
        starts_soft: True if the axes are soft at the start.
    """

    inner: dict[str, Any] = field(default_factory=dict)
    soft: dict[str, float] = field(default_factory=lambda: {"z": 2.0})
    firm: dict[str, float] = field(default_factory=dict)
    key: str = "space"
    starts_soft: bool = True


#: Force of a firm axis without an entry in `firm` [N]. Policies learn this number, so it must not
#: be many times the forces of soft axes.
FIRM = 10.0


class PliantSoftness(Teleoperator):
    """Wraps a teleoperator and adds the force of each axis to its action, as `cap_AXIS.vel`."""

    config_class = PliantSoftnessConfig
    name = "pliant_softness"

    def __init__(self, config: PliantSoftnessConfig) -> None:
        """Create the wrapped teleoperator.

        Raises:
            ValueError: `inner` has no type, or an axis is not x, y or z.
        """
        super().__init__(config)
        self.config = config
        if "type" not in config.inner:
            raise ValueError(
                "pliant_softness needs the teleoperator that moves the arm: "
                "--teleop.inner='{type: so101_leader, port: /dev/ttyACM1, id: blue}'"
            )
        # A field of type TeleoperatorConfig would make LeRobot's parser recurse without end.
        for axis in (*config.soft, *config.firm):
            if axis not in AXES:
                raise ValueError(f"pliant_softness: axis {axis!r}; choose from {', '.join(AXES)}")
        self.inner = make_teleoperator_from_config(draccus.decode(TeleoperatorConfig, config.inner))
        self.is_soft = config.starts_soft
        self._listener: Any = None

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Entries of the wrapped teleoperator's action, and one force per axis."""
        caps = {f"{CAP}{axis}{SUFFIX}": float for axis in self.config.soft}
        return {**self.inner.action_features, **caps}

    @property
    def feedback_features(self) -> dict[str, type]:
        """Feedback that the wrapped teleoperator takes."""
        return dict(self.inner.feedback_features)

    @property
    def is_connected(self) -> bool:
        """True if the wrapped teleoperator is connected."""
        return bool(self.inner.is_connected)

    @property
    def is_calibrated(self) -> bool:
        """True if the wrapped teleoperator is calibrated."""
        return bool(self.inner.is_calibrated)

    def calibrate(self) -> None:
        """Calibrate the wrapped teleoperator."""
        self.inner.calibrate()

    def configure(self) -> None:
        """Configure the wrapped teleoperator."""
        self.inner.configure()

    def connect(self, calibrate: bool = True) -> None:
        """Connect the wrapped teleoperator, and start to listen for the key."""
        self.inner.connect(calibrate)
        try:
            from pynput import keyboard

            self._listener = keyboard.Listener(on_press=self._on_press)
            self._listener.start()
        except Exception as error:
            LOG.warning(
                "no key switches the softness, it stays %s: %s",
                "soft" if self.is_soft else "firm",
                error,
            )

    def _on_press(self, key: Any) -> None:
        """Switch between soft and firm at the configured key; called by pynput's thread."""
        name = getattr(key, "name", None) or getattr(key, "char", None)
        if name == self.config.key:
            self.toggle()

    def toggle(self) -> None:
        """Switch between soft and firm."""
        self.is_soft = not self.is_soft
        LOG.info("axes %s: %s", " ".join(self.config.soft), "soft" if self.is_soft else "firm")

    def get_action(self) -> dict[str, Any]:
        """Return the wrapped teleoperator's action, with the force cap of each axis [N] added."""
        action = dict(self.inner.get_action())
        for axis, soft in self.config.soft.items():
            firm = self.config.firm.get(axis, FIRM)
            action[f"{CAP}{axis}{SUFFIX}"] = soft if self.is_soft else firm
        return action

    def send_feedback(self, feedback: Mapping[str, Any]) -> None:
        """Pass feedback to the wrapped teleoperator."""
        self.inner.send_feedback(dict(feedback))

    def __getattr__(self, name: str) -> Any:
        """Return `enable_torque` or `disable_torque` of the wrapped teleoperator, if it has it.

        Before the handover, LeRobot moves a leader that has both to the follower's pose.
        """
        if name in ("enable_torque", "disable_torque"):
            return getattr(self.inner, name)
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

    def disconnect(self) -> None:
        """Stop listening and disconnect the wrapped teleoperator."""
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.stop()
        self.inner.disconnect()
