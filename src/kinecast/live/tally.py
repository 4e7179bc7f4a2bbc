"""What was sent, dropped and how late, in a memory that does not grow."""

from __future__ import annotations

__all__ = ["Tally"]

WIDTH = 0.5e-3
"""Of a bin [s]: how exactly a percentile is known."""
BINS = 4000
"""The last one holds all that took longer."""


class Tally:
    """Counts of one sink.

    Attributes:
        published: how many were sent or written.
        dropped: how many were not, because the sink was busy, slow or broken.
    """

    def __init__(self) -> None:
        self.published = 0
        self.dropped = 0
        self._bins = [0] * (BINS + 1)

    def sent(self, latency: float) -> None:
        """One was sent, so long after its frame was acquired [s]."""
        self.published += 1
        self._bins[min(max(int(latency / WIDTH), 0), BINS)] += 1

    def latency(self, share: float) -> float:
        """The latency that this share of all that was sent did not exceed [s], rounded up to 0.5 ms.

        NaN before the first; inf beyond 2 s.
        """
        bins = list(self._bins)
        wanted = share * sum(bins)
        if not wanted:
            return float("nan")
        seen = 0
        for place, count in enumerate(bins):
            seen += count
            if seen >= wanted:
                return (place + 1) * WIDTH if place < BINS else float("inf")
        return float("inf")
