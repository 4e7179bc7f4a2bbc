"""Recordings as bags: a MarkerArray for each frame of a person, with a sphere for each joint, named by its text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError
from kinecast.live.message_file import labelled_frames, message, recordings_of
from kinecast.ros.bags import BagWriter, read_frames, skeleton_topics
from kinecast.ros.incoming import InputOptions
from kinecast.ros.messages import Distribution
from kinecast.types import SkeletonFrame

__all__ = ["SKELETONS", "load", "write"]

SKELETONS = "/skeletons"
"""Topic of the frames that are written."""
MARKERS = "visualization_msgs/MarkerArray"
FRAME = "world"
LATEST = 2.0**31
"""The first time that ROS 2 cannot say [s]."""
SPHERE, DIAMETER = 2, 0.05


def load(path: Path) -> list[Recording]:
    """One recording for each person on `/skeletons`, else on the only topic that skeletons are read from.

    Raises:
        DatasetError: no bag, a damaged one, or one that does not say which joint is which.
    """
    topic = SKELETONS if SKELETONS in skeleton_topics(path) else ""
    frames, _ = read_frames(path, topic, InputOptions())
    found = recordings_of(((str(path), message(frame, None)) for frame in _increasing(frames)), path, "bag")
    return [replace(each, rate=float(f"{each.rate:.6g}")) for each in found]  # not what nanoseconds make of it


def write(path: Path, recordings: Sequence[Recording]) -> None:
    """Writes recordings of different persons: for ROS 1 where the path ends in `.bag`, else a folder for ROS 2.

    Stamps go to the nanosecond; names, rates, subjects, tasks, labels and notes are lost.

    Raises:
        DatasetError: stamps that ROS cannot say.
        OptionError: there is something at the path.
    """
    for recording in recordings:
        if len(recording.stamps) and not 0 <= recording.stamps.min() <= recording.stamps.max() < LATEST:
            raise DatasetError(recording.name, f"ROS can say stamps from 0 to {LATEST:.0f} s only")
    writer = BagWriter(path, Distribution.JAZZY, "mcap")
    try:
        for frame, _ in labelled_frames(recordings):
            writer.write(SKELETONS, MARKERS, writer.messages.encode(MARKERS, _markers(frame)), frame.stamp)
    finally:
        writer.close()


def _markers(frame: SkeletonFrame) -> dict[str, Any]:
    common = {
        "header": {"stamp": frame.stamp, "frame_id": FRAME}, "ns": frame.person, "type": SPHERE,
        "scale": dict.fromkeys("xyz", DIAMETER), "color": dict.fromkeys("rgba", 1.0), "lifetime": 0.5,
    }  # fmt: skip
    return {
        "markers": [
            common | {"id": place, "text": joint, "pose": {"position": dict(zip("xyz", xyz, strict=True))}}
            for place, (joint, xyz) in enumerate(zip(frame.joints, frame.positions.tolist(), strict=True))
        ]
    }


def _increasing(frames: Sequence[SkeletonFrame]) -> Iterator[SkeletonFrame]:
    """Without those of a person that come twice."""
    last: dict[str, float] = {}
    for frame in frames:
        if frame.stamp > last.get(frame.person, -np.inf):
            last[frame.person] = frame.stamp
            yield frame
