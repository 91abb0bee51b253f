"""Ctrl-C and SIGTERM while an arm has torque: leave in order, then in a hurry."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import FrameType

CAUGHT = (signal.SIGINT, signal.SIGTERM)


class Signals:
    """Handlers that turn signals into exceptions, and the ones that were there before.

    The first signal raises `KeyboardInterrupt` (SIGINT) or `SystemExit` (SIGTERM), on which the arm
    is lowered. One more while the arm is being lowered raises `SystemExit` at once. A signal that
    comes first while the arm is being lowered anyway waits until it is down. A process that was
    forked meanwhile has no arm: what comes there goes to the former handler.

    Attributes:
        leaving: Whether the arm is being lowered.
        installed: Whether these handlers are in force.
    """

    def __init__(self) -> None:
        """Nothing is caught yet."""
        self.leaving = self.installed = False
        self._before: dict[int, Any] = {}
        self._count = self._process = 0
        self._waiting: int | None = None

    def install(self) -> None:
        """Catch signals from now on; outside the main thread Python cannot, and this says so."""
        if self.installed:
            return
        if threading.current_thread() is not threading.main_thread():
            warnings.warn(
                "torque goes on outside the main thread, where signals cannot be caught: Ctrl-C "
                "and SIGTERM will not lower this arm; enable it in the main thread",
                RuntimeWarning,
                stacklevel=3,
            )
            return
        for number in CAUGHT:
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._catch)
        self.installed, self._process = True, os.getpid()
        self._count, self._waiting = 0, None

    def restore(self) -> None:
        """Put the former handlers back, where ours are still in force."""
        if not self.installed:
            return
        for number, handler in self._before.items():
            if signal.getsignal(number) == self._catch:
                # A handler that was not set from Python is None: the default is nearest to it.
                with contextlib.suppress(ValueError):
                    signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before.clear()
        self.installed = False

    def deliver(self) -> None:
        """Raise what came while the arm was being lowered and has had no effect yet."""
        if self._waiting is not None:
            number, self._waiting = self._waiting, None
            raise _exception(number)

    def _catch(self, number: int, frame: FrameType | None) -> None:
        """Act on a signal."""
        if self._process != os.getpid():
            self._pass_on(number, frame)
            return
        first = self._count == 0
        self._count += 1
        if self.leaving and first:
            self._waiting = number
            print("the arm is being lowered; once more: hold it and leave", file=sys.stderr)
            return
        self._waiting = None
        raise SystemExit(128 + number) if self.leaving else _exception(number)

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        """Do what would have been done without the arm."""
        former = self._before.get(number)
        if callable(former):
            former(number, frame)
        else:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)


def _exception(number: int) -> BaseException:
    """What Python raises, or would, on a signal."""
    return KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)
