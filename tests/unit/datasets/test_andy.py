"""ANDY: motion with the majority label of three annotators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import XSENS_23
from kinecast.datasets import andy, mvnx
from kinecast.errors import DatasetError

TRIAL = "Participant_541_Setup_A_Seq_4_Trial_2"
TRACKS = ("general_posture", "detailed_posture", "details", "current_action")


def labels_text(votes: Sequence[tuple[float, str, str, str]]) -> str:
    """A label file whose current_action holds these votes; the other tracks say something else."""
    header = ["t_video", *(f"{track}_Annotator{number}" for track in TRACKS for number in (1, 2, 3))]
    lines = [",".join([str(stamp), *["St"] * 9, *actions]) for stamp, *actions in votes]
    return "\n".join([",".join(header), *lines]) + "\n"


@pytest.fixture
def trial(tmp_path: Path, mvnx_text: Callable[..., str], motion: Callable[..., np.ndarray]) -> Path:
    """A trial of 5 frames, 0.25 s apart: each is in another window."""
    path = tmp_path / "xsens" / "Participant_541" / f"{TRIAL}.xsens.mvnx"
    path.parent.mkdir(parents=True)
    path.write_text(mvnx_text(rate="4", positions=motion(XSENS_23.joints, 5)))
    return path


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    path = tmp_path / "annotations" / "labels_csv2" / "Participant_541" / f"{TRIAL.lower()}.labels.csv"
    path.parent.mkdir(parents=True)
    return path


def test_majority_of_a_window_and_ties(trial: Path, labels: Path) -> None:
    votes = [
        (0.00, "Re", "Re", "Pi"), (0.12, "Pi", "Re", "Pi"),  # a tie, 3 to 3
        (0.25, "Re", "Re", "Pi"), (0.40, "Pi", "Re", "Re"),  # 4 to 2
        (0.50, "Fm", "Ca", "Sc"),  # a tie of three
        (0.76, "Id", "", ""), (0.99, "Rl", "Idle", ""),  # empty is no vote, long names count as short ones
    ]  # fmt: skip
    labels.write_text(labels_text(votes))
    assert andy.matches(trial)
    (recording,) = andy.load(trial)
    assert recording.format == "andy"
    assert (recording.subject, recording.task) == ("541", "Setup_A_Seq_4")
    assert recording.labels == ("NONE", "reaching", "NONE", "idle", "NONE")  # the last window has no votes


def test_labels_may_lie_beside(trial: Path) -> None:
    assert not andy.matches(trial)
    (trial.parent / f"{TRIAL}.labels.csv").write_text(labels_text([(0.0, "Fm", "fine_manipulation", "Ca")]))
    assert andy.matches(trial)
    assert andy.load(trial)[0].labels == ("fine manipulation", *["NONE"] * 4)


def test_motion_is_that_of_the_mvnx_file(trial: Path, labels: Path) -> None:
    labels.write_text(labels_text([(0.0, "Re", "Re", "Re")]))
    (plain,), (labelled,) = mvnx.load(trial), andy.load(trial)
    np.testing.assert_array_equal(labelled.positions, plain.positions)


def test_labels_of_another_trial_do_not_count(trial: Path, labels: Path) -> None:
    labels.with_name(f"{TRIAL}0.labels.csv").write_text(labels_text([(0.0, "Re", "Re", "Re")]))
    assert not andy.matches(trial)
    with pytest.raises(DatasetError, match=rf"no {TRIAL}\.labels\.csv beside it or in annotations"):
        andy.load(trial)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,label\n0,Re\n", r"labels\.csv, line 1: header is 'time,label', expected t_video"),
        (labels_text([(0.0, "Re", "Re", "Re"), (0.1, "Re", "Re")]), r"line 3: 12 columns, expected 13"),
        (labels_text([("start", "Re", "Re", "Re")]), r"line 2: t_video is 'start', expected a number"),
    ],
)  # fmt: skip
def test_a_spoilt_label_file_is_refused(trial: Path, labels: Path, text: str, message: str) -> None:
    labels.write_text(text)
    with pytest.raises(DatasetError, match=message):
        andy.load(trial)
