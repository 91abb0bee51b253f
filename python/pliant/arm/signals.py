"""Signals while arms have torque: one registry per process, and no signal ends a descent by chance.

- While no arm is being lowered, SIGINT raises `KeyboardInterrupt`, and SIGTERM, SIGHUP and SIGQUIT
  raise `SystemExit`, on which arms are lowered. The same signal again within `PAUSE` is the same
  request.
- While an arm is being lowered, a handler raises nothing. The exception follows once the arm is
  down.
- Only SIGINT ends a descent: the second one, at least `PAUSE` after the one before it, and after
  the message that says what it does.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
import time
import warnings
from typing import TYPE_CHECKING, Any

from pliant.arm.speaker import SPEAKER

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

    from pliant.arm.speaker import Message

#: Those that there are on this system.
CAUGHT = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if hasattr(signal, name)
)
#: A signal this soon after the same one is a repetition [s]: keyboards begin to repeat a key that
#: is held down after 0.25 to 0.66 s.
PAUSE = 0.75
#: A descent that has not ended this long after it was told to hangs [s]; a third Ctrl-C leaves it.
HANGS = 1.0


class Signals:
    """The part of one arm in the registry.

    Args:
        stop: Ends the arm's descent, torque on; called in a signal handler.

    Attributes:
        leaving: Whether the arm is being lowered.
        stopped: Whether a second Ctrl-C has ended its descent.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        """Catch nothing yet."""
        self.stop = stop
        self.leaving = self.stopped = False

    @property
    def installed(self) -> bool:
        """Return True if this arm is registered."""
        return self in _REGISTRY.arms

    @property
    def heard(self) -> bool:
        """Whether a signal waits until arms are down."""
        return _REGISTRY.pending is not None

    def install(self) -> None:
        """Catch signals from now on; outside the main thread, warn that Python cannot."""
        self.stopped = False
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
        self.leaving = False
        _REGISTRY.add(self)

    def restore(self) -> None:
        """Leave the registry; the former handlers come back with the last arm."""
        _REGISTRY.remove(self)
        self.leaving = False

    def begin(self, told: Message) -> None:
        """Begin a descent, announced by a message."""
        if self.installed:
            _REGISTRY.begin(self, told)

    def deliver(self) -> None:
        """Raise what a signal during the descent asked for.

        Raises:
            KeyboardInterrupt, SystemExit: Here in the main thread; from another, there.
        """
        _REGISTRY.deliver(self)


class Registry:
    """All arms with torque, the handlers, and the handlers that were there before.

    Attributes:
        arms: In order of arrival.
        pending: Signal that came during a descent and has had no effect yet.
    """

    def __init__(self) -> None:
        """Catch nothing yet."""
        self.arms: list[Signals] = []
        self._before: dict[int, Any] = {}
        self._process = 0
        self._forget()

    def _forget(self) -> None:
        """Begin without a past."""
        self._last: tuple[int, float] = (0, -PAUSE)
        self.pending: int | None = None
        self._told: Message | None = None
        self._stopped_at: float | None = None

    def add(self, arm: Signals) -> None:
        """Catch signals for an arm too."""
        if self._process != os.getpid():
            # The arms of the process that this one was forked from are not its own.
            self.arms.clear()
            self._forget()
        self._process = os.getpid()
        self._last = (0, -PAUSE)
        self.arms.append(arm)
        for number in CAUGHT:
            handler = signal.getsignal(number)
            if handler not in (self._catch, signal.SIG_IGN):
                self._before[number] = handler
                signal.signal(number, self._catch)

    def remove(self, arm: Signals) -> None:
        """Forget an arm; with the last one, put former handlers back where ours are in force."""
        if arm not in self.arms:
            return
        self.arms.remove(arm)
        if not any(other.leaving for other in self.arms):
            self._told = self._stopped_at = None
        if self.arms:
            return
        # Python sets handlers in the main thread alone; in another, ours act as the former ones.
        with contextlib.suppress(ValueError):
            for number, handler in self._before.items():
                if signal.getsignal(number) == self._catch:
                    # A handler that was not set from Python is None; the default is nearest to it.
                    signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def begin(self, arm: Signals, told: Message) -> None:
        """Raise nothing from now on, until the arm is removed."""
        arm.leaving = True
        if self._told is None and is_interrupted(sys.exception()):
            self._told = told

    def deliver(self, arm: Signals) -> None:
        """Raise what has come while arms were lowered, once none is any more."""
        if any(other.leaving for other in self.arms):
            return
        pending, self.pending = self.pending, None
        stopped, arm.stopped = arm.stopped, False
        # What is on its way already ends the program as surely, unless it is Ctrl-C alone.
        number = _stronger(signal_of(sys.exception()), pending)
        if stopped:
            raised: BaseException = SystemExit(128 + (number or signal.SIGINT))
        elif pending is None or number != pending:
            return
        else:
            raised = exception(pending)
        if threading.current_thread() is threading.main_thread():
            raise raised
        os.kill(os.getpid(), number or signal.SIGINT)

    def _catch(self, number: int, frame: FrameType | None) -> None:
        """Act on a signal."""
        if self._process != os.getpid() or not self.arms:
            self._pass_on(number, frame)
            return
        now = time.monotonic()
        is_repeated = self._last[0] == number and now - self._last[1] < PAUSE
        self._last = (number, now)
        if not any(arm.leaving for arm in self.arms):
            if not is_repeated:
                raise exception(number)
        elif number != signal.SIGINT:
            if self.pending in (None, signal.SIGINT):
                self.pending = number
                SPEAKER.say(
                    f"{name_of(number)}: the arm is being lowered; the program ends once it is "
                    "down",
                    logging.WARNING,
                )
        else:
            self._interrupt(now, is_repeated=is_repeated)

    def _interrupt(self, now: float, *, is_repeated: bool) -> None:
        """Ctrl-C while an arm is being lowered."""
        if self._stopped_at is not None:
            if now - self._stopped_at > HANGS and not is_repeated:
                raise SystemExit(128 + signal.SIGINT)
        elif self._told is None:
            self.pending = self.pending or signal.SIGINT
            self._told = SPEAKER.say(
                "Ctrl-C: the arm is being lowered, and the program ends once it is down; once more "
                "leaves at once, torque ON",
                logging.WARNING,
            )
        elif self._told.told and not is_repeated:
            self._stopped_at = now
            for arm in self.arms:
                if arm.leaving:
                    arm.stopped = True
                    arm.stop()

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        """Do what would have been done without an arm."""
        former = self._before.get(number)
        if callable(former):
            former(number, frame)
        elif former != signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)


_REGISTRY = Registry()


def exception(number: int) -> BaseException:
    """Return what Python raises, or would raise, on a signal."""
    return KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)


def _stronger(first: int | None, second: int | None) -> int | None:
    """Return the signal that ends a program after two; Ctrl-C, often caught, is the weaker."""
    if first is None or (first == signal.SIGINT and second is not None):
        return second
    return first


def name_of(number: int) -> str:
    """Return what a user calls a signal."""
    return "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name


def signal_of(error: BaseException | None) -> int | None:
    """Return the signal that an exception, or one that it came out of, was raised for."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return int(signal.SIGINT)
        if isinstance(error, SystemExit) and isinstance(error.code, int):
            number = error.code - 128
            if number in CAUGHT:
                return number
        error = error.__context__
    return None


def is_interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is why an exception is on its way."""
    return signal_of(error) == signal.SIGINT
