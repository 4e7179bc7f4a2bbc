"""Bags of both generations, by rosbags: skeletons are read from them, predictions and recordings written into them.

Nothing in a bag is trusted: messages are read by this project's own definitions, never by those that a bag brings.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal

from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys.msg import denormalize_msgtype, normalize_msgtype

from kinecast.errors import DatasetError, OptionError
from kinecast.live.message import MessageError
from kinecast.ros.carrier import Taker
from kinecast.ros.incoming import INPUTS, TF_TYPE, Incoming, InputOptions
from kinecast.ros.messages import Distribution, Messages, messages_of
from kinecast.types import SkeletonFrame

__all__ = ["BagWriter", "is_bag", "read_frames", "skeleton_topics"]

MOST_MESSAGES = 5_000_000
"""Read from one bag."""
STORAGES = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
"""Of rosbag2."""


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: `.bag`, or a folder with rosbag2's `metadata.yaml`, or a `.db3` file."""
    return path.suffix in (".bag", ".db3") if path.is_file() else (path / "metadata.yaml").is_file()


def skeleton_topics(path: Path) -> dict[str, str]:
    """Topics of a bag that skeletons may be read from, with the type of each.

    Raises:
        DatasetError: it is no bag, or a damaged one.
    """
    with _opened(path) as (reader, _):
        types = {each.topic: denormalize_msgtype(each.msgtype) for each in reader.connections}
    return {topic: type_ for topic, type_ in sorted(types.items()) if type_ in INPUTS}


def read_frames(path: Path, topic: str, options: InputOptions) -> tuple[list[SkeletonFrame], int]:
    """Every skeleton of a topic, by stamp, and how many messages were none.

    Args:
        path: of the bag.
        topic: with skeletons; "" for the only one there is.
        options: see InputOptions.

    Raises:
        DatasetError: it is no bag, a damaged one, or has no skeletons there.
        OptionError: options that do not fit the type of the messages.
    """
    topics = skeleton_topics(path)
    plain = {each: type_ for each, type_ in topics.items() if type_ != TF_TYPE} or dict.fromkeys(topics, TF_TYPE)
    if not topic and len(plain) == 1:
        (topic,) = plain
    if topic not in topics:
        found = ", ".join(f"{each} ({type_})" for each, type_ in topics.items()) or "none"
        raise DatasetError(path, f"say in which topic the skeletons are; those that may have some: {found}")
    incoming = Incoming(topic, topics[topic], options)
    frames: list[SkeletonFrame] = []
    wrong: list[MessageError] = []
    for each in _read(path, incoming):
        (wrong if isinstance(each, MessageError) else frames).append(each)  # type: ignore[arg-type]
    if not frames:
        raise DatasetError(path, f"no skeleton in {topic}" + (f": {wrong[0]}" if wrong else ""))
    return sorted(frames, key=lambda frame: frame.stamp), len(wrong)


def _read(path: Path, incoming: Incoming) -> Iterator[SkeletonFrame | MessageError]:
    with _opened(path) as (reader, choices):
        wanted = [each for each in reader.connections if each.topic in incoming.topics]
        speaks = {each.id: _speaking(choices, each) for each in wanted}
        for count, (connection, _, content) in enumerate(reader.messages(wanted)):
            if count >= MOST_MESSAGES:
                raise DatasetError(path, f"more than {MOST_MESSAGES} messages in {', '.join(incoming.topics)}")
            yield from incoming.read_bytes(speaks[connection.id], connection.topic, content)


def _speaking(choices: tuple[Messages, ...], connection: Any) -> Messages:
    """The definitions a connection was written by: those of its hash, else the oldest."""
    name = connection.msgtype
    return next(
        (each for each in choices if each.knows(name) and each.definition(name)[1] == connection.digest), choices[0]
    )


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, tuple[Messages, ...]]]:
    """A reader, and the definitions its messages may be of; whatever goes wrong in it is a DatasetError."""
    first = path.suffix == ".bag"
    distributions = [each for each in Distribution if each.generation == (1 if first else 2)]
    try:
        with (Reader1 if first else Reader2)(path) as reader:
            yield reader, tuple(map(messages_of, distributions))
    except (DatasetError, OptionError):
        raise
    except Exception as error:  # a reader of damaged files raises anything
        raise DatasetError(path, f"no bag that can be read ({type(error).__name__}: {str(error)[:200]})") from None


class BagWriter:
    """Writes messages into a bag: a Carrier that only publishes. It is opened by the thread that writes first.

    Args:
        path: a file that ends in `.bag` for ROS 1, else a folder for ROS 2; neither may be there.
        distribution: whose definitions are used in ROS 2.
        storage: of ROS 2, one of `STORAGES`.

    Raises:
        OptionError: there is something at the path, no folder for it, or an unknown storage.
    """

    def __init__(self, path: Path, distribution: Distribution, storage: str) -> None:
        first = path.suffix == ".bag"
        self.messages = messages_of(Distribution.NOETIC if first else distribution)
        if path.exists():
            raise OptionError(f"{path}: is there already; a bag is never replaced")
        if not os.access(path.absolute().parent, os.W_OK | os.X_OK):
            raise OptionError(f"{path}: there is no folder {path.absolute().parent} that can be written to")
        if not first and storage not in STORAGES:
            raise OptionError(f"storage {storage!r}: expected {' or '.join(STORAGES)}")
        version: Literal[8, 9] = 8 if distribution is Distribution.HUMBLE else 9
        self._make = (
            partial(Writer1, path)
            if first
            else partial(Writer2, path, version=version, storage_plugin=STORAGES[storage])
        )
        self._writer: Any = None
        self._connections: dict[str, Any] = {}

    def subscribe(self, topic: str, type_: str, take: Taker) -> None:
        """See Carrier; nothing comes."""

    def advertise(self, topic: str, type_: str) -> None:
        """See Carrier; a topic is in the bag once it has a message."""

    def publish(self, topic: str, type_: str, content: bytes) -> None:
        """See Carrier; it is written as received now."""
        self.write(topic, type_, content, self.now())

    def write(self, topic: str, type_: str, content: bytes, received: float) -> None:
        """Writes a message.

        Args:
            topic, type_, content: see Carrier.
            received: when [s].

        Raises:
            OSError: the bag cannot be written.
        """
        self._open()
        if topic not in self._connections:
            store = self.messages.store
            self._connections[topic] = self._writer.add_connection(topic, normalize_msgtype(type_), typestore=store)
        self._writer.write(self._connections[topic], math.floor(received * 1e9), content)

    def now(self) -> float:
        """See Carrier: the time of this machine."""
        return time.time()

    def close(self) -> None:
        """Makes the bag whole."""
        self._open()
        self._writer.close()

    def _open(self) -> None:
        if self._writer is None:
            self._writer = self._make()
            self._writer.open()
