"""The csv twin of an Xsens MVNX file, as ANDY has it: a column for each quantity, segment and axis."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinecast.body.skeleton import XSENS_23
from kinecast.datasets.compressed import head, read_bytes
from kinecast.datasets.delimited import rows, split_lines
from kinecast.datasets.mvnx import sequence_name
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError

__all__ = ["load", "matches"]

_ASSUMED_RATE = 240.0  # ANDY's MVNX files say so; their csv twins have no rate
_COLUMN = re.compile(r"position_(\w+)_([xyz])", re.IGNORECASE)


def matches(path: Path) -> bool:
    """Whether a file's first line names a column like `position_<Segment>_x`."""
    if not path.is_file():
        return False
    names = head(path, 1 << 16).partition(b"\n")[0].split(b",")
    return any(_COLUMN.fullmatch(name.strip().decode("utf-8", errors="replace")) for name in names)


def load(path: Path) -> list[Recording]:
    """One trial, at an assumed 240 Hz; segments are found by name, in upper or lower case.

    Args:
        path: csv with columns `position_<Segment>_x`, `_y` and `_z` in metres, z up; others are passed over.

    Returns:
        One recording of the segments known to Xsens 23.

    Raises:
        DatasetError: a segment lacks an axis, or a row is not as long as the header or holds text.
    """
    (header,), data = split_lines(read_bytes(path), 1, path)
    names = [name.strip() for name in header.split(",")]
    segments: dict[str, dict[str, int]] = {}
    for column, name in enumerate(names):
        found = _COLUMN.fullmatch(name)
        if found and XSENS_23.find(found[1]):
            segments.setdefault(found[1], {})[found[2].lower()] = column
    for segment, axes in segments.items():
        if len(axes) < 3:
            raise DatasetError(
                f"{path}, line 1", f"segment {segment} has columns for {', '.join(axes)}, expected x, y, z"
            )
    columns = [axes[axis] for axes in segments.values() for axis in "xyz"]
    table = rows(data, len(names), path, first_line=2, use=columns)
    return [
        Recording(
            name=sequence_name(path),
            joints=XSENS_23.canonical(segments, f"{path}, line 1"),
            stamps=np.arange(len(table)) / _ASSUMED_RATE,
            positions=table.reshape(len(table), len(segments), 3),
            rate=_ASSUMED_RATE,
            source=path,
            format="mvnx",
            notes=("rate not stated by the format; 240 Hz assumed",),
        )
    ]
