"""Signal handling while arms have torque: one registry per process.

- While no arm is being lowered, SIGINT raises `KeyboardInterrupt`, and SIGTERM, SIGHUP and SIGQUIT
  raise `SystemExit`; these exceptions lower the arms. A repetition of the same signal within
  `REPEAT_TIME` is ignored.
- While an arm is being lowered, the handler stores the signal, and its exception is raised once the
  arm is down.
- Only SIGINT aborts a descent. This takes a second SIGINT, at least `REPEAT_TIME` after the
  previous SIGINT, and after the message that tells the user what it does. If the descent hangs, a
  third SIGINT, `HANG_TIMEOUT` after the second, raises `SystemExit` immediately.
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

from pliant.arm._messages import MESSAGES

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

    from pliant.arm._messages import Message

#: Signals that are handled, without those that the operating system lacks.
HANDLED = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if hasattr(signal, name)
)
#: Time after a signal in which a repetition counts as a key repeat [s]; keyboards start to repeat
#: a pressed key after 0.25 to 0.66 s.
REPEAT_TIME = 0.75
#: Time after the abort of a descent [s]; a third Ctrl-C after it ends the program, because a bus
#: call seems to hang.
HANG_TIMEOUT = 1.0


class Signals:
    """Registration of one arm with the signal handlers of the process.

    Args:
        stop: Function that aborts the arm's descent; a signal handler calls it.

    Attributes:
        leaving: True from the start of a descent until the arm is registered again.
        stopped: True if a second Ctrl-C has aborted the descent.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        """Store `stop`, which a signal calls once `install` has installed the handlers."""
        self.stop = stop
        self.leaving = self.stopped = False

    @property
    def installed(self) -> bool:
        """Return True if this arm is registered."""
        return self in _REGISTRY.arms

    @property
    def has_pending(self) -> bool:
        """Return True if a signal came during a descent and takes effect once all arms are down."""
        return _REGISTRY.pending is not None

    def install(self) -> None:
        """Register the arm, so that signals lower it; outside the main thread, only warn."""
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
        """Unregister the arm; after the last arm, restore the former signal handlers."""
        _REGISTRY.remove(self)

    def hold(self) -> None:
        """Store signals until `deliver`: an exception could keep the arm from being lowered."""
        if self.installed:
            _REGISTRY.begin(self, None)

    def begin(self, announcement: Message | None) -> None:
        """Mark the arm as being lowered.

        `announcement` is the message that the user has read about it; None if there was none,
        because another thread is already lowering the arm.
        """
        if self.installed:
            _REGISTRY.begin(self, announcement)

    def deliver(self) -> None:
        """Raise the exception for a signal that came during the descent, if there was one.

        Outside the main thread, send the signal to the process instead.

        Raises:
            KeyboardInterrupt, SystemExit: A signal came during the descent.
        """
        _REGISTRY.deliver(self)


