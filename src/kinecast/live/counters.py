"""What a sink counts, in memory that does not grow, and the error that stopped it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

import numpy as np

BIN = 0.5e-3  # width of a bin of latencies [s]: how exactly a percentile is known
BINS = 4000  # the last one holds all that took longer

log = logging.getLogger(__name__)


class SinkCounters:
    """Counts what a sink sent and dropped; of what fails nothing is raised, and the log has it once.

    Messages name the sink's address and what happens to a prediction there: it is "written", "sent" or "drawn". After a
    fatal error nothing more is tried; any other costs one prediction.
    """

    def __init__(self, address: str, verb: str, *fatal: type[Exception]) -> None:
        self.published = 0  # sent or written
        self.dropped = 0  # not sent, because the sink was busy, slow or broken
        self.failure: str | None = None  # why nothing more is tried
        self._address, self._verb, self._fatal = address, verb, fatal
        self._latencies = np.zeros(BINS + 1, dtype=np.int64)
        self._logged = False
        self._lock = threading.Lock()

    def attempt(self, action: Callable[..., object], *arguments: object) -> bool:
        """Calls it, and says whether that went well."""
        if self.failure is not None:
            return False
        try:
            action(*arguments)
        except self._fatal as error:
            self.fail(error)
        except Exception:
            if not self._logged:
                self._logged = True
                log.exception("%s: a prediction could not be %s", self._address, self._verb)
        else:
            return True
        return False

    def deliver(self, action: Callable[..., object], item: object, acquired: float) -> None:
        """Calls it with what was acquired then [s], and counts that as sent or dropped."""
        if self.attempt(action, item):
            self.sent(time.monotonic() - acquired)
        else:
            self.drop()

    def fail(self, error: Exception) -> None:
        """Nothing more is tried."""
        if self.failure is None:
            self.failure = f"{self._address}: {error}"
            log.error("%s: nothing more is %s", self.failure, self._verb)

    def sent(self, latency: float) -> None:
        """One was sent, so long after its frame was acquired [s]."""
        with self._lock:
            self.published += 1
            self._latencies[int(min(max(latency / BIN, 0.0), BINS))] += 1

    def drop(self, count: int = 1) -> None:
        """So many were not sent."""
        with self._lock:
            self.dropped += count

    def latency(self, share: float) -> float:
        """The latency that this share of all that was sent did not exceed [s], rounded up to 0.5 ms.

        NaN before the first; inf beyond 2 s.
        """
        reached = np.cumsum(self._latencies)
        if not reached[-1]:
            return float("nan")
        place = int(np.searchsorted(reached, share * reached[-1]))
        return (place + 1) * BIN if place < BINS else float("inf")
