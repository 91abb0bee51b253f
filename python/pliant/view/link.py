"""The pipe between the loop and the page, which is a separate process.

The loop never waits for the page: it sends a snapshot only after the page has taken the last one,
so the pipe holds at most one. The page cannot starve the loop: orders are merged at both ends, and
a tick takes a bounded number of them.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from pliant._core import PliantError
from pliant.view.orders import Edit, Order, Queue

if TYPE_CHECKING:
    from types import TracebackType

    from pliant.view.snapshot import Snapshot, Stage

#: Largest rate of snapshots [Hz].
FRAMES = 30.0
#: Timeout for the start and the end of the page [s].
PATIENCE = 30.0
#: Least period of orders from the page [s], and messages taken per poll of the pipe.
PASSED, WORDS = 0.02, 4
#: Least time between two edits of the settings [s].
EDITS = 0.05


class PageGone(PliantError):
    """The page's process has ended."""


class Taken:
    """Message of the page: it has taken a snapshot."""


class Heard:
    """Message of the loop: it has taken the orders, and the next may be sent."""


class Ready:
    """First message of the page: its link."""

    def __init__(self, link: str) -> None:
        """Store the link, with the token."""
        self.link = link


class Failed:
    """Only message of a page that cannot start."""

    def __init__(self, text: str) -> None:
        """Store the reason."""
        self.text = text


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
        self.address = self._come_up()

    def _come_up(self) -> str:
        first: Any = None
        with contextlib.suppress(EOFError, OSError):
            if self._pipe.poll(PATIENCE):
                first = self._pipe.recv()
        if isinstance(first, Ready):
            return first.link
        self.close()
        if isinstance(first, Failed):
            raise PliantError(first.text)
        raise PliantError("the page's process did not start; its output is above")

    def orders(self) -> list[Order]:
        """Return the next orders of the page: at most `orders.PER_TICK`, edits at a bounded rate.

        Raises:
            PageGone: The page's process has ended.
        """
        if not self._listen():
            raise PageGone("the page's process has ended, so it could no longer stop the arm")
        now = time.perf_counter()
        out = self._waiting.take(edit=now >= self._edit_due)
        if any(isinstance(order, Edit) for order in out):
            self._edit_due = now + EDITS
        return out

    def _listen(self) -> bool:
        """Receive messages, within bounds; return False if the page has ended."""
        try:
            for _ in range(WORDS):
                if not self._pipe.poll():
                    break
                heard = self._pipe.recv()
                if isinstance(heard, Taken):
                    self._free = True
                    continue
                self._pipe.send(Heard())
                for order in heard:
                    self._waiting.put(order)
        except (EOFError, OSError):
            return False
        return True

    def due(self) -> bool:
        """Return True if a snapshot is due now; False if the page has ended."""
        return time.perf_counter() >= self._due and self._listen() and self._free

    def send(self, snapshot: Snapshot | Stage) -> None:
        """Send a snapshot when one is `due`, or a stage at any time.

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
            self._process.wait(PATIENCE)
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


class Ear:
    """The page's end of the pipe. It sends orders only after the loop has taken the last ones.

    Otherwise a flood of orders could fill the pipe, and both ends would block.
    """

    def __init__(self, descriptor: int) -> None:
        """Take over the inherited end of the pipe."""
        os.set_inheritable(descriptor, False)
        self._pipe, self._lock = Connection(descriptor), threading.Lock()
        self._waiting, self._changed, self._free = Queue(), threading.Condition(), True
        self._words: SimpleQueue[Any] = SimpleQueue()
        for work in (self._receive, self._pass_on):
            threading.Thread(target=work, daemon=True).start()

    def say(self, word: Ready | Failed | Taken | list[Order]) -> None:
        """Send a message to the loop; ignore errors if the loop has ended."""
        with self._lock, contextlib.suppress(OSError):
            self._pipe.send(word)

    def ask(self, order: Order) -> None:
        """Queue an order, which a later one may replace; never blocks."""
        with self._changed:
            self._waiting.put(order)
            self._changed.notify()

    def listen(self) -> Any:
        """Return the next stage or snapshot and acknowledge it; None once the loop has ended."""
        word = self._words.get()
        if word is not None:
            self.say(Taken())
        return word

    def _receive(self) -> None:
        """Receive and sort messages of the loop."""
        while True:
            try:
                word = self._pipe.recv()
            except (EOFError, OSError):
                self._words.put(None)
                return
            if not isinstance(word, Heard):
                self._words.put(word)
                continue
            with self._changed:
                self._free = True
                self._changed.notify()

    def _pass_on(self) -> None:
        """Send queued orders, a few at a time."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._free and len(self._waiting) > 0)
                out, self._free = self._waiting.take(), False
            self.say(out)
            time.sleep(PASSED)
