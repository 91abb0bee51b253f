"""Processes beside the loop that have time: the page, the writer of a log."""

from __future__ import annotations

import contextlib
import os

#: How much they step back where the loop wants the processor too.
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
