"""Xsens MVNX and its csv twin."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import XSENS_23
from kinecast.datasets import mvnx
from kinecast.errors import DatasetError


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    return tmp_path / "Trial_2.xsens.mvnx"


@pytest.mark.parametrize("version", [3, 4])
def test_normal_frames_only(
    trial: Path, mvnx_text: Callable[..., str], motion: Callable[..., np.ndarray], version: int
) -> None:
    trial.write_text(mvnx_text(version))
    assert mvnx.matches(trial)
    (recording,) = mvnx.load(trial)
    assert (recording.name, recording.subject, recording.rate) == ("Trial_2", "Suit", 240.0)
    assert recording.joints == XSENS_23.joints
    np.testing.assert_array_equal(recording.positions, motion(XSENS_23.joints, 8))
    # Not from the frames' time, which steps by 4 and 5 ms.
    np.testing.assert_allclose(recording.stamps, np.arange(8) / 240.0, rtol=1e-12)


def test_an_upper_body_alone_is_read_by_name(
    trial: Path, mvnx_text: Callable[..., str], motion: Callable[..., np.ndarray]
) -> None:
    segments = ["LeftHand", "LeftForeArm", "LeftUpperArm", "Prop1", "RightUpperArm", "RightForearm", "RightHand"]
    trial.write_text(mvnx_text(4, segments))
    (recording,) = mvnx.load(trial)
    assert recording.joints == (
        "left_wrist", "left_elbow", "left_shoulder", "right_shoulder", "right_elbow", "right_wrist"
    )  # fmt: skip
    assert recording.notes == ("segments left out: Prop1",)
    expected = motion(["left_wrist", "left_elbow", "left_shoulder", "Prop1", *recording.joints[3:]], 8)
    np.testing.assert_array_equal(recording.positions, np.delete(expected, 3, axis=1))


def test_missing_frames_are_gaps(trial: Path, mvnx_text: Callable[..., str]) -> None:
    trial.write_text(
        mvnx_text()
        .replace('index="5"', 'index="50"')
        .replace('index="6"', 'index="60"')
        .replace('index="7"', 'index="70"')
    )
    np.testing.assert_allclose(mvnx.load(trial)[0].stamps, np.array([0, 1, 2, 3, 4, 50, 60, 70]) / 240.0)


def test_a_compressed_trial_is_the_same(trial: Path, mvnx_text: Callable[..., str]) -> None:
    trial.write_text(mvnx_text())
    packed = trial.with_name("Trial_2.xsens.mvnx.gz")
    packed.write_bytes(gzip.compress(trial.read_bytes()))
    assert mvnx.matches(packed)
    (plain,), (compressed,) = mvnx.load(trial), mvnx.load(packed)
    assert compressed.name == plain.name
    np.testing.assert_array_equal(compressed.positions, plain.positions)


BOMB = '<!DOCTYPE mvnx [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>\n'
FILE = '<!DOCTYPE mvnx [<!ENTITY secret SYSTEM "file:///etc/hostname">]>\n'


@pytest.mark.parametrize("attack", [BOMB, FILE, '<!DOCTYPE mvnx SYSTEM "http://localhost/x.dtd">\n'])
def test_document_types_and_entities_are_refused(trial: Path, mvnx_text: Callable[..., str], attack: str) -> None:
    trial.write_text(mvnx_text(before=attack).replace('label="Suit"', 'label="&b;"'))
    with pytest.raises(DatasetError, match=r"line 2: a document type declaration; entities are refused"):
        mvnx.load(trial)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mvn/mvnx", "other", r"namespace is .* expected 'http://www.xsens.com/mvn/mvnx'"),
        ('frameRate="240"', 'frameRate="0"', r"line 3: frameRate is 0.0, expected more than 0"),
        ('frameRate="240"', "", r"line 3: frameRate is '', expected a number"),
        ('type="normal"', 'type="tpose"', r"no frame of type normal"),
        ('index="3"', 'index="x"', r"line 9: frame index is 'x', expected a number"),
        ("</position>", " 1</position>", r"line 6: 70 numbers in position, expected 3 for each of 23"),
        ("position>", "place>", r"a normal frame without one position element"),
        ("<position>", "<position>" + " " * 50_000, r"a position of more than"),
        ('"Pelvis"', '"Pelvis" x="<"', r"line 4: broken XML"),
        ("</frames>", "", r"line \d+: broken XML"),
    ],
)
def test_a_spoilt_file_is_refused(trial: Path, mvnx_text: Callable[..., str], old: str, new: str, message: str) -> None:
    text = mvnx_text()
    assert old in text
    trial.write_text(text.replace(old, new))
    with pytest.raises(DatasetError, match=message):
        mvnx.load(trial)


def test_a_truncated_file_is_refused(trial: Path, mvnx_text: Callable[..., str]) -> None:
    text = mvnx_text()
    trial.write_text(text[: len(text) * 2 // 3])
    with pytest.raises(DatasetError, match=r"line \d+: broken XML"):
        mvnx.load(trial)


def test_text_in_a_number_is_named_with_its_line(trial: Path, mvnx_text: Callable[..., str]) -> None:
    lines = mvnx_text().split("\n")
    before, position, after = lines[8].partition("<position>")
    lines[8] = before + position + "wide " + after.split(" ", 1)[1]
    trial.write_text("\n".join(lines))
    with pytest.raises(DatasetError, match=r"line 9: position is 'wide', expected a number"):
        mvnx.load(trial)


def csv_text(segments: list[str], positions: np.ndarray) -> str:
    names = [f"position_{segment}_{axis}" for segment in segments for axis in "xyz"]
    lines = [",".join(["orientation_Pelvis_w", *names, "comment"])]
    lines += [",".join(["1.0", *map(repr, frame.ravel().tolist()), "fine"]) for frame in positions]
    return "\n".join(lines) + "\n"


def test_csv_twin(tmp_path: Path, motion: Callable[..., np.ndarray]) -> None:
    segments = [name.replace("ForeArm", "Forearm") for name in XSENS_23.aliases]
    path = tmp_path / "Trial_2.xsens.csv"
    positions = motion(XSENS_23.joints, 8)
    path.write_text(csv_text(segments, positions))
    assert mvnx.matches(path)
    (recording,) = mvnx.load(path)
    assert (recording.name, recording.rate) == ("Trial_2", 240.0)
    assert recording.joints == XSENS_23.joints
    assert recording.notes == ("rate not stated by the format; 240 Hz assumed",)
    np.testing.assert_array_equal(recording.positions, positions)


def test_csv_twin_that_lacks_an_axis_is_refused(tmp_path: Path, motion: Callable[..., np.ndarray]) -> None:
    path = tmp_path / "a.csv"
    path.write_text(
        csv_text(["LeftHand", "RightHand"], motion(["left_wrist", "right_wrist"], 4)).replace("RightHand_z", "z")
    )
    with pytest.raises(DatasetError, match=r"line 1: segment RightHand has columns for x, y, expected x, y, z"):
        mvnx.load(path)
