"""Sources and sinks of ROS, from what is written on the command line (docs/ros.md)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from kinecast.cli.progress import note
from kinecast.errors import OptionError
from kinecast.live.admission import Admission
from kinecast.live.loop import Source
from kinecast.live.mailbox import Feed
from kinecast.live.settings import number, whole_number
from kinecast.live.sinks import MOST_WAITING, Sink
from kinecast.ros.bags import BagWriter, read_frames
from kinecast.ros.dds import DdsTransport as DdsCarrier
from kinecast.ros.messages import Distribution
from kinecast.ros.planning_scene import SceneOptions
from kinecast.ros.publisher import OUTPUTS, OutputOptions
from kinecast.ros.publisher import PredictionPublisher as Outgoing
from kinecast.ros.ros1 import Ros1Transport as Ros1Carrier
from kinecast.ros.ros2 import Ros2Transport as Ros2Carrier
from kinecast.ros.subscriber import TF_TYPE, InputOptions, input_type
from kinecast.ros.subscriber import SkeletonSubscriber as Incoming
from kinecast.ros.transport import RosSink, RosSource
from kinecast.ros.transport import Transport as Carrier
from kinecast.types import SkeletonFrame

__all__ = [
    "BAG_SETTINGS",
    "BAG_SINK_SETTINGS",
    "SINK_SETTINGS",
    "SOURCE_SETTINGS",
    "bag_frames",
    "incoming",
    "open_bag_sink",
    "open_sink",
    "open_source",
    "outgoing",
]

_INPUT = ("type", "joints", "person", "frame", "height", "camera")
_OUTPUT = ("outputs", "planning_scene", "parts", "thickness")
_DDS = ("distro", "domain", "network")
SOURCE_SETTINGS = {"ros1": _INPUT, "ros2": _INPUT, "dds": (*_INPUT, *_DDS)}
SINK_SETTINGS = {"ros1": _OUTPUT, "ros2": _OUTPUT, "dds": (*_OUTPUT, *_DDS)}
BAG_SETTINGS = ("topic", *_INPUT[1:-1], "speed", "repeat")
BAG_SINK_SETTINGS = ("namespace", *_OUTPUT, "distro", "storage")
"""What may stand behind the question mark."""
ROOM = 8
"""Publications that wait for a network."""


def incoming(text: str, topic: str, settings: Mapping[str, str]) -> Incoming:
    """What reads a topic's messages.

    Args:
        text: the SOURCE, for messages.
        topic: as written.
        settings: some of `SOURCE_SETTINGS`.

    Raises:
        OptionError: no type, or one that is not read, or settings that do not fit.
    """
    if not topic.startswith("/"):
        raise OptionError(f"{text}: a topic such as /skeletons is expected")
    if "type" not in settings and topic not in ("/tf", "/tf_static"):
        raise OptionError(f"{text}: say of which type the messages are, such as type=PoseArray")
    type_ = input_type(settings["type"]) if "type" in settings else TF_TYPE
    return Incoming(topic, type_, _input_options(text, settings))


def outgoing(text: str, namespace: str, settings: Mapping[str, str]) -> Outgoing:
    """What makes messages of predictions.

    Args:
        text: the SINK, for messages.
        namespace: as written; "" is /kinecast.
        settings: some of `SINK_SETTINGS`.

    Raises:
        OptionError: a name that is none, or settings outside their ranges.
    """
    parts = whole_number(settings, "parts", SceneOptions.parts, text)
    scene = SceneOptions(parts, number(settings, "thickness", SceneOptions.thickness, text))
    outputs = tuple(settings["outputs"].split(",")) if "outputs" in settings else OUTPUTS
    return Outgoing(OutputOptions(namespace or "/kinecast", outputs, settings.get("planning_scene", ""), scene))


def open_source(
    text: str, kind: str, topic: str, settings: Mapping[str, str], feed: Feed, admission: Admission
) -> Source:
    """A source of one of the kinds of `SOURCE_SETTINGS`.

    Raises:
        OptionError: as `incoming`, or there is no ROS here.
    """
    return RosSource(text, feed, incoming(text, topic, settings), _carrier(kind, settings), admission)


def open_sink(text: str, kind: str, namespace: str, settings: Mapping[str, str]) -> Sink:
    """A sink of one of the kinds of `SINK_SETTINGS`.

    Raises:
        OptionError: as `outgoing`, or there is no ROS here.
    """
    return RosSink(text, outgoing(text, namespace, settings), _carrier(kind, settings), ROOM)


def bag_frames(text: str, path: Path, settings: Mapping[str, str]) -> list[SkeletonFrame]:
    """Frames of a bag; messages that are none are passed over, and counted on the terminal.

    Raises:
        DatasetError, OptionError: as `read_frames`.
    """
    frames, wrong = read_frames(path, settings.get("topic", ""), _input_options(text, settings))
    if wrong:
        note(f"{path}: {wrong} messages were no skeletons")
    return frames


def open_bag_sink(text: str, path: Path, settings: Mapping[str, str]) -> Sink:
    """A bag for predictions.

    Raises:
        OptionError: as `outgoing`, or the bag cannot be made.
    """
    told = outgoing(text, settings.get("namespace", ""), settings)
    writer = BagWriter(path, _distribution(text, settings), settings.get("storage", "mcap"))
    return RosSink(text, told, writer, MOST_WAITING)


def _carrier(kind: str, settings: Mapping[str, str]) -> Carrier:
    if kind == "ros1":
        return Ros1Carrier()
    if kind == "ros2":
        return Ros2Carrier()
    domain = settings.get("domain", os.environ.get("ROS_DOMAIN_ID", "0"))
    if not domain.isdecimal():
        raise OptionError(f"domain {domain!r} is no whole number")
    return DdsCarrier(_distribution("dds", settings), int(domain), settings.get("network", ""))


def _distribution(text: str, settings: Mapping[str, str]) -> Distribution:
    name = settings.get("distro", Distribution.JAZZY.value)
    known = {each.value: each for each in Distribution if each.generation == 2}
    if name not in known:
        raise OptionError(f"{text}: distro {name!r}, expected {' or '.join(known)}")
    return known[name]


def _input_options(text: str, settings: Mapping[str, str]) -> InputOptions:
    return InputOptions(
        settings.get("joints", ""),
        settings.get("person", "0"),
        settings.get("frame", "").lstrip("/"),
        number(settings, "height", InputOptions.height, text),
    )
