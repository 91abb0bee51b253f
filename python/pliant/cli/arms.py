"""`pliant arms`: the ready arms, and the configuration file of one."""

from __future__ import annotations

import difflib
import sys
from typing import Annotated

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from pliant import config
from pliant._core import ConfigError
from pliant.config import loader

#: Optional name of a ready arm.
Name = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]


def run(name: Name = "") -> None:
    """List the ready arms, or print the configuration file of one.

    To start a file of your own: pliant arms so101 > my_arm.toml

    Args:
        name: Ready arm whose file is printed. Default: a list of all.
    """
    if not name:
        Console().print(_table())
        return
    names = loader.list_arms()
    if name not in names:
        close = difflib.get_close_matches(name, names, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ConfigError(f"no ready arm is called {name!r}; there are {', '.join(names)}{hint}")
    sys.stdout.write(loader.builtin_text(name))


def _table() -> Table:
    """Return one row per arm: name, joints, servos, source of its URDF."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("name", "joints", "servos", "URDF"):
        table.add_column(heading, justify="right" if heading == "joints" else "left")
    for name in loader.list_arms():
        read = config.load(name)
        servos = dict.fromkeys(servo.model for servo in read.servo.values())
        gripper = "" if read.gripper is None else " + gripper"
        urdf = "included" if read.robot.builtin else "to be given"
        table.add_row(name, f"{len(read.servo)}{gripper}", ", ".join(servos), urdf)
    return table
