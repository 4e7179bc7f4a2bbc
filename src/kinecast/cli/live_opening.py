"""Sources and sinks from what is written on the command line; whatever is wrong is said before anything starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from kinecast.cli.options import check_file
from kinecast.cli.recordings import one_scene, read_recordings
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.live.detection import DetectionHandler
from kinecast.live.mailbox import Feed, Mailbox
from kinecast.live.mcap_file import McapSink
from kinecast.live.network import Address, Network
from kinecast.live.sender_guard import SenderGuard
from kinecast.live.settings import choice, number, settings_of, whole_number
from kinecast.live.sinks import FileSink, JsonlSink, Sink, WebSocketSink
from kinecast.live.sources import RecordedSource, Source, UdpSource, WebSocketSource
from kinecast.live.xsens import DEFAULT_PORT, XsensGuard, XsensOptions
from kinecast.pipeline import merged_frames
from kinecast.types import SkeletonFrame

if TYPE_CHECKING:
    from kinecast.cameras.fused_source import FusedSource
    from kinecast.cameras.overlay import Picture, Watcher
    from kinecast.cameras.pinhole import Intrinsics
    from kinecast.cameras.webcam import WebcamSource

SOURCE_FORMS = (
    "a recording's path, recording:PATH?speed=2&repeat=1, ws://HOST:PORT, udp://HOST:PORT, "
    "xsens://HOST:PORT?person=0, camera:NUMBER, FILE or FOLDER?body=1.75, realsense:SERIAL?model=FILE, "
    "ros1:, ros2: or dds:/TOPIC?type=PoseArray, bag:PATH?topic=/TOPIC"
)
SINK_FORMS = (
    "view://HOST:PORT, ws://HOST:PORT?format=json, mcap:PATH, jsonl:PATH, mp4:PATH, "
    "ros1:, ros2: or dds:/NAMESPACE, bag:PATH"
)
_ROS = ("ros1", "ros2", "dds")
_ROS_INPUT = ("type", "joints", "person", "frame", "height", "camera")
_ROS_OUTPUT = ("outputs", "planning_scene", "parts", "thickness")
_DDS = ("distro", "domain", "network")
SOURCE_SETTINGS = {
    "recording": ("speed", "repeat"),
    "ws": ("camera",),
    "udp": ("camera",),
    "xsens": ("person", "up", "stamps"),
    "camera": (
        "model",
        "people",
        "size",
        "rate",
        "fov",
        "lens",
        "tilt",
        "height",
        "body",
        "feet",
        "confidence",
        "speed",
        "camera",
    ),
    "realsense": ("model", "detector", "size", "rate", "tilt", "height", "camera"),
    "ros1": _ROS_INPUT,
    "ros2": _ROS_INPUT,
    "dds": (*_ROS_INPUT, *_DDS),
    "bag": ("topic", *_ROS_INPUT[1:-1], "speed", "repeat"),
}
SINK_SETTINGS: Mapping[str, tuple[str, ...]] = {
    "view": (),
    "ws": ("format",),
    "mcap": (),
    "jsonl": (),
    "mp4": (),
    "ros1": _ROS_OUTPUT,
    "ros2": _ROS_OUTPUT,
    "dds": (*_ROS_OUTPUT, *_DDS),
    "bag": ("namespace", *_ROS_OUTPUT, "distro", "storage"),
}
"""What may stand behind the question mark of each kind."""
_DEFAULT_PORTS = {"ws": None, "udp": None, "xsens": DEFAULT_PORT, "view": 8080}
"""Of the kinds that are addresses; None where a port is needed."""
_FILES: Mapping[str, type[FileSink]] = {"mcap": McapSink, "jsonl": JsonlSink}


@runtime_checkable
class TakesPictures(Protocol):
    """A sink that shows a camera's pictures too."""

    def take(self, picture: Picture) -> None: ...  # neither waits nor raises


@dataclass(frozen=True)
class Endpoint:
    """A SOURCE or SINK, taken apart: KIND:PLACE?SETTINGS."""

    text: str  # as written
    kind: str
    place: str | Address  # a path, a camera's serial number, a topic or a namespace; or an address
    settings: dict[str, str]

    @property
    def path(self) -> Path:
        """The place, where it is a file or folder."""
        return Path(str(self.place))

    @property
    def address(self) -> Address:
        """The place, where that is an address."""
        assert isinstance(self.place, Address)
        return self.place

    @property
    def replaces_file(self) -> bool:
        """Whether a sink begins with an empty file: opened last, so that none is lost where another cannot be."""
        return self.kind in (*_FILES, "mp4", "bag")


def read_source(text: str) -> Endpoint:
    """Takes a SOURCE apart; an OptionError where it is none."""
    kind, colon, _ = text.partition(":")
    if not (colon and kind in SOURCE_SETTINGS) and "://" not in text:
        return Endpoint(text, "recording", text, {})
    source = _endpoint(text, SOURCE_SETTINGS, f"--source {text}: expected {SOURCE_FORMS}")
    if source.kind == "xsens":
        XsensOptions.parse(source.settings, text)
    elif source.kind in _ROS:
        from kinecast.cli.live_ros import subscriber  # here, since ROS is an extra

        subscriber(source)
    return source


def read_sink(text: str) -> Endpoint:
    """Takes a SINK apart; an OptionError where it is none, or its file cannot be written."""
    wrong = f"--sink {text}: expected {SINK_FORMS}"
    sink = _endpoint(text, SINK_SETTINGS, wrong)
    choice(sink.settings, "format", ("json", "msgpack"), text)
    if sink.kind in (*_FILES, "mp4"):
        if not sink.place:
            raise OptionError(wrong)
        check_file(sink.path, (f".{sink.kind}",), "--sink")
    elif sink.kind in (*_ROS, "bag"):
        from kinecast.cli.live_ros import publisher

        publisher(sink)
    return sink


