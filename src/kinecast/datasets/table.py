"""Recordings in the project's own exchange format: a table of (stamp, person, joint), lossless both ways."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from kinecast.datasets.compressed import MOST_POINTS, base_name
from kinecast.datasets.recording import Recording
from kinecast.datasets.table_file import Rows, Words, is_table, read_rows, write_rows
from kinecast.errors import DatasetError

__all__ = ["Description", "describe", "load", "matches", "write"]

_WORLD = "z up, right-handed, metres, seconds"


def matches(path: Path) -> bool:
    """Whether a file is a table: parquet, or csv with its column names."""
    return path.is_file() and is_table(path)


def write(path: Path, recordings: Sequence[Recording]) -> None:
    """Write recordings so that `load` gives them back bit for bit; the file appears whole or not at all.

    Args:
        path: ends in `.parquet` or `.csv`.
        recordings: at least one; each of another person.

    Raises:
        OptionError: the path has another ending.
        DatasetError: two recordings are of one person, there is none, or the file cannot be written.
    """
    persons = [recording.person for recording in recordings]
    if not recordings or len(set(persons)) < len(persons):
        raise DatasetError(path, f"persons {persons}: a table holds one recording of each person, and at least one")
    blocks = [_block(recording) for recording in recordings]
    labelled = any(recording.labels is not None for recording in recordings)
    write_rows(
        path,
        Rows(
            stamp=np.concatenate([block.stamp for block in blocks]),
            person=_joined(block.person for block in blocks),
            joint=_joined(block.joint for block in blocks),
            position=np.concatenate([block.position for block in blocks]),
            label=_joined(block.label for block in blocks if block.label is not None) if labelled else None,
            metadata={
                "world": _WORLD,
                "recordings": [asdict(describe(recording)) for recording in recordings],
            },
        ),
    )


def load(path: Path) -> list[Recording]:
    """One recording for each person; those of `write` come back bit for bit.

    A table without kinecast's metadata takes its name from the file and its rate from the stamps.

    Args:
        path: parquet or csv, plain or compressed.

    Returns:
        Recordings in the order they were written, else of first appearance.

    Raises:
        DatasetError: the file is no table; or a row repeats, lacks its stamp, person or joint, or is of a
            person or joint the metadata does not name.
    """
    rows = read_rows(path)
    _require_complete(rows, path)
    if rows.metadata is None or "recordings" not in rows.metadata:
        return [_recording(rows, _inferred(rows, person, path), path) for person in rows.person.names]
    try:
        described = [Description(**each) for each in rows.metadata["recordings"]]
    except TypeError as error:
        raise DatasetError(path, f"metadata is damaged: {error}") from error
    unknown = set(rows.person.names) - {description.person for description in described}
    if unknown:
        raise DatasetError(path, f"person {min(unknown)!r} is not in the metadata")
    return [_recording(rows, description, path) for description in described]


@dataclass(frozen=True)
class Description:
    """What a recording is beside its frames, as a file's metadata holds it.

    Raises:
        TypeError: an entry of another type.
    """

    name: str
    person: str
    joints: list[str]
    rate: float
    source: str | None
    format: str
    subject: str
    task: str
    notes: list[str]

    def __post_init__(self) -> None:
        words = [self.name, self.person, self.format, self.subject, self.task, *self.joints, *self.notes]
        if not all(isinstance(word, str) for word in words) or not isinstance(self.source, str | None):
            raise TypeError(f"a name in {self} is no text")
        if not isinstance(self.rate, float | int):
            raise TypeError(f"rate {self.rate!r} is no number")


def describe(recording: Recording) -> Description:
    """What a recording is beside its frames."""
    return Description(
        name=recording.name,
        person=recording.person,
        joints=list(recording.joints),
        rate=recording.rate,
        source=None if recording.source is None else str(recording.source),
        format=recording.format,
        subject=recording.subject,
        task=recording.task,
        notes=list(recording.notes),
    )


def _inferred(rows: Rows, person: str, path: Path) -> Description:
    """The description of a person in a table without metadata."""
    mine = rows.person.codes == rows.person.names.index(person)
    stamps = np.unique(rows.stamp[mine])
    if len(stamps) < 2:
        raise DatasetError(path, f"{len(stamps)} frame of person {person!r}; at least 2 are needed to tell the rate")
    rate = float(1.0 / np.median(np.diff(stamps)))
    alone = len(rows.person.names) == 1
    return Description(
        name=base_name(path) if alone else f"{base_name(path)}/{person}",
        person=person,
        joints=[rows.joint.names[code] for code in dict.fromkeys(rows.joint.codes[mine].tolist())],
        rate=rate,
        source=str(path),
        format="table",
        subject="",
        task="",
        notes=[f"rate not stated; {rate:.6g} Hz from the stamps"],
    )


def _require_complete(rows: Rows, path: Path) -> None:
    incomplete = {
        "stamp": ~np.isfinite(rows.stamp),
        "person": rows.person.codes < 0,
        "joint": rows.joint.codes < 0,
    }
    for column, missing in incomplete.items():
        if missing.any():
            raise DatasetError(f"{path}, row {int(np.argmax(missing)) + 1}", f"no {column}")


def _recording(rows: Rows, description: Description, path: Path) -> Recording:
    """One person's rows as a recording; (stamp, joint) pairs without a row are NaN."""
    person = rows.person.names.index(description.person) if description.person in rows.person.names else -1
    mine = np.flatnonzero(rows.person.codes == person)
    stamps, frame = np.unique(rows.stamp[mine], return_inverse=True)
    if len(stamps) * len(description.joints) > MOST_POINTS:
        raise DatasetError(
            path, f"{len(stamps)} frames of {len(description.joints)} joints, at most {MOST_POINTS} positions"
        )
    places = {joint: place for place, joint in enumerate(description.joints)}
    joint = np.array([places.get(name, -1) for name in rows.joint.names], dtype=np.intp)[rows.joint.codes[mine]]
    if (joint < 0).any():
        row = mine[np.argmax(joint < 0)]
        name = rows.joint.names[rows.joint.codes[row]]
        raise DatasetError(f"{path}, row {row + 1}", f"joint {name!r} is not in the metadata")
    cell = frame * len(places) + joint
    first = np.unique(cell, return_index=True)[1]
    if len(first) < len(cell):
        row = mine[np.setdiff1d(np.arange(len(cell)), first)[0]]
        raise DatasetError(f"{path}, row {row + 1}", "repeats the stamp, person and joint of an earlier row")
    positions = np.full((len(stamps) * len(places), 3), np.nan)
    positions[cell] = rows.position[mine]
    return Recording(
        name=description.name,
        joints=tuple(description.joints),
        stamps=stamps,
        positions=positions.reshape(len(stamps), len(places), 3),
        rate=description.rate,
        source=None if description.source is None else Path(description.source),
        format=description.format,
        person=description.person,
        subject=description.subject,
        task=description.task,
        labels=_labels(rows, mine, frame, len(stamps), path),
        notes=tuple(description.notes),
    )


