"""Sources and sinks of ROS, from what is written on the command line (docs/ros.md)."""

from __future__ import annotations

from collections.abc import Mapping

from kinecast.errors import OptionError
from kinecast.live.loop import Source
from kinecast.live.sinks import Sink
from kinecast.perception.mailbox import Feed
from kinecast.ros.carrier import Carrier, RosSink, RosSource
from kinecast.ros.incoming import TF_TYPE, Incoming, InputOptions, input_type
from kinecast.ros.outgoing import OUTPUTS, Outgoing, OutputOptions
from kinecast.ros.planning_scene import SceneOptions
from kinecast.ros.ros1 import Ros1Carrier

__all__ = ["SINK_SETTINGS", "SOURCE_SETTINGS", "incoming", "open_sink", "open_source", "outgoing"]

SOURCE_SETTINGS = {"ros1": ("type", "joints", "person", "frame", "height")}
SINK_SETTINGS = {"ros1": ("outputs", "planning_scene", "parts", "thickness")}
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
    options = InputOptions(
        settings.get("joints", ""),
        settings.get("person", "0"),
        settings.get("frame", "").lstrip("/"),
        _number(text, settings, "height", 1.65),
    )
    return Incoming(topic, type_, options)


def outgoing(text: str, namespace: str, settings: Mapping[str, str]) -> Outgoing:
    """What makes messages of predictions.

    Args:
        text: the SINK, for messages.
        namespace: as written; "" is /kinecast.
        settings: some of `SINK_SETTINGS`.

    Raises:
        OptionError: a name that is none, or settings outside their ranges.
    """
    parts = _number(text, settings, "parts", 3)
    if parts != int(parts):
        raise OptionError(f"{text}: parts {settings['parts']!r} is no whole number")
    scene = SceneOptions(int(parts), _number(text, settings, "thickness", 0.05))
    outputs = tuple(settings["outputs"].split(",")) if "outputs" in settings else OUTPUTS
    return Outgoing(OutputOptions(namespace or "/kinecast", outputs, settings.get("planning_scene", ""), scene))


def open_source(text: str, kind: str, topic: str, settings: Mapping[str, str], feed: Feed) -> Source:
    """A source of one of the kinds of `SOURCE_SETTINGS`.

    Raises:
        OptionError: as `incoming`, or there is no ROS here.
    """
    return RosSource(text, feed, incoming(text, topic, settings), _carrier(kind))


def open_sink(text: str, kind: str, namespace: str, settings: Mapping[str, str]) -> Sink:
    """A sink of one of the kinds of `SINK_SETTINGS`.

    Raises:
        OptionError: as `outgoing`, or there is no ROS here.
    """
    return RosSink(text, outgoing(text, namespace, settings), _carrier(kind), ROOM)


def _carrier(kind: str) -> Carrier:  # noqa: ARG001
    return Ros1Carrier()


def _number(text: str, settings: Mapping[str, str], name: str, default: float) -> float:
    try:
        return float(settings.get(name, default))
    except ValueError:
        raise OptionError(f"{text}: {name} {settings[name]!r} is no number") from None
