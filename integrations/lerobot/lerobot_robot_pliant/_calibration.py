"""Configuration of an arm, with the calibration that LeRobot has of the arm."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Literal

import pliant
from pliant.config import Config, find_calibration

if TYPE_CHECKING:
    from pathlib import Path

LOG = logging.getLogger(__name__)


def load_file(device: Any, kind: Literal["robots", "teleoperators"]) -> Config:
    """Return the arm's configuration with its calibration.

    Args:
        device: LeRobot's device, with `id`, `calibration_fpath`, and a `config` with `arm`, `port`,
            `backend` and `calibration`.
        kind: `robots`: followers; `teleoperators`: leaders.

    Raises:
        ConfigError: As `pliant.config.load`; or the servos are real, the file gives no zeros, and
            LeRobot has no calibration with this id.
    """
    options = device.config
    replaced: dict[str, Any] = {"port": options.port, "backend": options.backend}
    calibration: Path | None = options.calibration
    file = pliant.config.load(options.arm, calibration=calibration, **replaced)
    has_zeros = any(servo.zero is not None for servo in file.servo.values())
    if file.calibration is not None or file.backend != "bus" or has_zeros:
        return file
    if device.id is None:
        raise pliant.ConfigError(
            "without an id LeRobot's calibration cannot be found: give the id with which the arm "
            "was calibrated (--robot.id, --teleop.id), or the file as `calibration`"
        )
    # A calibration_dir that the user names comes first, then the folders of LeRobot's own arms.
    path: Path = device.calibration_fpath
    if not path.is_file():
        path = find_calibration(device.id, options.arm, kind)
    LOG.info("calibration of %s: %s", device.id, path)
    return pliant.config.load(options.arm, calibration=path, **replaced)