def _endpoint(text: str, kinds: Mapping[str, tuple[str, ...]], wrong: str) -> Endpoint:
    bare, _, query = text.partition("?")
    kind, colon, place = bare.partition(":")
    if kind not in kinds or not colon or (kind in _DEFAULT_PORTS) != place.startswith("//"):
        raise OptionError(wrong)
    at = Address.parse(bare, _DEFAULT_PORTS[kind]) if kind in _DEFAULT_PORTS else place
    return Endpoint(text, kind, at, settings_of(text, query, kinds[kind]))


def open_source(
    source: Endpoint,
    mailbox: Mailbox,
    network: Network,
    fused: FusedSource | None,
    watchers: Sequence[Watcher] = (),
) -> Source:
    """Opens a source with a feed of its own in the mailbox; network sources listen at once.

    Args:
        source: which.
        mailbox, network: for its frames, and that it runs in.
        fused: takes what cameras of the rig see; None without a rig.
        watchers: take a plain camera's pictures.

    Raises:
        OptionError, DatasetError, ModelError: it cannot be opened.
    """
    text, settings = source.text, source.settings
    if source.kind in ("recording", "bag"):
        speed, repeat = number(settings, "speed", 1.0, text), whole_number(settings, "repeat", 1, text)
        return RecordedSource(text, mailbox.feed(text), _recorded(source), speed, repeat)
    if source.kind == "realsense":
        return _open_realsense(source, mailbox, fused)
    if source.kind == "camera":
        return _open_webcam(source, mailbox, fused, watchers)
    feed = mailbox.feed(text)
    if source.kind == "xsens":
        return UdpSource(source.address, feed, network, XsensGuard(feed, XsensOptions.parse(settings, text)))
    if fused is not None:
        fused.expect(feed)
    _handler(source, feed, fused)
    guard = SenderGuard(feed, fused, settings.get("camera", ""))
    if source.kind in _ROS:
        from kinecast.cli.live_ros import open_source as open_ros_source

        return open_ros_source(source, feed, guard)
    return (WebSocketSource if source.kind == "ws" else UdpSource)(source.address, feed, network, guard)


def _recorded(source: Endpoint) -> Sequence[SkeletonFrame]:
    """All persons of a recording or a bag, frame after frame."""
    if source.kind == "bag":
        from kinecast.cli.live_ros import bag_frames

        return bag_frames(source)
    recordings = one_scene(read_recordings((source.path,), None), source.path, "live")
    return list(merged_frames(recordings))


def _open_realsense(source: Endpoint, mailbox: Mailbox, fused: FusedSource | None) -> Source:
    from kinecast.cameras.realsense import RealSenseOptions, RealSenseSource  # here, since cameras are an extra

    options = RealSenseOptions.parse(source.settings, source.text)
    name = f"realsense:{source.place}"
    feed = mailbox.feed(name)
    opened = RealSenseSource(name, feed, str(source.place), options, _handler(source, feed, fused))
    _check_size(source, opened.intrinsics, fused)
    return opened


def _open_webcam(
    source: Endpoint, mailbox: Mailbox, fused: FusedSource | None, watchers: Sequence[Watcher]
) -> WebcamSource:
    from kinecast.cameras.webcam import WebcamOptions, WebcamSource

    options = WebcamOptions.parse(source.settings, source.text)
    name = f"camera:{source.place}"
    feed = mailbox.feed(name)
    opened = WebcamSource(name, feed, str(source.place), options, watchers, _handler(source, feed, fused))
    _check_size(source, opened.intrinsics, fused)
    return opened


def _check_size(source: Endpoint, found: Intrinsics, fused: FusedSource | None) -> None:
    """Raises OptionError unless a camera of the rig gives images of the size that it was calibrated with."""
    if fused is not None and "camera" in source.settings:
        calibrated = fused.rig.cameras[source.settings["camera"]].intrinsics
        if (found.width, found.height) != (calibrated.width, calibrated.height):
            sizes = f"{found.width}x{found.height} pixels, and the rig's camera {calibrated.width}x{calibrated.height}"
            raise OptionError(f"{source.text}: its images have {sizes}")


def _handler(source: Endpoint, feed: Feed, fused: FusedSource | None) -> DetectionHandler | None:
    """Where a source delivers what its camera of the rig sees; None where it is of no such camera."""
    camera = source.settings.get("camera")
    if camera is None:
        return None
    if fused is None:
        raise OptionError(f"{source.text}: a camera needs --rig, the file that says where it stands")
    return fused.handler(camera, feed)


def open_sink(sink: Endpoint, network: Network, scene: Scene | None = None) -> Sink:
    """Opens a sink, in the network where it needs one; OptionError where it cannot be. Views draw the scene."""
    if sink.kind in _FILES:
        return _FILES[sink.kind](sink.path)
    if sink.kind == "mp4":
        from kinecast.cameras.movie import Movie  # here, since cameras are an extra

        return Movie(sink.path)
    if sink.kind == "ws":
        return WebSocketSink(sink.address, network, sink.settings.get("format") == "msgpack")
    if sink.kind == "view":
        from kinecast.view.live_view import LiveView  # here, since the view is an extra

        return LiveView(sink.address.host, sink.address.port, scene, f"--sink {sink.text}")
    from kinecast.cli.live_ros import open_sink as open_ros_sink

    return open_ros_sink(sink)
