"""Process that lowers an arm after its program has ended, crashed or stopped with torque on.

The program starts it before torque comes on, see `Guardian`. Arguments: process id of the program,
descriptor of the socket to the program, descriptor of the heartbeat.
"""

from __future__ import annotations

import logging
import mmap
import os
import pickle
import signal
import sys
import time
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import TYPE_CHECKING

from pliant._core import ServoError, ServoFaultError
from pliant._processes import set_policy
from pliant.arm._guardian import SIZE
from pliant.arm._messages import MESSAGES
from pliant.arm._shutdown import RECOVER, brief
from pliant.arm.arm import Arm

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Period of the checks [s].
PERIOD = 0.1
#: Silence that is accepted in addition to the timeout of the program's watchdog thread [s]. That
#: thread acts first; it waits for the interpreter's lock and for a core.
MARGIN = 1.0
#: Longest time for which opening the port is retried after the program has ended [s].
OPEN_TIME = 30.0
#: Time between two attempts to open that port [s].
OPEN_PERIOD = 0.01
#: Longest wait for the end of the program after SIGKILL [s]; a hanging system call may delay it.
KILL_TIME = 5.0
#: Modules that the drive needs, imported before the program sends it.
DRIVERS = ("pliant.servo.bus", "rustypot")
#: Signals that are ignored: only SIGKILL ends the guardian while it watches.
IGNORED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGPIPE", "SIGUSR1", "SIGUSR2")


class Program:
    """The program that is watched.

    Times are counted in periods of the checks: while the guardian itself does not run, on a stopped
    or busy machine, no time passes for the program.

    Args:
        pid: Process id of the program, which is the parent of this process.
        heartbeat: Memory shared with the program, see `Supervisor.heartbeat`.
    """

    def __init__(self, pid: int, heartbeat: Sequence[float]) -> None:
        self.pid, self._heartbeat = pid, heartbeat
        self.restart()
        self._end: int | None = None
        if hasattr(os, "pidfd_open"):
            with suppress(OSError):
                self._end = os.pidfd_open(pid)

    @property
    def sentinels(self) -> list[int]:
        """Descriptors that become readable when the program ends; empty if unknown."""
        return [] if self._end is None or self.has_ended else [self._end]

    @property
    def has_ended(self) -> bool:
        """True if the program has ended: this process then has another parent."""
        return os.getppid() != self.pid

    def restart(self) -> None:
        """Set the times of silence and of stop to zero."""
        self._last, self._silent, self._stopped = tuple(self._heartbeat), 0.0, 0.0
        self._checked = time.monotonic()

    def problem(self, patience: float) -> str | None:
        """Return a sentence if the program has stopped or hangs, else None.

        Args:
            patience: Longest stop that is accepted [s]; `MARGIN` is added.
        """
        now = time.monotonic()
        passed, self._checked = min(now - self._checked, 2.0 * PERIOD), now
        heartbeat = tuple(self._heartbeat)
        # A new timeout counts as a heartbeat: the silence before it was within the old timeout.
        if heartbeat != self._last:
            self._last, self._silent, self._stopped = heartbeat, 0.0, 0.0
            return None
        _, limit = heartbeat
        self._silent = self._silent + passed if limit > 0.0 else 0.0
        self._stopped = self._stopped + passed if _is_stopped(self.pid) else 0.0
        if self._stopped > patience + MARGIN:
            return f"the program was stopped for {self._stopped:.1f} s"
        if limit > 0.0 and self._silent > limit + MARGIN:
            return f"the program was silent for {self._silent:.1f} s"
        return None

    def kill(self) -> None:
        """End the program with SIGKILL, and wait until it has ended, for at most `KILL_TIME`."""
        if not self.has_ended:
            os.kill(self.pid, signal.SIGKILL)
        deadline = time.monotonic() + KILL_TIME
        while not self.has_ended and time.monotonic() < deadline:
            time.sleep(OPEN_PERIOD)


def _is_stopped(pid: int) -> bool:
    """Return True if a signal or a debugger has stopped a process; False if that is not known."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] in {"T", "t"}


def watch(program: Program, line: Connection) -> tuple[Arm, str] | None:
    """Watch the program until it ends or hangs with torque on.

    Args:
        program: The program.
        line: Connection to the program. The program sends its arm before torque comes on, and None
            after torque off.

    Returns:
        The arm, and the reason for lowering it in this process; None if the program ended, or
        closed the connection, while there was no arm to watch.
    """
    arm: Arm | None = None
    is_open = True
    while True:
        if line in wait([line, *program.sentinels], PERIOD):
            try:
                content = line.recv()
                arm, answer = (None, None) if content is None else _build(content)
                program.restart()
                if content is not None:
                    line.send(answer)
            except (EOFError, OSError):
                is_open = False
        if arm is None:
            if not is_open or program.has_ended:
                return None
            continue
        if program.has_ended:
            return arm, "the program has ended"
        if not is_open:
            # The connection of a program that ends closes shortly before the process does.
            wait(program.sentinels, PERIOD)
            ended = program.has_ended
            return arm, "the program has ended" if ended else "the program has given the arm up"
        reason = program.problem(arm.comm_timeout)
        if reason is not None:
            program.kill()
            return arm, f"{reason}, and was ended"


def _build(content: bytes) -> tuple[Arm | None, str | None]:
    """Return the arm from a pickle, and None; or None and the text of the error."""
    try:
        drive, arguments = pickle.loads(content)
        return Arm(drive=drive, guardian=False, handle_signals=False, **arguments), None
    except Exception as error:
        return None, brief(error)


def take_over(arm: Arm, reason: str, program: Program) -> None:
    """Open the port once the program has released it, and perform `on_exit` of the arm.

    Args:
        arm: The arm, not open.
        reason: What has happened to the program, for messages.
        program: The program.
    """
    deadline = time.monotonic() + OPEN_TIME
    while True:
        try:
            arm._resume(reason)
        except ServoFaultError:
            # The message of the descent names the joints and the remedy.
            return
        except ServoError as error:
            # The next try opens the ports again.
            with suppress(ServoError):
                arm.drive.close()
            # A program that has not ended yet still locks the port.
            if time.monotonic() > deadline:
                MESSAGES.post(
                    f"{arm._label} was not lowered by its guardian ({reason}; {brief(error)}): "
                    f"torque may be ON. {RECOVER}",
                    logging.WARNING,
                )
                return
            time.sleep(OPEN_PERIOD if program.has_ended else PERIOD)
        else:
            return


def main(arguments: Sequence[str]) -> None:
    """Watch the program, and take over its arm when it ends or hangs."""
    for name in IGNORED:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    # The guardian then does not interrupt the control loop when it wakes up. A higher nice value
    # would have the same effect, but could not be lowered again for the descent.
    set_policy("SCHED_BATCH")
    for name in DRIVERS:
        with suppress(ImportError):
            import_module(name)
    pid, socket, memory = (int(argument) for argument in arguments)
    heartbeat = memoryview(mmap.mmap(memory, SIZE)).cast("d")
    MESSAGES.start()
    program = Program(pid, heartbeat)
    arm_and_reason = watch(program, Connection(socket))
    if arm_and_reason is not None:
        set_policy("SCHED_OTHER")
        take_over(*arm_and_reason, program)
        MESSAGES.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
