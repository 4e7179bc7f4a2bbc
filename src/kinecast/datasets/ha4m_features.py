"""HA4M's skeleton features: one npy array a clip, with a label for each frame in a folder beside."""

from __future__ import annotations

import io
from pathlib import Path
from tokenize import TokenError

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import HA4M_ARMS_14, HA4M_UPPER_23, Skeleton
from kinecast.datasets.compressed import WHOLE_LIMIT, base_name, head, read_bytes
from kinecast.datasets.ha4m import RATE, TASK, label_name, subject_of
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError
from kinecast.geometry.transforms import from_camera

__all__ = ["load", "matches"]

_MAGIC = b"\x93NUMPY"
_SKELETONS = {3 * len(skeleton.joints): skeleton for skeleton in (HA4M_UPPER_23, HA4M_ARMS_14)}


def matches(path: Path) -> bool:
    """Whether a file is a NumPy array."""
    return path.is_file() and head(path).startswith(_MAGIC)


def load(path: Path) -> list[Recording]:
    """One clip, named as its file, e.g. `IDU001V001`.

    Labels come from `../GroundTruth/<clip>.txt` where that file exists. `ArmSkel` holds joints 3 to 16 of
    `UpSkel`: load one of the two.

    Args:
        path: npy file of float64 (69, T) or (42, T), in mm, camera axes.

    Returns:
        One recording at 30 Hz.

    Raises:
        DatasetError: the array or the label file is not as expected.
    """
    array, skeleton = _array(path)
    joints = len(skeleton.joints)
    positions = from_camera(array.reshape(3, joints, -1).transpose(2, 1, 0)) / 1000.0
    clip = base_name(path)
    return [
        Recording(
            name=clip,
            joints=skeleton.joints,
            stamps=np.arange(len(positions)) / RATE,
            positions=positions,
            rate=RATE,
            source=path,
            format="ha4m-features",
            subject=subject_of(clip),
            task=TASK,
            labels=_labels(path, len(positions)),
        )
    ]


def _array(path: Path) -> tuple[Float[np.ndarray, "C T"], Skeleton]:
    """The file's array, its header checked before anything is loaded."""
    data = io.BytesIO(head(path))
    try:
        version = np.lib.format.read_magic(data)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, _, dtype = read_header(data)
    except (ValueError, KeyError, EOFError, SyntaxError, TokenError) as error:
        raise DatasetError(path, f"not a NumPy array of version 1 or 2: {error}") from error
    if dtype != np.float64 or len(shape) != 2 or shape[0] not in _SKELETONS:
        raise DatasetError(path, f"array of {dtype} {shape}, expected float64 (69, T) or (42, T)")
    size = data.tell() + 8 * shape[0] * shape[1]
    if size > WHOLE_LIMIT:
        raise DatasetError(path, f"array {shape} is larger than the limit of {WHOLE_LIMIT >> 20} MiB")
    content = read_bytes(path)
    if len(content) != size:
        raise DatasetError(path, f"{len(content)} bytes, but an array {shape} takes {size}")
    array: Float[np.ndarray, "C T"] = np.load(io.BytesIO(content), allow_pickle=False)
    return array, _SKELETONS[shape[0]]


def _labels(path: Path, frames: int) -> tuple[str, ...] | None:
    """Label names of a clip, or None where it has no label file."""
    file = path.absolute().parent.parent / "GroundTruth" / f"{base_name(path)}.txt"
    if not file.is_file():
        return None
    lines = read_bytes(file).decode("utf-8-sig", errors="replace").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if len(lines) != frames:
        raise DatasetError(file, f"{len(lines)} labels for the {frames} frames of {path.name}")
    return tuple(label_name(text.strip(), f"{file}, line {line}") for line, text in enumerate(lines, 1))
