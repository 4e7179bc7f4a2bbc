"""Sources and sinks of ROS, from what is written on the command line (docs/ros.md); what is wrong is an OptionError."""

from __future__ import annotations

import os

from kinecast.cli.live_opening import Endpoint
from kinecast.cli.progress import note
from kinecast.errors import OptionError
from kinecast.live.mailbox import Feed
from kinecast.live.sender_guard import SenderGuard
from kinecast.live.settings import number, whole_number
from kinecast.live.sinks import MOST_WAITING, Sink
from kinecast.live.sources import Source
from kinecast.ros.bags import BagWriter, read_frames
from kinecast.ros.dds import DdsTransport
from kinecast.ros.messages import Distribution
from kinecast.ros.nodes import Ros1Transport, Ros2Transport
from kinecast.ros.publisher import OUTPUTS, OutputOptions, PredictionPublisher
from kinecast.ros.subscriber import TF_TYPE, InputOptions, SkeletonSubscriber, input_type
from kinecast.ros.transport import RosSink, RosSource, Transport
from kinecast.types import SkeletonFrame

ROOM = 8  # publications that wait for a network


def subscriber(source: Endpoint) -> SkeletonSubscriber:
    """What reads a topic's messages."""
    topic, settings = str(source.place), source.settings
    if not topic.startswith("/"):
        raise OptionError(f"{source.text}: a topic such as /skeletons is expected")
    if "type" not in settings and topic not in ("/tf", "/tf_static"):
        raise OptionError(f"{source.text}: say of which type the messages are, such as type=PoseArray")
    type_ = input_type(settings["type"]) if "type" in settings else TF_TYPE
    return SkeletonSubscriber(topic, type_, _input_options(source))


def publisher(sink: Endpoint) -> PredictionPublisher:
    """What makes messages of predictions."""
    settings = sink.settings
    namespace = settings.get("namespace") if sink.kind == "bag" else str(sink.place)
    parts = whole_number(settings, "parts", OutputOptions.parts, sink.text)
    thickness = number(settings, "thickness", OutputOptions.thickness, sink.text)
    outputs = tuple(settings["outputs"].split(",")) if "outputs" in settings else OUTPUTS
    topic = settings.get("planning_scene", "")
    return PredictionPublisher(OutputOptions(namespace or "/kinecast", outputs, topic, parts, thickness))


def open_source(source: Endpoint, feed: Feed, guard: SenderGuard) -> Source:
    """A topic of ROS 1, ROS 2 or DDS."""
    return RosSource(source.text, feed, subscriber(source), _transport(source), guard)


def open_sink(sink: Endpoint) -> Sink:
    """Topics of ROS 1, ROS 2 or DDS, or a bag."""
    if sink.kind != "bag":
        return RosSink(sink.text, publisher(sink), _transport(sink), ROOM)
    writer = BagWriter(sink.path, _distribution(sink, sink.text), sink.settings.get("storage", "mcap"))
    return RosSink(sink.text, publisher(sink), writer, MOST_WAITING)


def bag_frames(source: Endpoint) -> list[SkeletonFrame]:
    """Frames of a bag; messages that are none are passed over, and counted on the terminal."""
    frames, wrong = read_frames(source.path, source.settings.get("topic", ""), _input_options(source))
    if wrong:
        note(f"{source.path}: {wrong} messages were no skeletons")
    return frames


def _transport(endpoint: Endpoint) -> Transport:
    if endpoint.kind == "ros1":
        return Ros1Transport()
    if endpoint.kind == "ros2":
        return Ros2Transport()
    domain = endpoint.settings.get("domain", os.environ.get("ROS_DOMAIN_ID", "0"))
    if not domain.isdecimal():
        raise OptionError(f"domain {domain!r} is no whole number")
    return DdsTransport(_distribution(endpoint, "dds"), int(domain), endpoint.settings.get("network", ""))


def _distribution(endpoint: Endpoint, where: str) -> Distribution:
    name = endpoint.settings.get("distro", Distribution.JAZZY.value)
    known = {each.value: each for each in Distribution if each.generation == 2}
    if name not in known:
        raise OptionError(f"{where}: distro {name!r}, expected {' or '.join(known)}")
    return known[name]


def _input_options(source: Endpoint) -> InputOptions:
    settings = source.settings
    height = number(settings, "height", InputOptions.height, source.text)
    frame = settings.get("frame", "").lstrip("/")
    return InputOptions(settings.get("joints", ""), settings.get("person", "0"), frame, height)
