"""Recordings as messages (docs/live.md): what a tracker sends to `kinecast live`, or what that wrote to a file.

Predictions hold the arms they rest on, as measured: that is what is read from them.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.datasets.files import MOST_POINTS, base_name, chunks
from kinecast.datasets.recording import Description, Recording
from kinecast.errors import DatasetError
from kinecast.live.message import LATEST_STAMP, LONGEST_NAME, MessageError, decode
from kinecast.types import SkeletonFrame

__all__ = ["labelled_frames", "load", "message", "recordings_of", "write"]

LONGEST_LINE = 1 << 20
"""Bytes of one message; a prediction of 300 steps has 400,000."""
ROUNDED = "arms as `kinecast live` saw them, to 0.1 mm"


class _Kind(msgspec.Struct, gc=False):
    """What a message is, and what no skeleton has."""

    kind: str | None = None
    label: str | None = None


class _Prediction(msgspec.Struct, gc=False):
    """What is measured in a prediction."""

    stamp: float
    person: str
    source: str
    joints: list[str]
    observed: list[list[float | None]]


_KIND, _PREDICTION = msgspec.json.Decoder(_Kind), msgspec.json.Decoder(_Prediction)
_ENCODE = msgspec.json.Encoder().encode


@dataclass
class _Track:
    """One person's frames, as they come."""

    stamps: list[float] = field(default_factory=list)
    joints: list[tuple[str, ...]] = field(default_factory=list)
    positions: list[Float[np.ndarray, "J 3"]] = field(default_factory=list)
    labels: list[str | None] = field(default_factory=list)
    late: int = 0


def labelled_frames(recordings: Sequence[Recording]) -> Iterator[tuple[SkeletonFrame, str | None]]:
    """All persons' frames by stamp, each with its label."""

    def one(recording: Recording) -> Iterator[tuple[SkeletonFrame, str | None]]:
        labels = recording.labels or (None,) * len(recording.stamps)
        for stamp, positions, label in zip(recording.stamps, recording.positions, labels, strict=True):
            yield SkeletonFrame(float(stamp), recording.joints, positions, recording.person), label

    return heapq.merge(*map(one, recordings), key=lambda each: each[0].stamp)


def message(frame: SkeletonFrame, label: str | None) -> bytes:
    """A frame as JSON; NaN is null, every other number comes back to the last bit."""
    content = {
        "stamp": frame.stamp,
        "person": frame.person,
        "joints": frame.joints,
        "positions": frame.positions.tolist(),
    }
    return _ENCODE(content if label is None else {**content, "label": label})


def write(path: Path, recordings: Sequence[Recording]) -> None:
    """One line of JSON for each frame; names, rate, subject, task and notes are lost.

    Raises:
        OSError: the file cannot be written.
    """
    with path.open("wb") as file:
        for frame, label in labelled_frames(recordings):
            file.write(message(frame, label) + b"\n")


def load(path: Path) -> list[Recording]:
    """One recording for each person, of lines of skeletons or of predictions.

    Raises:
        DatasetError: a line is neither, or a person's stamps do not increase.
    """
    return recordings_of(_lines(path), path, "jsonl")


def recordings_of(
    messages: Iterable[tuple[str, bytes]],
    path: Path,
    format: str,
    descriptions: Sequence[Description] = (),
) -> list[Recording]:
    """One recording for each person in messages.

    Args:
        messages: where each is, for errors, and its JSON.
        path: of the file.
        format: its name.
        descriptions: of the recordings, where they are known.

    Raises:
        DatasetError: a message is neither skeleton nor prediction, or a person's stamps do not increase.
    """
    tracks: dict[tuple[str, str], _Track] = {}
    predicted: bool | None = None
    points = 0
    for where, content in messages:
        frame, source, label = _frame(where, content)
        if predicted not in (None, source is not None):
            raise DatasetError(where, "predictions and skeletons in one file")
        predicted = source is not None
        track = tracks.setdefault((source or "", frame.person), _Track())
        if track.stamps and frame.stamp <= track.stamps[-1]:
            if not predicted:
                raise DatasetError(where, f"stamp {frame.stamp} s does not come after {track.stamps[-1]} s")
            track.late += 1
            continue
        points += len(frame.joints)
        if points > MOST_POINTS:
            raise DatasetError(where, f"more than {MOST_POINTS} positions")
        track.stamps.append(frame.stamp)
        track.joints.append(frame.joints)
        track.positions.append(frame.positions)
        track.labels.append(label)
    if descriptions:
        known = {description.person: description for description in descriptions}
        missing = {person for _, person in tracks} ^ set(known)
        if missing:
            raise DatasetError(path, f"person {min(missing)!r} is in the metadata or in the messages alone")
        return [_described(tracks["", person], known[person]) for person in known]
    sources = {source for source, _ in tracks}
    return [
        _inferred(
            track, path, format, f"{source}/{person}" if len(sources) > 1 else person, len(tracks) == 1, bool(predicted)
        )
        for (source, person), track in tracks.items()
    ]


