"""Sources and sinks from what is written on the command line; whatever is wrong is an OptionError."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from kinecast.live.settings import read_settings
from kinecast.live.sinks import MOST_WAITING, FileSink, JsonlSink, Sink, WebSocketSink
from kinecast.live.sources import PlaybackOptions, RecordedSource, Source, UdpSource, WebSocketSource
from kinecast.live.xsens import DEFAULT_PORT, XsensGuard
from kinecast.pipeline import merged_frames
from kinecast.types import SkeletonFrame

if TYPE_CHECKING:
    from kinecast.cameras.overlay import Watcher
    from kinecast.cameras.realsense import RealSenseSource
    from kinecast.cameras.webcam import WebcamSource
    from kinecast.live.detection import DetectionHandler
    from kinecast.ros.transport import Transport

_SOURCES = {
    "recording": "live.sources.PlaybackOptions",
    "ws": "live.sender_guard.SenderOptions",
    "udp": "live.sender_guard.SenderOptions",
    "xsens": "live.xsens.XsensOptions",
    "camera": "cameras.webcam.WebcamOptions",
    "realsense": "cameras.realsense.RealSenseOptions",
    "ros1": "ros.subscriber.InputOptions",
    "ros2": "ros.subscriber.InputOptions",
    "dds": "ros.dds.DdsInputOptions",
    "bag": "ros.bags.BagInputOptions",
}
_SINKS = {
    "view": "live.settings.NoOptions",
    "ws": "live.sinks.WebSocketOptions",
    "mcap": "live.settings.NoOptions",
    "jsonl": "live.settings.NoOptions",
    "mp4": "live.settings.NoOptions",
    "ros1": "ros.publisher.OutputOptions",
    "ros2": "ros.publisher.OutputOptions",
    "dds": "ros.dds.DdsOutputOptions",
    "bag": "ros.bags.BagOutputOptions",
}
"""Each kind, and the options that stand behind its question mark; imported when needed, since some need an extra."""
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
    options: Any  # as in `_SOURCES` and `_SINKS`

    @property
    def address(self) -> Address:
        """The place, where that is an address; an OptionError where it is none."""
        return Address.parse(f"{self.kind}:{self.place}", _DEFAULT_PORTS[self.kind])


def read_source(text: str) -> Endpoint:
    """Takes a SOURCE apart."""
    kind, colon, _ = text.partition(":")
    if not (colon and kind in _SOURCES) and "://" not in text:
        return Endpoint(text, "recording", text, PlaybackOptions())
    return _endpoint("--source", text, _SOURCES)


def read_sink(text: str) -> Endpoint:
    """Takes a SINK apart, and sees whether its file can be written."""
    sink = _endpoint("--sink", text, _SINKS)
    if sink.kind in _REPLACED:
        check_file(Path(sink.place), (f".{sink.kind}",), "--sink")
    return sink


def _endpoint(option: str, text: str, kinds: Mapping[str, str]) -> Endpoint:
    bare, _, query = text.partition("?")
    kind, colon, place = bare.partition(":")
    at_port = kind in _DEFAULT_PORTS
    if kind not in kinds or not colon or at_port != place.startswith("//") or (kind in _REPLACED and not place):
        forms = ", ".join(f"{each}://HOST:PORT" if each in _DEFAULT_PORTS else f"{each}:" for each in kinds)
        raise OptionError(f"{option} {text}: expected one of {forms}; see kinecast live --help")
    module, _, options = kinds[kind].rpartition(".")
    return Endpoint(
        text, kind, place, read_settings(getattr(import_module(f"kinecast.{module}"), options), query, text)
    )


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
    text, kind, options = source.text, source.kind, source.options
    of_pictures = kind in ("camera", "realsense")
    feed = mailbox.feed(f"{kind}:{source.place}" if of_pictures else text)
    if kind in ("recording", "bag"):
        return RecordedSource(text, feed, _recorded(source), options)
    if kind == "xsens":
        return UdpSource(source.address, feed, network, XsensGuard(feed, options))
    if options.camera and fused is None:
        raise OptionError(f"{text}: a camera needs --rig, the file that says where it stands")
    handler = fused.handler(options.camera, feed) if fused and options.camera else None
    if of_pictures:
        opened = _camera(source, feed, watchers, handler)
        if fused and options.camera:
            sizes = [(of.width, of.height) for of in (opened.intrinsics, fused.rig.cameras[options.camera].intrinsics)]
            if sizes[0] != sizes[1]:
                found = "{}x{} pixels, and the rig's camera {}x{}".format(*sizes[0], *sizes[1])
                raise OptionError(f"{text}: its images have {found}")
        return opened
    if fused and handler is None:
        fused.expect(feed)
    guard = SenderGuard(feed, fused, options.camera)
    if kind in ("ws", "udp"):
        return (WebSocketSource if kind == "ws" else UdpSource)(source.address, feed, network, guard)
    from kinecast.ros.subscriber import SkeletonSubscriber, input_type  # here, since ROS is an extra
    from kinecast.ros.transport import RosSource

    subscriber = SkeletonSubscriber(source.place, input_type(source.place, options.type), options)
    return RosSource(text, feed, subscriber, _transport(source), guard)


def _camera(
    source: Endpoint, feed: Feed, watchers: Sequence[Watcher], handler: DetectionHandler | None
) -> WebcamSource | RealSenseSource:
    if source.kind == "camera":
        from kinecast.cameras.webcam import WebcamSource  # here, since cameras are extras

        return WebcamSource(feed.name, feed, source.place, source.options, watchers, handler)
    from kinecast.cameras.realsense import RealSenseSource

    return RealSenseSource(feed.name, feed, source.place, source.options, handler)


def _recorded(source: Endpoint) -> Sequence[SkeletonFrame]:
    """All persons of a recording or a bag, frame after frame."""
    path = Path(source.place)
    if source.kind == "recording":
        return list(merged_frames(one_scene(read_recordings((path,), None), path, "live")))
    from kinecast.ros.bags import read_frames

    frames, wrong = read_frames(path, source.options)
    if wrong:
        note(f"{path}: {wrong} messages were no skeletons")
    return frames


def _sink(sink: Endpoint, network: Network, scene: Scene | None) -> Sink:
    """Opens a sink, in the network where it needs one. Views draw the scene."""
    kind, path, options = sink.kind, Path(sink.place), sink.options
    if kind in _FILES:
        return _FILES[kind](path)
    if kind == "mp4":
        from kinecast.cameras.movie import Movie

        return Movie(path)
    if kind == "ws":
        return WebSocketSink(sink.address, network, options)
    if kind == "view":
        from kinecast.view.live_view import LiveView  # here, since the view is an extra

        return LiveView(sink.address.host, sink.address.port, scene, f"--sink {sink.text}")
    from kinecast.ros.publisher import PredictionPublisher
    from kinecast.ros.transport import RosSink

    publisher = PredictionPublisher(options, (options.namespace if kind == "bag" else sink.place) or "/kinecast")
    return RosSink(sink.text, publisher, _transport(sink), MOST_WAITING if kind == "bag" else ROOM)


def _transport(endpoint: Endpoint) -> Transport:
    from kinecast.ros.bags import BagWriter
    from kinecast.ros.dds import DdsTransport
    from kinecast.ros.nodes import Ros1Transport, Ros2Transport

    match endpoint.kind:
        case "ros1":
            return Ros1Transport()
        case "ros2":
            return Ros2Transport()
        case "dds":
            return DdsTransport(endpoint.options)
    return BagWriter(Path(endpoint.place), endpoint.options)
