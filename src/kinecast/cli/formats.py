"""Formats of recordings beyond those of kinecast.datasets, and every format that can be written.

A format that needs an extra is registered here with functions that import it when they are called.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType

from kinecast.datasets import table
from kinecast.datasets.files import head
from kinecast.datasets.loading import FORMATS, Format
from kinecast.datasets.recording import Recording
from kinecast.errors import MissingExtraError

__all__ = ["FORMAT_NAMES", "MORE_FORMATS", "UNREAD", "WRITERS"]

MCAP_MAGIC = b"\x89MCAP0\r\n"
PROFILE = slice(21, 25)
"""Where an MCAP file of ROS 2 says that it is one."""
BAG1_MAGIC = b"#ROSBAG V2.0"
BAG2_START = b"rosbag2_bagfile_information"


def _is_mcap(path: Path) -> bool:
    return path.is_file() and head(path).startswith(MCAP_MAGIC)


def _is_jsonl(path: Path) -> bool:
    return path.is_file() and head(path).lstrip().startswith(b"{")


def _is_bag(path: Path) -> bool:
    """Of ROS 1, or a folder or an MCAP file of ROS 2."""
    if path.is_dir():
        about = path / "metadata.yaml"
        return about.is_file() and head(about).startswith(BAG2_START)
    start = head(path) if path.is_file() else b""
    return start.startswith(BAG1_MAGIC) or (start.startswith(MCAP_MAGIC) and start[PROFILE] == b"ros2")


def _live(name: str) -> ModuleType:
    """A module that needs the extra for live streams."""
    try:
        return importlib.import_module(f"kinecast.live.{name}")
    except ModuleNotFoundError as error:
        raise MissingExtraError("MCAP and JSON lines", "live") from error


def _load(module: str, path: Path) -> list[Recording]:
    recordings: list[Recording] = _live(module).load(path)
    return recordings


def _write(module: str, path: Path, recordings: Sequence[Recording]) -> None:
    _live(module).write(path, recordings)


def _ros() -> ModuleType:
    """The module that reads and writes bags, which needs an extra."""
    return importlib.import_module("kinecast.ros.bag_recordings")


def _load_bag(path: Path) -> list[Recording]:
    recordings: list[Recording] = _ros().load(path)
    return recordings


MORE_FORMATS = (
    Format("bag", _is_bag, _load_bag),
    Format("mcap", _is_mcap, partial(_load, "mcap_file")),
    Format("jsonl", _is_jsonl, partial(_load, "message_file")),
)
"""Read beside those of kinecast.datasets.loading."""

FORMAT_NAMES = tuple(sorted((*FORMATS, *(each.name for each in MORE_FORMATS))))
"""All that are read."""

WRITERS: Mapping[str, Callable[[Path, Sequence[Recording]], None]] = {
    ".parquet": table.write,
    ".csv": table.write,
    ".mcap": partial(_write, "mcap_file"),
    ".jsonl": partial(_write, "message_file"),
    ".bag": lambda path, recordings: _ros().write(path, recordings),
    ".rosbag2": lambda path, recordings: _ros().write(path, recordings),
}
"""What writes a file of each ending, or with `.rosbag2` a folder; recordings are of different persons."""

UNREAD: Mapping[str, str] = {
    "bag": "orientations, coordinate frames and other topics",
    "vicon": "rotations of the rigid bodies",
    "bvh": "rotations and offsets of the joints",
    "mvnx": "orientations, velocities, sensors and joint angles",
    "andy": "orientations, velocities, sensors and joint angles; labels of single annotators and of other tracks",
    "ha4m": "orientations, confidences and image points",
    "kth-handover": "orientations",
}
"""What files of a format may hold that no recording does."""
