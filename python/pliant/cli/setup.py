"""`pliant setup`: the only command that writes EEPROM; shows what, asks, reads back, can undo."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from pliant import ConfigError, ServoError
from pliant.cli.flags import ArmName, File, Wired
from pliant.config import assemble
from pliant.servo import RustypotTransport
from pliant.servo.settle import Change, apply, changes, restore

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pliant.config import Config
    from pliant.servo import ServoSpec, Transport


def run(
    arm: ArmName,
    *,
    yes: bool = False,
    keep_overload: bool = False,
    undo: File = None,
    backup: Path = Path("pliant-setup.json"),
    override: Wired,
) -> None:
    """Set the servos' EEPROM up for compliant control; LeRobot's own values stay as they are.

    Args:
        arm: Configuration file, or the name of a ready one.
        yes: Do not ask.
        keep_overload: Leave the servos' overload shutdown on: they may drop a compliant arm.
        undo: Backup of an earlier set-up whose values are to be put back.
        backup: Where the old values go.
        override: What the command line says in place of the file.
    """
    former = None if undo is None else restore(_load(undo))
    read = override.load(arm)
    console = Console()
    specs = assemble.specs(read, assemble.paths(read))
    with _Ports(read, specs) as ports:
        if former is None:
            wanted = [
                change
                for spec in specs
                for number, _ in spec.servos
                for change in changes(
                    ports[spec.port], spec.name, number, spec.row, overload=not keep_overload
                )
            ]
        else:
            wanted = former
        if not wanted:
            console.print("nothing to change" + ("; no backup is written" if undo is None else ""))
            return
        _show(console, wanted)
        if not yes and console.input("write this? [y/N] ").strip().lower() not in {"y", "yes"}:
            raise ConfigError("nothing was written")
        if undo is None:
            _save(backup, wanted)
        for spec in specs:
            for number, _ in spec.servos:
                own = [c for c in wanted if c.joint == spec.name and c.id == number]
                apply(ports[spec.port], spec.row.family, own)
    console.print(f"{len(wanted)} registers written and read back")
    again = " ".join(["pliant doctor", arm, "--watch", *override.words()])
    console.print(
        f"before torque comes on, see its directions: {again}",
        highlight=False,
        soft_wrap=True,
    )
    if undo is None:
        console.print(f"old values in {backup}; pliant setup {arm} --undo {backup} puts them back")


class _Ports:
    """The open ports by path."""

    def __init__(self, config: Config, specs: list[ServoSpec]) -> None:
        paths = assemble.paths(config)
        bauds = {paths[port.name]: port.baud for port in config.port}
        protocols = {spec.port: spec.row.family.protocol for spec in specs}
        self._wanted = {path: (bauds[path], protocol) for path, protocol in protocols.items()}
        self._open: dict[str, Transport] = {}

    def __enter__(self) -> _Ports:
        for path, (baud, protocol) in self._wanted.items():
            self._open[path] = RustypotTransport(path, baud, protocol, timeout=0.05)
        return self

    def __exit__(self, *_: object) -> None:
        for io in self._open.values():
            io.close()

    def __getitem__(self, path: str) -> Transport:
        return self._open[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self._open)


def _show(console: Console, wanted: list[Change]) -> None:
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title="EEPROM", title_justify="left")
    for heading in ("joint", "id", "register", "is", "becomes", "so that it"):
        table.add_column(heading)
    for change in wanted:
        cells = (change.joint, change.id, change.register, change.old, change.new, change.why)
        table.add_row(*map(str, cells))
    console.print(table)


def _save(path: Path, wanted: list[Change]) -> None:
    """Old values first: what is not saved is not written."""
    if path.exists():
        raise ConfigError(f"{path} exists: old values would be lost; give another --backup")
    path.write_text(json.dumps([asdict(change) for change in wanted], indent=1), encoding="utf-8")


def _load(path: Path) -> list[Change]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return [Change(**entry) for entry in data]
    except FileNotFoundError:
        raise  # the command line says which files there are
    except (OSError, ValueError, TypeError) as error:
        raise ServoError(f"{path} is no backup of pliant setup: {error}") from error
