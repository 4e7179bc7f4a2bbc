"""HA4M: raw clips, one text file a frame, and arrays of features."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import AZURE_KINECT_32, HA4M_ARMS_14, HA4M_UPPER_23, Skeleton
from kinecast.datasets import ha4m
from kinecast.errors import DatasetError

FRAMES = (10, 11, 12, 15, 16)


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    return tmp_path / "IDU007V002"


def frame_file(clip: Path, frame: int) -> Path:
    (file,) = clip.glob(f"Skeletons/*/FrameID{frame}_*.txt")
    return file


def test_positions_stamps_and_names(clip: Path, write_ha4m: Callable[..., np.ndarray]) -> None:
    positions = write_ha4m(clip, FRAMES)
    assert ha4m.matches(clip)
    assert not ha4m.matches(clip / "Skeletons")
    (recording,) = ha4m.load(clip)
    assert (recording.name, recording.subject, recording.rate) == ("IDU007V002", "007", 30.0)
    assert recording.joints == AZURE_KINECT_32.joints
    assert recording.labels is None
    np.testing.assert_allclose(recording.positions, positions, atol=1e-7)
    # Frames 13 and 14 are missing: time goes on, nothing is put in.
    np.testing.assert_allclose(recording.stamps, np.array([0, 1, 2, 5, 6]) / 30.0)


def test_frames_are_ordered_by_number_not_by_spelling(clip: Path, write_ha4m: Callable[..., np.ndarray]) -> None:
    positions = write_ha4m(clip, (8, 9, 10, 100))
    (recording,) = ha4m.load(clip)
    np.testing.assert_allclose(recording.positions, positions, atol=1e-7)
    np.testing.assert_allclose(recording.stamps, np.array([0, 1, 2, 92]) / 30.0)


def test_joints_go_by_their_id_not_their_row(clip: Path, write_ha4m: Callable[..., np.ndarray]) -> None:
    positions = write_ha4m(clip, FRAMES)
    file = frame_file(clip, 11)
    header, *lines = file.read_text().splitlines()
    file.write_text("\n".join([header, *reversed(lines)]) + "\n")
    np.testing.assert_allclose(ha4m.load(clip)[0].positions, positions, atol=1e-7)


def test_labels_join_on_the_frame_id(clip: Path, write_ha4m: Callable[..., np.ndarray]) -> None:
    write_ha4m(clip, FRAMES)
    (clip / "Labels.txt").write_text("9 0 0\n10 1 1\n11 1 1\n13 5 5\n15 12 12\n16 3 4\n")
    (recording,) = ha4m.load(clip)
    assert recording.labels == ("carrier", "carrier", "", "finish", "planet gears")


def test_every_body_is_a_recording_the_longest_first(clip: Path, write_ha4m: Callable[..., np.ndarray]) -> None:
    positions = write_ha4m(clip, FRAMES, bodies=(4, 6))
    file = frame_file(clip, 12)
    file.write_text("\n".join(line for line in file.read_text().splitlines() if not line.startswith("4\t")))
    first, second = ha4m.load(clip)
    assert (first.name, first.person) == ("IDU007V002", "6")
    assert (second.name, second.person) == ("IDU007V002/body4", "4")
    assert len(first.stamps) == 5
    np.testing.assert_allclose(second.positions, positions[[0, 1, 3, 4]], atol=1e-7)
    np.testing.assert_allclose(second.stamps, np.array([0, 1, 5, 6]) / 30.0)


def test_a_body_of_one_frame_is_noted(clip: Path, write_ha4m: Callable[..., np.ndarray]) -> None:
    write_ha4m(clip, FRAMES)
    file = frame_file(clip, 12)
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines + ["9" + line[1:] for line in lines[1:]]))
    (recording,) = ha4m.load(clip)
    assert recording.notes == ("bodies seen in one frame only, left out: 9",)


def test_a_frame_without_bodies_is_a_gap(clip: Path, write_ha4m: Callable[..., np.ndarray]) -> None:
    write_ha4m(clip, FRAMES)
    file = frame_file(clip, 12)
    file.write_text(file.read_text().splitlines()[0] + "\n")
    np.testing.assert_allclose(ha4m.load(clip)[0].stamps, np.array([0, 1, 5, 6]) / 30.0)


def test_cameras_are_told_apart_by_name(clip: Path, write_ha4m: Callable[..., np.ndarray]) -> None:
    write_ha4m(clip, FRAMES, camera="CameraA")
    write_ha4m(clip, FRAMES, camera="CameraB")
    assert [recording.name for recording in ha4m.load(clip)] == ["IDU007V002/CameraA", "IDU007V002/CameraB"]


def replaced(clip: Path, old: str, new: str) -> None:
    file = frame_file(clip, 11)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda clip: replaced(clip, "1\t0\t2\t", "1\t0\t"), r"FrameID11_\d+\.txt, line 2: 13 columns"),
        (lambda clip: replaced(clip, "1\t5\t2\t", "1\t5\thigh\t"), r"line 7: column 3 is 'high'"),
        (lambda clip: replaced(clip, "1\t5\t2\t", "1\t6\t2\t"), r"FrameID11_.*: body 1 has 32 rows"),
        (lambda clip: (clip / "Labels.txt").write_text("10 1\n"), r"Labels\.txt, line 1: 2 columns, expected 3"),
        (lambda clip: (clip / "Labels.txt").write_text("10 1 1\n11 13 1\n"), r"line 2: label is 13, expected 0 to 12"),
        (lambda clip: (clip / "Skeletons/Camera0/FrameID11_x.txt").touch(), r"frame 11 is also in FrameID11"),
    ],
)  # fmt: skip
def test_a_spoilt_clip_is_refused_with_file_and_line(
    clip: Path, write_ha4m: Callable[..., np.ndarray], spoil: Callable[[Path], object], message: str
) -> None:
    write_ha4m(clip, FRAMES)
    spoil(clip)
    with pytest.raises(DatasetError, match=message):
        ha4m.load(clip)


def test_a_folder_without_frames_is_refused(clip: Path) -> None:
    (clip / "Skeletons").mkdir(parents=True)
    with pytest.raises(DatasetError, match="expected a clip's folder"):
        ha4m.load(clip)
    (clip / "Skeletons" / "Camera0").mkdir()
    with pytest.raises(DatasetError, match="no files named FrameID"):
        ha4m.load(clip)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "UpSkel" / "IDU003V004.npy"
    path.parent.mkdir()
    return path


def features(positions: np.ndarray) -> np.ndarray:
    """(3·J, T) as HA4M stores them: mm, camera axes, all x, then all y, then all z."""
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.concatenate([x.T, -z.T, y.T]) * 1000.0


@pytest.mark.parametrize("skeleton", [HA4M_UPPER_23, HA4M_ARMS_14], ids=lambda skeleton: skeleton.name)
@pytest.mark.parametrize("order", ["C", "F"])
def test_features(file: Path, motion: Callable[..., np.ndarray], skeleton: Skeleton, order: str) -> None:
    positions = motion(skeleton.joints, 8)
    np.save(file, np.asarray(features(positions), order=order))
    assert ha4m.matches_features(file)
    (recording,) = ha4m.load_features(file)
    assert (recording.name, recording.subject, recording.rate) == ("IDU003V004", "003", 30.0)
    assert recording.joints == skeleton.joints
    assert recording.labels is None
    np.testing.assert_allclose(recording.positions, positions, atol=1e-12)


def test_feature_labels_lie_beside(file: Path, motion: Callable[..., np.ndarray]) -> None:
    np.save(file, features(motion(HA4M_UPPER_23.joints, 3)))
    labels = file.parent.parent / "GroundTruth" / "IDU003V004.txt"
    labels.parent.mkdir()
    labels.write_text("0\n11\n12\n\n")
    assert ha4m.load_features(file)[0].labels == ("none", "screws", "finish")
    labels.write_text("0\n11\n")
    with pytest.raises(DatasetError, match=r"IDU003V004\.txt: 2 labels for the 3 frames of IDU003V004\.npy"):
        ha4m.load_features(file)
    labels.write_text("0\n11\nscrew\n")
    with pytest.raises(DatasetError, match=r"IDU003V004\.txt, line 3: column 1 is 'screw', expected a number"):
        ha4m.load_features(file)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((68, 5)), r"array of float64 \(68, 5\), expected float64 \(69, T\) or \(42, T\)"),
        (np.zeros((69, 5), dtype=np.float32), r"array of float32 \(69, 5\), expected float64"),
        (np.zeros(69), r"array of float64 \(69,\), expected"),
    ],
)
def test_other_arrays_are_refused(file: Path, array: np.ndarray, message: str) -> None:
    np.save(file, array)
    with pytest.raises(DatasetError, match=message):
        ha4m.load_features(file)


def test_pickles_are_never_loaded(file: Path) -> None:
    np.save(file, np.empty((69, 2), dtype=object), allow_pickle=True)
    with pytest.raises(DatasetError, match="array of object"):
        ha4m.load_features(file)


def test_truncated_arrays_are_refused(file: Path) -> None:
    np.save(file, np.zeros((69, 5)))
    whole = file.read_bytes()
    file.write_bytes(whole[:-100])
    with pytest.raises(DatasetError, match=r"2788 bytes, but an array \(69, 5\) takes 2888"):
        ha4m.load_features(file)
    file.write_bytes(whole[:20])
    with pytest.raises(DatasetError, match="not a NumPy array"):
        ha4m.load_features(file)


def test_a_header_that_promises_too_much_is_refused_unread(file: Path) -> None:
    with file.open("wb") as stream:
        header = {"descr": "<f8", "fortran_order": False, "shape": (69, 1 << 40)}
        np.lib.format.write_array_header_1_0(stream, header)
    with pytest.raises(DatasetError, match="bytes, but an array"):
        ha4m.load_features(file)


def test_real_clip(data_root: Path) -> None:
    path = data_root / "ha4m_features_demo" / "UpSkel" / "IDU001V001.npy"
    (recording,) = ha4m.load_features(path)
    assert recording.positions.shape == (2427, 23, 3)
    assert recording.labels is not None
    assert recording.labels.count("gear bearings") == 281
    raw = np.load(path, allow_pickle=False)
    # Row 13 + 23 is y of the right wrist, down.
    np.testing.assert_array_equal(recording.joint("right_wrist")[:, 2], -raw[13 + 23] / 1000.0)
    upright = np.median(recording.positions, axis=0)
    height = dict(zip(recording.joints, upright[:, 2], strict=True))
    assert height["head"] > height["neck"] > height["chest"] > height["spine"]
