"""Splits into training and test recordings: by recording, subject or task, never by window."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError

__all__ = [
    "Key",
    "Split",
    "by_recording",
    "by_subject",
    "by_task",
    "inner_split",
    "leave_one_out",
    "split_by",
]

Key = Callable[[Recording], str]
"""What recordings are grouped by: recordings with the same key stay together."""

INNER_GAP = 1.0
"""Time cut out between the two parts where one recording is split in time [s]: no window reaches across."""


@dataclass(frozen=True)
class Split:
    """Recordings to train on, and to test on.

    Attributes:
        train: not empty.
        test: not empty; shares no group with train.
        held_out: the groups in test.
    """

    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    held_out: tuple[str, ...]


def by_recording(recording: Recording) -> str:
    """The recording itself: its source where known, so that the persons in one file stay together."""
    return recording.name if recording.source is None else str(recording.source)


def by_subject(recording: Recording) -> str:
    """Who is recorded."""
    return _known(recording, "subject", recording.subject)


def by_task(recording: Recording) -> str:
    """What is being done."""
    return _known(recording, "task", recording.task)


def split_by(recordings: Sequence[Recording], key: Key, test: Collection[str]) -> Split:
    """Recordings whose key is among `test` held out, the others to train on.

    Raises:
        DatasetError: a key in `test` that no recording has, or nothing left to train or test on.
    """
    present = _groups(recordings, key)
    unknown = sorted(set(test) - set(present))
    if unknown:
        raise DatasetError("split", f"{', '.join(unknown)} not found among {', '.join(present)}")
    held_out = tuple(group for group in present if group in test)
    train = tuple(recording for recording in recordings if key(recording) not in held_out)
    tested = tuple(recording for recording in recordings if key(recording) in held_out)
    if not train or not tested:
        empty = "test on" if train else "train on"
        raise DatasetError("split", f"nothing left to {empty}: the groups are {', '.join(present) or 'none'}")
    return Split(train, tested, held_out)


def leave_one_out(recordings: Sequence[Recording], key: Key) -> Iterator[Split]:
    """One split per group, in order of appearance, that group held out.

    Raises:
        DatasetError: fewer than two groups.
    """
    for group in _groups(recordings, key):
        yield split_by(recordings, key, {group})


def inner_split(recordings: Sequence[Recording], key: Key, share: float = 0.25, seed: int = 0) -> Split:
    """Part of the training recordings held out for tuning.

    Whole groups, drawn at random, holding about `share` of the time. A single group cannot be held out whole:
    then the end of each of its recordings is, and `INNER_GAP` before it is dropped.

    Args:
        recordings: all to be trained on in the end.
        key: what stays together.
        share: of the time to hold out, in (0, 1).
        seed: of the draw.

    Raises:
        DatasetError: no recordings, or a single group too short to split.
    """
    groups = _groups(recordings, key)
    if len(groups) < 2:
        return _split_in_time(recordings, share, ", ".join(groups))
    duration = {
        group: sum(recording.duration for recording in recordings if key(recording) == group) for group in groups
    }
    wanted = share * sum(duration.values())
    held_out: list[str] = []
    held = 0.0
    for index in np.random.default_rng(seed).permutation(len(groups)):
        group = groups[int(index)]
        better = abs(held + duration[group] - wanted) < abs(held - wanted)
        if len(held_out) < len(groups) - 1 and (better or not held_out):
            held_out.append(group)
            held += duration[group]
    return split_by(recordings, key, held_out)


def _split_in_time(recordings: Sequence[Recording], share: float, group: str) -> Split:
    train, test = [], []
    for recording in recordings:
        border = recording.stamps[0] + (1 - share) * recording.duration
        early = int(np.searchsorted(recording.stamps, border - INNER_GAP))
        late = int(np.searchsorted(recording.stamps, border))
        if early > 1 and len(recording.stamps) - late > 1:
            train.append(recording.select(slice(0, early)))
            test.append(recording.select(slice(late, None)))
    if not train:
        raise DatasetError("split", f"nothing to hold out for tuning: {group or 'no recording'} is too short")
    return Split(tuple(train), tuple(test), (group,))


def _groups(recordings: Sequence[Recording], key: Key) -> list[str]:
    return list(dict.fromkeys(key(recording) for recording in recordings))


def _known(recording: Recording, name: str, value: str) -> str:
    if not value:
        raise DatasetError(recording.source or recording.name, f"its {name} is not known, so it cannot be split by")
    return value
