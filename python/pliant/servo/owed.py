"""Record of missing replies, so that a late one is never taken for a new one.

The protocols carry no sequence number. The length of a reply serves as its identification.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pliant.servo.models.row import Block

#: Time for which the length of a missing reply is avoided if there is a choice; and time after
#: which a reply is given up if nothing was answered since [s].
MEMORY, GIVEN_UP = 1.0, 2.0


@dataclass
class Answer:
    """A missing reply.

    Attributes:
        size: Number of data bytes.
        time: Time of the request [s].
        settled: Whether a later request was answered, so that this reply cannot arrive any more.
    """

    size: int
    time: float
    settled: bool = False


class Owed:
    """Missing replies of the servos on one port, by id."""

    def __init__(self) -> None:
        """Start without missing replies."""
        self._missing: dict[int, list[Answer]] = {}

    def add(self, ids: Iterable[int], size: int, time: float) -> None:
        """Record missing replies of this length, requested at `time` [s]."""
        for id in ids:
            self._missing.setdefault(id, []).append(Answer(size, time))

    def settle(self, ids: Iterable[int]) -> None:
        """Mark all missing replies of these servos as settled, after a reply of another length."""
        for id in ids if self._missing else ():
            for answer in self._missing.get(id, ()):
                answer.settled = True

    def barred(self, id: int) -> set[int]:
        """Return the lengths that a late reply of this servo may have."""
        return {answer.size for answer in self._missing.get(id, ()) if not answer.settled}

    def choose(self, ids: Sequence[int], blocks: Sequence[Block], now: float) -> Block | None:
        """Return the first block whose length fits no missing reply, preferably no recent one."""
        if not self._missing:
            return blocks[0]
        for id in ids:
            self._forget(id, now)
        avoided = {answer.size for id in ids for answer in self._missing.get(id, ())}
        barred = {size for id in ids for size in self.barred(id)}
        for sizes in (avoided, barred):
            for block in blocks:
                if block.size not in sizes:
                    return block
        return None

    def _forget(self, id: int, now: float) -> None:
        left = [
            answer
            for answer in self._missing.get(id, ())
            if now - answer.time < (MEMORY if answer.settled else GIVEN_UP)
        ]
        if left:
            self._missing[id] = left
        else:
            self._missing.pop(id, None)
