"""Splits: groups stay together, nothing is in both parts, and no part is empty."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinecast.datasets.recording import Recording
from kinecast.datasets.splits import Split, by_recording, by_subject, by_task, split_by
from kinecast.errors import DatasetError


def made(name: str, subject: str = "", task: str = "", seconds: float = 10.0, source: Path | None = None) -> Recording:
    t = np.arange(round(seconds * 30)) / 30.0
    return Recording(
        name, ("left_wrist",), t, np.zeros((len(t), 1, 3)), 30.0, subject=subject, task=task, source=source
    )


RECORDINGS = [made(f"{subject}-{task}", subject, task) for subject in "abc" for task in ("reach", "carry")]


def names(part: tuple[Recording, ...]) -> list[str]:
    return [recording.name for recording in part]


def check_apart(split: Split, recordings: list[Recording], key: Callable[[Recording], str]) -> None:
    assert split.train
    assert split.test
    assert {key(r) for r in split.train} & {key(r) for r in split.test} == set()
    assert sorted(names(split.train) + names(split.test)) == sorted(r.name for r in recordings)


def test_a_task_is_held_out() -> None:
    split = split_by(RECORDINGS, by_task, {"carry"})
    assert names(split.test) == ["a-carry", "b-carry", "c-carry"]
    assert split.held_out == ("carry",)
    check_apart(split, RECORDINGS, by_task)


@pytest.mark.parametrize(("key", "count"), [(by_recording, 6), (by_subject, 3), (by_task, 2)])
def test_leaving_one_out_tests_each_recording_once(key: Callable[[Recording], str], count: int) -> None:
    groups = sorted({key(recording) for recording in RECORDINGS})
    assert len(groups) == count
    splits = [split_by(RECORDINGS, key, {group}) for group in groups]
    for split in splits:
        check_apart(split, RECORDINGS, key)
    tested = [name for split in splits for name in names(split.test)]
    assert sorted(tested) == sorted(recording.name for recording in RECORDINGS)


def test_persons_of_one_file_stay_together() -> None:
    recordings = [made("0", source=Path("a")), made("1", source=Path("a")), made("0", source=Path("b"))]
    assert [len(split_by(recordings, by_recording, {group}).test) for group in "ab"] == [2, 1]


def test_empty_parts_are_errors() -> None:
    with pytest.raises(DatasetError, match="nothing left to train on"):
        split_by(RECORDINGS, by_task, {"carry", "reach"})
    with pytest.raises(DatasetError, match="nothing left to test on"):
        split_by(RECORDINGS, by_task, set())
    with pytest.raises(DatasetError, match="d not found among a, b, c"):
        split_by(RECORDINGS, by_subject, {"a", "d"})
    with pytest.raises(DatasetError, match="nothing left to train on"):
        split_by([made("alone")], by_recording, {"alone"})


def test_an_unknown_subject_or_task_is_an_error() -> None:
    with pytest.raises(DatasetError, match="its subject is not known"):
        split_by([made("x"), made("y")], by_subject, {"x"})
    with pytest.raises(DatasetError, match="its task is not known"):
        split_by([made("x"), made("y")], by_task, {"reach"})
