"""Sources and sinks from what is written on the command line; whatever is wrong is an OptionError."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

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
    from kinecast.cameras.overlay import Watcher
    from kinecast.cameras.realsense import RealSenseSource
    from kinecast.cameras.webcam import WebcamSource
    from kinecast.live.detection import DetectionHandler
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
    """Sources with their mailbox, and sinks; at the end sources are closed first, then sinks, then their network.

    What cameras of a rig see is fused; sinks that show pictures take those of a plain camera. An OptionError,
    DatasetError or ModelError where something cannot be opened.
    """
    mailbox = Mailbox()
    watchers: list[Watcher] = []
    with closing(Network()) as network, ExitStack() as close_sinks, ExitStack() as close_sources:
        close_sources.callback(mailbox.discard)
        fused = None if rig is None else close_sources.enter_context(closing(FusedSource(rig, mailbox.feed("fusion"))))
        sources: list[Source] = [] if fused is None else [fused]
        for each in inputs:
            sources.append(close_sources.enter_context(closing(_source(each, mailbox, network, fused, watchers))))
        sinks: list[Sink] = []
        for each in sorted(outputs, key=lambda each: each.kind in _REPLACED):
            sinks.append(close_sinks.enter_context(closing(_sink(each, network, scene))))
        watchers += [sink.take for sink in sinks if hasattr(sink, "take")]
        yield mailbox, sources, sinks


def _source(
    source: Endpoint, mailbox: Mailbox, network: Network, fused: FusedSource | None, watchers: Sequence[Watcher]
) -> Source:
    """Opens a source with a feed of its own in the mailbox; network sources listen at once."""
    text, kind, settings = source.text, source.kind, source.settings
    of_pictures, camera = kind in ("camera", "realsense"), settings.get("camera")
    feed = mailbox.feed(f"{kind}:{source.place}" if of_pictures else text)
    handler: DetectionHandler | None = None
    if camera is not None:
        if fused is None:
            raise OptionError(f"{text}: a camera needs --rig, the file that says where it stands")
        handler = fused.handler(camera, feed)
    if of_pictures:
        opened = _camera(source, feed, watchers, handler)
        if camera is not None and fused is not None:
            sizes = [(each.width, each.height) for each in (opened.intrinsics, fused.rig.cameras[camera].intrinsics)]
            if sizes[0] != sizes[1]:
                found = "{}x{} pixels, and the rig's camera {}x{}".format(*sizes[0], *sizes[1])
                raise OptionError(f"{text}: its images have {found}")
        return opened
    if kind in ("recording", "bag"):
        speed, repeat = number(settings, "speed", 1.0, text), whole_number(settings, "repeat", 1, text)
        return RecordedSource(text, feed, _recorded(source), speed, repeat)
    if kind == "xsens":
        return UdpSource(source.address, feed, network, XsensGuard(feed, XsensOptions.parse(settings, text)))
    if fused is not None and handler is None:
        fused.expect(feed)
    guard = SenderGuard(feed, fused, camera or "")
    if kind in ("ws", "udp"):
        return (WebSocketSource if kind == "ws" else UdpSource)(source.address, feed, network, guard)
    return _ros_source(source, feed, guard)


def _camera(
    source: Endpoint, feed: Feed, watchers: Sequence[Watcher], handler: DetectionHandler | None
) -> WebcamSource | RealSenseSource:
    if source.kind == "camera":
        from kinecast.cameras.webcam import WebcamOptions, WebcamSource  # here, since cameras are extras

        options = WebcamOptions.parse(source.settings, source.text)
        return WebcamSource(feed.name, feed, source.place, options, watchers, handler)
    from kinecast.cameras.realsense import RealSenseOptions, RealSenseSource

    return RealSenseSource(feed.name, feed, source.place, RealSenseOptions.parse(source.settings, source.text), handler)


def _recorded(source: Endpoint) -> Sequence[SkeletonFrame]:
    """All persons of a recording or a bag, frame after frame."""
    path = Path(source.place)
    if source.kind == "recording":
        return list(merged_frames(one_scene(read_recordings((path,), None), path, "live")))
    from kinecast.ros.bags import read_frames  # here, since ROS is an extra

    frames, wrong = read_frames(path, source.settings.get("topic", ""), _ros_input(source))
    if wrong:
        note(f"{path}: {wrong} messages were no skeletons")
    return frames


def _sink(sink: Endpoint, network: Network, scene: Scene | None) -> Sink:
    """Opens a sink, in the network where it needs one. Views draw the scene."""
    kind, path = sink.kind, Path(sink.place)
    if kind in _FILES:
        return _FILES[kind](path)
    if kind == "mp4":
        from kinecast.cameras.movie import Movie  # here, since cameras are an extra

        return Movie(path)
    if kind == "ws":
        packed = choice(sink.settings, "format", ("json", "msgpack"), sink.text) == "msgpack"
        return WebSocketSink(sink.address, network, packed)
    if kind == "view":
        from kinecast.view.live_view import LiveView  # here, since the view is an extra

        return LiveView(sink.address.host, sink.address.port, scene, f"--sink {sink.text}")
    return _ros_sink(sink)


# ROS (docs/ros.md)


def _ros_source(source: Endpoint, feed: Feed, guard: SenderGuard) -> Source:
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

    settings, height = source.settings, number(source.settings, "height", InputOptions.height, source.text)
    frame = settings.get("frame", "").lstrip("/")
    return InputOptions(settings.get("joints", ""), settings.get("person", "0"), frame, height)


def _ros_sink(sink: Endpoint) -> Sink:
    from kinecast.ros.publisher import OUTPUTS, OutputOptions, PredictionPublisher
    from kinecast.ros.transport import RosSink

    settings = sink.settings
    namespace = settings.get("namespace") if sink.kind == "bag" else sink.place
    outputs = tuple(settings["outputs"].split(",")) if "outputs" in settings else OUTPUTS
    parts = whole_number(settings, "parts", OutputOptions.parts, sink.text)
    thickness = number(settings, "thickness", OutputOptions.thickness, sink.text)
    topic = settings.get("planning_scene", "")
    publisher = PredictionPublisher(OutputOptions(namespace or "/kinecast", outputs, topic, parts, thickness))
    return RosSink(sink.text, publisher, _transport(sink), MOST_WAITING if sink.kind == "bag" else ROOM)


def _transport(endpoint: Endpoint) -> Transport:
    from kinecast.ros.bags import BagWriter
    from kinecast.ros.dds import DdsTransport
    from kinecast.ros.messages import ros2_release
    from kinecast.ros.nodes import Ros1Transport, Ros2Transport

    kind, settings = endpoint.kind, endpoint.settings
    if kind in ("ros1", "ros2"):
        return Ros1Transport() if kind == "ros1" else Ros2Transport()
    where = f"{endpoint.text}: distro" if kind == "bag" else "dds: distro"
    distribution = ros2_release(settings.get("distro", "jazzy"), where)
    if kind == "bag":
        return BagWriter(Path(endpoint.place), distribution, settings.get("storage", "mcap"))
    domain = settings.get("domain", os.environ.get("ROS_DOMAIN_ID", "0"))
    if not domain.isdecimal():
        raise OptionError(f"domain {domain!r} is no whole number")
    return DdsTransport(distribution, int(domain), settings.get("network", ""))
