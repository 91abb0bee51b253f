"""Answers that servos owe: what was asked for and did not come, or not well.

The protocols carry no sequence number; an answer carries its length, and that is the number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pliant.servo.models.row import Block

#: A length is avoided for so long after an answer of it was missed, where there is a choice, and
#: for so long where nothing has been answered since [s].
MEMORY, GIVEN_UP = 1.0, 2.0


@dataclass
class Answer:
    """One that is missing.

    Attributes:
        size: Its data bytes.
        time: When it was asked for [s].
        settled: Whether a later request has been answered, so that it cannot come any more.
    """

    size: int
    time: float
    settled: bool = False


class Owed:
    """What the servos of one port owe, by id."""

    def __init__(self) -> None:
        """Nothing is owed."""
        self._missing: dict[int, list[Answer]] = {}

    def add(self, ids: Iterable[int], size: int, time: float) -> None:
        """Answers of this length, asked for then, may still come."""
        for id in ids:
            self._missing.setdefault(id, []).append(Answer(size, time))

    def settle(self, ids: Iterable[int]) -> None:
        """These servos have answered a request of a length that they did not owe."""
        for id in ids if self._missing else ():
            for answer in self._missing.get(id, ()):
                answer.settled = True

    def barred(self, id: int) -> set[int]:
        """Lengths in which an answer of this servo may be one to an earlier request."""
        return {answer.size for answer in self._missing.get(id, ()) if not answer.settled}

    def choose(self, ids: Sequence[int], blocks: Sequence[Block], now: float) -> Block | None:
        """The first block of a length that nobody owes: not within memory, or not any more."""
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
