"""A source and a sink over anything that carries ROS messages as bytes."""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from kinecast.live.mailbox import Feed
from kinecast.live.message import MessageError
from kinecast.live.publication import Publication
from kinecast.live.sender_guard import SenderGuard
from kinecast.live.sinks import BackgroundWriter
from kinecast.ros.messages import Messages
from kinecast.ros.publisher import Posting, PredictionPublisher
from kinecast.ros.subscriber import SkeletonSubscriber

Callback = Callable[[str, bytes], None]
"""Takes a topic and the bytes of a message that came on it, in any thread."""
CLOSING = 5.0  # longest wait for a thread to end: a network may hang [s]


class Transport(ABC):
    """Carries bytes between topics, in the definitions of `messages`."""

    def __init__(self, messages: Messages) -> None:
        self.messages = messages
        self._publishers: dict[str, Callable[[bytes], None]] = {}

    @abstractmethod
    def subscribe(self, topic: str, type_: str, callback: Callback) -> None:
        """Has `callback` called with each message of a topic."""

    @abstractmethod
    def create_publisher(self, topic: str, type_: str) -> Callable[[bytes], None]:
        """What sends the bytes of a message on a topic; an OSError says that nothing can be sent any more."""

    @abstractmethod
    def close(self) -> None:
        """Ends all that was opened."""

    def advertise(self, topic: str, type_: str) -> None:
        """Says that messages will come, so that those who wait for them get the first."""
        if topic not in self._publishers:
            self._publishers[topic] = self.create_publisher(topic, type_)

    def publish(self, topic: str, type_: str, content: bytes) -> None:
        """Sends a message on a topic, which need not be advertised."""
        self.advertise(topic, type_)
        self._publishers[topic](content)

    def now(self) -> float:
        """The ROS clock [s]."""
        return time.time()


@dataclass
class RosSource:
    """Skeletons from topics, to a guard; bad messages are counted in the feed. It closes its transport."""

    address: str
    feed: Feed
    subscriber: SkeletonSubscriber
    transport: Transport
    guard: SenderGuard
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def start(self) -> None:
        """Subscribes."""
        for topic, type_ in self.subscriber.topics.items():
            self.transport.messages.prepare(type_)
            self.transport.subscribe(topic, type_, self._take)

    def close(self) -> None:
        """Ends; no frame comes afterwards."""
        self.transport.close()

    def _take(self, topic: str, content: bytes) -> None:
        arrived = time.monotonic()
        try:
            with self._lock:
                for found in self.subscriber.read(self.transport.messages, topic, content):
                    try:
                        if isinstance(found, MessageError):
                            raise found
                        self.guard.admit(found, self.address, arrived)
                    except MessageError as problem:
                        self.feed.refuse(str(problem))
        except Exception as error:  # in a thread of the transport's, which must go on
            self.feed.refuse(f"{topic}: {type(error).__name__}: {str(error)[:200]}")


class RosSink(BackgroundWriter):
    """Predictions on topics; what was drawn or put into a scene is deleted once it expires. It closes its transport."""

    def __init__(self, address: str, publisher: PredictionPublisher, transport: Transport, room: int) -> None:
        self._publisher, self._transport = publisher, transport
        for topic, type_ in publisher.topics.items():
            transport.messages.prepare(type_)
            transport.advertise(topic, type_)
        super().__init__(address, room, "sent")

    def write(self, publication: Publication) -> None:
        self._send(self._publisher.tell(publication, time.monotonic(), self._transport.now()))

    def expire(self) -> None:
        self._send(self._publisher.take_back(time.monotonic()))

    def finish(self) -> None:
        self._send(self._publisher.take_back(math.inf))

    def release(self) -> None:
        self._transport.close()

    def _send(self, postings: Iterator[Posting]) -> None:
        for topic, type_, fields in postings:
            self._transport.publish(topic, type_, self._transport.messages.encode(type_, fields))
