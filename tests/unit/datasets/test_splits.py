"""Splits: groups stay together, nothing is in both parts, and no part is empty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinecast.datasets.recording import Recording
from kinecast.datasets.splits import (
    INNER_GAP,
    Key,
    Split,
    by_recording,
    by_subject,
    by_task,
    inner_split,
    leave_one_out,
    split_by,
)
from kinecast.errors import DatasetError


def made(name: str, subject: str = "", task: str = "", seconds: float = 10.0, source: Path | None = None) -> Recording:
    t = np.arange(round(seconds * 30)) / 30.0
    return Recording(
        name, ("left_wrist",), t, np.zeros((len(t), 1, 3)), 30.0, subject=subject, task=task, source=source
    )


RECORDINGS = [made(f"{subject}-{task}", subject, task) for subject in "abc" for task in ("reach", "carry")]


def names(part: tuple[Recording, ...]) -> list[str]:
    return [recording.name for recording in part]


def check_apart(split: Split, recordings: list[Recording], key: Key) -> None:
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
def test_leaving_one_out_tests_each_recording_once(key: Key, count: int) -> None:
    splits = list(leave_one_out(RECORDINGS, key))
    assert len(splits) == count
    for split in splits:
        check_apart(split, RECORDINGS, key)
    tested = [name for split in splits for name in names(split.test)]
    assert sorted(tested) == sorted(recording.name for recording in RECORDINGS)


def test_persons_of_one_file_stay_together() -> None:
    recordings = [made("0", source=Path("a")), made("1", source=Path("a")), made("0", source=Path("b"))]
    splits = list(leave_one_out(recordings, by_recording))
    assert [len(split.test) for split in splits] == [2, 1]


def test_empty_parts_are_errors() -> None:
    with pytest.raises(DatasetError, match="nothing left to train on"):
        split_by(RECORDINGS, by_task, {"carry", "reach"})
    with pytest.raises(DatasetError, match="nothing left to test on"):
        split_by(RECORDINGS, by_task, set())
    with pytest.raises(DatasetError, match="d not found among a, b, c"):
        split_by(RECORDINGS, by_subject, {"a", "d"})
    with pytest.raises(DatasetError, match="nothing left to train on"):
        list(leave_one_out([made("alone")], by_recording))


def test_an_unknown_subject_or_task_is_an_error() -> None:
    with pytest.raises(DatasetError, match="its subject is not known"):
        list(leave_one_out([made("x"), made("y")], by_subject))
    with pytest.raises(DatasetError, match="its task is not known"):
        split_by([made("x"), made("y")], by_task, {"reach"})


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.9])
def test_the_inner_split_holds_out_about_its_share(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    recordings = [made(f"{k}", seconds=float(rng.uniform(5, 20))) for k in range(12)]
    split = inner_split(recordings, by_recording, share, seed)
    check_apart(split, recordings, by_recording)
    total = sum(recording.duration for recording in recordings)
    held = sum(recording.duration for recording in split.test)
    assert abs(held / total - share) < 20.0 / total
    again = inner_split(recordings, by_recording, share, seed)
    assert names(again.test) == names(split.test)


def test_two_groups_split_into_one_and_one() -> None:
    recordings = [made("long", seconds=100.0), made("short", seconds=2.0)]
    for seed in range(6):
        split = inner_split(recordings, by_recording, 0.25, seed)
        assert len(split.train) == len(split.test) == 1


def test_a_single_recording_is_split_in_time_with_a_gap() -> None:
    recording = made("alone", seconds=40.0)
    split = inner_split([recording], by_recording, 0.25)
    (train,), (test,) = split.train, split.test
    assert test.stamps[-1] == recording.stamps[-1]
    assert test.duration == pytest.approx(10.0, abs=0.1)
    assert test.stamps[0] - train.stamps[-1] >= INNER_GAP


def test_nothing_to_hold_out_is_an_error() -> None:
    with pytest.raises(DatasetError, match="too short"):
        inner_split([made("blink", seconds=1.0)], by_recording)
    with pytest.raises(DatasetError, match="no recording"):
        inner_split([], by_recording)
