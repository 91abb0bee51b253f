"""Configuration files of an arm (TOML): robot, ports, servos, settings, loop.

    >>> config = pliant.config.load("so101")          # a ready file, or a path
    >>> config = pliant.config.load("my_arm.toml")
    >>> model, settings = config.model(), config.settings()

An error names the file, the key, the value and the allowed values. Nothing is opened before the
whole file is valid.
"""

from pliant.config.factory import connect
from pliant.config.lerobot import Calibration, read_calibration
from pliant.config.loader import describe_arm, list_arms, load, parse
from pliant.config.schema import Config

__all__ = [
    "Calibration",
    "Config",
    "connect",
    "describe_arm",
    "list_arms",
    "load",
    "parse",
    "read_calibration",
]
