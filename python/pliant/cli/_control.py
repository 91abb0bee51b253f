"""Settings and control loop of the commands that control an arm."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError, Controller
from pliant.arm._checks import setting
from pliant.cli._flags import check_duration, check_log, make_recorder
from pliant.config._soft import apply_soft
from pliant.loop import Loop

if TYPE_CHECKING:
    from pathlib import Path

    from pliant._core import Settings
    from pliant.arm import Arm
    from pliant.cli._flags import ConfigFlags
    from pliant.config import Config


def load(
    arm: str,
    override: ConfigFlags,
    soft: str,
    *,
    duration: float | None,
    log: Path | None,
    source: str | None = None,
) -> tuple[Config, Settings]:
    """Return an arm's configuration, and its settings with `--soft`; check duration and log.

    The log must not overwrite the configuration, its files or `source`.
    """
    config = override.load(arm)
    check_log(log, [*override.inputs(arm, config), source])
    check_duration(duration)
    return config, apply_soft(config.settings(), soft, config.model(), option="--soft")


def check_settings(arm: Arm, settings: Settings) -> None:
    """Check that the arm can have a controller with these settings, before torque comes on.

    Raises:
        PliantError: The settings do not fit the arm. An error of the task names the table of the
            configuration file that sets it.
    """
    try:
        Controller(arm.model, settings, arm.servos)
    except ConfigError as error:
        if not setting(error).startswith("task."):
            raise
        raise ConfigError(
            f'{error}. In the file it is `task` in [settings], as in task = "xyz"'
        ) from error


def make_loop(
    arm: Arm, settings: Settings, config: Config, *, duration: float | None, log: Path | None
) -> Loop:
    """Return the control loop of a connected arm, with a new controller and the log's recorder."""
    controller = Controller(arm.model, settings, arm.servos)
    recorder = None if log is None else make_recorder(log, config=config)
    return Loop(arm, controller, rate=settings.rate, duration=duration, recorder=recorder)
