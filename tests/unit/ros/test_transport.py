"""A sink whose transport is slow or broken, and a source whose transport goes on whatever comes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.live.mailbox import Mailbox
from kinecast.live.sender_guard import SenderGuard
from kinecast.ros.messages import Distribution, messages_of
from kinecast.ros.publisher import OutputOptions, PredictionPublisher
from kinecast.ros.subscriber import InputOptions, SkeletonSubscriber
from kinecast.ros.transport import Callback, RosSink, RosSource, Transport

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
LONG = 60.0
"""Of a wait for another thread [s]."""
ONE = OutputOptions(outputs="prediction")


class Wire(Transport):
    """A transport inside this process, which waits or fails as it is told."""

    def __init__(self, trouble: Exception | None = None) -> None:
        super().__init__(messages_of(Distribution.JAZZY))
        self.trouble = trouble
        self.free = threading.Event()
        self.begun = threading.Event()
        self.sent: list[str] = []
        self.callbacks: dict[str, Callback] = {}
        self.closed = False

    def subscribe(self, topic: str, type_: str, callback: Callback) -> None:
        self.callbacks[topic] = callback

    def create_publisher(self, topic: str, type_: str) -> Callable[[bytes], None]:
        assert topic == "/kinecast/prediction"

        def publish(content: bytes) -> None:
            self.begun.set()
            assert self.free.wait(LONG)
            if self.trouble:
                raise self.trouble
            self.sent.append(self.messages.decode(type_, content).person)

        return publish

    def now(self) -> float:
        return 1_760_000_000.0

    def close(self) -> None:
        self.closed = True


def test_the_oldest_waits_no_longer_where_there_is_no_room(publish: Any) -> None:
    wire = Wire()
    sink = RosSink("wire", PredictionPublisher(ONE), wire, room=3)
    sink.publish(publish(REST, 0.0, "first"))
    assert wire.begun.wait(LONG)
    for k in range(8):
        sink.publish(publish(REST, 0.0, str(k)))
    assert sink.counters.dropped == 5
    wire.free.set()
    sink.close()
    assert wire.sent == ["first", "5", "6", "7"]
    assert (sink.counters.published, sink.counters.failure, wire.closed) == (4, None, True)


def after_five(wire: Wire, publish: Any) -> RosSink:
    """A sink that has ended after five publications."""
    wire.free.set()
    sink = RosSink("wire", PredictionPublisher(ONE), wire, room=100)
    for k in range(5):
        sink.publish(publish(REST, 0.0, str(k)))
    sink.close()
    return sink


def test_after_an_error_of_the_system_nothing_more_is_sent(publish: Any, caplog: pytest.LogCaptureFixture) -> None:
    wire = Wire(OSError("the cable is out"))
    sink = after_five(wire, publish)
    assert sink.counters.failure == "wire: the cable is out"
    assert (sink.counters.published, sink.counters.dropped) == (0, 5)
    assert caplog.text.count("nothing more is sent") == 1
    assert wire.closed


def test_any_other_error_costs_one_prediction(publish: Any, caplog: pytest.LogCaptureFixture) -> None:
    wire = Wire(ValueError("odd"))
    sink = after_five(wire, publish)
    assert (sink.counters.published, sink.counters.dropped, sink.counters.failure) == (0, 5, None)
    assert caplog.text.count("could not be sent") == 1


def test_a_source_counts_what_it_refuses_and_goes_on() -> None:
    wire, feed = Wire(), Mailbox().feed("wire")
    subscriber = SkeletonSubscriber("/arms", "geometry_msgs/PoseArray", InputOptions(joints=",".join(ARM_JOINTS)))
    source = RosSource("wire", feed, subscriber, wire, SenderGuard(feed))
    source.start()
    poses = [{"position": dict(zip("xyz", xyz, strict=True))} for xyz in REST.tolist()]
    good = wire.messages.encode("geometry_msgs/PoseArray", {"header": {"stamp": 5.0}, "poses": poses})
    for content in (b"", good[:-9], good, bytes(good[:4]) + b"\xff" * 60):
        wire.callbacks["/arms"]("/arms", content)
    wire.callbacks["/arms"]("/nowhere", good)  # what no transport should do
    assert (feed.received, feed.refused) == (1, 4)
    source.close()
    assert wire.closed
