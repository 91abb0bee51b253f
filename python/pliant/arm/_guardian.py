"""Program's side of the guardian, a process that lowers the arm after the program has ended."""

from __future__ import annotations

import logging
import mmap
import os
import pickle
import socket
import subprocess
import sys
import tempfile
import weakref
from contextlib import suppress
from multiprocessing import spawn
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from pliant._core import ServoError
from pliant.arm._messages import MESSAGES
from pliant.arm._supervisor import private_heartbeat

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pliant.arm._supervisor import Supervisor
    from pliant.drive import Drive

#: Longest time for the guardian to import its modules and build the arm [s].
START_TIME = 30.0
#: Size of the heartbeat [byte]: two numbers, see `Supervisor.heartbeat`.
SIZE = 16


class Guardian:
    """Process beside the program that lowers the arm if the program ends with torque on.

    The process starts at once, and imports its modules while the program does other work. It is in
    a session of its own, so that signals of a terminal do not reach it. It ends with `close`, or
    when the program ends while it rests.

    Args:
        supervisor: Its heartbeat becomes memory that the process shares.
    """

    def __init__(self, supervisor: Supervisor) -> None:
        """Start the process, without waiting for it.

        Raises:
            OSError: The system does not start it.
        """
        number = _above_standard(_shared_memory())
        ours, theirs = (_above_standard(end.detach()) for end in socket.socketpair())
        try:
            heartbeat = memoryview(mmap.mmap(number, SIZE)).cast("d")
            words = (os.getpid(), theirs, number)
            self._process = subprocess.Popen(
                # -P: do not import modules from the working directory.
                [_executable(), "-P", "-m", "pliant.arm._guardian_process", *map(str, words)],
                pass_fds=(theirs, number),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )
        finally:
            os.close(theirs)
            os.close(number)
        self._line = Connection(ours)
        self._supervisor, supervisor.heartbeat = supervisor, heartbeat
        self._drive: Drive | None = None
        _running.add(self)

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid

    @property
    def is_ours(self) -> bool:
        """True if the process watches this process, and not one from which this one was forked."""
        return self in _running

    def watch(self, drive: Drive, arguments: Mapping[str, Any]) -> None:
        """Let the guardian process watch this program; return once it does.

        Call this before torque is switched on.

        Args:
            drive: The drive of the arm, open.
            arguments: Constructor arguments of the arm. The guardian process builds its own copy of
                the arm from them, and lowers it if this program ends.

        Raises:
            ServoError: The process has ended, or could not build the arm.
        """
        copy = drive.closed_copy()  # type: ignore[attr-defined]
        content = pickle.dumps((copy, dict(arguments)))
        reason: Any = "it did not answer; its output is above"
        with suppress(EOFError, OSError):
            self._line.send(content)
            if self._line.poll(START_TIME):
                reason = self._line.recv()
        if reason is not None:
            raise ServoError(
                f"the guardian did not start: {reason}. Torque stays as it is; guardian=False goes "
                "without what lowers the arm after SIGKILL"
            )
        self._drive = drive

    def rest(self) -> None:
        """Tell the process that the program needs it no longer, until the next `watch`."""
        if self._drive is not None:
            self._drive = None
            if self._process.poll() is not None:
                MESSAGES.post(
                    "the guardian of the arm has ended before the program: until now nothing would "
                    "have lowered the arm after SIGKILL or a crash",
                    logging.WARNING,
                )
            # Without memory for the message, the process finds the torque off at the program's end.
            with suppress(OSError, MemoryError):
                self._line.send(None)

    def close(self, *, hand_over: bool = False) -> None:
        """End the process; with `hand_over` it first lowers the arm, whose ports must be closed."""
        _running.discard(self)
        if hand_over and self._drive is not None:
            self._line.close()
            return
        self.rest()
        self._line.close()
        # It rests, or still imports its modules.
        self._process.kill()
        self._process.wait()

    def leave(self) -> None:
        """Give up line and ports in a forked process, so that they close when the program ends."""
        self._line.close()
        self._supervisor.heartbeat = private_heartbeat()
        drop_ports = getattr(self._drive, "drop_ports", None)
        self._drive = None
        if drop_ports is not None:
            drop_ports()


#: Guardians of this process.
_running: weakref.WeakSet[Guardian] = weakref.WeakSet()


def _leave_all() -> None:
    """Give up all guardians in a forked process: they watch its parent."""
    for guardian in list(_running):
        guardian.leave()
    _running.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_all)


def is_available(drive: Drive) -> bool:
    """Return True if a guardian can lower the arm of a drive.

    The servos must keep their torque after the end of the program, and the system must have the
    signals of POSIX. A program that was frozen into one file cannot start another interpreter.
    Where such servos go without a guardian, a message warns.
    """
    if not getattr(drive, "outlives_program", False):
        return False
    if os.name == "posix" and not getattr(sys, "frozen", False):
        return True
    MESSAGES.start()
    MESSAGES.post(
        "no guardian watches this arm, because the program runs on Windows or is frozen into one "
        "file: after a kill or a crash the servos keep their last goal and limit; guardian=False "
        "hides this message",
        logging.WARNING,
    )
    return False


def _executable() -> str:
    """Return the path of the interpreter, as `multiprocessing.set_executable` may have set it."""
    return os.fsdecode(spawn.get_executable() or sys.executable)


def _above_standard(number: int) -> int:
    """Return a descriptor of the same file above those of the standard streams; close `number`.

    A program with closed standard streams gets their descriptors for the files that it opens. The
    guardian process has streams there.
    """
    from fcntl import F_DUPFD_CLOEXEC, fcntl  # not on Windows, where there is no guardian

    if number > 2:
        return number
    try:
        return fcntl(number, F_DUPFD_CLOEXEC, 3)
    finally:
        os.close(number)


def _shared_memory() -> int:
    """Return the descriptor of a file of `SIZE` bytes, in memory where the system has such files.

    A store into a page of a file on a disk could wait while the page is being written there.
    """
    if hasattr(os, "memfd_create"):
        number = os.memfd_create("pliant-heartbeat")
    else:
        with tempfile.TemporaryFile() as file:
            number = os.dup(file.fileno())
    os.truncate(number, SIZE)
    return number