def _labels(
    rows: Rows, mine: Int[np.ndarray, " R"], frame: Int[np.ndarray, " R"], frames: int, path: Path
) -> tuple[str, ...] | None:
    """One label a frame, or None where no row has one."""
    if rows.label is None or (rows.label.codes[mine] < 0).all():
        return None
    codes = np.full(frames, -1)
    codes[frame] = rows.label.codes[mine]
    differs = codes[frame] != rows.label.codes[mine]
    if differs.any():
        raise DatasetError(f"{path}, row {mine[np.argmax(differs)] + 1}", "another label than other rows of its stamp")
    return tuple(rows.label.names[code] if code >= 0 else "" for code in codes)


def _block(recording: Recording) -> Rows:
    """A recording's rows: frame by frame, joint by joint."""
    frames, joints = recording.positions.shape[:2]
    label = None if recording.labels is None else Words.of(recording.labels)
    return Rows(
        stamp=np.repeat(recording.stamps, joints),
        person=Words((recording.person,), np.zeros(frames * joints, dtype=np.int32)),
        joint=Words(recording.joints, np.tile(np.arange(joints, dtype=np.int32), frames)),
        position=recording.positions.reshape(-1, 3),
        label=Words((), np.full(frames * joints, -1, dtype=np.int32))
        if label is None
        else Words(label.names, np.repeat(label.codes, joints)),
    )


def _joined(columns: Iterable[Words]) -> Words:
    """Columns of words below one another."""
    places: dict[str, int] = {}
    codes = []
    for column in columns:
        new = [places.setdefault(name, len(places)) for name in column.names]
        codes.append(np.array([*new, -1], dtype=np.int32)[column.codes])  # code -1 finds the last: missing
    return Words(tuple(places), np.concatenate(codes))
