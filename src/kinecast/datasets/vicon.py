"""Vicon Tracker csv: rigid bodies of the human_robot_animations recordings."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import VICON
from kinecast.datasets.files import base_name, head, number, read_bytes, rows, split_lines
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError

_FIRST_DATA_LINE = 6
_CELLS = ["RX", "RY", "RZ", "TX", "TY", "TZ"]
_UNITS = ["rad"] * 3 + ["mm"] * 3


def matches(path: Path) -> bool:
    """Whether a file opens with the line `Objects`."""
    return path.is_file() and head(path).partition(b"\n")[0].strip() == b"Objects"


def load(path: Path) -> list[Recording]:
    """One take of every body object, in file order, named `<folder>/<file>`; the folder is the task."""
    header, data = split_lines(read_bytes(path), _FIRST_DATA_LINE - 1, path)
    rate = number(header[1], f"{path}, line 2", "rate")
    if rate <= 0:
        raise DatasetError(f"{path}, line 2", f"rate {rate} Hz, expected more than 0")
    objects = _objects(header, path)
    table = rows(data, 2 + 6 * len(objects), path, first_line=_FIRST_DATA_LINE)

    bodies = [place for place, name in enumerate(objects) if VICON.find(name)]
    others = [name for name in objects if not VICON.find(name)]
    translations = table[:, 2:].reshape(len(table), len(objects), 6)[:, bodies, 3:]
    task = path.absolute().parent.name
    return [
        Recording(
            name=f"{task}/{base_name(path)}",
            joints=VICON.canonical((objects[place] for place in bodies), path),
            stamps=_stamps(table[:, 0], rate, path),
            positions=translations / 1000.0,
            rate=rate,
            source=path,
            format="vicon",
            task=task,
            notes=(f"objects left out: {', '.join(others)}",) if others else (),
        )
    ]


def _objects(header: list[str], path: Path) -> list[str]:
    """Object names in column order, after a check of lines 3 to 5."""
    objects = re.findall(r"Global Angle ([^:,]+):", header[2])
    expected = {
        3: ["", ""] + [cell for name in objects for cell in (f"Global Angle {name}:{name}", "", "", "", "", "")],
        4: ["Frame", "Sub Frame"] + _CELLS * len(objects),
        5: ["", ""] + _UNITS * len(objects),
    }
    for line, cells in expected.items():
        found = header[line - 1].split(",")
        # Tracker writes one comma too many after the names.
        if not objects or found[: len(cells)] != cells or any(found[len(cells) :]):
            wanted = ",".join(cells[:8]) if objects else ",,Global Angle <name>:<name>,"
            raise DatasetError(f"{path}, line {line}", f"header is {header[line - 1][:60]!r}, expected {wanted!r}, …")
    return objects


def _stamps(frames: Float[np.ndarray, " N"], rate: float, path: Path) -> Float[np.ndarray, " N"]:
    """(N,) stamps [s] from Tracker's frame numbers, the first at zero."""
    bad = ~np.isfinite(frames) | np.append(False, ~(np.diff(frames) > 0))
    if bad.any():
        row = int(np.argmax(bad))
        raise DatasetError(f"{path}, line {row + _FIRST_DATA_LINE}", f"frame number {frames[row]} does not increase")
    return np.subtract(frames, frames[0]) / rate
