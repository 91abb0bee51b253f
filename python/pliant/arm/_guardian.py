"""Client of the guardian, a process that lowers the arm after the program has ended."""

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
    """Process that lowers the arm if the program ends with torque on.

    The constructor starts the process, which imports its modules while the program continues. It
    runs in its own session, so that signals of a terminal do not reach it. `close` ends it; without
    `watch`, it also ends with the program.

    Args:
        supervisor: Supervisor of the arm. Its heartbeat moves to memory that both processes share.
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
            arguments = (os.getpid(), theirs, number)
            self._process = subprocess.Popen(
                # -P: do not import modules from the working directory.
                [_executable(), "-P", "-m", "pliant.arm._guardian_process", *map(str, arguments)],
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
        """True in the process that started the guardian, False in its forked children."""
        return self in _running

    def watch(self, drive: Drive, arguments: Mapping[str, Any]) -> None:
        """Let the guardian watch this program, and wait until it does.

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
                f"the guardian did not start: {reason}. Torque stays as it is; guardian=False "
                "starts without it, and then nothing lowers the arm after SIGKILL"
            )
        self._drive = drive

    def rest(self) -> None:
        """Tell the guardian to stop watching until the next `watch`."""
        if self._drive is not None:
            self._drive = None
            if self._process.poll() is not None:
                MESSAGES.post(
                    "the guardian of the arm has ended before the program: until now nothing would "
                    "have lowered the arm after SIGKILL or a crash",
                    logging.WARNING,
                )
            # If this fails, the guardian finds at the end of the program that torque is off.
            with suppress(OSError, MemoryError):
                self._line.send(None)

    def close(self, *, hand_over: bool = False) -> None:
        """End the process; with `hand_over`, it lowers the arm first (the ports must be closed)."""
        _running.discard(self)
        if hand_over and self._drive is not None:
            self._line.close()
            return
        self.rest()
        self._line.close()
        # The guardian does not watch an arm now, so it can be killed.
        self._process.kill()
        self._process.wait()

    def leave(self) -> None:
        """Close connection and ports in a forked process; the parent alone then keeps them open."""
        self._line.close()
        self._supervisor.heartbeat = private_heartbeat()
        drop_ports = getattr(self._drive, "drop_ports", None)
        self._drive = None
        if drop_ports is not None:
            drop_ports()


#: Guardians of this process.
_running: weakref.WeakSet[Guardian] = weakref.WeakSet()


def beat_all() -> None:
    """Show the guardians of this process that the program runs, without an access to the drives.

    The guardian of an arm whose descent failed must not kill a program that lowers another arm.
    """
    # The iteration fails if another thread adds a guardian; the next call sends the heartbeat.
    with suppress(RuntimeError):
        for guardian in _running:
            guardian._supervisor.beat()


def _leave_all() -> None:
    """Give up all guardians in a forked process, because they watch its parent."""
    for guardian in list(_running):
        guardian.leave()
    _running.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_all)


def is_available(drive: Drive) -> bool:
    """Return True if a guardian can lower the arm of a drive.

    The servos must keep their torque after the end of the program. The system must be POSIX. A
    program that is frozen into one file cannot start another interpreter. If the servos keep their
    torque but a guardian is not possible, a warning is logged.
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
    """Return `number` if it is above 2; else close it and return a descriptor above 2 of its file.

    A program with closed standard streams gets descriptors 0 to 2 for the files that it opens, but
    the guardian process has its standard streams there.
    """
    from fcntl import F_DUPFD_CLOEXEC, fcntl  # not on Windows, where there is no guardian

    if number > 2:
        return number
    try:
        return fcntl(number, F_DUPFD_CLOEXEC, 3)
    finally:
        os.close(number)


def _shared_memory() -> int:
    """Return the descriptor of `SIZE` bytes of shared memory, or of a temporary file without it.

    Memory is preferred: a store into a file on a disk may wait while its page is being written.
    """
    if hasattr(os, "memfd_create"):
        number = os.memfd_create("pliant-heartbeat")
    else:
        with tempfile.TemporaryFile() as file:
            number = os.dup(file.fileno())
    os.truncate(number, SIZE)
    return number
