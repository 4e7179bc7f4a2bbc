"""Bags of both generations, by rosbags: skeletons are read from them, predictions and recordings written into them.

Nothing in a bag is trusted: messages are read by this project's own definitions, never by those that a bag brings. A
recording is a MarkerArray for each frame of a person, with a sphere for each joint, named by its text.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys.msg import denormalize_msgtype, normalize_msgtype

from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError, OptionError
from kinecast.live.drawing import points, pose
from kinecast.live.message import MessageError
from kinecast.live.message_file import Said, recordings_of
from kinecast.live.sources import PlaybackOptions
from kinecast.pipeline import merged_frames
from kinecast.ros.messages import Distribution, messages_of
from kinecast.ros.publisher import OutputOptions
from kinecast.ros.subscriber import INPUTS, MARKERS, SPHERE, TF_TYPE, InputOptions, SkeletonSubscriber
from kinecast.ros.transport import Callback, Transport
from kinecast.types import SkeletonFrame

MOST_MESSAGES = 5_000_000  # read from one bag
SKELETONS, FRAME, DIAMETER = "/skeletons", "world", 0.05  # topic, coordinate frame and spheres of a recording
LATEST = 2.0**31  # the first time that ROS 2 cannot say [s]
ROS1 = ".bag"  # ending of a bag of ROS 1


@dataclass(frozen=True)
class BagInputOptions(PlaybackOptions, InputOptions):
    """How a bag is played."""

    topic: str = ""  # with the skeletons; "" for `/skeletons`, else the only one there is


@dataclass(frozen=True)
class BagOutputOptions(OutputOptions):
    """What a bag is."""

    namespace: str = "/kinecast"
    distro: Literal["humble", "jazzy"] = "jazzy"  # whose definitions bags of ROS 2 have
    storage: Literal["mcap", "sqlite3"] = "mcap"  # of bags of ROS 2


def load(path: Path) -> list[Recording]:
    """One recording for each person on `/skeletons`, else on the only topic that skeletons are read from.

    A DatasetError for no bag, a damaged one, or one that does not say which joint is which.
    """
    frames, _ = read_frames(path, BagInputOptions())
    once: dict[tuple[str, float], SkeletonFrame] = {}
    for frame in frames:
        once.setdefault((frame.person, frame.stamp), frame)
    found = recordings_of((Said(str(path), frame) for frame in once.values()), path, "bag")
    return [replace(each, rate=float(f"{each.rate:.6g}")) for each in found]  # not what nanoseconds make of it


def write(path: Path, recordings: Sequence[Recording]) -> None:
    """Writes recordings of different persons: for ROS 1 where the path ends in `.bag`, else a folder for ROS 2.

    Stamps go to the nanosecond; names, rates, subjects, tasks, labels and notes are lost. A DatasetError for stamps
    that ROS cannot say, an OptionError where there is something at the path.
    """
    for recording in recordings:
        if len(recording.stamps) and not 0 <= recording.stamps.min() <= recording.stamps.max() < LATEST:
            raise DatasetError(recording.name, f"ROS can say stamps from 0 to {LATEST:.0f} s only")
    writer = BagWriter(path, BagOutputOptions())
    try:
        for frame in merged_frames(recordings):
            common = {
                "header": {"stamp": frame.stamp, "frame_id": FRAME}, "ns": frame.person, "type": SPHERE,
                "scale": dict.fromkeys("xyz", DIAMETER), "color": dict.fromkeys("rgba", 1.0), "lifetime": 0.5,
            }  # fmt: skip
            placed = enumerate(zip(frame.joints, points(frame.positions), strict=True))
            markers = [common | {"id": id_, "text": joint, "pose": pose(at)} for id_, (joint, at) in placed]
            writer.write(SKELETONS, MARKERS, writer.messages.encode(MARKERS, {"markers": markers}), frame.stamp)
    finally:
        writer.close()


def read_frames(path: Path, options: BagInputOptions) -> tuple[list[SkeletonFrame], int]:
    """Every skeleton of a topic, by stamp, and how many messages were none.

    A DatasetError for no bag, a damaged one, or one without skeletons there, an OptionError for options that do not fit
    the type of the messages.
    """
    # Humble's definitions of what is read are Jazzy's
    messages = messages_of(Distribution.NOETIC if path.suffix == ROS1 else Distribution.JAZZY)
    found: list[SkeletonFrame | MessageError] = []
    with _opened(path) as reader:
        types = {each.topic: denormalize_msgtype(each.msgtype) for each in reader.connections}
        topics = {topic: type_ for topic, type_ in sorted(types.items()) if type_ in INPUTS}
        plain = [each for each, type_ in topics.items() if type_ != TF_TYPE] or list(topics)
        topic = options.topic or (SKELETONS if SKELETONS in topics else plain[0] if len(plain) == 1 else "")
        if topic not in topics:
            some = ", ".join(f"{each} ({type_})" for each, type_ in topics.items()) or "none"
            raise DatasetError(path, f"say in which topic the skeletons are; those that may have some: {some}")
        subscriber = SkeletonSubscriber(topic, topics[topic], options)
        wanted = [each for each in reader.connections if each.topic in subscriber.topics]
        for count, (connection, _, content) in enumerate(reader.messages(wanted)):
            if count >= MOST_MESSAGES:
                raise DatasetError(path, f"more than {MOST_MESSAGES} messages in {', '.join(subscriber.topics)}")
            found += subscriber.read(messages, connection.topic, content)
    frames = [each for each in found if isinstance(each, SkeletonFrame)]
    wrong = [each for each in found if isinstance(each, MessageError)]
    if not frames:
        raise DatasetError(path, f"no skeleton in {topic}" + (f": {wrong[0]}" if wrong else ""))
    return sorted(frames, key=lambda frame: frame.stamp), len(wrong)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A reader; whatever goes wrong in it is a DatasetError."""
    try:
        with (Reader1 if path.suffix == ROS1 else Reader2)(path) as reader:
            yield reader
    except (DatasetError, OptionError):
        raise
    except Exception as error:  # a reader of damaged files raises anything
        raise DatasetError(path, f"no bag that can be read ({type(error).__name__}: {str(error)[:200]})") from None


