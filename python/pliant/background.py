"""Priority of processes beside the loop: some have time, the emulator has deadlines."""

from __future__ import annotations

import contextlib
import os

#: Steps by which a process with time gives way, and by which one with deadlines goes first.
NICE = 10


def step_back() -> None:
    """Let this process wait for others, and never take a processor from one that runs.

    On Linux it also becomes a batch process: its waking up interrupts nobody. It is not made idle,
    for a page has to hear STOP on a busy machine too.
    """
    os.nice(NICE)
    if hasattr(os, "SCHED_BATCH"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def step_forward() -> None:
    """Let threads that start from here go before others, where the system allows it."""
    with contextlib.suppress(OSError):
        os.nice(-NICE)
