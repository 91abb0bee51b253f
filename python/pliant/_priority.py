"""Process priorities (nice values): lower for background processes, higher for the emulator."""

from __future__ import annotations

import contextlib
import os
import sys

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
    if hasattr(os, "SCHED_BATCH"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def raise_priority() -> None:
    """Raise the priority of this thread and of threads that it starts, if the system permits it."""
    if sys.platform == "win32":
        return  # Windows has no nice values
    with contextlib.suppress(OSError):
        os.nice(-NICE)
