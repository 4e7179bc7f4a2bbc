"""Sources and sinks from what is written on the command line; whatever is wrong is an OptionError."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from kinecast.cameras.fused_source import FusedSource
from kinecast.cameras.rig import Rig
from kinecast.cli.options import check_file
from kinecast.cli.progress import note
from kinecast.cli.recordings import one_scene, read_recordings
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.live.mailbox import Feed, Mailbox
from kinecast.live.mcap_file import McapSink
from kinecast.live.network import Address, Network
from kinecast.live.sender_guard import SenderGuard
from kinecast.live.settings import choice, number, settings_of, whole_number
from kinecast.live.sinks import MOST_WAITING, FileSink, JsonlSink, Sink, WebSocketSink
from kinecast.live.sources import RecordedSource, Source, UdpSource, WebSocketSource
from kinecast.live.xsens import DEFAULT_PORT, XsensGuard, XsensOptions
from kinecast.pipeline import merged_frames
from kinecast.types import SkeletonFrame

if TYPE_CHECKING:
    from kinecast.cameras.overlay import Picture, Watcher
    from kinecast.ros.publisher import PredictionPublisher
    from kinecast.ros.subscriber import InputOptions
    from kinecast.ros.transport import Transport

SOURCE_FORMS = (
    "a recording's path, recording:PATH?speed=2&repeat=1, ws://HOST:PORT, udp://HOST:PORT, "
    "xsens://HOST:PORT?person=0, camera:NUMBER, FILE or FOLDER?body=1.75, realsense:SERIAL?model=FILE, "
    "ros1:, ros2: or dds:/TOPIC?type=PoseArray, bag:PATH?topic=/TOPIC"
)
SINK_FORMS = (
    "view://HOST:PORT, ws://HOST:PORT?format=json, mcap:PATH, jsonl:PATH, mp4:PATH, "
    "ros1:, ros2: or dds:/NAMESPACE, bag:PATH"
)
SOURCE_SETTINGS = {
    "recording": "speed repeat",
    "ws": "camera",
    "udp": "camera",
    "xsens": "person up stamps",
    "camera": "model people size rate fov lens tilt height body feet confidence speed camera",
    "realsense": "model detector size rate tilt height camera",
    "ros1": "type joints person frame height camera",
    "ros2": "type joints person frame height camera",
    "dds": "type joints person frame height camera distro domain network",
    "bag": "topic joints person frame height speed repeat",
}
SINK_SETTINGS = {
    "view": "",
    "ws": "format",
    "mcap": "",
    "jsonl": "",
    "mp4": "",
    "ros1": "outputs planning_scene parts thickness",
    "ros2": "outputs planning_scene parts thickness",
    "dds": "outputs planning_scene parts thickness distro domain network",
    "bag": "namespace outputs planning_scene parts thickness distro storage",
}
"""What may stand behind the question mark of each kind."""
ROOM = 8  # publications that wait for a network
_DEFAULT_PORTS = {"ws": None, "udp": None, "xsens": DEFAULT_PORT, "view": 8080}  # of the kinds that are addresses
_FILES: Mapping[str, type[FileSink]] = {"mcap": McapSink, "jsonl": JsonlSink}
_REPLACED = (*_FILES, "mp4")  # sinks that begin with an empty file: opened last, so that none is lost for nothing


@runtime_checkable
class TakesPictures(Protocol):
    """A sink that shows a camera's pictures too."""

    def take(self, picture: Picture) -> None: ...  # neither waits nor raises


@dataclass(frozen=True)
class Endpoint:
    """A SOURCE or SINK, taken apart: KIND:PLACE?SETTINGS."""

    text: str  # as written
    kind: str
    place: str  # a path, a camera, a topic, a namespace, or //HOST:PORT
    settings: Mapping[str, str]

    @property
    def address(self) -> Address:
        """The place, where that is an address; an OptionError where it is none."""
        return Address.parse(f"{self.kind}:{self.place}", _DEFAULT_PORTS[self.kind])

    def number(self, name: str, default: float) -> float:
        """One of the settings."""
        return number(self.settings, name, default, self.text)

    def whole_number(self, name: str, default: int) -> int:
        """One of the settings."""
        return whole_number(self.settings, name, default, self.text)


def read_source(text: str) -> Endpoint:
    """Takes a SOURCE apart."""
    kind, colon, _ = text.partition(":")
    if not (colon and kind in SOURCE_SETTINGS) and "://" not in text:
        return Endpoint(text, "recording", text, {})
    return _endpoint(text, SOURCE_SETTINGS, f"--source {text}: expected {SOURCE_FORMS}")


