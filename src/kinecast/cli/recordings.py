"""Recordings as commands read them: all formats, those of extras too, and what can be written."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kinecast.cli.progress import note, progress_bar
from kinecast.datasets import table
from kinecast.datasets.files import head
from kinecast.datasets.loading import FORMATS, Format, load
from kinecast.datasets.recording import Recording
from kinecast.errors import OptionError


def _is(format: str, path: Path) -> bool:
    """Whether a file or folder begins as one of this format."""
    if path.is_dir():
        about = path / "metadata.yaml"
        return format == "bag" and about.is_file() and head(about).startswith(b"rosbag2_bagfile_information")
    start = head(path) if path.is_file() else b""
    if start.startswith(b"\x89MCAP0\r\n"):
        return format == ("bag" if start[21:25] == b"ros2" else "mcap")  # the profile in its header
    if format == "bag":
        return start.startswith(b"#ROSBAG V2.0")
    return format == "jsonl" and start.lstrip().startswith(b"{")


def _lazily(module: str, function: str) -> Callable[..., Any]:
    """A function of a module that needs an extra, imported when it is called."""

    def call(*arguments: Any) -> Any:
        return getattr(importlib.import_module(f"kinecast.{module}"), function)(*arguments)

    return call


MORE_FORMATS = tuple(
    Format(name, partial(_is, name), _lazily(module, "load"))
    for name, module in (("bag", "ros.bags"), ("mcap", "live.mcap_file"), ("jsonl", "live.message_file"))
)
FORMAT_NAMES = tuple(sorted((*FORMATS, *(each.name for each in MORE_FORMATS))))
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


def read_recordings(paths: Sequence[Path], format: str | None, option: str = "") -> list[Recording]:
    """Every recording in files or folders, at least one; `option` is what the paths were given with, for an error."""
    if not paths:
        raise OptionError(f"{option}: no recording given".removeprefix(": "))
    with progress_bar("reading") as progress:
        return load(paths, format, progress=progress, more=MORE_FORMATS)


def one_scene(recordings: Sequence[Recording], path: Path, command: str) -> Sequence[Recording]:
    """All recordings that a path holds; OptionError unless they may be of one scene, a person each."""
    if len({recording.person for recording in recordings}) < len(recordings):
        names = listed([recording.name for recording in recordings])
        raise OptionError(f"{path}: holds {len(recordings)} recordings ({names}); {command} takes one")
    return recordings


def unseen(train: Sequence[Recording], test: Sequence[Recording]) -> list[Recording]:
    """The training recordings that are not test recordings too, by content; OptionError if none is left."""
    known = [any(np.array_equal(a.positions, b.positions, equal_nan=True) for b in test) for a in train]
    left_out = listed([recording.name for recording, out in zip(train, known, strict=True) if out])
    if all(known):
        raise OptionError(
            f"every training recording is also a test recording ({left_out}); nothing is left to train on"
        )
    if left_out:
        note(f"not trained on, because they are test recordings: {left_out}")
    return [recording for recording, out in zip(train, known, strict=True) if not out]


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names with commas between them, the first few of many."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")
