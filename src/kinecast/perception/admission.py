"""What a network source lets in: whole messages, few persons, and one sender for each person."""

from __future__ import annotations

from collections.abc import Hashable

from kinecast.perception.clock import SourceClock
from kinecast.perception.mailbox import Feed
from kinecast.perception.message import MessageError, decode
from kinecast.types import SkeletonFrame

__all__ = ["MOST_PERSONS", "MOST_SENDERS", "Admission"]

MOST_PERSONS = 16
"""Persons of one source at once."""
MOST_SENDERS = 16
"""Senders of one source at once."""
FORGET = 2.0
"""After so much silence [s] a person's name, or a sender's place, is free for another."""


class Admission:
    """Takes the messages of every sender to one source; whatever comes, nothing is raised.

    Args:
        feed: where good frames go and bad messages are counted.
    """

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._senders: dict[Hashable, tuple[SourceClock, float]] = {}
        self._persons: dict[str, tuple[Hashable, float]] = {}

    @property
    def senders(self) -> int:
        """How many are known now."""
        return len(self._senders)

    def take(self, content: bytes | str, sender: Hashable, arrived: float) -> None:
        """One message.

        Args:
            content: see kinecast.perception.message.
            sender: who sent it: a connection or an address.
            arrived: when [s], on `time.monotonic`.
        """
        try:
            self.admit(decode(content), sender, arrived)
        except MessageError as problem:
            self._feed.refuse(str(problem))

    def admit(self, frame: SkeletonFrame, sender: Hashable, arrived: float) -> None:
        """A frame that was read already; see `take`.

        Raises:
            MessageError: too many send, or its person is another sender's.
        """
        clock = self._clock(sender, arrived)
        self._claim(frame, sender, arrived)
        jumps = clock.jumps
        acquired = clock.acquired(frame.stamp, arrived)
        self._feed.clock_jumps += clock.jumps - jumps
        self._feed.difference = clock.difference
        self._feed.put(frame, acquired)

    def leave(self, sender: Hashable) -> None:
        """A sender has gone: its persons' names are free."""
        self._senders.pop(sender, None)
        self._persons = {person: owner for person, owner in self._persons.items() if owner[0] != sender}

    def _clock(self, sender: Hashable, arrived: float) -> SourceClock:
        """The sender's clock; one that is new takes the place of one that is silent."""
        if sender not in self._senders:
            self._senders = {known: kept for known, kept in self._senders.items() if arrived - kept[1] < FORGET}
            if len(self._senders) >= MOST_SENDERS:
                raise MessageError(f"more than {MOST_SENDERS} senders")
        clock = self._senders[sender][0] if sender in self._senders else SourceClock()
        self._senders[sender] = clock, arrived
        return clock

    def _claim(self, frame: SkeletonFrame, sender: Hashable, arrived: float) -> None:
        """A person belongs to the first who sends it, until that sender is silent about it."""
        owner, last = self._persons.get(frame.person, (sender, arrived))
        if owner != sender and arrived - last < FORGET:
            raise MessageError(f"person {frame.person!r} is sent by another sender too")
        if frame.person not in self._persons:
            self._persons = {name: kept for name, kept in self._persons.items() if arrived - kept[1] < FORGET}
            if len(self._persons) >= MOST_PERSONS:
                raise MessageError(f"more than {MOST_PERSONS} persons")
        self._persons[frame.person] = sender, arrived
