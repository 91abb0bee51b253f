"""Configuration files of an arm (TOML): robot, ports, servos, settings, loop.

    >>> config = pliant.config.load("so101")          # a built-in file
    >>> config = pliant.config.load("my_arm.toml")    # a path
    >>> model, settings = config.model(), config.settings()

An error names the file, the key, the value and the allowed values. The whole file is validated
before a port is opened.
"""

from pliant.config.factory import connect
from pliant.config.lerobot import Calibration, find_calibration, read_calibration
from pliant.config.loader import describe_arm, list_arms, load, parse
from pliant.config.motor_units import MotorUnits, motor_units
from pliant.config.schema import Config

__all__ = [
    "Calibration",
    "Config",
    "MotorUnits",
    "connect",
    "describe_arm",
    "find_calibration",
    "list_arms",
    "load",
    "motor_units",
    "parse",
    "read_calibration",
]
