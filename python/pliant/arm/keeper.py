"""Takes the arm over from a program that does not come back."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from typing import TYPE_CHECKING

from pliant import ServoError, ServoTimeoutError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: While another thread computes without pause, Python hands over only after this time [s]; its
#: default of 5 ms, once per call of the bus, would be half a period each.
SWITCH = 1e-4


class Keeper:
    """The one lock of an arm, and a thread that brings the arm down when nobody calls any more.

    Every call of the program is a `with keeper`. The thread exists only inside `watched`. An arm
    with torque belongs to one process: one forked from it has the same port and other threads, and
    none of it is for it to use.

    Attributes:
        owner: Process that switched torque on; None while it is off.
        lock: Held by whoever uses the drive.
        reason: Why the arm was taken over, None while it was not.
        unwanted: Set to end a descent before it is over, wherever it runs.
    """

    def __init__(self, leave: Callable[[], None]) -> None:
        """Know how to leave; `leave` is called with the lock held."""
        self.lock = threading.RLock()
        self.unwanted = threading.Event()
        self.reason: str | None = None
        self.owner: int | None = None
        self._leave, self._seen = leave, 0.0
        self._done = threading.Event()

    def __enter__(self) -> None:
        """One call of the program.

        Raises:
            ServoError: As `check`.
        """
        self.check()
        self.lock.acquire()
        if self.reason is not None:
            self.lock.release()
            self.check()

    def __exit__(self, *_: object) -> None:
        self._seen = time.perf_counter()
        self.lock.release()

    @property
    def elsewhere(self) -> bool:
        """Whether the arm has torque and belongs to another process."""
        return self.owner is not None and self.owner != os.getpid()

    def check(self) -> None:
        """Tell a program that comes back, and one that never had the arm.

        Raises:
            ServoTimeoutError: The arm has been taken over: at once, also while it is being lowered.
            ServoError: Another process switched its torque on.
        """
        if self.elsewhere:
            raise ServoError(
                f"this arm belongs to process {self.owner}, which switched its torque on; this is "
                f"process {os.getpid()}, forked from it: read and write there, and pass on what "
                "this one needs"
            )
        if self.reason is not None:
            raise ServoTimeoutError(f"{self.reason}; arm.enable() starts anew")

    @contextlib.contextmanager
    def alone(self, *, at_once: bool = False) -> Iterator[None]:
        """Hold the lock for an exit.

        A descent that another thread has begun is waited for, unless `at_once`, or an exception
        comes meanwhile: it then ends where it is, torque on.

        Raises:
            ServoError: Another process switched torque on.
        """
        if self.elsewhere:
            self.check()
        if at_once:
            self.unwanted.set()
        try:
            self.lock.acquire()
        except BaseException:
            self.unwanted.set()
            if self.lock.acquire(timeout=1.0):
                self.lock.release()
            raise
        try:
            self.unwanted.clear()
            yield
        finally:
            # The thread has waited for the lock, and shall not take this for silence.
            self._seen = time.perf_counter()
            self.lock.release()

    @contextlib.contextmanager
    def watched(self, patience: float | None) -> Iterator[Callable[[], None]]:
        """Take the arm over after so long without a call [s], None for never; gives `check`.

        An exception does not end the watch: the program may block on its way to an exit of the arm.
        `dismiss`, the next watch, or a take-over does.
        """
        if patience is None:
            yield self.check
            return
        self.dismiss()
        done = self._done = threading.Event()
        self._seen = time.perf_counter()
        thread = threading.Thread(
            target=self._watch, args=(patience, done), name="pliant-keeper", daemon=True
        )
        thread.start()
        try:
            yield self.check
        except GeneratorExit:
            done.set()
            raise
        done.set()

    def dismiss(self) -> None:
        """End the watch."""
        self._done.set()

    def _watch(self, patience: float, done: threading.Event) -> None:
        """Sleep until the program would be late, look, sleep again."""
        most = threading.TIMEOUT_MAX
        while not done.wait(min(max(self._seen + patience - time.perf_counter(), 1e-3), most)):
            if time.perf_counter() - self._seen < patience:
                continue
            with self.lock:
                # Whoever had the lock was no stalled program.
                silent = time.perf_counter() - self._seen
                if silent >= patience and not done.is_set() and self.reason is None:
                    self._take_over(silent)
                    return

    def _take_over(self, silent: float) -> None:
        """Leave in the place of the program."""
        self.reason = f"the program did not come back for {silent:.2f} s: the arm was taken over"
        self.unwanted.clear()
        before = sys.getswitchinterval()
        sys.setswitchinterval(min(before, SWITCH))
        try:
            self._leave()
        except BaseException as error:
            self.reason += f"; while it was being lowered: {error}"
        finally:
            sys.setswitchinterval(before)
