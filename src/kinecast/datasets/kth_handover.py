"""KTH handover folders: giver and taker, one csv file a body segment."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import KTH_13
from kinecast.datasets.files import read_bytes, rows, split_lines
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError

_RATE = 120.0
_HEADER = "x,y,z,q0,q1,q2,q3"
_FILE = re.compile(r"(giver|taker)_(\w+)_pose_saved\.csv(?:\.gz|\.xz)?")


def matches(path: Path) -> bool:
    """Whether a folder holds `giver_*_pose_saved.csv` or `taker_*` files."""
    return path.is_dir() and any(_FILE.fullmatch(file.name) for file in path.iterdir())


def load(path: Path) -> list[Recording]:
    """One handover, named `<folder>/giver` and `<folder>/taker`; files of baton and wrenches are passed over."""
    files: dict[str, dict[str, Path]] = {}
    for file in sorted(path.iterdir()) if path.is_dir() else ():
        if found := _FILE.fullmatch(file.name):
            files.setdefault(found[1], {})[found[2]] = file
    if not files:
        expected = "giver_<segment>_pose_saved.csv and taker_<segment>_pose_saved.csv"
        raise DatasetError(path, f"expected a folder of {expected}")
    return [_person(path, person, segments) for person, segments in sorted(files.items())]


def _person(path: Path, person: str, segments: dict[str, Path]) -> Recording:
    tracks = {file: _track(file) for file in segments.values()}
    (first, frames), *others = [(file, len(track)) for file, track in tracks.items()]
    for file, count in others:
        if count != frames:
            raise DatasetError(file, f"{count} rows, but {first.name} has {frames}")
    return Recording(
        name=f"{path.absolute().name}/{person}",
        joints=KTH_13.canonical(segments, path),
        stamps=np.arange(frames) / _RATE,
        positions=np.stack(list(tracks.values()), axis=1),
        rate=_RATE,
        source=path,
        format="kth-handover",
        person=person,
        task="handover",
    )


def _track(file: Path) -> Float[np.ndarray, "N 3"]:
    """(N, 3) origin of one segment [m]."""
    (header,), data = split_lines(read_bytes(file), 1, file)
    if header != _HEADER:
        raise DatasetError(f"{file}, line 1", f"header is {header[:60]!r}, expected {_HEADER!r}")
    return rows(data, 7, file, first_line=2)[:, :3]
