"""The loop: the newest frame, its prediction, every sink. One thread predicts; nobody makes it wait."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from kinecast.live.mailbox import Arrival, Feed, Mailbox
from kinecast.live.publication import Publication
from kinecast.live.sinks import Sink
from kinecast.predictor import Predictor
from kinecast.types import Status

LOOK = 0.1  # longest wait for a frame before looking whether to end [s]

log = logging.getLogger(__name__)


@dataclass
class Live:
    """Sources → predictions → sinks."""

    mailbox: Mailbox  # that the sources' feeds belong to
    predictors: Mapping[Feed, Predictor]  # one for each source, so that one that lies is alone with that
    sinks: Sequence[Sink]  # that take every prediction
    level: float = 0.95  # probability of the tubes
    statuses: Counter[Status] = field(default_factory=Counter)  # how often each was published
    last: dict[Feed, Status] = field(default_factory=dict)  # the newest of each source
    failures: int = 0  # frames whose prediction could not be published

    def run(self, stop: threading.Event) -> None:
        """Until it is told to stop, or every source has ended."""
        while not stop.is_set() and not self.mailbox.finished:
            arrival = self.mailbox.take(LOOK)
            if arrival is not None:
                self.step(arrival)

    def step(self, arrival: Arrival) -> None:
        """One frame, start to end; whatever happens, it does not raise."""
        feed, frame, acquired = arrival.feed, arrival.frame, arrival.acquired
        try:
            delay = max(time.monotonic() - acquired, 0.0)
            prediction = self.predictors[feed].observe(frame, frame.stamp + delay * arrival.pace)
            self.statuses[prediction.status] += 1
            self.last[feed] = prediction.status
            number = self.statuses.total()
            publication = Publication.of(number, feed.name, frame, prediction, self.level, acquired)
            for sink in self.sinks:
                sink.publish(publication)
        except Exception:
            self.failures += 1
            if self.failures == 1:  # the others are counted
                log.exception("%s: a prediction could not be published", feed.name)
