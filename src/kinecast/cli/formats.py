"""Formats of recordings beyond those of kinecast.datasets, and every format that can be written.

A format that needs an extra is registered here with functions that import it when they are called.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from kinecast.datasets import table
from kinecast.datasets.files import head
from kinecast.datasets.loading import FORMATS, Format
from kinecast.datasets.recording import Recording

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


def _lazily(module: str, function: str) -> Callable[..., Any]:
    """A function of a module that is imported when the function is called: it needs an extra."""

    def call(*arguments: Any) -> Any:
        return getattr(importlib.import_module(f"kinecast.{module}"), function)(*arguments)

    return call


MORE_FORMATS = (
    Format("bag", _is_bag, _lazily("ros.bags", "load")),
    Format("mcap", _is_mcap, _lazily("live.mcap_file", "load")),
    Format("jsonl", _is_jsonl, _lazily("live.message_file", "load")),
)
"""Read beside those of kinecast.datasets.loading."""

FORMAT_NAMES = tuple(sorted((*FORMATS, *(each.name for each in MORE_FORMATS))))
"""All that are read."""

WRITERS: Mapping[str, Callable[[Path, Sequence[Recording]], None]] = {
    ".parquet": table.write,
    ".csv": table.write,
    ".mcap": _lazily("live.mcap_file", "write"),
    ".jsonl": _lazily("live.message_file", "write"),
    ".bag": _lazily("ros.bags", "write"),
    ".rosbag2": _lazily("ros.bags", "write"),
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
