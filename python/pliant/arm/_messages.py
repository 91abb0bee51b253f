"""Messages about an arm, written by a separate thread so that output never blocks a descent."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import sys
import threading
import time
from typing import NoReturn

#: Logger of all messages. Without a handler, INFO and above go to standard error.
LOGGER = logging.getLogger("pliant.arm")
#: Least time between a progress line and the line before it, without a terminal [s].
PROGRESS_PERIOD = 5.0
#: Width of a terminal that does not report one [columns].
WIDTH = 80
#: Longest wait for messages at the end of a descent [s].
FLUSH_TIMEOUT = 0.3


class Message:
    """A queued line.

    Attributes:
        text: The line.
        level: As in `logging`.
        progress: Whether a later line may overwrite it on a terminal.
        is_written: Whether the line was written, or writing failed.
    """

    __slots__ = ("is_written", "level", "progress", "text")

    def __init__(self, text: str, level: int, *, progress: bool = False) -> None:
        """Store the line; it is not written yet."""
        self.text, self.level, self.progress, self.is_written = text, level, progress, False


class MessageQueue:
    """Queue of messages and the thread that writes them.

    `post` never blocks and never raises: signal handlers and the thread that lowers an arm call it.
    """

    def __init__(self) -> None:
        """Start without a thread."""
        self._process = 0
        self._queue: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._last: Message | None = None
        self._blocked: Message | None = None
        self._line_open, self._written = False, -PROGRESS_PERIOD

    def start(self) -> None:
        """Start the thread, once per process; this is not possible in a signal handler."""
        if self._process == os.getpid():
            return
        self._queue, self._last = queue.SimpleQueue(), None
        # Without a thread the arm is still lowered, but without messages.
        with contextlib.suppress(RuntimeError):
            threading.Thread(
                target=self._run, args=(self._queue,), name="pliant-messages", daemon=True
            ).start()
            self._process = os.getpid()

    def post(self, text: str, level: int = logging.INFO, *, progress: bool = False) -> Message:
        """Queue a line."""
        message = Message(text, level, progress=progress)
        if self._process == os.getpid():
            self._last = message
            self._queue.put(message)
        else:
            message.is_written = True
        return message

    def flush(self, within: float = FLUSH_TIMEOUT) -> None:
        """Wait until all lines are written, at most `within` [s]; once per blocked stream."""
        last = self._last
        if last is None or (self._blocked is not None and not self._blocked.is_written):
            return
        deadline = time.monotonic() + within
        while not last.is_written and time.monotonic() < deadline:
            time.sleep(0.002)
        self._blocked = None if last.is_written else last

    def _run(self, lines: queue.SimpleQueue[Message]) -> NoReturn:
        """Write one line after another."""
        while True:
            message = lines.get()
            with contextlib.suppress(Exception):
                self._write(message)
            message.is_written = True

    def _write(self, message: Message) -> None:
        """Pass a line to `logging`, or write it to standard error."""
        now = time.monotonic()
        sparse = message.progress and now - self._written < PROGRESS_PERIOD
        if LOGGER.hasHandlers():
            if not sparse:
                self._written = now
                LOGGER.log(message.level, message.text)
            return
        stream = sys.stderr
        if stream is None or not _is_enabled(message.level):
            return
        text = f"pliant: {message.text}"
        # Bypass the interpreter's stream: a blocked writer would hold its lock forever.
        own = sys.__stderr__
        number = own.fileno() if own is not None and stream is own else None
        if number is not None and os.isatty(number) and os.environ.get("TERM") != "dumb":
            if message.progress:
                width = os.get_terminal_size(number).columns or WIDTH
                text = f"\r\x1b[K{text[: width - 1]}"
            else:
                text = ("\r\x1b[K" if self._line_open else "") + f"{text}\r\n"
            self._line_open = message.progress
        elif sparse:
            return
        else:
            text = f"{text}\n"
        self._written = now
        if number is None:
            stream.write(text)
            stream.flush()
            return
        left = text.encode(errors="replace")
        while left:
            left = left[os.write(number, left) :]


def _is_enabled(level: int) -> bool:
    """Return True if standard error shows this level when `logging` has no handler."""
    if LOGGER.disabled or logging.root.manager.disable >= level:
        return False
    for logger in (LOGGER, logging.getLogger("pliant")):
        if logger.level:
            return level >= logger.level
    return level >= logging.INFO


#: Message queue of this process.
MESSAGES = MessageQueue()
