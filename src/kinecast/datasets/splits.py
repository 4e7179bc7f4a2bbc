"""Splits into training and test recordings: by recording, subject or task, never by window."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError


@dataclass(frozen=True)
class Split:
    """Recordings to train on, and to test on; neither is empty, and they share no group."""

    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    held_out: tuple[str, ...]  # the groups in test


def by_recording(recording: Recording) -> str:
    """The recording itself: its source where known, so that the persons in one file stay together."""
    return recording.name if recording.source is None else str(recording.source)


def by_subject(recording: Recording) -> str:
    """Who is recorded; DatasetError where that is not known."""
    return _known(recording, "subject", recording.subject)


def by_task(recording: Recording) -> str:
    """What is being done; DatasetError where that is not known."""
    return _known(recording, "task", recording.task)


def _known(recording: Recording, name: str, value: str) -> str:
    if not value:
        raise DatasetError(recording.source or recording.name, f"its {name} is not known, so it cannot be split by")
    return value


def split_by(recordings: Sequence[Recording], key: Callable[[Recording], str], test: Collection[str]) -> Split:
    """Recordings whose key is among `test` held out, the others to train on.

    Raises:
        DatasetError: a key in `test` that no recording has, or nothing left to train or test on.
    """
    present = list(dict.fromkeys(map(key, recordings)))
    unknown = sorted(set(test) - set(present))
    if unknown:
        raise DatasetError("split", f"{', '.join(unknown)} not found among {', '.join(present)}")
    train = tuple(recording for recording in recordings if key(recording) not in test)
    tested = tuple(recording for recording in recordings if key(recording) in test)
    if not train or not tested:
        empty = "test on" if train else "train on"
        raise DatasetError("split", f"nothing left to {empty}: the groups are {', '.join(present) or 'none'}")
    return Split(train, tested, tuple(group for group in present if group in test))
