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
from kinecast.datasets.resampling import measured_rate
from kinecast.errors import DatasetError
from kinecast.live.message import LONGEST_NAME, MessageError, SkeletonMessage, person_of
from kinecast.pipeline import frames
from kinecast.types import SkeletonFrame

LONGEST_LINE = 1 << 20  # bytes of one message; a prediction of 300 steps has 400,000
ROUNDED = "arms as `kinecast live` saw them, to 0.1 mm"


class _Message(SkeletonMessage, gc=False):
    """Of a recording, or what a prediction holds beside a skeleton's fields."""

    kind: str | None = None
    label: str | None = None
    source: str = ""
    observed: list[list[float | None]] | None = None


@dataclass
class _Track:
    """One person's frames, as they come."""

    frames: list[SkeletonFrame] = field(default_factory=list)
    labels: list[str | None] = field(default_factory=list)
    late: int = 0


def labelled_frames(recordings: Sequence[Recording]) -> Iterator[tuple[SkeletonFrame, str | None]]:
    """All persons' frames by stamp, each with its label."""

    def one(recording: Recording) -> Iterator[tuple[SkeletonFrame, str | None]]:
        return zip(frames(recording), recording.labels or (None,) * len(recording.stamps), strict=True)

    return heapq.merge(*map(one, recordings), key=lambda each: each[0].stamp)


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
    """One recording for each person, of lines of skeletons or of predictions.

    Raises:
        DatasetError: a line is neither, or a person's stamps do not increase.
    """
    return recordings_of(_lines(path), path, "jsonl")


def recordings_of(
    messages: Iterable[tuple[str, bytes]], path: Path, format: str, descriptions: Sequence[Description] = ()
) -> list[Recording]:
    """One recording for each person in messages.

    Args:
        messages: each one's place, for errors, and its JSON.
        path, format: of the file.
        descriptions: of the recordings, where they are known.

    Raises:
        DatasetError: a message is neither skeleton nor prediction, or a person's stamps do not increase.
    """
    tracks: dict[tuple[str, str], _Track] = {}
    predicted: bool | None = None
    points = 0
    for where, content in messages:
        frame, source, label = _read(where, content)
        if predicted not in (None, source is not None):
            raise DatasetError(where, "predictions and skeletons in one file")
        predicted = source is not None
        track = tracks.setdefault((source or "", frame.person), _Track())
        if track.frames and frame.stamp <= track.frames[-1].stamp:
            if not predicted:
                raise DatasetError(where, f"stamp {frame.stamp} s does not come after {track.frames[-1].stamp} s")
            track.late += 1
            continue
        points += len(frame.joints)
        if points > MOST_POINTS:
            raise DatasetError(where, f"more than {MOST_POINTS} positions")
        track.frames.append(frame)
        track.labels.append(label)
    if descriptions:
        known = {description.person: description for description in descriptions}
        missing = {person for _, person in tracks} ^ set(known)
        if missing:
            raise DatasetError(path, f"person {min(missing)!r} is in the metadata or in the messages alone")
        return [_recording(tracks["", person], known[person]) for person in known]
    sources = {source for source, _ in tracks}
    persons = [f"{source}/{person}" if len(sources) > 1 else person for source, person in tracks]
    return [
        _recording(track, _inferred(track, path, format, person, len(tracks) == 1, bool(predicted)))
        for person, track in zip(persons, tracks.values(), strict=True)
    ]


def _read(where: str, content: bytes) -> tuple[SkeletonFrame, str | None, str | None]:
    """A message's skeleton; its source where it is a prediction; its label."""
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
    return frame, found.source[:LONGEST_NAME] if predicted else None, found.label


def _inferred(track: _Track, path: Path, format: str, person: str, alone: bool, predicted: bool) -> Description:
    """What is not stated: the rate from the stamps, the name from the file."""
    if len(track.frames) < 2:
        raise DatasetError(path, f"{len(track.frames)} frame of person {person!r}; at least 2 tell the rate")
    stamps = np.array([frame.stamp for frame in track.frames])
    rate = float(f"{measured_rate(stamps):.9g}")  # not what rounding of the stamps makes of it
    notes = [f"rate not stated; {rate:.6g} Hz from the stamps"]
    if predicted:
        notes.append(ROUNDED)
    if track.late:
        notes.append(f"{track.late} frames that came late or twice left out")
    name = base_name(path) if alone else f"{base_name(path)}/{person}"
    joints = list(dict.fromkeys(joint for frame in track.frames for joint in frame.joints))
    return Description(name, person, joints, rate, str(path), format, "", "", notes)


def _recording(track: _Track, about: Description) -> Recording:
    """A track's frames, NaN for joints that one does not name."""
    places = {joint: place for place, joint in enumerate(about.joints)}
    unknown = {joint for frame in track.frames for joint in frame.joints} - set(places)
    if unknown:
        raise DatasetError(about.name, f"joint {min(unknown)!r} is not in the metadata")
    positions: Float[np.ndarray, "N J 3"] = np.full((len(track.frames), len(places), 3), np.nan)
    for row, frame in zip(positions, track.frames, strict=True):
        row[[places[joint] for joint in frame.joints]] = frame.positions
    labelled = set(track.labels) != {None} if about.labelled is None else about.labelled
    stamps = np.array([frame.stamp for frame in track.frames])
    labels = tuple(label or "" for label in track.labels) if labelled else None
    return about.recording(stamps, positions, labels)


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
