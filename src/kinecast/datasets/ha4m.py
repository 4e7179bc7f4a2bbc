"""HA4M: raw clip folders of Azure Kinect body tracking, one text file a frame, and arrays of skeleton features."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from tokenize import TokenError

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import AZURE_KINECT_32, HA4M_ARMS_14, HA4M_UPPER_23, Skeleton
from kinecast.datasets.files import base_name, head, read_bytes, rows, split_lines
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError
from kinecast.geometry.transforms import from_camera

LABELS = (
    "none", "carrier", "gear bearings", "planet gears", "carrier shaft", "sun shaft", "sun gear",
    "sun gear bearing", "ring bear", "block 2 on 1", "cover", "screws", "finish",
)  # fmt: skip
"""Names of labels 0 to 12."""

_RATE = 30.0
_TASK = "gear train assembly"
_CLIP = re.compile(r"IDU(\d{3})V\d{3}")
_FRAME = re.compile(r"FrameID(\d+)(?:_.*)?\.txt(?:\.gz|\.xz)?")
_COLUMNS = 14
_JOINTS = len(AZURE_KINECT_32.joints)
_NPY_MAGIC = b"\x93NUMPY"
_FEATURES = {3 * len(skeleton.joints): skeleton for skeleton in (HA4M_UPPER_23, HA4M_ARMS_14)}


def matches(path: Path) -> bool:
    """Whether a folder is named like a clip (`IDU001V001`) and holds a folder `Skeletons`."""
    return bool(_CLIP.fullmatch(path.absolute().name)) and (path / "Skeletons").is_dir()


def load(path: Path) -> list[Recording]:
    """One clip: a recording for each camera and body id, the body seen longest under the clip's own name.

    Stamps come from frame ids, so a missing frame is a gap in time. A body seen in one frame only is named
    in the notes and left out. Labels are those of the first label column, "" where a frame has none.
    """
    cameras = sorted(folder for folder in path.glob("Skeletons/*") if folder.is_dir())
    if not cameras:
        raise DatasetError(path, "expected a clip's folder with frame files in Skeletons/<camera>/FrameID<N>_*.txt")
    label_files = sorted([*path.glob("Labels.txt*"), *path.glob("*/Labels.txt*")])
    labels = _clip_labels(label_files[0]) if label_files else None
    return [recording for camera in cameras for recording in _bodies(camera, len(cameras) == 1, path, labels)]


def matches_features(path: Path) -> bool:
    """Whether a file is a NumPy array."""
    return path.is_file() and head(path).startswith(_NPY_MAGIC)


def load_features(path: Path) -> list[Recording]:
    """One clip of skeleton features, named as its file: float64 (69, T) or (42, T), in mm, camera axes.

    Labels come from `../GroundTruth/<clip>.txt` where that file exists. `ArmSkel` holds joints 3 to 16 of
    `UpSkel`: load one of the two.
    """
    array, skeleton = _features(path)
    positions = from_camera(array.reshape(3, len(skeleton.joints), -1).transpose(2, 1, 0)) / 1000.0
    clip = base_name(path)
    return [
        Recording(
            name=clip,
            joints=skeleton.joints,
            stamps=np.arange(len(positions)) / _RATE,
            positions=positions,
            rate=_RATE,
            source=path,
            format="ha4m-features",
            subject=_subject(clip),
            task=_TASK,
            labels=_feature_labels(path, len(positions)),
        )
    ]


def _subject(clip: str) -> str:
    """The person's id in a clip's name: `001` of `IDU001V002`; "" where the name is another."""
    return found[1] if (found := _CLIP.fullmatch(clip)) else ""


def _bodies(camera: Path, alone: bool, path: Path, labels: dict[float, str] | None) -> Iterator[Recording]:
    """One camera's recordings, the longest first."""
    clip = path.absolute().name
    name = clip if alone else f"{clip}/{camera.name}"
    tracks: dict[int, dict[int, Float[np.ndarray, "J 3"]]] = {}
    for frame, file in _frames(camera):
        for body, positions in _frame_bodies(file).items():
            tracks.setdefault(body, {})[frame] = positions
    bodies = sorted(tracks, key=lambda body: (-len(tracks[body]), body))
    short = [body for body in bodies[1:] if len(tracks[body]) < 2]
    note = f"bodies seen in one frame only, left out: {', '.join(map(str, short))}"
    for body in (body for body in bodies if body not in short):
        frames = np.array(list(tracks[body]))
        yield Recording(
            name=name if body == bodies[0] else f"{name}/body{body}",
            joints=AZURE_KINECT_32.joints,
            stamps=(frames - frames[0]) / _RATE,
            positions=from_camera(np.stack(list(tracks[body].values()))) / 1000.0,
            rate=_RATE,
            source=path,
            format="ha4m",
            person=str(body),
            subject=_subject(clip),
            task=_TASK,
            labels=None if labels is None else tuple(labels.get(int(frame), "") for frame in frames),
            notes=(note,) if short and body == bodies[0] else (),
        )


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
        block = block[np.argsort(block[:, 1])]
        if not np.array_equal(block[:, 1], np.arange(_JOINTS)):
            expected = f"joint ids 0 to {_JOINTS - 1} once each"
            raise DatasetError(file, f"body {body:g} has {len(block)} rows, expected {expected}")
        bodies[int(body)] = block[:, 3:6]
    return bodies


def _clip_labels(file: Path) -> dict[float, str]:
    """Label name of every frame id in `Labels.txt`."""
    table = rows(read_bytes(file), 3, file, delimiter=None)
    return dict(zip(table[:, 0].tolist(), _names(table[:, 1], file), strict=True))


def _feature_labels(path: Path, frames: int) -> tuple[str, ...] | None:
    """Label names of a clip, or None where it has no label file."""
    file = path.absolute().parent.parent / "GroundTruth" / f"{base_name(path)}.txt"
    if not file.is_file():
        return None
    labels = rows(read_bytes(file), 1, file, delimiter=None)[:, 0]
    if len(labels) != frames:
        raise DatasetError(file, f"{len(labels)} labels for the {frames} frames of {path.name}")
    return _names(labels, file)


def _names(labels: Float[np.ndarray, " N"], file: Path) -> tuple[str, ...]:
    """Names of labels that a file has as numbers, one a line."""
    wrong = ~np.isin(labels, np.arange(len(LABELS)))
    if wrong.any():
        line = int(np.argmax(wrong))
        raise DatasetError(f"{file}, line {line + 1}", f"label is {labels[line]:g}, expected 0 to {len(LABELS) - 1}")
    return tuple(LABELS[int(label)] for label in labels)


def _features(path: Path) -> tuple[Float[np.ndarray, "C T"], Skeleton]:
    """The file's array, and whose joints it holds."""
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    content = read_bytes(path)
    data = io.BytesIO(content)
    try:
        shape, by_column, dtype = readers[np.lib.format.read_magic(data)](data)
    except (ValueError, KeyError, EOFError, SyntaxError, TokenError) as error:
        raise DatasetError(path, f"not a NumPy array of version 1 or 2: {error}") from error
    if dtype != np.float64 or len(shape) != 2 or shape[0] not in _FEATURES:
        raise DatasetError(path, f"array of {dtype} {shape}, expected float64 (69, T) or (42, T)")
    size = data.tell() + 8 * shape[0] * shape[1]
    if len(content) != size:
        raise DatasetError(path, f"{len(content)} bytes, but an array {shape} takes {size}")
    array = np.frombuffer(content, offset=data.tell()).reshape(shape, order="F" if by_column else "C")
    return array, _FEATURES[shape[0]]
