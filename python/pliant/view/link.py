"""The pipe between the loop and the page, which is a process of its own.

The loop never waits for the page: a snapshot is sent only when the last one has been taken, so the
pipe never holds more than one. The page cannot starve the loop: its orders are coalesced on both
sides, and a tick takes a bounded number of them.
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

from pliant import PliantError
from pliant.view.orders import Edit, Order, Queue

if TYPE_CHECKING:
    from types import TracebackType

    from pliant.view.snapshot import Snapshot, Stage

#: Snapshots per second at most [Hz].
FRAMES = 30.0
#: How long the page may take to come up, and to go [s].
PATIENCE = 30.0
#: How often the page passes orders on at most [s], and the words that one look at the pipe takes.
PASSED, WORDS = 0.02, 4
#: Least time between two edits of the settings [s].
EDITS = 0.05


class PageGone(PliantError):
    """The page's process has ended."""


class Taken:
    """The page's word that it has taken a snapshot."""


class Heard:
    """The loop's word that it has taken orders, and may be sent the next."""


class Ready:
    """The page's first word: where it can be reached."""

    def __init__(self, link: str) -> None:
        """With the token in it."""
        self.link = link


class Failed:
    """The page's only word where it cannot come up."""

    def __init__(self, text: str) -> None:
        """Why."""
        self.text = text


class Link:
    """The loop's end. `with` starts the page and ends it.

    Args:
        host: Address that the page listens on.
        port: Port; the next free one is taken.

    Attributes:
        address: Where the page can be reached.

    Raises:
        PliantError: The page does not come up; says why.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Start the process, and wait until it listens."""
        ours, theirs = socket.socketpair()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pliant.view.page", str(theirs.fileno()), host, str(port)],
            pass_fds=(theirs.fileno(),),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            # Ctrl-C is for the loop; the page ends with its pipe.
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
        raise PliantError("the page's process did not come up; its own words stand above")

    def orders(self) -> list[Order]:
        """Return what the page asks for next: `orders.PER_TICK` at most, and edits not too often.

        Raises:
            PageGone: Its process has ended.
        """
        if not self._listen():
            raise PageGone(
                "the page's process has ended, so nobody could stop the arm from there any more"
            )
        now = time.perf_counter()
        out = self._waiting.take(edit=now >= self._edit_due)
        if any(isinstance(order, Edit) for order in out):
            self._edit_due = now + EDITS
        return out

    def _listen(self) -> bool:
        """Take what has come in, within bounds; return whether the page is still there."""
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
        """Whether a snapshot is wanted now; never of a page that has ended."""
        return time.perf_counter() >= self._due and self._listen() and self._free

    def send(self, snapshot: Snapshot | Stage) -> None:
        """Hand over a snapshot when one is `due`, or a stage at any time.

        Raises:
            PageGone: Its process has ended.
        """
        self._due, self._free = time.perf_counter() + 1.0 / FRAMES, False
        try:
            self._pipe.send(snapshot)
        except OSError:
            raise PageGone("the page's process has ended") from None

    def close(self) -> None:
        """Let the page end."""
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
    """The page's end. Orders pass only after the loop has taken those before: the pipe stays empty.

    Otherwise a page that floods would fill it, and both ends would wait for each other.
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
        """Tell the loop; nothing where it has ended."""
        with self._lock, contextlib.suppress(OSError):
            self._pipe.send(word)

    def ask(self, order: Order) -> None:
        """Pass an order on soon, unless a later one replaces it before; never blocks."""
        with self._changed:
            self._waiting.put(order)
            self._changed.notify()

    def listen(self) -> Any:
        """Return the next stage or snapshot, which is then taken; None once the loop has ended."""
        word = self._words.get()
        if word is not None:
            self.say(Taken())
        return word

    def _receive(self) -> None:
        """Sort what the loop says."""
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
        """Send the orders that wait, a few at a time."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._free and len(self._waiting) > 0)
                out, self._free = self._waiting.take(), False
            self.say(out)
            time.sleep(PASSED)
