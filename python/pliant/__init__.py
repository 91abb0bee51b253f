"""Compliant task-space control for arms with back-drivable position servos."""

from pliant._core import *  # noqa: F403 (the compiled module's `__all__` is the list)
from pliant._core import __all__, __version__

__all__ = [*__all__, "__version__"]
