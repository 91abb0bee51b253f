"""Conversion between joint positions [rad] and LeRobot's motor values: degrees, -100 to 100, ..."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pliant._core import ConfigError
from pliant.config.schema import calibrations, gripper_travel, servos, spec, zeros
from pliant.servo.spec import Units

if TYPE_CHECKING:
    from pliant._core import Model
    from pliant.config.schema import Config


@dataclass(frozen=True)
class MotorUnits:
    """Conversion between the position of a joint [rad] and LeRobot's value for the joint's motor.

    Attributes:
        name: Joint and motor name.
        norm: Unit of the value: degrees from the middle of the range; or -100 to 100, or 0 to 100,
            over the range, with positions beyond the range clipped.
        zero: Encoder count at joint position 0.
        step: Change of the joint position per encoder count, with the sign of the servo [rad].
        range_min, range_max: Ends of the calibrated range [counts].
        resolution: Encoder counts of one turn minus 1, which LeRobot uses for degrees.
        inverted: True if LeRobot inverts values that are not degrees (`drive_mode` 1 of Feetech
            servos).
    """

    name: str
    norm: Literal["degrees", "range_m100_100", "range_0_100"]
    zero: float
    step: float
    range_min: float
    range_max: float
    resolution: int
    inverted: bool = False

    def value(self, position: float) -> float:
        """Return LeRobot's value, in the unit `norm`, of a joint position [rad]."""
        count = self.zero + position / self.step
        low, high = self.range_min, self.range_max
        if self.norm == "degrees":
            return (count - (low + high) / 2.0) * 360.0 / self.resolution
        share = (min(max(count, low), high) - low) / (high - low)
        share = 1.0 - share if self.inverted else share
        return 100.0 * share if self.norm == "range_0_100" else 200.0 * share - 100.0

    def position(self, value: float) -> float:
        """Return the joint position [rad] of LeRobot's value, which is in the unit `norm`."""
        low, high = self.range_min, self.range_max
        if self.norm == "degrees":
            count = (low + high) / 2.0 + value * self.resolution / 360.0
        else:
            share = value / 100.0 if self.norm == "range_0_100" else (value + 100.0) / 200.0
            share = min(max(share, 0.0), 1.0)
            count = low + (high - low) * (1.0 - share if self.inverted else share)
        return (count - self.zero) * self.step


def motor_units(config: Config, model: Model, *, use_degrees: bool = True) -> dict[str, MotorUnits]:
    """Return the conversion of each motor of a configuration by joint name, the gripper last.

    Ranges come from the calibration file. Without a calibration, the range of a joint is given by
    the position limits of the model, the range of the gripper by its open and closed positions.

    Args:
        config: The configuration.
        model: Robot model of the configuration.
        use_degrees: True: joints in degrees; False: -100 to 100. A gripper is 0 to 100.

    Raises:
        ConfigError: The file has no servos, or `pliant.config.schema.zeros` fails.
    """
    if not config.servo:
        raise ConfigError(
            f"{config.source}: LeRobot's values are those of servos: give every joint its servo in "
            "[servo]"
        )
    entries, counts = calibrations(config), zeros(config)
    ends = dict(zip(model.joint_names, zip(model.lower, model.upper, strict=True), strict=True))
    out: dict[str, MotorUnits] = {}
    for joint, servo in servos(config).items():
        unit = Units.of(spec(joint, servo, port=servo.port, zero=counts[joint]))
        step, entry = unit.sign * unit.count, entries.get(joint)
        on_chain = joint in ends
        if entry is not None:
            low, high = float(entry.range_min), float(entry.range_max)
        else:
            travel = ends[joint] if on_chain else gripper_travel(config)
            low, high = sorted(float(unit.zero + end / step) for end in travel)
        out[joint] = MotorUnits(
            name=joint,
            norm=("degrees" if use_degrees else "range_m100_100") if on_chain else "range_0_100",
            zero=unit.zero,
            step=step,
            range_min=low,
            range_max=high,
            resolution=int(unit.row.counts_per_turn) - 1,
            inverted=entry is not None
            and bool(entry.drive_mode)
            and unit.row.family.status == "feetech",
        )
    return out
