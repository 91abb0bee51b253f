"""Exclusive access to an arm, and a watchdog thread that lowers it if the program stalls."""

from __future__ import annotations

import contextlib
import mmap
import os
import sys
import threading
import time
from typing import TYPE_CHECKING, Self

from pliant._core import ConfigError, ExclusiveAccess, ServoError, ServoTimeoutError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: Python's thread switch interval while the watchdog thread lowers the arm [s]. With the default of
#: 5 ms, another busy thread would delay every bus call by half a control period of 10 ms.
SWITCH_INTERVAL = 1e-4


def private_heartbeat() -> memoryview[float]:
    """Return memory for `Supervisor.heartbeat` that no other process reads."""
    return memoryview(bytearray(16)).cast("d")


#: `madvise` option of Linux: the memory is 0 in a process that is forked from this one.
MADV_WIPEONFORK = 18


def _not_forked() -> bytes | memoryview[int]:
    """Return memory whose byte 0 is true only in the process that has imported this module.

    Unlike `os.getpid`, reading it needs no system call. It is also right if C code has forked. On
    systems other than Linux it is always 0.
    """
    if sys.platform != "linux":
        return bytes(1)
    try:
        page = mmap.mmap(-1, mmap.PAGESIZE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        page.madvise(MADV_WIPEONFORK)
    except OSError:
        return bytes(1)
    page[0] = 1
    return memoryview(page)


#: Byte 0 is true if this process is not forked from another one after the import.
_NOT_FORKED = _not_forked()


class ShortSwitchInterval:
    """Context in which Python's thread switch interval is at most `SWITCH_INTERVAL`.

    Threads may be in it at the same time; the last one to leave restores the interval.
    """

    def __init__(self) -> None:
        self._lock, self._users, self._interval = threading.Lock(), 0, 0.0

    def __enter__(self) -> None:
        with self._lock:
            if self._users == 0:
                self._interval = sys.getswitchinterval()
                sys.setswitchinterval(min(self._interval, SWITCH_INTERVAL))
            self._users += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._users -= 1
            if self._users == 0:
                sys.setswitchinterval(self._interval)


#: The switch interval applies to the whole interpreter, so all supervisors share this object.
_SHORT_SWITCH_INTERVAL = ShortSwitchInterval()


class Supervisor(ExclusiveAccess):
    """Lock of an arm, and a watchdog thread that calls `leave` if the program stalls.

    Each access to the drive is inside `with supervisor`, which restarts the timeout. The watchdog
    thread exists only inside `supervised`. Only the process that switched torque on may use the
    arm: a forked process shares the open port, and packets of two processes would mix.

    Attributes:
        owner: Id of the process that switched torque on; None while torque is off, or after it was
            left on deliberately.
        lock: Lock that the thread with access to the drive holds.
        reason: Reason for which the watchdog thread has called `leave`; None if it has not. `Arm`
            also sets it when the program ends.
        is_leaving: True while the watchdog thread calls `leave`.
        abort: Event that aborts a running descent in any thread.
        heartbeat: Two times [s] that the guardian reads: the last access to the drive, and the
            timeout after which the program counts as hanging (0: no timeout).
    """

    def __new__(cls, leave: Callable[[], None]) -> Self:
        """Create the lock."""
        return super().__new__(cls, threading.RLock(), _NOT_FORKED, time.perf_counter)

    def __init__(self, leave: Callable[[], None]) -> None:
        """Store `leave`, which lowers the arm or leaves it on; it is called with `lock` held."""
        self.abort = threading.Event()
        self.owner: int | None = None
        self.is_leaving = False
        self._leave = leave
        self._done = threading.Event()
        self.heartbeat = private_heartbeat()

    @property
    def is_owned_elsewhere(self) -> bool:
        """Return True if torque is on and the arm belongs to another process."""
        return self.owner is not None and self.owner != os.getpid()

    def check(self) -> None:
        """Raise an error unless this process and thread may use the arm.

        Raises:
            ServoTimeoutError: The watchdog thread has taken the arm over, or is lowering it.
            ServoError: Another process switched the torque of the arm on.
        """
        if not _NOT_FORKED[0] and self.is_owned_elsewhere:
            raise ServoError(
                f"this arm belongs to process {self.owner}, which switched its torque on; this is "
                f"process {os.getpid()}, forked from it: read and write there, and send the data "
                "to this process"
            )
        if self.reason is not None:
            raise ServoTimeoutError(f"{self.reason}; arm.enable() starts again")

    @contextlib.contextmanager
    def exclusive(self, *, at_once: bool = False) -> Iterator[None]:
        """Return a context that holds the lock while torque is switched on or off.

        The context first waits until a descent (lowering) in another thread has ended. With
        `at_once` it aborts that descent; the arm then holds its pose with torque on.

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
            # Wait for the aborted descent: it still sends goals that hold the arm.
            if self.abort.is_set() and self.lock.acquire(timeout=1.0):
                self.lock.release()
            raise
        try:
            self.abort.clear()
            yield
        finally:
            # The watchdog thread must not count the time in this context as a stall.
            self.last_call = time.perf_counter()
            self.lock.release()

    @contextlib.contextmanager
    def supervised(self, timeout: float | None) -> Iterator[Callable[[], None]]:
        """Run a watchdog thread that calls `leave` after `timeout` [s] without access to the drive.

        The context yields a function that raises as `check` does, or if another such context has
        begun. With `timeout` None, no thread runs. The thread ends with the context. If an
        exception ends the context, the thread continues until `end_supervision`, the next
        `supervised` or the call of `leave`, because the program may block before it lowers the arm.
        """
        self.end_supervision()
        done = self._done = threading.Event()

        def check() -> None:
            if self._done is not done:
                raise ConfigError(
                    "another loop over this arm has begun meanwhile: end one loop before the next"
                )
            if self.reason is not None or not _NOT_FORKED[0]:
                self.check()

        if timeout is None:
            yield check
            return
        self.heartbeat[1] = timeout
        self.last_call = time.perf_counter()
        thread = threading.Thread(
            target=self._run, args=(timeout, done), name="pliant-supervisor", daemon=True
        )
        thread.start()
        try:
            yield check
        except GeneratorExit:
            self._end(done)
            raise
        self._end(done)

    def end_supervision(self) -> None:
        """Stop the watchdog thread, if one runs."""
        self._end(self._done)

    def _end(self, done: threading.Event) -> None:
        """Stop the watchdog thread that waits for `done`; keep a thread that replaced it."""
        done.set()
        if done is self._done:
            self.heartbeat[1] = 0.0

    def beat(self) -> None:
        """Show the guardian that the program runs, without an access to the drive."""
        self.heartbeat[0] = time.perf_counter()

    def _run(self, timeout: float, done: threading.Event) -> None:
        """Take the arm over once the program stalls for `timeout` [s]; return if `done` is set."""
        longest = threading.TIMEOUT_MAX
        while not done.wait(
            min(max(self.last_call + timeout - time.perf_counter(), 1e-3), longest)
        ):
            if time.perf_counter() - self.last_call < timeout:
                continue
            with self.lock:
                # Compute the stall again: another thread may have accessed the drive while this
                # thread waited for the lock.
                stall = time.perf_counter() - self.last_call
                if stall >= timeout and not done.is_set() and self.reason is None:
                    self._take_over(stall)
                    return

    def _take_over(self, stall: float) -> None:
        """Call `leave` after a stall of `stall` [s]; store the stall and any error in `reason`."""
        self.reason = f"the program did not come back for {stall:.2f} s: the arm was taken over"
        self.abort.clear()
        self.is_leaving = True
        with _SHORT_SWITCH_INTERVAL:
            try:
                self._leave()
            except BaseException as error:
                self.reason += f"; while it was being lowered: {error}"
            finally:
                self.is_leaving = False
