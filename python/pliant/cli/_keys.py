"""Enter, pressed while a loop runs."""

from __future__ import annotations

import queue
import sys
import threading


class Keys:
    """Lines of standard input, read by a thread of their own."""

    def __init__(self) -> None:
        """Start to listen."""
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True, name="pliant-keys").start()

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)

    def enter(self) -> bool:
        """Whether Enter has been pressed since the last call."""
        pressed = False
        while not self._lines.empty():
            self._lines.get()
            pressed = True
        return pressed
