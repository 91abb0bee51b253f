"""Files that describe an arm: robot, ports, servos, settings, loop; read from TOML, checked whole.

    >>> config = pliant.config.load("so101")          # a ready file, or a path
    >>> config = pliant.config.load("my_arm.toml")
    >>> model, settings = config.model(), config.settings()

A mistake is an error that names the file, the key, the value and what would be right; nothing is
opened before the whole file is good.
"""

from pliant.config.lerobot import Calibration, read_calibration
from pliant.config.load import load, parse
from pliant.config.ready import describe, names
from pliant.config.schema import Config

__all__ = ["Calibration", "Config", "describe", "load", "names", "parse", "read_calibration"]
