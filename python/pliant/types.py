"""Result types of the controller and of the contact estimator, for annotations."""

from pliant._core import BatchState, Diagnostics, WrenchEstimate

__all__ = ["BatchState", "Diagnostics", "WrenchEstimate"]
