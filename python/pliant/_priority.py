"""Process priorities: background processes get a lower one, the emulator a higher one."""

from __future__ import annotations

import contextlib
import os

#: Change of the nice value in either direction.
NICE = 10


def lower_priority() -> None:
    """Lower the priority of this process, so that it never delays the control loop.

    On Linux it also becomes a batch process, which does not preempt others when it wakes up. The
    idle policy is not used, because STOP on a web page must work on a busy machine too.
    """
    os.nice(NICE)
    if hasattr(os, "SCHED_BATCH"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def raise_priority() -> None:
    """Raise the priority of threads started from here, if the system permits it."""
    with contextlib.suppress(OSError):
        os.nice(-NICE)
