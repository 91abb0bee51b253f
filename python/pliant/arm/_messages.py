"""Messages to the user, written by a separate thread so that output never blocks a descent.

A descent is the lowering of an arm until it rests.
"""

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
#: Shortest time between two progress messages in a log or file [s]; on a terminal, each progress
#: message overwrites the previous one instead.
PROGRESS_PERIOD = 5.0
#: Assumed width of a terminal that does not report its width [columns].
WIDTH = 80
#: Longest wait at the end of a descent until all messages are written [s].
FLUSH_TIMEOUT = 0.3


class Message:
    """Line of text in the message queue.

    Attributes:
        text: The line.
        level: Level of the module `logging`.
        progress: True if a later line may overwrite this line on a terminal.
        is_written: True if the line was written, or if writing failed.
    """

    __slots__ = ("is_written", "level", "progress", "text")

    def __init__(self, text: str, level: int, *, progress: bool = False) -> None:
        """Store the line `text`, marked as not yet written."""
        self.text, self.level, self.progress, self.is_written = text, level, progress, False


class MessageQueue:
    """Queue of messages and the thread that writes them.

    `post` never blocks and never raises: signal handlers and the thread that lowers an arm call it.
    """

    def __init__(self) -> None:
        """Create an empty queue without a thread."""
        self._process = 0
        self._queue: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._last: Message | None = None
        self._blocked: Message | None = None
        self._line_open, self._last_write_time = False, -PROGRESS_PERIOD

    def start(self) -> None:
        """Start the thread that writes, once per process; signal handlers must not call this."""
        if self._process == os.getpid():
            return
        self._queue, self._last = queue.SimpleQueue(), None
        # Ignore a failure to start the thread: the arm can then be lowered without messages.
        with contextlib.suppress(RuntimeError):
            threading.Thread(
                target=self._run, args=(self._queue,), name="pliant-messages", daemon=True
            ).start()
            self._process = os.getpid()

    def post(self, text: str, level: int = logging.INFO, *, progress: bool = False) -> Message:
        """Append a message to the queue and return it; without a running thread, discard it."""
        message = Message(text, level, progress=progress)
        if self._process == os.getpid():
            self._last = message
            self._queue.put(message)
        else:
            message.is_written = True
        return message

    def flush(self, within: float = FLUSH_TIMEOUT) -> None:
        """Wait until all messages are written, at most `within` [s].

        Return immediately if the last call timed out and its last message is still not written.
        """
        last = self._last
        if last is None or (self._blocked is not None and not self._blocked.is_written):
            return
        deadline = time.monotonic() + within
        while not last.is_written and time.monotonic() < deadline:
            time.sleep(0.002)
        self._blocked = None if last.is_written else last

    def _run(self, lines: queue.SimpleQueue[Message]) -> NoReturn:
        """Write the messages of the queue `lines` in order, without end; the thread runs this."""
        while True:
            message = lines.get()
            with contextlib.suppress(Exception):
                self._write(message)
            message.is_written = True

    def _write(self, message: Message) -> None:
        """Pass a message to `logging` if it has a handler, else write it to standard error."""
        now = time.monotonic()
        is_too_soon = message.progress and now - self._last_write_time < PROGRESS_PERIOD
        if LOGGER.hasHandlers():
            if not is_too_soon:
                self._last_write_time = now
                LOGGER.log(message.level, message.text)
            return
        stream = sys.stderr
        if stream is None or not _is_enabled(message.level):
            return
        text = f"pliant: {message.text}"
        # Write to the file descriptor: a blocked write to Python's stream would hold its lock.
        stderr = sys.__stderr__
        number = stderr.fileno() if stderr is not None and stream is stderr else None
        if number is not None and os.isatty(number) and os.environ.get("TERM") != "dumb":
            if message.progress:
                width = os.get_terminal_size(number).columns or WIDTH
                text = f"\r\x1b[K{text[: width - 1]}"
            else:
                text = ("\r\x1b[K" if self._line_open else "") + f"{text}\r\n"
            self._line_open = message.progress
        elif is_too_soon:
            return
        else:
            text = f"{text}\n"
        self._last_write_time = now
        if number is None:
            stream.write(text)
            stream.flush()
            return
        data = text.encode(errors="replace")
        while data:
            data = data[os.write(number, data) :]


def _is_enabled(level: int) -> bool:
    """Return True if messages of this level go to standard error when `logging` has no handler."""
    if LOGGER.disabled or logging.root.manager.disable >= level:
        return False
    for logger in (LOGGER, logging.getLogger("pliant")):
        if logger.level:
            return level >= logger.level
    return level >= logging.INFO


#: Message queue of this process.
MESSAGES = MessageQueue()
