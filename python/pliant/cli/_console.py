"""Output of plain lines, and detection of the Enter key while a loop runs."""

from __future__ import annotations

import queue
import sys
import threading

from rich.console import Console


def print_line(text: str, console: Console | None = None) -> None:
    """Print a line as it is: not wrapped, not coloured, without markup."""
    (console or Console()).print(text, highlight=False, soft_wrap=True, markup=False)


class EnterKey:
    """Lines of standard input, read in a separate thread."""

    def __init__(self) -> None:
        """Start the thread."""
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True, name="pliant-keys").start()

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)

    def pressed(self) -> bool:
        """Return True if Enter has been pressed since the last call."""
        pressed = False
        while not self._lines.empty():
            self._lines.get()
            pressed = True
        return pressed
