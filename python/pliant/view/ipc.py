"""Pipe between the process of the control loop and the process of the browser page.

The processes of ROS 2 and Foxglove (`pliant.ros`) use the same pipe; here, "the page" is any of
them.

The loop never waits for the page: it sends a snapshot (state of the arm) only after the page has
acknowledged the last one. The page cannot overload the loop: at both ends, new messages replace
obsolete ones, and the loop handles a bounded number of messages per tick.
"""

from __future__ import annotations

import contextlib
import socket
import subprocess
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, Self

from pliant._core import PliantError
from pliant._processes import start_module, take_socket
from pliant.view.messages import Edit, Message, Queue

#: Maximum rate at which the loop sends snapshots of the arm to the browser page [Hz].
SNAPSHOT_RATE = 30.0
#: Timeout for the start and for the end of the page's process [s].
TIMEOUT = 30.0
#: Minimum time between two transmissions from the page to the loop [s].
MESSAGE_PERIOD = 0.02
#: Maximum number of objects that the loop takes from the pipe at a time.
MAX_RECEIVED = 4
#: Minimum time between two changes of the settings that the loop handles [s].
EDIT_PERIOD = 0.05


class PageGone(PliantError):
    """The process of the browser page has ended."""


class Ack:
    """Acknowledgement of the last received object; the other process may then send the next one."""


@dataclass(frozen=True)
class Ready:
    """First message of the page's process: the link that opens the page, with its access token."""

    link: str


@dataclass(frozen=True)
class StartupError:
    """First and only message of the page's process if it cannot start: the error text."""

    text: str


class ProcessLink:
    """End of the pipe in the process of the loop; it starts and ends the other process.

    Args:
        name: Name of the other process in error messages.
        module: Module that the other process runs as ``python -m MODULE DESCRIPTOR ARGUMENTS``.
        arguments: Arguments of the module.
        rate: Maximum rate of snapshots [Hz].

    Attributes:
        address: Address that the other process has reported once it was ready.

    Raises:
        PliantError: The process does not start; the message gives the reason.
    """

    def __init__(
        self, name: str, module: str, *arguments: str, rate: float = SNAPSHOT_RATE
    ) -> None:
        """Start the other process, and wait until it is ready."""
        self._name, self._period = name, 1.0 / rate
        ours, theirs = socket.socketpair()
        # Ctrl-C is for the loop; the process ends when its pipe closes.
        self._process = start_module(module, theirs, *arguments)
        theirs.close()
        self._pipe = Connection(ours.detach())
        self._acknowledged, self._due = True, 0.0
        self._pending, self._edit_due = Queue(), 0.0
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
        raise PliantError(f"the {self._name}'s process did not start; its output is above")

    def messages(self) -> list[Message]:
        """Return the messages of the page to handle in one tick.

        Changes of the settings are limited to one per `EDIT_PERIOD`.

        Raises:
            PageGone: The page's process has ended.
        """
        if not self._listen():
            raise PageGone(
                f"the {self._name}'s process has ended, so it could no longer stop the arm"
            )
        now = time.perf_counter()
        out = self._pending.take(edit=now >= self._edit_due)
        if any(isinstance(message, Edit) for message in out):
            self._edit_due = now + EDIT_PERIOD
        return out

    def _listen(self) -> bool:
        """Take up to `MAX_RECEIVED` objects from the pipe; return False if the page has ended."""
        try:
            for _ in range(MAX_RECEIVED):
                if not self._pipe.poll():
                    break
                received = self._pipe.recv()
                if isinstance(received, Ack):
                    self._acknowledged = True
                    continue
                self._pipe.send(Ack())
                for message in received:
                    self._pending.put(message)
        except (EOFError, OSError):
            return False
        return True

    def due(self) -> bool:
        """Return True if a snapshot can be sent.

        At least 1 / `rate` must have passed since the last snapshot, and the page must have
        acknowledged the last object.
        """
        return time.perf_counter() >= self._due and self._listen() and self._acknowledged

    def send(self, snapshot: object) -> None:
        """Send a snapshot (only if `due()` is True) or the description of a scene (at any time).

        Raises:
            PageGone: The page's process has ended.
        """
        self._due, self._acknowledged = time.perf_counter() + self._period, False
        try:
            self._pipe.send(snapshot)
        except OSError:
            raise PageGone(f"the {self._name}'s process has ended") from None

    def close(self) -> None:
        """Close the pipe and wait for the page's process to end; kill it after `TIMEOUT`."""
        self._pipe.close()
        try:
            self._process.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Link(ProcessLink):
    """Link to the process of the browser page.

    Args:
        host: Address on which the page listens.
        port: TCP port; if it is taken, the page uses the next free one.

    Attributes:
        address: Link that opens the page, with its access token.

    Raises:
        PliantError: The page does not start; the message gives the reason.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Start the process of the page, and wait until its web server listens."""
        super().__init__("page", "pliant.view.page", host, str(port))


class PageEndpoint:
    """End of the pipe in the process of the page.

    It sends messages only after the loop has acknowledged the last ones: otherwise many messages
    could fill the pipe, and both processes would block.
    """

    def __init__(self, descriptor: int) -> None:
        """Open the pipe's inherited file descriptor; start a thread to receive and one to send."""
        self._pipe, self._lock = Connection(take_socket(descriptor)), threading.Lock()
        self._pending, self._changed, self._acknowledged = Queue(), threading.Condition(), True
        self._inbox: SimpleQueue[Any] = SimpleQueue()
        for work in (self._sort_incoming, self._forward):
            threading.Thread(target=work, daemon=True).start()

    def send(self, message: Ready | StartupError | Ack | list[Message]) -> None:
        """Send an object to the loop without queueing it; do nothing if the loop has ended."""
        with self._lock, contextlib.suppress(OSError):
            self._pipe.send(message)

    def queue(self, message: Message) -> None:
        """Queue a message for the loop; until it is sent, a later message may replace it."""
        with self._changed:
            self._pending.put(message)
            self._changed.notify()

    def receive(self) -> Any:
        """Return the next scene or snapshot and acknowledge it; None once the loop has ended."""
        message = self._inbox.get()
        if message is not None:
            self.send(Ack())
        return message

    def _sort_incoming(self) -> None:
        """Receive objects from the loop, in a thread; queue all but `Ack` for `receive`."""
        while True:
            try:
                message = self._pipe.recv()
            except (EOFError, OSError):
                self._inbox.put(None)
                return
            if not isinstance(message, Ack):
                self._inbox.put(message)
                continue
            with self._changed:
                self._acknowledged = True
                self._changed.notify()

    def _forward(self) -> None:
        """Send the queued messages to the loop, in a thread; at most `PER_TICK` at a time."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._acknowledged and len(self._pending) > 0)
                out, self._acknowledged = self._pending.take(), False
            self.send(out)
            time.sleep(MESSAGE_PERIOD)
