"""LEGO assembly text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import LEGO_6
from kinecast.datasets import lego
from kinecast.errors import DatasetError


def write(path: Path, positions: np.ndarray) -> None:
    camera = np.stack([positions[..., 0], -positions[..., 2], positions[..., 1]], axis=-1)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, camera.reshape(len(positions), 18))


def test_positions_turn_z_up_and_names_come_from_the_folders(tmp_path: Path, motion: Callable[..., np.ndarray]) -> None:
    path = tmp_path / "Task2" / "Human1" / "trial1.txt"
    positions = motion(LEGO_6.joints, 8)
    write(path, positions)
    assert lego.matches(path)
    (recording,) = lego.load(path)
    assert (recording.name, recording.subject, recording.task) == ("Task2/Human1/trial1", "Human1", "Task2")
    assert recording.notes == ("rate not stated by the format; 30 Hz assumed",)
    np.testing.assert_array_equal(recording.positions, positions)


def test_other_folders_are_no_subject(tmp_path: Path, motion: Callable[..., np.ndarray]) -> None:
    path = tmp_path / "loose.txt"
    write(path, motion(LEGO_6.joints, 8))
    (recording,) = lego.load(path)
    assert (recording.name, recording.subject, recording.task) == ("loose", "", "")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (" ".join(["1.0"] * 17), r"line 1: 17 columns, expected 18"),
        (" ".join(["1.0"] * 17 + ["high"]), r"line 1: column 18 is 'high'"),
    ],
)
def test_a_spoilt_first_line_still_matches_and_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(f"{line}\n")
    assert lego.matches(path)
    with pytest.raises(DatasetError, match=message):
        lego.load(path)


@pytest.mark.parametrize("text", ["source: a public repository\n", "0\n1\n", "10 0 0\n", "a,b,c\n1,2,3\n"])
def test_other_text_does_not_match(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(text)
    assert not lego.matches(path)


def test_real_trial(data_root: Path) -> None:
    (recording,) = lego.load(data_root / "human_assembly_data" / "Task1" / "Human1" / "trial1.txt.gz")
    assert recording.positions.shape == (925, 6, 3)
    # First row of the file: left wrist 0.26554544 0.08574302 0.72790375, y down and z forward.
    np.testing.assert_allclose(recording.joint("left_wrist")[0], [0.26554544, 0.72790375, -0.08574302], atol=1e-8)
    assert np.median(recording.joint("left_shoulder")[:, 2] - recording.joint("left_wrist")[:, 2]) > 0.2
