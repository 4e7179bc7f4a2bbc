"""Recordings as messages (docs/live.md): what a tracker sends to `kinecast live`, or what that wrote to a file.

Predictions hold the arms they rest on, as measured: that is what is read from them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.datasets import table
from kinecast.datasets.files import MOST_POINTS, chunks
from kinecast.datasets.recording import Recording
from kinecast.datasets.table import Rows, words
from kinecast.errors import DatasetError
from kinecast.live.message import LONGEST_NAME, MessageError, SkeletonMessage, person_of
from kinecast.pipeline import labelled_frames
from kinecast.types import SkeletonFrame

LONGEST_LINE = 1 << 20  # bytes of one message; a prediction of 300 steps has 400,000
ROUNDED = "arms as `kinecast live` saw them, to 0.1 mm"


class _Message(SkeletonMessage, gc=False):
    """Of a recording, or what a prediction holds beside a skeleton's fields."""

    kind: str | None = None
    label: str | None = None
    source: str = ""
    observed: list[list[float | None]] | None = None


def message(frame: SkeletonFrame, label: str | None) -> bytes:
    """A frame as JSON; NaN is null, every other number comes back to the last bit."""
    content = {
        "stamp": frame.stamp,
        "person": frame.person,
        "joints": frame.joints,
        "positions": frame.positions.tolist(),
    }
    return msgspec.json.encode(content if label is None else {**content, "label": label})


def write(path: Path, recordings: Sequence[Recording]) -> None:
    """One line of JSON for each frame; names, rate, subject, task and notes are lost."""
    with path.open("wb") as file:
        for frame, label in labelled_frames(recordings):
            file.write(message(frame, label) + b"\n")


def load(path: Path) -> list[Recording]:
    """One recording for each person, of lines of skeletons or of predictions; a DatasetError for other lines."""
    return recordings_of((read(where, line) for where, line in _lines(path)), path, "jsonl")


class Said(NamedTuple):
    """A frame that was read."""

    where: str  # for errors
    frame: SkeletonFrame
    source: str | None = None  # of the prediction that it was read from
    label: str | None = None

    @property
    def key(self) -> tuple[str, str]:
        """Source and person."""
        return self.source or "", self.frame.person


def recordings_of(
    found: Iterable[Said], path: Path, format: str, described: Sequence[Mapping[str, Any]] = ()
) -> list[Recording]:
    """One recording for each person in frames; fields of `Description` say what is known of each.

    A DatasetError where there is none, a person's stamps do not increase, or predictions and skeletons are mixed.
    """
    kept: list[Said] = []
    newest: dict[tuple[str, str], float] = {}
    late: Counter[tuple[str, str]] = Counter()
    points = 0
    for each in found:
        frame, key, predicted = each.frame, each.key, each.source is not None
        if kept and predicted != (kept[0].source is not None):
            raise DatasetError(each.where, "predictions and skeletons in one file")
        if frame.stamp <= newest.get(key, -np.inf):
            if not predicted:
                raise DatasetError(each.where, f"stamp {frame.stamp} s does not come after {newest[key]} s")
            late[key] += 1
            continue
        points += len(frame.joints)
        if points > MOST_POINTS:
            raise DatasetError(each.where, f"more than {MOST_POINTS} positions")
        newest[key] = frame.stamp
        kept.append(each)
    if not kept:
        raise DatasetError(path, "no frame")
    several = len({source for source, _ in newest}) > 1
    persons = {key: "/".join(key) if several else key[1] for key in newest}
    frames, sizes = [each.frame for each in kept], np.array([len(each.frame.joints) for each in kept])
    rows = Rows(
        stamp=np.repeat([frame.stamp for frame in frames], sizes),
        person=words([persons[each.key] for each in kept], sizes),
        joint=words(joint for frame in frames for joint in frame.joints),
        position=np.concatenate([frame.positions for frame in frames]),
        label=words([each.label or "" for each in kept], sizes),
        metadata={"recordings": described} if described else None,
    )
    recordings = table.recordings_of(rows, path)
    if described:
        return recordings
    notes = {persons[key]: [f"{late[key]} frames that came late or twice left out"] * (late[key] > 0) for key in newest}
    return [
        replace(
            each,
            format=format,
            rate=float(f"{each.rate:.9g}"),  # not what rounding of the stamps makes of it
            notes=(*each.notes, *[ROUNDED] * (kept[0].source is not None), *notes[each.person]),
        )
        for each in recordings
    ]


def read(where: str, content: bytes) -> Said:
    """A message's skeleton, which comes from somewhere that an error names; a DatasetError where it has none."""
    try:
        found = msgspec.json.decode(content, type=_Message)
        predicted = found.kind == "prediction"
        if predicted:
            found.positions = found.observed
            if tuple(found.joints or ()) != ARM_JOINTS or [len(row) for row in found.observed or ()] != [3] * 6:
                raise MessageError("a prediction's observed are 6 × 3, its joints those of both arms")
        frame = person_of(found)
    except (msgspec.MsgspecError, MessageError, ValueError, RecursionError) as error:
        raise DatasetError(where, f"neither skeleton nor prediction: {str(error)[:200]}") from None
    if not isinstance(frame, SkeletonFrame):
        raise DatasetError(where, "pixels of one camera; a recording needs positions in metres")
    return Said(where, frame, found.source[:LONGEST_NAME] if predicted else None, found.label)


def _lines(path: Path) -> Iterator[tuple[str, bytes]]:
    """Every line that is not blank, and where it is."""
    rest, number = b"", 0
    for piece in chunks(path):
        *whole, rest = (rest + piece).split(b"\n")
        for line in whole:
            number += 1
            if line.strip():
                yield f"{path}, line {number}", line
        if len(rest) > LONGEST_LINE:
            raise DatasetError(f"{path}, line {number + 1}", f"longer than {LONGEST_LINE} bytes")
    if rest.strip():
        yield f"{path}, line {number + 1}", rest
