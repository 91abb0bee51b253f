"""`pliant servos setup`: write the EEPROM of servos after a prompt, or restore the old values."""

from __future__ import annotations

import shlex
import signal
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pliant._core import ConfigError, ServoError
from pliant.arm._signals import HANDLED, exception
from pliant.cli._console import Console, make_table, print_line
from pliant.cli._flags import ArmName, BusFlags, File, Ids
from pliant.cli.servos import _backup as backups
from pliant.config import factory
from pliant.servo import RustypotTransport
from pliant.servo._port import latency_timer
from pliant.servo._transactions import TransactionGuard
from pliant.servo.eeprom import (
    RegisterChange,
    check_set_id,
    plan_restore,
    plan_setup,
    set_id,
    write_changes,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

    from pliant.config import Config
    from pliant.servo import ServoSpec, Transport


def run(
    arm: ArmName,
    *,
    yes: bool = False,
    keep_overload: bool = False,
    undo: File = None,
    backup: Path = Path("pliant-setup.json"),
    set_id: Ids = None,
    override: BusFlags,
) -> None:
    """Write the servos' EEPROM for compliant control; values that LeRobot sets stay unchanged.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        yes: Write without a prompt.
        keep_overload: Keep the servos' overload shutdown, which may drop a compliant arm.
        undo: Backup of an earlier setup, whose old values are written back.
        backup: File to which the old values are saved.
        set_id: Change the id of one servo from OLD to NEW, and do nothing else. Connect only that
            servo; NEW is an id of the configuration.
        override: Values that replace those of the configuration file.
    """
    if set_id is not None and undo is not None:
        raise ConfigError(
            "--set-id and --undo do not go together: --set-id NEW:OLD puts an id back"
        )
    ids = None if set_id is None else _ids(set_id)
    old_changes = None if undo is None else backups.load(undo, arm)
    arm_config = override.load(arm)
    console = Console()
    specs = factory.servo_specs(arm_config, factory.port_paths(arm_config))
    if ids is not None:
        _assign_id(arm_config, specs, *ids, console, yes=yes)
        return
    if undo is not None and old_changes is not None:
        backups.check(undo, old_changes, specs)
    with _Ports(arm_config, specs) as ports:
        planned: list[RegisterChange] = []
        for spec in specs:
            for number, _ in spec.servos:
                servo = ports[spec.port], spec.name, number, spec.row
                planned += (
                    plan_setup(*servo, overload=not keep_overload)
                    if old_changes is None
                    else plan_restore(*servo, old_changes)
                )
        if not planned:
            console.print("nothing to change" + ("; no backup is written" if undo is None else ""))
            return
        _show(console, planned)
        _confirm(console, yes=yes)
        name, flags = shlex.quote(arm), override.as_arguments()
        if undo is None:
            backups.save(backup, arm, planned)
            # Print the undo command before the first write, in case of an interruption.
            restore = ["pliant servos setup", name, "--undo", shlex.quote(str(backup)), *flags]
            print_line(f"old values in {backup}; this puts them back: {' '.join(restore)}", console)
        _write(ports, specs, planned)
    console.print(f"{len(planned)} registers written and read back")
    check = " ".join(["pliant servos doctor", name, "--watch", *flags])
    print_line(f"before torque on, check the directions of the joints: {check}", console)


def _write(ports: _Ports, specs: list[ServoSpec], planned: list[RegisterChange]) -> None:
    """Write all planned changes; after an error of one servo, the other servos are still written.

    Raises:
        ServoError: Some changes were not written; the message names them.
    """
    errors, again = [], "the same command shows what is left to write"
    try:
        for spec in specs:
            for number, _ in spec.servos:
                changes = [c for c in planned if c.joint == spec.name and c.id == number]
                try:
                    with _signals_deferred():
                        write_changes(ports[spec.port], spec.row.family, changes)
                except ServoError as error:
                    errors.append(str(error))
    except (KeyboardInterrupt, SystemExit):
        Console(stderr=True).print(f"interrupted: {again}")
        raise
    if errors:
        raise ServoError("\n".join([*dict.fromkeys(errors), again]))


@contextmanager
def _signals_deferred() -> Iterator[None]:
    """Defer signals that would end the program until the EEPROM of a servo is locked again.

    Raises:
        KeyboardInterrupt, SystemExit: A signal came; an exit code of 143 stands for SIGTERM.
    """
    pending: list[int] = []

    def store(number: int, _: FrameType | None) -> None:
        pending.append(number)

    former = {}
    try:
        is_main = threading.current_thread() is threading.main_thread()
        for number in HANDLED if is_main else ():
            if signal.getsignal(number) not in {None, signal.SIG_IGN}:
                former[number] = signal.signal(number, store)
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
        if pending:
            raise exception(pending[0])


def _ids(text: str) -> tuple[int, int]:
    """Return old and new servo id from the value OLD:NEW of `--set-id`.

    Raises:
        ConfigError: The text is not a pair of different ids.
    """
    parts = text.split(":")
    if len(parts) != 2 or not all(part.isdecimal() for part in parts):
        raise ConfigError(f"--set-id is OLD:NEW, as in 1:6, got {text!r}")
    old, new = map(int, parts)
    if old == new:
        raise ConfigError(f"--set-id {text}: the ids are the same")
    return old, new


def _assign_id(
    arm_config: Config, specs: list[ServoSpec], old: int, new: int, console: Console, *, yes: bool
) -> None:
    """Change the id of the only connected servo from `old` to `new`, after a prompt."""
    owners = [spec for spec in specs if new in dict(spec.servos)]
    if len(owners) != 1:
        known = ", ".join(f"{n} ({spec.name})" for spec in specs for n, _ in spec.servos)
        raise ConfigError(
            f"--set-id: id {new} is not the id of exactly one joint; there are {known}"
        )
    (spec,) = owners
    with _Ports(arm_config, specs) as ports:
        io = ports[spec.port]
        check_set_id(io, spec.name, spec.row, old, new)
        _show(console, [RegisterChange(spec.name, old, "id", old, new, "has an id of its own")])
        _confirm(console, yes=yes)
        with _signals_deferred():
            set_id(io, spec.name, spec.row, old, new)
    console.print(f"the servo of {spec.name} answers to id {new} now", highlight=False)


def _confirm(console: Console, *, yes: bool) -> None:
    """Ask the user to confirm, unless `yes`; exit with code 1 without confirmation."""
    with suppress(EOFError):
        if yes or console.input("write this? [y/N] ").strip().lower() in {"y", "yes"}:
            return
    Console(stderr=True).print("cancelled: nothing was written", highlight=False)
    raise SystemExit(1)


class _Ports:
    """Context manager that opens the arm's serial ports; repeats requests without a reply."""

    def __init__(self, config: Config, specs: list[ServoSpec]) -> None:
        paths = factory.port_paths(config)
        bauds = {paths[port.name]: port.baud for port in config.port}
        protocols = {spec.port: spec.row.family.protocol for spec in specs}
        self._settings = {path: (bauds[path], protocol) for path, protocol in protocols.items()}
        self._open: list[Transport] = []
        self._guards: dict[str, TransactionGuard] = {}

    def __enter__(self) -> _Ports:
        for path, (baud, protocol) in self._settings.items():
            self._open.append(RustypotTransport(path, baud, protocol))
            latency = latency_timer(path) or 0.001
            self._guards[path] = TransactionGuard(
                self._open[-1], protocol, baudrate=baud, latency=latency
            )
        return self

    def __exit__(self, *_: object) -> None:
        for io in self._open:
            io.close()

    def __getitem__(self, path: str) -> TransactionGuard:
        return self._guards[path]


def _show(console: Console, planned: list[RegisterChange]) -> None:
    headings = ("joint", "id", "register", "is", "becomes", "so that it")
    table = make_table(*headings, title="EEPROM", title_justify="left")
    for change in planned:
        cells = (change.joint, change.id, change.register, change.old, change.new, change.why)
        table.add_row(*map(str, cells))
    console.print(table)
