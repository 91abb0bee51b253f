"""`pliant arms`: list the configurations in the package, or print one."""

from __future__ import annotations

import difflib
import sys
from typing import TYPE_CHECKING, Annotated

import tyro

from pliant import config
from pliant._core import ConfigError
from pliant.cli._console import Console, make_table
from pliant.config import loader

if TYPE_CHECKING:
    from rich.table import Table

#: Optional name of a configuration in the package.
Name = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]


def run(name: Name = "") -> None:
    """List the arms with a ready configuration file, or print the file of one arm.

    To start your own configuration file: pliant arms so101 > my_arm.toml

    Args:
        name: Arm whose configuration file is printed. Without a name, all arms are listed.
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
    """Return a table with one row per arm: name, number of joints, servo models, URDF."""
    table = make_table("name", "joints", "servos", "URDF", right={"joints"})
    for name in loader.list_arms():
        arm_config = config.load(name)
        servos = dict.fromkeys(servo.model for servo in arm_config.servo.values())
        gripper = "" if arm_config.gripper is None else " + gripper"
        urdf = "included" if arm_config.robot.builtin else "to be given"
        table.add_row(name, f"{len(arm_config.servo)}{gripper}", ", ".join(servos), urdf)
    return table
