"""Results of an experiment for the report: numbers, statements judged by them, figures, tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from pliant._report.page import Table

#: Numbers, texts, lists of them and further maps by name, so that `results.json` is readable.
Numbers = Mapping[str, Any]

#: Source of a statement: the paper, or the study before the package, whose bands are our tests.
Source = Literal["paper", "study"]


class Verdict(StrEnum):
    """Verdict on a statement by the numbers of this run."""

    AGREES = "agrees"
    DIFFERS = "differs because"
    DISAGREES = "does not agree"


@dataclass(frozen=True, kw_only=True)
class Check:
    """One number and the interval in which a statement holds.

    Attributes:
        name: Name of the number.
        value: The number of this run; a non-finite number passes no test.
        low, high: The interval, bounds included.
        unit: Of all three.
    """

    name: str
    value: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    @property
    def passed(self) -> bool:
        """True if the number lies in the interval."""
        return math.isfinite(self.value) and self.low <= self.value <= self.high


@dataclass(frozen=True, kw_only=True)
class Statement:
    """A claim and the result of this run.

    Attributes:
        claim: The claim in our words.
        outcome: A sentence made from the numbers of this run.
        tests: The numbers that decide; all must pass.
        source: Source of the claim.
        because: Known reason for a failure; shown only when it fails.
    """

    claim: str
    outcome: str
    tests: tuple[Check, ...]
    source: Source = "paper"
    because: str = ""

    @property
    def verdict(self) -> Verdict:
        """Verdict, decided by the numbers alone."""
        if self.tests and all(test.passed for test in self.tests):
            return Verdict.AGREES
        return Verdict.DIFFERS if self.because else Verdict.DISAGREES


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A picture with its explanation.

    Attributes:
        file: Stem of the picture's file.
        title: Headline.
        done: What was done.
        paper: The paper's statement about it, in our words; may be empty.
        caption: How to read the picture.
    """

    file: str
    title: str
    done: str
    caption: str
    paper: str = ""
    statements: tuple[Statement, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """One experiment in the report.

    Attributes:
        number: As in `--only`.
        title: Headline.
        lead: Its subject, in two sentences.
        figures, tables: In the order of the report.
        numbers: All measurements, for `results.json`.
        headline: The numbers for the closing table of the terminal: name and value.
    """

    number: int
    title: str
    lead: str
    figures: tuple[Figure, ...]
    numbers: Numbers
    tables: tuple[Table, ...] = ()
    headline: tuple[tuple[str, str], ...] = field(default=())

    def statements(self, source: Source | None = None) -> list[Statement]:
        """Return all statements, or those of one source."""
        found = [s for figure in self.figures for s in figure.statements]
        return [s for s in found if source is None or s.source == source]

    def count(self, verdict: Verdict, source: Source | None = None) -> int:
        """Return the number of statements with this verdict."""
        return sum(s.verdict is verdict for s in self.statements(source))


def near(
    name: str,
    value: float,
    reference: float,
    *,
    rel: float = 0.0,
    plus: float = 0.0,
    unit: str = "",
) -> Check:
    """Return a test that a number lies within ``rel |reference| + plus`` of a reference."""
    width = rel * abs(reference) + plus
    return Check(name=name, value=value, low=reference - width, high=reference + width, unit=unit)


def at_most(name: str, value: float, bound: float, unit: str = "") -> Check:
    """Return a test that a number is not above a bound."""
    return Check(name=name, value=value, high=bound, unit=unit)


def at_least(name: str, value: float, bound: float, unit: str = "") -> Check:
    """Return a test that a number is not below a bound."""
    return Check(name=name, value=value, low=bound, unit=unit)


def between(name: str, value: float, low: float, high: float, unit: str = "") -> Check:
    """Return a test that a number lies within two bounds."""
    return Check(name=name, value=value, low=low, high=high, unit=unit)


def mm(length: float) -> str:
    """Return a length [m] in millimetres, with a suitable number of digits."""
    size = abs(1e3 * length)
    digits = 0 if size >= 9.95 else 1 if size >= 0.095 else 2
    return f"{1e3 * length:.{digits}f} mm"
