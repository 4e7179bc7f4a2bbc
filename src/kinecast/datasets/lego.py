"""LEGO assembly text files (human_assembly_data): both arms in camera axes, without times."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinecast.body.skeleton import LEGO_6
from kinecast.datasets.files import base_name, head, read_bytes, rows
from kinecast.datasets.recording import Recording
from kinecast.geometry.transforms import from_camera

_ASSUMED_RATE = 30.0
_COLUMNS = 18
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)


def matches(path: Path) -> bool:
    """Whether a file's first line is several words apart by white space, most of them numbers."""
    words = head(path).partition(b"\n")[0].split() if path.is_file() else []
    return len(words) >= 6 and 2 * sum(bool(_NUMBER.fullmatch(word)) for word in words) > len(words)


def load(path: Path) -> list[Recording]:
    """One trial of 18 numbers [m] a line, named `Task1/Human1/trial1` after folders where these are the dataset's."""
    table = rows(read_bytes(path), _COLUMNS, path, delimiter=None)
    *_, task, person, _ = ("", "", *path.absolute().parts)
    known = re.fullmatch(r"Human\d+", person) is not None
    return [
        Recording(
            name=f"{task}/{person}/{base_name(path)}" if known else base_name(path),
            joints=LEGO_6.joints,
            stamps=np.arange(len(table)) / _ASSUMED_RATE,
            positions=from_camera(table.reshape(-1, 6, 3)),
            rate=_ASSUMED_RATE,
            source=path,
            format="lego",
            subject=person if known else "",
            task=task if known else "",
            notes=("rate not stated by the format; 30 Hz assumed",),
        )
    ]
