"""ANDY: Xsens motion with the action labels of three annotators."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path
from statistics import multimode

import numpy as np
from jaxtyping import Float

from kinecast.datasets import mvnx
from kinecast.datasets.files import base_name, number, read_bytes
from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError

ACTIONS = {
    "Re": "reaching", "Pi": "picking", "Pl": "placing", "Rl": "release", "Ca": "carrying",
    "Fm": "fine manipulation", "Sc": "screwing", "Id": "idle",
}  # fmt: skip
"""Names of the short labels of current_action."""

NO_MAJORITY = "NONE"
"""Label of a window in which no action has more votes than every other."""

_WINDOW = 0.25  # [s], as the dataset's authors vote
_TRACK = "current_action"
_TRIAL = re.compile(r"participant_?(\d+)_(setup_?\w+?_seq(?:uence)?_?\d+)", re.IGNORECASE)


def matches(path: Path) -> bool:
    """Whether a file is Xsens motion with a label file, beside it or in the folder of annotations."""
    return mvnx.matches(path) and _label_file(path) is not None


def load(path: Path) -> list[Recording]:
    """One trial with the label of each frame: the annotators' majority over 0.25 s windows, ties `NONE`.

    Labels lie beside an MVNX file or its csv twin, or in a folder above it in
    `annotations/labels_csv2/<participant>/<trial>.labels.csv`. Subject and task are read from the trial's name.
    """
    if (labels := _label_file(path)) is None:
        missing = f"{mvnx.sequence_name(path)}.labels.csv"
        raise DatasetError(path, f"no {missing} beside it or in annotations/labels_csv2 above")
    (motion,) = mvnx.load(path)
    trial = _TRIAL.search(motion.name)
    subject, task = trial.groups() if trial else (motion.subject, "")
    return [replace(motion, format="andy", subject=subject, task=task, labels=_frame_labels(labels, motion.stamps))]


def _label_file(path: Path) -> Path | None:
    """The label file of a trial; names are compared without case."""
    wanted = f"{mvnx.sequence_name(path)}.labels".casefold()
    folder = path.absolute().parent
    files = [*folder.glob("*.labels.csv*")]
    for parent in folder.parents:
        files += sorted(parent.glob("annotations/labels_csv2/*/*.labels.csv*"))
    return next((file for file in files if base_name(file).casefold() == wanted), None)


def _frame_labels(file: Path, stamps: Float[np.ndarray, " N"]) -> tuple[str, ...]:
    """Majority label of the window each stamp lies in."""
    votes: dict[int, list[str]] = {}
    text = read_bytes(file).decode("utf-8-sig", errors="replace")
    try:
        header, *lines = list(csv.reader(text.splitlines())) or [[]]
    except csv.Error as error:
        raise DatasetError(file, f"broken csv: {error}") from error
    tracks = [place for place, name in enumerate(header) if re.fullmatch(rf"{_TRACK}_Annotator\d", name.strip())]
    if not tracks or header[0].strip() != "t_video":
        expected = f"t_video, …, {_TRACK}_Annotator1, …"
        raise DatasetError(f"{file}, line 1", f"header is {','.join(header)[:60]!r}, expected {expected}")
    for line, cells in enumerate(lines, 2):
        where = f"{file}, line {line}"
        if not cells:
            continue
        if len(cells) != len(header):
            raise DatasetError(where, f"{len(cells)} columns, expected {len(header)}")
        window = _window(number(cells[0], where, "t_video"))
        given = (cells[place].strip() for place in tracks)
        votes.setdefault(window, []).extend(  # one name for an action, written short or long
            ACTIONS.get(label.capitalize(), label.replace("_", " ").lower()) for label in given if label
        )
    winners = {window: modes[0] for window, labels in votes.items() if len(modes := multimode(labels)) == 1}
    return tuple(winners.get(_window(float(stamp)), NO_MAJORITY) for stamp in stamps)


def _window(stamp: float) -> int:
    """Index of the window a time [s] lies in; a time a rounding error short of a border counts as on it."""
    return int(np.floor(stamp / _WINDOW + 1e-6))