class Registry:
    """Registry of all arms with torque; installs and restores the signal handlers.

    Attributes:
        arms: Registered arms, in order of registration.
        pending: Signal that came during a descent and was not delivered yet, or None.
    """

    def __init__(self) -> None:
        """Create a registry without arms; no signal handlers are installed."""
        self.arms: list[Signals] = []
        self._before: dict[int, Any] = {}
        self._process = 0
        self._forget()

    def _forget(self) -> None:
        """Discard pending signals and all other state that earlier signals left."""
        self._last: tuple[int, float] = (0, -REPEAT_TIME)
        self.pending: int | None = None
        self._announced: Message | None = None
        self._stopped_at: float | None = None

    def add(self, arm: Signals) -> None:
        """Register an arm, and install the signal handlers of this package."""
        if self._process != os.getpid():
            # After a fork: the arms of the parent process do not belong to this process.
            self.arms.clear()
            self._forget()
        self._process = os.getpid()
        self._last = (0, -REPEAT_TIME)
        self.arms.append(arm)
        for number in HANDLED:
            handler = signal.getsignal(number)
            if handler not in (self._catch, signal.SIG_IGN):
                self._before[number] = handler
                signal.signal(number, self._catch)

    def remove(self, arm: Signals) -> None:
        """Unregister an arm; after the last arm, restore the former handlers."""
        if arm not in self.arms:
            return
        self.arms.remove(arm)
        if not any(other.leaving for other in self.arms):
            self._announced = self._stopped_at = None
        if self.arms:
            return
        # Only the main thread can set handlers. In another thread ignore the error: `_catch` stays
        # installed and calls the former handlers.
        with contextlib.suppress(ValueError):
            for number, handler in self._before.items():
                if signal.getsignal(number) == self._catch:
                    # A handler that was not set from Python is None and cannot be restored: use
                    # the default action instead.
                    signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def begin(self, arm: Signals, announcement: Message | None) -> None:
        """Mark an arm as being lowered; until `remove`, signals are stored and not raised.

        If a Ctrl-C caused the descent, `announcement` told the user that the next one aborts it.
        """
        arm.leaving = True
        handler = signal.getsignal(signal.SIGINT)
        is_main = threading.current_thread() is threading.main_thread()
        # Jupyter sets the default handler in each cell; it would raise within the descent.
        if handler is signal.default_int_handler and is_main:
            self._before[signal.SIGINT] = handler
            signal.signal(signal.SIGINT, self._catch)
        if self._announced is None and is_interrupted(sys.exception()):
            self._announced = announcement

    def deliver(self, arm: Signals) -> None:
        """Raise the exception for a pending signal, unless another arm is being lowered."""
        if any(other.leaving for other in self.arms):
            return
        pending, self.pending = self.pending, None
        stopped, arm.stopped = arm.stopped, False
        # A `SystemExit` that a signal has raised before ends the program anyway: do not replace it
        # by the exception of a pending Ctrl-C.
        number = _stronger(signal_of(sys.exception()), pending)
        if stopped:
            error: BaseException = SystemExit(128 + (number or signal.SIGINT))
        elif pending is None or number != pending:
            return
        else:
            error = exception(pending)
        if threading.current_thread() is threading.main_thread():
            raise error
        os.kill(os.getpid(), number or signal.SIGINT)

    def _catch(self, number: int, frame: FrameType | None) -> None:
        """Handle signal `number`: raise its exception, or store the signal during a descent."""
        if self._process != os.getpid() or not self.arms:
            self._pass_on(number, frame)
            return
        now = time.monotonic()
        is_repeated = self._last[0] == number and now - self._last[1] < REPEAT_TIME
        self._last = (number, now)
        if not any(arm.leaving for arm in self.arms):
            if not is_repeated:
                raise exception(number)
        elif number != signal.SIGINT:
            if self.pending in (None, signal.SIGINT):
                self.pending = number
                MESSAGES.post(
                    f"{name_of(number)}: the arm is being lowered; the program ends once it is "
                    "down",
                    logging.WARNING,
                )
        else:
            self._interrupt(now, is_repeated=is_repeated)

    def _interrupt(self, now: float, *, is_repeated: bool) -> None:
        """Handle Ctrl-C at time `now` [s] while an arm is being lowered.

        The first Ctrl-C sends a message, the second aborts the descent, a third ends the program.
        `is_repeated` is True for a key repeat, which does not abort.
        """
        if self._stopped_at is not None:
            if now - self._stopped_at > HANG_TIMEOUT and not is_repeated:
                raise SystemExit(128 + signal.SIGINT)
        elif self._announced is None:
            self.pending = self.pending or signal.SIGINT
            self._announced = MESSAGES.post(
                "Ctrl-C: the arm is being lowered, and the program ends once it is down; once more "
                "leaves at once, torque ON",
                logging.WARNING,
            )
        elif self._announced.is_written and not is_repeated:
            self._stopped_at = now
            for arm in self.arms:
                if arm.leaving:
                    arm.stopped = True
                    arm.stop()

    def _pass_on(self, number: int, frame: FrameType | None) -> None:
        """Call the former handler of a signal; without one, take the signal's default action."""
        former = self._before.get(number)
        if callable(former):
            former(number, frame)
        elif former != signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)


_REGISTRY = Registry()


def exception(number: int) -> BaseException:
    """Return the exception for a signal: `KeyboardInterrupt` for SIGINT, else `SystemExit`."""
    return KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)


def _stronger(first: int | None, second: int | None) -> int | None:
    """Return which of two signals to deliver (None: no signal): the one that is not SIGINT, if any.

    Programs often catch the exception of SIGINT, so it might not end the program.
    """
    if first is None or (first == signal.SIGINT and second is not None):
        return second
    return first


def name_of(number: int) -> str:
    """Return the name of a signal for messages: Ctrl-C for SIGINT."""
    return "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name


def signal_of(error: BaseException | None) -> int | None:
    """Return the number of the signal behind an exception or its context chain, or None."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return int(signal.SIGINT)
        if isinstance(error, SystemExit) and isinstance(error.code, int):
            number = error.code - 128
            if number in HANDLED:
                return number
        error = error.__context__
    return None


def is_interrupted(error: BaseException | None) -> bool:
    """Return True if Ctrl-C caused an exception, directly or through its context chain."""
    return signal_of(error) == signal.SIGINT