def read_sink(text: str) -> Endpoint:
    """Takes a SINK apart, and sees whether its file can be written."""
    sink = _endpoint(text, SINK_SETTINGS, f"--sink {text}: expected {SINK_FORMS}")
    if sink.kind in _REPLACED:
        check_file(Path(sink.place), (f".{sink.kind}",), "--sink")
    return sink


def _endpoint(text: str, kinds: Mapping[str, str], wrong: str) -> Endpoint:
    bare, _, query = text.partition("?")
    kind, colon, place = bare.partition(":")
    at_port = kind in _DEFAULT_PORTS
    if kind not in kinds or not colon or at_port != place.startswith("//") or (kind in _REPLACED and not place):
        raise OptionError(wrong)
    return Endpoint(text, kind, place, settings_of(text, query, tuple(kinds[kind].split())))


@contextmanager
def opened(
    inputs: Sequence[Endpoint], outputs: Sequence[Endpoint], rig: Rig | None = None, scene: Scene | None = None
) -> Iterator[tuple[Mailbox, list[Source], list[Sink]]]:
    """Sources with their mailbox, and sinks; at the end sources are closed first, then sinks, then their network."""
    mailbox = Mailbox()
    watchers: list[Watcher] = []
    with closing(Network()) as network, ExitStack() as close_sinks, ExitStack() as close_sources:
        close_sources.callback(mailbox.discard)
        fused = None if rig is None else close_sources.enter_context(closing(FusedSource(rig, mailbox.feed("fusion"))))
        sources: list[Source] = [] if fused is None else [fused]
        for each in inputs:
            sources.append(close_sources.enter_context(closing(open_source(each, mailbox, network, fused, watchers))))
        sinks: list[Sink] = []
        for each in sorted(outputs, key=lambda each: each.kind in _REPLACED):
            sinks.append(close_sinks.enter_context(closing(open_sink(each, network, scene))))
        watchers += [sink.take for sink in sinks if isinstance(sink, TakesPictures)]
        yield mailbox, sources, sinks


def open_source(
    source: Endpoint,
    mailbox: Mailbox,
    network: Network,
    fused: FusedSource | None = None,
    watchers: Sequence[Watcher] = (),
) -> Source:
    """Opens a source with a feed of its own in the mailbox; network sources listen at once.

    What cameras of a rig see is fused, and watchers take a plain camera's pictures. An OptionError, DatasetError or
    ModelError where it cannot be opened.
    """
    text, kind, settings = source.text, source.kind, source.settings
    if kind in ("camera", "realsense"):
        return _open_camera(source, mailbox.feed(f"{kind}:{source.place}"), fused, watchers)
    feed = mailbox.feed(text)
    if kind in ("recording", "bag"):
        speed, repeat = source.number("speed", 1.0), source.whole_number("repeat", 1)
        return RecordedSource(text, feed, _recorded(source), speed, repeat)
    if kind == "xsens":
        return UdpSource(source.address, feed, network, XsensGuard(feed, XsensOptions.parse(settings, text)))
    if "camera" in settings:
        _rig_of(source, fused).handler(settings["camera"], feed)
    elif fused is not None:
        fused.expect(feed)
    guard = SenderGuard(feed, fused, settings.get("camera", ""))
    if kind in ("ws", "udp"):
        return (WebSocketSource if kind == "ws" else UdpSource)(source.address, feed, network, guard)
    return _open_ros(source, feed, guard)


def _rig_of(source: Endpoint, fused: FusedSource | None) -> FusedSource:
    if fused is None:
        raise OptionError(f"{source.text}: a camera needs --rig, the file that says where it stands")
    return fused


def _recorded(source: Endpoint) -> Sequence[SkeletonFrame]:
    """All persons of a recording or a bag, frame after frame."""
    if source.kind == "recording":
        return list(merged_frames(one_scene(read_recordings((Path(source.place),), None), Path(source.place), "live")))
    from kinecast.ros.bags import read_frames  # here, since ROS is an extra

    frames, wrong = read_frames(Path(source.place), source.settings.get("topic", ""), _ros_input(source))
    if wrong:
        note(f"{Path(source.place)}: {wrong} messages were no skeletons")
    return frames


