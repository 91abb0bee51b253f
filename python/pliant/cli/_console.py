"""Printing of unformatted lines, and detection of the Enter key while a control loop runs."""

from __future__ import annotations

import queue
import sys
import threading

from rich.console import Console


def print_line(text: str, console: Console | None = None) -> None:
    """Print a line without wrapping, colours or markup; on stdout if `console` is None."""
    (console or Console()).print(text, highlight=False, soft_wrap=True, markup=False)


class EnterKey:
    """Detector of the Enter key; a separate thread reads standard input, so nothing blocks."""

    def __init__(self) -> None:
        """Start the thread that reads standard input."""
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True, name="pliant-keys").start()

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)

    def pressed(self) -> bool:
        """Return True if Enter has been pressed since the last call of this method."""
        pressed = False
        while not self._lines.empty():
            self._lines.get()
            pressed = True
        return pressed
