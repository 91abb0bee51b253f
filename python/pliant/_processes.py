"""Child processes, and priorities of processes and threads.

Priorities are lower in the background, and real-time for the control loop.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Amount by which the nice value is raised or lowered.
NICE = 10
#: Windows' priority class for processes that work in the background.
BELOW_NORMAL_PRIORITY_CLASS = 0x4000


def lower_priority() -> None:
    """Lower the priority of this process, so that it does not delay the control loop.

    On Linux the process also gets the scheduling policy SCHED_BATCH, so that it does not preempt
    other processes when it wakes up. SCHED_IDLE is not used: on a busy machine it would stop the
    web page, and with it the STOP button.
    """
    if sys.platform == "win32":
        import ctypes

        kernel = ctypes.windll.kernel32
        kernel.SetPriorityClass(kernel.GetCurrentProcess(), BELOW_NORMAL_PRIORITY_CLASS)
        return
    os.nice(NICE)
    set_policy("SCHED_BATCH")


def set_policy(name: str) -> None:
    """Set the scheduling policy of this process, such as SCHED_BATCH, where the system has it."""
    if hasattr(os, name):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, getattr(os, name), os.sched_param(0))


def raise_priority() -> None:
    """Raise the priority of this thread and of threads that it starts, if the system permits it."""
    if sys.platform == "win32":
        return  # Windows has no nice values
    with contextlib.suppress(OSError):
        os.nice(-NICE)


def check_real_time_priority(priority: int | None) -> int | None:
    """Validate a real-time priority and return it; None: no real-time priority.

    Raises:
        ConfigError: The number is out of range, or this system has no real-time scheduling.
    """
    if priority is None:
        return None
    if sys.platform == "win32" or not hasattr(os, "SCHED_FIFO"):
        raise ConfigError("realtime_priority needs SCHED_FIFO, which this system lacks: use None")
    low = os.sched_get_priority_min(os.SCHED_FIFO)
    high = os.sched_get_priority_max(os.SCHED_FIFO)
    if isinstance(priority, bool) or not isinstance(priority, int) or not low <= priority <= high:
        raise ConfigError(
            f"realtime_priority must be an integer from {low} to {high}, or None, got {priority!r}"
        )
    return priority


def end_real_time_priority(pid: int) -> None:
    """Remove the inherited real-time priority of a process that this program has just started.

    A process inherits the policy of the thread that starts it. Until it calls `lower_priority`, its
    start would otherwise occupy a core for a tenth of a second, and delay the control loop.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            if os.sched_getscheduler(pid) in {os.SCHED_FIFO, os.SCHED_RR}:
                os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))


@contextlib.contextmanager
def real_time_priority(priority: int | None) -> Iterator[None]:
    """Return a context in which this thread, and threads that it starts, have real-time priority.

    The scheduling policy is SCHED_FIFO: the threads preempt all programs without real-time
    priority. The former policy of this thread is restored at the end. With None, nothing changes.

    Raises:
        ConfigError: The system does not permit it.
    """
    if priority is None or sys.platform == "win32":
        yield
        return
    thread = threading.get_native_id()
    former = os.sched_getscheduler(thread), os.sched_getparam(thread)
    try:
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError as error:
        raise ConfigError(
            f"realtime_priority={priority}: this user may not use real-time priorities; add the "
            f"line '<user> - rtprio {priority}' to /etc/security/limits.conf and log in again, or "
            "leave realtime_priority out"
        ) from error
    try:
        yield
    finally:
        os.sched_setscheduler(thread, *former)


def child_options() -> dict[str, Any]:
    """Return arguments of `subprocess.Popen` for a process that Ctrl-C does not reach."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def start_module(module: str, shared: socket.socket, *arguments: str) -> subprocess.Popen[bytes]:
    """Start ``python -m MODULE NUMBER ARGUMENTS``; `take_socket` opens the socket by its number.

    Ctrl-C does not reach the process; its standard output is discarded.
    """
    number = shared.fileno()
    command = [sys.executable, "-m", module, str(number), *arguments]
    options = child_options() | {"stdout": subprocess.DEVNULL}
    if sys.platform != "win32":
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=(number,), **options)
        end_real_time_priority(child.pid)
        return child
    # Windows does not promise that a process can use an inherited socket.
    process = subprocess.Popen(command, stdin=subprocess.PIPE, **options)
    with contextlib.suppress(OSError), process.stdin:
        process.stdin.write(shared.share(process.pid))
    return process


def take_socket(number: int) -> int:
    """Return, in a process of `start_module`, the handle of the socket, private to this process."""
    if sys.platform == "win32":
        return socket.fromshare(sys.stdin.buffer.read()).detach()
    os.set_inheritable(number, False)
    return number
