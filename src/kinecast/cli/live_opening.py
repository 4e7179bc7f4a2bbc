"""Sources and sinks from what is written on the command line; whatever is wrong is said before anything starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.live.admission import Admission
from kinecast.live.detection import DetectionHandler
from kinecast.live.loop import Source
from kinecast.live.mailbox import Feed, Mailbox
from kinecast.live.mcap import McapSink
from kinecast.live.network import Address, Network, UdpSource, WebSocketSource
from kinecast.live.recorded import RecordedSource
from kinecast.live.settings import number, whole_number
from kinecast.live.sinks import FileSink, JsonlSink, Sink
from kinecast.live.websocket import WebSocketSink
from kinecast.live.xsens import DEFAULT_PORT, XsensAdmission, XsensOptions
from kinecast.types import SkeletonFrame

if TYPE_CHECKING:
    from kinecast.cameras.fused_source import FusedSource

__all__ = ["Description", "open_sinks", "open_sources", "read_sink", "read_source"]

SOURCE_FORMS = (
    "a recording's path, recording:PATH?speed=2&repeat=1, ws://HOST:PORT, udp://HOST:PORT, "
    "xsens://HOST:PORT?person=0, realsense:SERIAL?model=FILE, "
    "ros1:, ros2: or dds:/TOPIC?type=PoseArray, bag:PATH?topic=/TOPIC"
)
REALSENSE_SETTINGS = ("model", "detector", "size", "rate", "tilt", "height", "camera")
SINK_FORMS = (
    "view://HOST:PORT, ws://HOST:PORT?format=json, mcap:PATH, jsonl:PATH, ros1:, ros2: or dds:/NAMESPACE, bag:PATH"
)
_DEFAULT_PORTS = {"xsens": DEFAULT_PORT, "view": 8080}
_ROS = ("ros1", "ros2", "dds")
_FILES: dict[str, tuple[type[FileSink], str]] = {"mcap": (McapSink, ".mcap"), "jsonl": (JsonlSink, ".jsonl")}


@dataclass(frozen=True)
class Description:
    """A SOURCE or SINK, taken apart.

    Attributes:
        text: as written.
        kind: "recording", "ws", "udp", "xsens", "realsense", "view", "mcap", "jsonl", "ros1", "ros2", "dds" or
            "bag".
        place: a path, the address, a camera's serial number, or a ROS name.
        settings: what stands behind the question mark.
    """

    text: str
    kind: str
    place: Path | Address | str
    settings: dict[str, str]


def read_source(text: str) -> Description:
    """Takes a SOURCE apart.

    Raises:
        OptionError: it is none.
    """
    if "://" in text:
        settings = ("person", "up", "stamps") if text.startswith("xsens:") else ("camera",)
        source = _address(text, ("ws", "udp", "xsens"), settings, f"--source {text}: expected {SOURCE_FORMS}")
        XsensOptions.parse(source.settings, text)
        return source
    if text.startswith("realsense:"):
        place, _, query = text.removeprefix("realsense:").partition("?")
        return Description(text, "realsense", place, _settings(text, query, REALSENSE_SETTINGS))
    if text.startswith("bag:"):
        from kinecast.cli.live_ros import BAG_SETTINGS

        path, _, query = text.removeprefix("bag:").partition("?")
        return Description(text, "bag", Path(path), _settings(text, query, BAG_SETTINGS))
    if (kind := text.partition(":")[0]) in _ROS:
        from kinecast.cli import live_ros  # here, since ROS is an extra

        source = _ros(text, kind, live_ros.SOURCE_SETTINGS[kind])
        live_ros.incoming(text, str(source.place), source.settings)
        return source
    if not text.startswith("recording:"):
        return Description(text, "recording", Path(text), {})
    path, _, query = text.removeprefix("recording:").partition("?")
    return Description(text, "recording", Path(path), _settings(text, query, ("speed", "repeat")))


def read_sink(text: str) -> Description:
    """Takes a SINK apart.

    Raises:
        OptionError: it is none.
    """
    wrong = f"--sink {text}: expected {SINK_FORMS}"
    if "://" in text:
        return _address(text, ("ws", "view"), () if text.startswith("view:") else ("format",), wrong)
    kind, colon, path = text.partition(":")
    if kind in _ROS:
        from kinecast.cli import live_ros  # here, since ROS is an extra

        sink = _ros(text, kind, live_ros.SINK_SETTINGS[kind])
        live_ros.outgoing(text, str(sink.place), sink.settings)
        return sink
    if kind == "bag":
        from kinecast.cli import live_ros

        sink = _ros(text, kind, live_ros.BAG_SINK_SETTINGS)
        live_ros.outgoing(text, sink.settings.get("namespace", ""), sink.settings)
        return sink
    if not colon or kind not in _FILES or not path:
        raise OptionError(wrong)
    ending = _FILES[kind][1]
    if Path(path).suffix != ending:
        raise OptionError(f"--sink {text}: its name must end in {ending}")
    return Description(text, kind, Path(path), {})


def open_sources(
    sources: Sequence[Description],
    play: Callable[[Path], Sequence[SkeletonFrame]],
    mailbox: Mailbox,
    network: Network,
    opened: list[Source],
    fused: FusedSource | None = None,
) -> None:
    """Opens sources, each with a feed of its own; network sources listen at once.

    Args:
        sources: which.
        play: gives the frames of a recording.
        mailbox: for their frames.
        network: that they run in.
        opened: those opened are appended, also when one fails.
        fused: takes what cameras of the rig see; None without a rig.

    Raises:
        OptionError, DatasetError, ModelError: one cannot be opened.
    """
    for each in sources:
        opened.append(_source(each, play, mailbox, network, fused))


def _source(
    source: Description,
    play: Callable[[Path], Sequence[SkeletonFrame]],
    mailbox: Mailbox,
    network: Network,
    fused: FusedSource | None,
) -> Source:
    if isinstance(source.place, Path):
        speed = number(source.settings, "speed", 1.0, source.text)
        repeat = whole_number(source.settings, "repeat", 1, source.text)
        frames = _bag(source) if source.kind == "bag" else play(source.place)
        return RecordedSource(source.text, mailbox.feed(source.text), frames, speed, repeat)
    if isinstance(source.place, str) and source.kind not in _ROS:
        return _realsense(source, source.place, mailbox, fused)
    feed = mailbox.feed(source.text)
    if source.kind == "xsens":
        assert isinstance(source.place, Address)
        return UdpSource(
            source.place, feed, network, XsensAdmission(feed, XsensOptions.parse(source.settings, source.text))
        )
    if fused is not None:
        fused.expect(feed)
    _deliverer(source, feed, fused)
    admission = Admission(feed, fused, source.settings.get("camera", ""))
    if isinstance(source.place, str):
        from kinecast.cli.live_ros import open_source

        return open_source(source.text, source.kind, source.place, source.settings, feed, admission)
    return (WebSocketSource if source.kind == "ws" else UdpSource)(source.place, feed, network, admission)


def _bag(source: Description) -> list[SkeletonFrame]:
    from kinecast.cli.live_ros import bag_frames

    return bag_frames(source.text, Path(str(source.place)), source.settings)


def _realsense(source: Description, place: str, mailbox: Mailbox, fused: FusedSource | None) -> Source:
    from kinecast.cameras.realsense import RealSenseOptions, RealSenseSource  # here, since cameras are an extra

    options = RealSenseOptions.parse(source.settings, source.text)
    name = f"realsense:{place}"
    feed = mailbox.feed(name)
    opened = RealSenseSource(name, feed, place, options, _deliverer(source, feed, fused))
    if fused is not None and "camera" in source.settings:
        calibrated = fused.rig.cameras[source.settings["camera"]].intrinsics
        found = opened.intrinsics
        if (found.width, found.height) != (calibrated.width, calibrated.height):
            sizes = f"{found.width}x{found.height} pixels, and the rig's camera {calibrated.width}x{calibrated.height}"
            raise OptionError(f"{source.text}: its images have {sizes}")
    return opened


def _deliverer(source: Description, feed: Feed, fused: FusedSource | None) -> DetectionHandler | None:
    """Where a source delivers what its camera of the rig sees; None where it is of no such camera."""
    camera = source.settings.get("camera")
    if camera is None:
        return None
    if fused is None:
        raise OptionError(f"{source.text}: a camera needs --rig, the file that says where it stands")
    return fused.handler(camera, feed)


def open_sinks(sinks: Sequence[Description], network: Network, opened: list[Sink], scene: Scene | None = None) -> None:
    """Opens sinks: addresses first, so that no file is replaced where one of them cannot be.

    Args:
        sinks: which.
        network: that they run in.
        opened: those opened are appended, also when one fails.
        scene: obstacles and goals, for sinks that draw them.

    Raises:
        OptionError: one cannot be opened.
    """
    for each in sinks:
        if isinstance(each.place, Address) and each.kind == "view":
            from kinecast.view.live_view import LiveView  # here, since the view is an extra

            opened.append(LiveView(each.place.host, each.place.port, scene, f"--sink {each.text}"))
        elif isinstance(each.place, Address):
            opened.append(WebSocketSink(each.place, network, each.settings.get("format") == "msgpack"))
        elif isinstance(each.place, str):
            from kinecast.cli.live_ros import open_sink

            if each.kind != "bag":
                opened.append(open_sink(each.text, each.kind, each.place, each.settings))
    for each in sinks:
        if each.kind == "bag":
            from kinecast.cli.live_ros import open_bag_sink

            opened.append(open_bag_sink(each.text, Path(str(each.place)), each.settings))
        elif isinstance(each.place, Path):
            opened.append(_FILES[each.kind][0](each.place))


def _address(text: str, schemes: tuple[str, ...], settings: tuple[str, ...], wrong: str) -> Description:
    bare, _, query = text.partition("?")
    if bare.partition("://")[0] not in schemes:
        raise OptionError(wrong)
    address = Address.parse(bare, _DEFAULT_PORTS.get(bare.partition("://")[0]))
    found = _settings(text, query, settings)
    if found.get("format", "json") not in ("json", "msgpack"):
        raise OptionError(f"{text}: format {found['format']}, allowed are json, msgpack")
    return Description(text, address.scheme, address, found)


def _ros(text: str, kind: str, allowed: tuple[str, ...]) -> Description:
    name, _, query = text.removeprefix(f"{kind}:").partition("?")
    return Description(text, kind, name, _settings(text, query, allowed))


def _settings(text: str, query: str, allowed: tuple[str, ...]) -> dict[str, str]:
    found = dict(parse_qsl(query, keep_blank_values=True))
    unknown = sorted(set(found) - set(allowed))
    if unknown or (query and not found):
        raise OptionError(f"{text}: {', '.join(unknown) or query} unknown; allowed are {', '.join(allowed) or 'none'}")
    return found