def _open_camera(source: Endpoint, feed: Feed, fused: FusedSource | None, watchers: Sequence[Watcher]) -> Source:
    camera, place, settings = source.settings.get("camera"), source.place, source.settings
    opened: Source
    handler = None if camera is None else _rig_of(source, fused).handler(camera, feed)
    if source.kind == "camera":
        from kinecast.cameras.webcam import WebcamOptions, WebcamSource  # here, since cameras are extras

        webcam = WebcamSource(feed.name, feed, place, WebcamOptions.parse(settings, source.text), watchers, handler)
        opened, found = webcam, webcam.intrinsics
    else:
        from kinecast.cameras.realsense import RealSenseOptions, RealSenseSource

        depth = RealSenseSource(feed.name, feed, place, RealSenseOptions.parse(settings, source.text), handler)
        opened, found = depth, depth.intrinsics
    if camera is not None and fused is not None:
        calibrated = fused.rig.cameras[camera].intrinsics
        if (found.width, found.height) != (calibrated.width, calibrated.height):
            sizes = f"{found.width}x{found.height} pixels, and the rig's camera {calibrated.width}x{calibrated.height}"
            raise OptionError(f"{source.text}: its images have {sizes}")
    return opened


def open_sink(sink: Endpoint, network: Network, scene: Scene | None = None) -> Sink:
    """Opens a sink, in the network where it needs one. Views draw the scene."""
    kind = sink.kind
    if kind in _FILES:
        return _FILES[kind](Path(sink.place))
    if kind == "mp4":
        from kinecast.cameras.movie import Movie  # here, since cameras are an extra

        return Movie(Path(sink.place))
    if kind == "ws":
        packed = choice(sink.settings, "format", ("json", "msgpack"), sink.text) == "msgpack"
        return WebSocketSink(sink.address, network, packed)
    if kind == "view":
        from kinecast.view.live_view import LiveView  # here, since the view is an extra

        address = sink.address
        return LiveView(address.host, address.port, scene, f"--sink {sink.text}")
    from kinecast.ros.bags import BagWriter  # here, since ROS is an extra
    from kinecast.ros.messages import ros2_release
    from kinecast.ros.transport import RosSink

    publisher = _ros_output(sink)
    if kind == "bag":
        distribution = ros2_release(sink.settings.get("distro", "jazzy"), f"{sink.text}: distro")
        bag = BagWriter(Path(sink.place), distribution, sink.settings.get("storage", "mcap"))
        return RosSink(sink.text, publisher, bag, MOST_WAITING)
    return RosSink(sink.text, publisher, _transport(sink), ROOM)


# ROS (docs/ros.md)


def _open_ros(source: Endpoint, feed: Feed, guard: SenderGuard) -> Source:
    from kinecast.ros.subscriber import TF_TYPE, SkeletonSubscriber, input_type
    from kinecast.ros.transport import RosSource

    topic, settings = source.place, source.settings
    if not topic.startswith("/"):
        raise OptionError(f"{source.text}: a topic such as /skeletons is expected")
    if "type" not in settings and topic not in ("/tf", "/tf_static"):
        raise OptionError(f"{source.text}: say of which type the messages are, such as type=PoseArray")
    type_ = input_type(settings["type"]) if "type" in settings else TF_TYPE
    subscriber = SkeletonSubscriber(topic, type_, _ros_input(source))
    return RosSource(source.text, feed, subscriber, _transport(source), guard)


def _ros_input(source: Endpoint) -> InputOptions:
    from kinecast.ros.subscriber import InputOptions

    settings, height = source.settings, source.number("height", InputOptions.height)
    frame = settings.get("frame", "").lstrip("/")
    return InputOptions(settings.get("joints", ""), settings.get("person", "0"), frame, height)


def _ros_output(sink: Endpoint) -> PredictionPublisher:
    from kinecast.ros.publisher import OUTPUTS, OutputOptions, PredictionPublisher

    settings = sink.settings
    namespace = settings.get("namespace") if sink.kind == "bag" else sink.place
    outputs = tuple(settings["outputs"].split(",")) if "outputs" in settings else OUTPUTS
    parts = sink.whole_number("parts", OutputOptions.parts)
    thickness = sink.number("thickness", OutputOptions.thickness)
    topic = settings.get("planning_scene", "")
    return PredictionPublisher(OutputOptions(namespace or "/kinecast", outputs, topic, parts, thickness))


def _transport(endpoint: Endpoint) -> Transport:
    from kinecast.ros.dds import DdsTransport
    from kinecast.ros.messages import ros2_release
    from kinecast.ros.nodes import Ros1Transport, Ros2Transport

    settings = endpoint.settings
    if endpoint.kind != "dds":
        return Ros1Transport() if endpoint.kind == "ros1" else Ros2Transport()
    domain = settings.get("domain", os.environ.get("ROS_DOMAIN_ID", "0"))
    if not domain.isdecimal():
        raise OptionError(f"domain {domain!r} is no whole number")
    distribution = ros2_release(settings.get("distro", "jazzy"), "dds: distro")
    return DdsTransport(distribution, int(domain), settings.get("network", ""))