class BagWriter(Transport):
    """Writes messages into a bag, and subscribes to nothing. It is opened by the thread that writes first.

    The path is a file that ends in `.bag` for ROS 1, else a folder for ROS 2; neither may be there. An OptionError
    where a bag cannot be written there.
    """

    def __init__(self, path: Path, options: BagOutputOptions) -> None:
        self._first = path.suffix == ROS1
        super().__init__(messages_of(Distribution.NOETIC if self._first else Distribution(options.distro)))
        if path.exists():
            raise OptionError(f"{path}: is there already; a bag is never replaced")
        if not os.access(path.absolute().parent, os.W_OK | os.X_OK):
            raise OptionError(f"{path}: there is no folder {path.absolute().parent} that can be written to")
        self._path, self._options = path, options
        self._connections: dict[str, Any] = {}

    def subscribe(self, topic: str, type_: str, callback: Callback) -> None:
        """Nothing comes."""

    def create_publisher(self, topic: str, type_: str) -> Callable[[bytes], None]:
        """A topic is in the bag once it has a message."""
        return lambda content: self.write(topic, type_, content, self.now())

    def write(self, topic: str, type_: str, content: bytes, received: float) -> None:
        """Writes a message that was received then [s]; an OSError where the bag cannot be written."""
        if topic not in self._connections:
            store = self.messages.store
            self._connections[topic] = self._writer.add_connection(topic, normalize_msgtype(type_), typestore=store)
        self._writer.write(self._connections[topic], math.floor(received * 1e9), content)

    def close(self) -> None:
        """Makes the bag whole."""
        self._writer.close()

    @cached_property
    def _writer(self) -> Any:
        if self._first:
            writer: Any = Writer1(self._path)
        else:
            version: Any = 8 if self._options.distro == "humble" else 9  # of rosbag2's format
            writer = Writer2(self._path, version=version, storage_plugin=StoragePlugin[self._options.storage.upper()])
        writer.open()
        return writer
