"""When a frame was acquired, on this machine's clock, told from the stamps of a clock that is not this machine's."""

from __future__ import annotations

import math

WINDOW = 15.0
"""The least lag is sought over one to two of these [s]; clocks that drift 50 ppm apart part by 1.5 ms in that time."""
JUMP = 1.0  # stamps that move against arrivals by more than this [s] are another clock, or a stall
CONFIRM = 1.0
"""A lag that grew by more than `JUMP` and stays for this long [s] is another clock; until then it is a stall."""


class SourceClock:
    """The difference between a sender's clock and this machine's: the least lag lately seen between stamp and arrival.

    What the fastest message took on its way cannot be told from a difference of clocks, and is not counted as delay.

    Attributes:
        jumps: how often the sender's clock was set.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._least = self._least_before = math.inf
        self._begun = -math.inf
        self._strange: tuple[float, float] | None = None

    @property
    def difference(self) -> float:
        """This machine's clock less the sender's [s]; inf before the first frame."""
        return min(self._least, self._least_before)

    def acquired(self, stamp: float, arrived: float) -> float:
        """When a frame was acquired [s] on this machine's clock, on which it arrived; `arrived` never decreases."""
        lag = arrived - stamp
        if lag < self.difference - JUMP:
            self.jumps += self.difference < math.inf
            self._restart(lag, arrived)
        elif lag > self.difference + JUMP:
            since, least = self._strange or (arrived, lag)
            self._strange = since, min(least, lag)
            if arrived - since >= CONFIRM:
                self.jumps += 1
                self._restart(min(least, lag), arrived)
        else:
            self._strange = None
            if arrived - self._begun > WINDOW:
                self._least_before, self._least, self._begun = self._least, lag, arrived
            self._least = min(self._least, lag)
        return min(stamp + self.difference, arrived)

    def _restart(self, lag: float, now: float) -> None:
        self._least, self._least_before, self._begun, self._strange = lag, math.inf, now, None