def _frame(where: str, content: bytes) -> tuple[SkeletonFrame, str | None, str | None]:
    """A message's skeleton; its source where it is a prediction; its label."""
    try:
        kind = _KIND.decode(content)
        if kind.kind == "prediction":
            return *_observed(content), None
        frame = decode(content)
    except (msgspec.MsgspecError, MessageError, ValueError, RecursionError) as error:
        raise DatasetError(where, f"neither skeleton nor prediction: {str(error)[:200]}") from None
    if not isinstance(frame, SkeletonFrame):
        raise DatasetError(where, "pixels of one camera; a recording needs positions in metres")
    return frame, None, kind.label


def _observed(content: bytes) -> tuple[SkeletonFrame, str]:
    found = _PREDICTION.decode(content)
    if tuple(found.joints) != ARM_JOINTS or [len(row) for row in found.observed] != [3] * len(ARM_JOINTS):
        raise MessageError("a prediction's observed are 6 × 3, its joints those of both arms")
    if not abs(found.stamp) <= LATEST_STAMP or not 0 < len(found.person) <= LONGEST_NAME:
        raise MessageError("a prediction's stamp or person is out of range")
    positions = np.array(found.observed, dtype=float)
    return SkeletonFrame(found.stamp, ARM_JOINTS, positions, found.person), found.source[:LONGEST_NAME]


def _stacked(track: _Track, joints: tuple[str, ...]) -> Float[np.ndarray, "N J 3"]:
    """(N, J, 3) with NaN for joints that a frame does not name."""
    places = {joint: place for place, joint in enumerate(joints)}
    positions = np.full((len(track.stamps), len(joints), 3), np.nan)
    for row, (names, found) in enumerate(zip(track.joints, track.positions, strict=True)):
        positions[row, [places[name] for name in names]] = found
    return positions


def _labels(track: _Track) -> tuple[str, ...] | None:
    return None if set(track.labels) == {None} else tuple(label or "" for label in track.labels)


def _described(track: _Track, known: Description) -> Recording:
    unknown = {name for names in track.joints for name in names} - set(known.joints)
    if unknown:
        raise DatasetError(known.name, f"joint {min(unknown)!r} is not in the metadata")
    return Recording(
        name=known.name,
        joints=tuple(known.joints),
        stamps=np.array(track.stamps),
        positions=_stacked(track, tuple(known.joints)),
        rate=known.rate,
        source=None if known.source is None else Path(known.source),
        format=known.format,
        person=known.person,
        subject=known.subject,
        task=known.task,
        labels=_labels(track),
        notes=tuple(known.notes),
    )


def _inferred(track: _Track, path: Path, format: str, person: str, alone: bool, predicted: bool) -> Recording:
    if len(track.stamps) < 2:
        raise DatasetError(path, f"{len(track.stamps)} frame of person {person!r}; at least 2 tell the rate")
    joints = tuple(dict.fromkeys(name for names in track.joints for name in names))
    rate = float(f"{1.0 / np.median(np.diff(track.stamps)):.9g}")  # not what rounding of the stamps makes of it
    notes = [f"rate not stated; {rate:.6g} Hz from the stamps"]
    if predicted:
        notes.append(ROUNDED)
    if track.late:
        notes.append(f"{track.late} frames that came late or twice left out")
    return Recording(
        name=base_name(path) if alone else f"{base_name(path)}/{person}",
        joints=joints,
        stamps=np.array(track.stamps),
        positions=_stacked(track, joints),
        rate=rate,
        source=path,
        format=format,
        person=person,
        labels=_labels(track),
        notes=tuple(notes),
    )


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
