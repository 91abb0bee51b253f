"""Printing of lines and of the summary of a loop, and lines typed during a loop."""

from __future__ import annotations

import contextlib
import queue
import sys
import threading
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console as RichConsole
from rich.table import Table

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pliant.arm import Arm
    from pliant.loop import Loop


class Console(RichConsole):
    """Console that raises `BrokenPipeError` where the reader of the output has gone.

    The base class ends the program with the exit code of a declined prompt.
    """

    def on_broken_pipe(self) -> None:
        """Raise the `BrokenPipeError` that is being handled."""
        # The base class calls this method in its `except BrokenPipeError`.
        raise  # noqa: PLE0704


def print_line(text: str, console: Console | None = None) -> None:
    """Print a line without wrapping, colours or markup; on stdout if `console` is None."""
    (console or Console()).print(text, highlight=False, soft_wrap=True, markup=False)


def print_summary(arm: Arm, loop: Loop, notes: Sequence[str] = ()) -> None:
    """Print notes, then number, lateness and misses of ticks, and bus counters that are not 0."""
    for note in notes:
        print_line(note)
    counts = ", ".join(f"{name} {count}" for name, count in arm.counters.items() if count)
    Console().print(
        f"{len(loop.lateness)} ticks, late by {loop.lateness}; {loop.missed} missed; bus: {counts}",
        highlight=False,
    )


def make_table(*headings: str, right: Collection[str] = (), **options: Any) -> Table:
    """Return a table without rows; the columns `right` are aligned to the right.

    `options` are those of `rich.table.Table`.
    """
    table = Table(box=SIMPLE_HEAD, pad_edge=False, **options)
    for heading in headings:
        table.add_column(heading, justify="right" if heading in right else "left")
    return table


class Keyboard:
    """Lines from standard input; a thread reads them, so no method blocks."""

    def __init__(self) -> None:
        """Start the thread that reads standard input."""
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True, name="pliant-keys").start()

    def _read(self) -> None:
        # An unreadable stream counts as ended.
        with contextlib.suppress(OSError, ValueError):
            for line in sys.stdin or ():
                self._lines.put(line)
        self._lines.put(None)

    def pressed(self) -> bool:
        """Return True if Enter has been pressed since the last call of this method."""
        pressed = False
        while not self._lines.empty():
            if self._lines.get() is None:
                self._lines.put(None)  # for `line`
                break
            pressed = True
        return pressed

    def discard(self) -> None:
        """Discard lines that were typed before a question is shown; keep the lines of a script."""
        if sys.stdin is not None and sys.stdin.isatty():
            self.pressed()

    def line(self) -> str | None:
        """Return the next line, or None if there is none yet.

        Raises:
            ConfigError: Standard input has ended.
        """
        if self._lines.empty():
            return None
        line = self._lines.get()
        if line is None:
            self._lines.put(None)
            raise ConfigError("standard input ended before the last answer")
        return line
