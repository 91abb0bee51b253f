"""A drive wrapper that shares its readings with the page, also during the descent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.drive import Drive, JointReadings


class Tap:
    """Wraps a drive.

    Attributes:
        last: The last reading; None before the first.
        on_read: Called after every reading.
    """

    def __init__(self, drive: Drive) -> None:
        """Wrap a drive."""
        self._drive = drive
        self.last: JointReadings | None = None
        self.on_read: Callable[[], None] = _nobody

    def read(self) -> JointReadings:
        """Read the positions of this cycle."""
        self.last = self._drive.read()
        self.on_read()
        return self.last

    def __getattr__(self, name: str) -> Any:
        return getattr(self._drive, name)


def _nobody() -> None:
    """Do nothing."""
