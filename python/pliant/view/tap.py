"""A drive whose readings somebody else sees too: the page, while the arm is on its way down."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.arm.drive import Drive, Sampled


class Tap:
    """A drive in whose place it stands.

    Attributes:
        last: The last reading; None before the first.
        on_read: Called after every reading.
    """

    def __init__(self, drive: Drive) -> None:
        """Pass everything on."""
        self._drive = drive
        self.last: Sampled | None = None
        self.on_read: Callable[[], None] = _nobody

    def read(self) -> Sampled:
        """Positions of this cycle."""
        self.last = self._drive.read()
        self.on_read()
        return self.last

    def __getattr__(self, name: str) -> Any:
        return getattr(self._drive, name)


def _nobody() -> None:
    """Nobody wants to know."""
