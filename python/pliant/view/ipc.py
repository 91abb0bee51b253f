"""The pipe between the loop and the page, which is a separate process.

The loop never waits for the page: it sends a snapshot only after the page has taken the last one,
so the pipe holds at most one. The page cannot starve the loop: messages are merged at both ends,
and a tick takes a bounded number of them.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from pliant._core import PliantError
from pliant.view.messages import Edit, Message, Queue

if TYPE_CHECKING:
    from types import TracebackType

    from pliant.view.snapshot import SceneInfo, Snapshot

#: Largest rate of snapshots [Hz].
FRAMES = 30.0
#: Timeout for the start and the end of the page [s].
TIMEOUT = 30.0
#: Least period of messages from the page [s], and messages taken per poll of the pipe.
PASSED, WORDS = 0.02, 4
#: Least time between two edits of the settings [s].
EDITS = 0.05


class PageGone(PliantError):
    """The page's process has ended."""


class Ack:
    """Message of either end: it has taken what was sent, and the next may come."""


@dataclass(frozen=True)
class Ready:
    """First message of the page: its link, with the token."""

    link: str


@dataclass(frozen=True)
class StartupError:
    """Only message of a page that cannot start: the reason."""

    text: str


class Link:
    """The loop's end of the pipe. `with` starts the page and ends it.

    Args:
        host: Address on which the page listens.
        port: Port; the next free one is taken.

    Attributes:
        address: Link of the page.

    Raises:
        PliantError: The page does not start; the message gives the reason.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Start the process, and wait until it listens."""
        ours, theirs = socket.socketpair()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pliant.view.page", str(theirs.fileno()), host, str(port)],
            pass_fds=(theirs.fileno(),),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            # Ctrl-C must only reach the loop; the page ends with its pipe.
            start_new_session=True,
        )
        theirs.close()
        self._pipe = Connection(ours.detach())
        self._free, self._due = True, 0.0
        self._waiting, self._edit_due = Queue(), 0.0
        self.address = self._wait_for_page()

    def _wait_for_page(self) -> str:
        first: Any = None
        with contextlib.suppress(EOFError, OSError):
            if self._pipe.poll(TIMEOUT):
                first = self._pipe.recv()
        if isinstance(first, Ready):
            return first.link
        self.close()
        if isinstance(first, StartupError):
            raise PliantError(first.text)
        raise PliantError("the page's process did not start; its output is above")

    def messages(self) -> list[Message]:
        """Return the next messages: at most `PER_TICK`, edits at a bounded rate.

        Raises:
            PageGone: The page's process has ended.
        """
        if not self._listen():
            raise PageGone("the page's process has ended, so it could no longer stop the arm")
        now = time.perf_counter()
        out = self._waiting.take(edit=now >= self._edit_due)
        if any(isinstance(message, Edit) for message in out):
            self._edit_due = now + EDITS
        return out

    def _listen(self) -> bool:
        """Receive messages, within bounds; return False if the page has ended."""
        try:
            for _ in range(WORDS):
                if not self._pipe.poll():
                    break
                heard = self._pipe.recv()
                if isinstance(heard, Ack):
                    self._free = True
                    continue
                self._pipe.send(Ack())
                for message in heard:
                    self._waiting.put(message)
        except (EOFError, OSError):
            return False
        return True

    def due(self) -> bool:
        """Return True if a snapshot is due now; False if the page has ended."""
        return time.perf_counter() >= self._due and self._listen() and self._free

    def send(self, snapshot: Snapshot | SceneInfo) -> None:
        """Send a snapshot when one is `due`, or the scene at any time.

        Raises:
            PageGone: The page's process has ended.
        """
        self._due, self._free = time.perf_counter() + 1.0 / FRAMES, False
        try:
            self._pipe.send(snapshot)
        except OSError:
            raise PageGone("the page's process has ended") from None

    def close(self) -> None:
        """Close the pipe and wait for the page to end."""
        self._pipe.close()
        try:
            self._process.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> Link:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class PageEndpoint:
    """The page's end of the pipe. It sends messages only after the loop has taken the last ones.

    Otherwise a flood of messages could fill the pipe, and both ends would block.
    """

    def __init__(self, descriptor: int) -> None:
        """Take over the inherited end of the pipe."""
        os.set_inheritable(descriptor, False)
        self._pipe, self._lock = Connection(descriptor), threading.Lock()
        self._waiting, self._changed, self._free = Queue(), threading.Condition(), True
        self._words: SimpleQueue[Any] = SimpleQueue()
        for work in (self._sort_incoming, self._forward):
            threading.Thread(target=work, daemon=True).start()

    def send(self, word: Ready | StartupError | Ack | list[Message]) -> None:
        """Send a message to the loop; ignore errors if the loop has ended."""
        with self._lock, contextlib.suppress(OSError):
            self._pipe.send(word)

    def queue(self, message: Message) -> None:
        """Queue a message, which a later one may replace; never blocks."""
        with self._changed:
            self._waiting.put(message)
            self._changed.notify()

    def receive(self) -> Any:
        """Return the next scene or snapshot and acknowledge it; None once the loop has ended."""
        word = self._words.get()
        if word is not None:
            self.send(Ack())
        return word

    def _sort_incoming(self) -> None:
        """Receive and sort messages of the loop."""
        while True:
            try:
                word = self._pipe.recv()
            except (EOFError, OSError):
                self._words.put(None)
                return
            if not isinstance(word, Ack):
                self._words.put(word)
                continue
            with self._changed:
                self._free = True
                self._changed.notify()

    def _forward(self) -> None:
        """Send queued messages, a few at a time."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._free and len(self._waiting) > 0)
                out, self._free = self._waiting.take(), False
            self.send(out)
            time.sleep(PASSED)
