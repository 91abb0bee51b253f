"""`Refusals`: messages about refused input on stderr, at a bounded rate."""

from __future__ import annotations

import math
import sys
import time

#: Minimum time between two messages about refused input [s].
REPORT_PERIOD = 0.5


class Refusals:
    """Prints at most one message about refused input per `REPORT_PERIOD`.

    Args:
        what: Name of the input, as the beginning of the message.
    """

    def __init__(self, what: str) -> None:
        """Start without refused input."""
        self._what, self._next, self._unreported = what, -math.inf, 0

    def report(self, error: Exception) -> None:
        """Print why an input was refused, or only count it if the last message is too recent."""
        now = time.monotonic()
        if now < self._next:
            self._unreported += 1
            return
        note = f" ({self._unreported} more since the last message)" if self._unreported else ""
        print(f"{self._what} refused: {error}{note}", file=sys.stderr, flush=True)
        self._next, self._unreported = now + REPORT_PERIOD, 0

    def close(self) -> None:
        """Print the number of refused inputs that got no message because of the bounded rate."""
        if self._unreported:
            print(f"{self._unreported} more {self._what}s were refused", file=sys.stderr)
