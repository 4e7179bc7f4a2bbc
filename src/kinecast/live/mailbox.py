"""Between sources and the predictor: the newest frame of each person, and never a queue."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass

from kinecast.types import SkeletonFrame

QUIET = 5.0  # between two lines in the log about one source [s]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Arrival:
    """A frame on its way to the predictor."""

    feed: Feed  # of the source it came from
    frame: SkeletonFrame
    acquired: float  # when the camera took it [s], on `time.monotonic`
    pace: float = 1.0  # seconds of the frames' clock in one of this machine's: above 1 for a recording played faster


class Mailbox:
    """Holds one frame a person: a newer one takes the place of one that was not fetched in time.

    Sources take turns, and so do the persons of each: who sends more has no more of the predictor's time.
    """

    def __init__(self) -> None:
        self.feeds: list[Feed] = []
        self._waiting: dict[Feed, dict[str, Arrival]] = {}
        self._changed = threading.Condition()

    def feed(self, name: str) -> Feed:
        """Where a new source puts its frames."""
        feed = Feed(name, self)
        self.feeds.append(feed)
        return feed

    @property
    def finished(self) -> bool:
        """Whether every source has ended and nothing is waiting."""
        with self._changed:
            return not self._waiting and all(feed.ended for feed in self.feeds)

    def put(self, arrival: Arrival) -> None:
        """Takes in a frame; never waits."""
        with self._changed:
            persons = self._waiting.setdefault(arrival.feed, {})
            arrival.feed.superseded += arrival.frame.person in persons
            persons[arrival.frame.person] = arrival
            self._changed.notify()

    def take(self, timeout: float) -> Arrival | None:
        """The next frame to predict from; None where none came within so many seconds, or nothing will come."""
        with self._changed:
            if timeout and not self._waiting and not all(feed.ended for feed in self.feeds):
                self._changed.wait(timeout)
            if not self._waiting:
                return None
            feed, persons = next(iter(self._waiting.items()))
            del self._waiting[feed]
            arrival = persons.pop(next(iter(persons)))
            if persons:
                self._waiting[feed] = persons  # behind the other sources
            return arrival

    def discard(self) -> None:
        """Counts what still waits as superseded: nobody will take it."""
        while (arrival := self.take(0.0)) is not None:
            arrival.feed.superseded += 1

    def end(self, feed: Feed) -> None:
        """No frame will come from a source any more."""
        with self._changed:
            feed.ended = True
            self._changed.notify_all()


class Feed:
    """One source's way in, and what is counted of it."""

    def __init__(self, name: str, mailbox: Mailbox) -> None:
        self.name = name
        self.received = 0  # frames that came
        self.superseded = 0  # frames that a newer one of the same person replaced, or that the end left
        self.refused = 0  # messages that were no frame, or not wanted
        self.clock_jumps = 0  # how often the source's clock was set
        self.clients = 0  # how many are connected, or send datagrams, now
        self.difference: float | None = None  # this machine's clock less the source's [s]; None where they are one
        self.last: float | None = None  # when the newest frame came [s], on `time.monotonic`
        self.ended = False  # no frame will come any more
        self.fused = False  # what comes goes into another feed, of several cameras
        self._mailbox = mailbox
        self._logged = 0
        self._quiet_until = 0.0

    def put(self, frame: SkeletonFrame, acquired: float, pace: float = 1.0) -> None:
        """Takes in a frame; see `Arrival`."""
        self.received += 1
        self.last = time.monotonic()
        self._mailbox.put(Arrival(self, frame, acquired, pace))

    def refuse(self, problem: str) -> None:
        """Counts a message that was no frame, and says so in the log, at most every `QUIET` seconds."""
        self.refused += 1
        now = time.monotonic()
        if now >= self._quiet_until:
            more = self.refused - self._logged - 1
            log.warning("%s: %s%s", self.name, problem, f" (and {more} more refused before)" if more else "")
            self._logged, self._quiet_until = self.refused, now + QUIET

    def end(self) -> None:
        """Says that no frame will come any more."""
        self._mailbox.end(self)
