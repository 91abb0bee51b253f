"""Histogram of the lateness of ticks, of bounded size."""

from __future__ import annotations

import math

import numpy as np

#: Lower end of the first bin [s], bins per decade, and number of bins: 1 µs to 10 s.
FIRST, PER_DECADE, BINS = 1e-6, 20, 140


class Lateness:
    """Histogram of ticks by lateness, 20 bins per decade from 1 µs to 10 s.

    Attributes:
        counts: Ticks per bin (142,): below 1 µs, the 140 bins, above 10 s.
        largest: Latest tick [s].
    """

    def __init__(self) -> None:
        """Start with empty bins."""
        self.counts = np.zeros(BINS + 2, dtype=np.int64)
        self.largest = 0.0

    def add(self, late: float) -> None:
        """Count a tick that began `late` [s] after its deadline."""
        late = max(late, 0.0)
        self.largest = max(self.largest, late)
        bin_ = 0
        if late >= FIRST:
            bin_ = min(1 + int(PER_DECADE * math.log10(late / FIRST)), BINS + 1)
        self.counts[bin_] += 1

    def __len__(self) -> int:
        """Return the number of ticks."""
        return int(self.counts.sum())

    def percentile(self, share: float) -> float:
        """Return the lateness percentile `share` (0 to 100) [s], 12 % coarse; 0 without ticks."""
        total = len(self)
        if total == 0:
            return 0.0
        place = int(np.searchsorted(np.cumsum(self.counts), max(share / 100.0 * total, 1e-9)))
        if place > BINS:
            return self.largest
        return min(FIRST * float(10.0 ** (place / PER_DECADE)), self.largest)

    def __str__(self) -> str:
        parts = [f"{1e6 * self.percentile(p):.0f}" for p in (50.0, 99.0, 99.9)]
        return f"{' / '.join(parts)} µs (50, 99, 99.9 %), at most {1e6 * self.largest:.0f} µs"
