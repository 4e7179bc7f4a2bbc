"""HA4M's raw folders: one text file a frame, from Azure Kinect body tracking."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import AZURE_KINECT_32
from kinecast.datasets.compressed import read_bytes
from kinecast.datasets.delimited import rows, split_lines
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError
from kinecast.geometry.transforms import from_camera

__all__ = ["LABELS", "RATE", "TASK", "label_name", "load", "matches", "subject_of"]

RATE = 30.0
TASK = "gear train assembly"
LABELS = (
    "none", "carrier", "gear bearings", "planet gears", "carrier shaft", "sun shaft", "sun gear",
    "sun gear bearing", "ring bear", "block 2 on 1", "cover", "screws", "finish",
)  # fmt: skip
"""Names of labels 0 to 12."""

_CLIP = re.compile(r"IDU(\d{3})V\d{3}")
_FRAME = re.compile(r"FrameID(\d+)(?:_.*)?\.txt(?:\.gz|\.xz)?")
_COLUMNS = 14
_JOINTS = len(AZURE_KINECT_32.joints)


def matches(path: Path) -> bool:
    """Whether a folder is named like a clip (`IDU001V001`) and holds a folder `Skeletons`."""
    return bool(_CLIP.fullmatch(path.absolute().name)) and (path / "Skeletons").is_dir()


def load(path: Path) -> list[Recording]:
    """One clip: a recording for each camera and body id, the body seen longest under the clip's own name.

    Stamps come from frame ids, so a missing frame is a gap in time. A body seen in one frame only is named
    in the notes and left out.

    Args:
        path: the clip's folder, e.g. `IDU001V001`.

    Returns:
        Recordings of 32 joints; labels are those of the first label column, "" where a frame has none.

    Raises:
        DatasetError: the folder, a frame file or the label file is not as HA4M writes it.
    """
    cameras = sorted(folder for folder in path.glob("Skeletons/*") if folder.is_dir())
    if not cameras:
        raise DatasetError(path, "expected a clip's folder with frame files in Skeletons/<camera>/FrameID<N>_*.txt")
    label_files = sorted([*path.glob("Labels.txt*"), *path.glob("*/Labels.txt*")])
    labels = _labels(label_files[0]) if label_files else None
    clip = path.absolute().name
    names = [clip if len(cameras) == 1 else f"{clip}/{camera.name}" for camera in cameras]
    return [
        recording
        for camera, name in zip(cameras, names, strict=True)
        for recording in _bodies(camera, name, path, labels)
    ]


def label_name(text: str, where: object) -> str:
    """Name of a label written as its number; raises DatasetError where it is none of 0 to 12."""
    if not (text.isdecimal() and int(text) < len(LABELS)):
        raise DatasetError(where, f"label is {text[:40]!r}, expected 0 to {len(LABELS) - 1}")
    return LABELS[int(text)]


def subject_of(clip: str) -> str:
    """The person's id in a clip's name: `001` of `IDU001V002`; "" where the name is another."""
    found = _CLIP.fullmatch(clip)
    return found[1] if found else ""


def _bodies(camera: Path, name: str, path: Path, labels: dict[int, str] | None) -> list[Recording]:
    """One camera's recordings, the longest first."""
    tracks: dict[int, dict[int, Float[np.ndarray, "J 3"]]] = {}
    for frame, file in _frames(camera):
        for body, positions in _frame_bodies(file).items():
            tracks.setdefault(body, {})[frame] = positions
    longest_first = sorted(tracks, key=lambda body: (-len(tracks[body]), body))
    short = [body for body in longest_first[1:] if len(tracks[body]) < 2]
    notes = (f"bodies seen in one frame only, left out: {', '.join(map(str, short))}",) if short else ()
    recordings = []
    for body in longest_first:
        if body in short:
            continue
        frames = np.array(list(tracks[body]))
        recordings.append(
            Recording(
                name=name if body == longest_first[0] else f"{name}/body{body}",
                joints=AZURE_KINECT_32.joints,
                stamps=(frames - frames[0]) / RATE,
                positions=from_camera(np.stack(list(tracks[body].values()))) / 1000.0,
                rate=RATE,
                source=path,
                format="ha4m",
                person=str(body),
                subject=subject_of(path.absolute().name),
                task=TASK,
                labels=None if labels is None else tuple(labels.get(int(frame), "") for frame in frames),
                notes=notes if body == longest_first[0] else (),
            )
        )
    return recordings


def _frames(camera: Path) -> list[tuple[int, Path]]:
    """Frame ids and files of one camera, in order of the id."""
    found = ((_FRAME.fullmatch(file.name), file) for file in camera.iterdir())
    frames = sorted((int(name[1]), file) for name, file in found if name)
    if not frames:
        raise DatasetError(camera, "no files named FrameID<N>_*.txt")
    for (frame, file), (following, other) in pairwise(frames):
        if frame == following:
            raise DatasetError(other, f"frame {frame} is also in {file.name}")
    return frames


def _frame_bodies(file: Path) -> dict[int, Float[np.ndarray, "J 3"]]:
    """Joint positions [mm] of every body in one frame, camera axes."""
    _, data = split_lines(read_bytes(file), 1, file)
    if not data.strip():
        return {}
    table = rows(data, _COLUMNS, file, delimiter="\t", first_line=2)
    bodies = {}
    for body in np.unique(table[:, 0]):
        block = table[table[:, 0] == body]
        order = np.argsort(block[:, 1])
        if not np.array_equal(block[order, 1], np.arange(_JOINTS)):
            raise DatasetError(
                file, f"body {body:g} has {len(block)} rows, expected joint ids 0 to {_JOINTS - 1} once each"
            )
        bodies[int(body)] = block[order, 3:6]
    return bodies


def _labels(file: Path) -> dict[int, str]:
    """Label name of every frame id in `Labels.txt`."""
    labels = {}
    for line, text in enumerate(read_bytes(file).decode("utf-8-sig", errors="replace").splitlines(), 1):
        words = text.split()
        if not words:
            continue
        where = f"{file}, line {line}"
        if len(words) != 3 or not words[0].isdecimal():
            raise DatasetError(where, f"found {text[:40]!r}, expected a frame id and two labels")
        labels[int(words[0])] = label_name(words[1], where)
    return labels
