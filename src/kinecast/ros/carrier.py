"""A source and a sink over anything that carries ROS messages as bytes."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Protocol, runtime_checkable

from kinecast.live.counters import SinkCounters
from kinecast.live.mailbox import Feed
from kinecast.live.message import MessageError
from kinecast.live.publication import Publication
from kinecast.live.sender_guard import SenderGuard
from kinecast.ros.incoming import Incoming
from kinecast.ros.messages import Messages
from kinecast.ros.outgoing import Outgoing, Posting

__all__ = ["Carrier", "RosSink", "RosSource", "Taker"]

Taker = Callable[[str, bytes], None]
"""Takes a topic and the bytes of a message that came on it, in any thread."""
LOOK = 0.5
"""Longest wait before looking whether to end [s]."""


@runtime_checkable
class Carrier(Protocol):
    """Carries bytes between topics.

    Attributes:
        messages: the definitions it speaks.
    """

    messages: Messages

    def subscribe(self, topic: str, type_: str, take: Taker) -> None:
        """Has `take` called with each message of a topic."""
        ...

    def advertise(self, topic: str, type_: str) -> None:
        """Says that messages will come, so that those who wait for them get the first."""
        ...

    def publish(self, topic: str, type_: str, content: bytes) -> None:
        """Sends a message on a topic, which need not be advertised.

        Raises:
            OSError: nothing can be sent any more.
        """
        ...

    def now(self) -> float:
        """The ROS clock [s]."""
        ...

    def close(self) -> None:
        """Ends all that was opened."""
        ...


class RosSource:
    """Skeletons from topics.

    Args:
        address: for messages.
        feed: where bad messages are counted.
        incoming: reads messages.
        carrier: is closed with the source.
        guard: takes the frames.
    """

    def __init__(self, address: str, feed: Feed, incoming: Incoming, carrier: Carrier, guard: SenderGuard) -> None:
        self.address = address
        self._feed = feed
        self._incoming = incoming
        self._carrier = carrier
        self._guard = guard
        self._lock = threading.Lock()

    def start(self) -> None:
        """Subscribes."""
        for topic, type_ in self._incoming.topics.items():
            self._carrier.messages.prepare(type_)
            self._carrier.subscribe(topic, type_, self._take)

    def close(self) -> None:
        """Ends; no frame comes afterwards."""
        self._carrier.close()

    def _take(self, topic: str, content: bytes) -> None:
        arrived = time.monotonic()
        try:
            self._admit(topic, content, arrived)
        except Exception as error:  # in a thread of the carrier's, which must go on
            self._feed.refuse(f"{topic}: {type(error).__name__}: {str(error)[:200]}")

    def _admit(self, topic: str, content: bytes, arrived: float) -> None:
        with self._lock:
            for found in self._incoming.read_bytes(self._carrier.messages, topic, content):
                try:
                    if isinstance(found, MessageError):
                        raise found
                    self._guard.admit(found, self.address, arrived)
                except MessageError as problem:
                    self._feed.refuse(str(problem))


class RosSink:
    """Predictions on topics, from a thread of its own that also deletes what has expired.

    Args:
        address: for messages.
        outgoing: makes the messages.
        carrier: is closed with the sink.
        room: publications that may wait; the oldest of more are dropped and counted.
    """

    def __init__(self, address: str, outgoing: Outgoing, carrier: Carrier, room: int) -> None:
        self.address = address
        self.counters = SinkCounters(address, "sent", OSError)
        self._outgoing = outgoing
        self._carrier = carrier
        self._room = room
        self._waiting: deque[Publication] = deque()
        self._changed = threading.Condition()
        self._ending = False
        for topic, type_ in outgoing.topics.items():
            carrier.messages.prepare(type_)
            carrier.advertise(topic, type_)
        self._thread = threading.Thread(target=self._run, name=address, daemon=True)
        self._thread.start()

    def publish(self, publication: Publication) -> None:
        """See kinecast.live.sinks.Sink."""
        with self._changed:
            if len(self._waiting) >= self._room:
                self._waiting.popleft()
                self.counters.drop()
            self._waiting.append(publication)
            self._changed.notify()

    def close(self) -> None:
        """Sends what waits, deletes all that was drawn or put into a scene, and ends."""
        with self._changed:
            self._ending = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                if not self._waiting and not self._ending:
                    self._changed.wait(min(max(self._outgoing.next_expiry - time.monotonic(), 0.0), LOOK))
                publication = self._waiting.popleft() if self._waiting else None
                ended = self._ending and publication is None
            if publication is not None:
                if self.counters.attempt(self._send, self._told(publication)):
                    self.counters.sent(time.monotonic() - publication.acquired)
                else:
                    self.counters.drop()
            self.counters.attempt(self._send, self._outgoing.take_back(math.inf if ended else time.monotonic()))
            if ended:
                break
        try:
            self._carrier.close()
        except Exception as error:
            self.counters.fail(error)

    def _told(self, publication: Publication) -> Iterator[Posting]:
        yield from self._outgoing.tell(publication, time.monotonic(), self._carrier.now())

    def _send(self, postings: Iterator[Posting]) -> None:
        for each in postings:
            self._carrier.publish(each.topic, each.type_, self._carrier.messages.encode(each.type_, each.fields))
