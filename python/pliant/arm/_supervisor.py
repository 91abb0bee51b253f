"""Lock of an arm, and a watchdog thread that lowers it when the program stalls."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from typing import TYPE_CHECKING

from pliant._core import ServoError, ServoTimeoutError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: Thread switch interval of Python while the arm is lowered by the watchdog thread [s]. The default
#: of 5 ms would cost half a period per bus call while another thread computes.
SWITCH_INTERVAL = 1e-4


class Supervisor:
    """Lock of an arm, and a watchdog thread that calls `leave` when the program stalls.

    Each access to the drive is inside `with supervisor`, which restarts the timeout. The thread
    exists only inside `supervised`. Only the process that switched torque on may use the arm: a
    forked process shares the open port, and two users would mix their messages.

    Attributes:
        owner: Id of the process that switched torque on; None while torque is off.
        lock: Held by the thread that uses the drive.
        reason: Reason why the watchdog thread took the arm over; None: it did not. `Arm` also sets
            it when the program ends.
        abort: Set to abort a running descent, in any thread.
    """

    def __init__(self, leave: Callable[[], None]) -> None:
        """Store `leave`, which lowers the arm or leaves it enabled; it runs with the lock held."""
        self.lock = threading.RLock()
        self.abort = threading.Event()
        self.reason: str | None = None
        self.owner: int | None = None
        self._leave, self._last_call = leave, 0.0
        self._done = threading.Event()

    def __enter__(self) -> None:
        """Take the lock for one access to the drive.

        Raises:
            ServoError, ServoTimeoutError: As `check`.
        """
        self.check()
        self.lock.acquire()
        if self.reason is not None:
            self.lock.release()
            self.check()

    def __exit__(self, *_: object) -> None:
        self._last_call = time.perf_counter()
        self.lock.release()

    @property
    def is_owned_elsewhere(self) -> bool:
        """Return True if torque is on and the arm belongs to another process."""
        return self.owner is not None and self.owner != os.getpid()

    def check(self) -> None:
        """Raise if the arm was taken over or belongs to another process.

        Raises:
            ServoTimeoutError: The watchdog thread has taken the arm over; raised at once, also
                while the arm is being lowered.
            ServoError: Another process switched its torque on.
        """
        if self.is_owned_elsewhere:
            raise ServoError(
                f"this arm belongs to process {self.owner}, which switched its torque on; this is "
                f"process {os.getpid()}, forked from it: read and write there, and pass on what "
                "this one needs"
            )
        if self.reason is not None:
            raise ServoTimeoutError(f"{self.reason}; arm.enable() starts again")

    @contextlib.contextmanager
    def exclusive(self, *, at_once: bool = False) -> Iterator[None]:
        """Return a context that holds the lock while torque is switched on or off.

        It first waits until a descent in another thread ends. With `at_once`, or if an exception
        comes during the wait, that descent is aborted and the arm stays where it is, torque on.

        Raises:
            ServoError: Another process switched torque on.
        """
        if self.is_owned_elsewhere:
            self.check()
        if at_once:
            self.abort.set()
        try:
            self.lock.acquire()
        except BaseException:
            self.abort.set()
            if self.lock.acquire(timeout=1.0):
                self.lock.release()
            raise
        try:
            self.abort.clear()
            yield
        finally:
            # The watchdog thread must not count the time in this context as a stall.
            self._last_call = time.perf_counter()
            self.lock.release()

    @contextlib.contextmanager
    def supervised(self, timeout: float | None) -> Iterator[Callable[[], None]]:
        """Run a watchdog thread that takes the arm over after `timeout` [s] without a call.

        With None no thread runs. The context yields `check`. An exception does not stop the thread,
        because the program may block before it lowers the arm. Then `end_supervision`, the next
        `supervised` or a takeover stops it.
        """
        if timeout is None:
            yield self.check
            return
        self.end_supervision()
        done = self._done = threading.Event()
        self._last_call = time.perf_counter()
        thread = threading.Thread(
            target=self._run, args=(timeout, done), name="pliant-supervisor", daemon=True
        )
        thread.start()
        try:
            yield self.check
        except GeneratorExit:
            done.set()
            raise
        done.set()

    def end_supervision(self) -> None:
        """Stop the watchdog thread, if one runs."""
        self._done.set()

    def _run(self, timeout: float, done: threading.Event) -> None:
        """Take the arm over once the program stalls for `timeout` [s]; return at `done`."""
        longest = threading.TIMEOUT_MAX
        while not done.wait(
            min(max(self._last_call + timeout - time.perf_counter(), 1e-3), longest)
        ):
            if time.perf_counter() - self._last_call < timeout:
                continue
            with self.lock:
                # Another thread held the lock until now, so it may have made a call meanwhile.
                silent = time.perf_counter() - self._last_call
                if silent >= timeout and not done.is_set() and self.reason is None:
                    self._take_over(silent)
                    return

    def _take_over(self, silent: float) -> None:
        """Call `leave` after a stall of `silent` [s]; an error of it is added to `reason`."""
        self.reason = f"the program did not come back for {silent:.2f} s: the arm was taken over"
        self.abort.clear()
        interval = sys.getswitchinterval()
        sys.setswitchinterval(min(interval, SWITCH_INTERVAL))
        try:
            self._leave()
        except BaseException as error:
            self.reason += f"; while it was being lowered: {error}"
        finally:
            sys.setswitchinterval(interval)
