"""HA4M's skeleton features."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import HA4M_ARMS_14, HA4M_UPPER_23, Skeleton
from kinecast.datasets import ha4m_features
from kinecast.errors import DatasetError


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
def test_positions(file: Path, motion: Callable[..., np.ndarray], skeleton: Skeleton, order: str) -> None:
    positions = motion(skeleton.joints, 8)
    np.save(file, np.asarray(features(positions), order=order))
    assert ha4m_features.matches(file)
    (recording,) = ha4m_features.load(file)
    assert (recording.name, recording.subject, recording.rate) == ("IDU003V004", "003", 30.0)
    assert recording.joints == skeleton.joints
    assert recording.labels is None
    np.testing.assert_allclose(recording.positions, positions, atol=1e-12)


def test_labels_lie_beside(file: Path, motion: Callable[..., np.ndarray]) -> None:
    np.save(file, features(motion(HA4M_UPPER_23.joints, 3)))
    labels = file.parent.parent / "GroundTruth" / "IDU003V004.txt"
    labels.parent.mkdir()
    labels.write_text("0\n11\n12\n\n")
    assert ha4m_features.load(file)[0].labels == ("none", "screws", "finish")
    labels.write_text("0\n11\n")
    with pytest.raises(DatasetError, match=r"IDU003V004\.txt: 2 labels for the 3 frames of IDU003V004\.npy"):
        ha4m_features.load(file)
    labels.write_text("0\n11\nscrew\n")
    with pytest.raises(DatasetError, match=r"IDU003V004\.txt, line 3: label is 'screw', expected 0 to 12"):
        ha4m_features.load(file)


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
        ha4m_features.load(file)


def test_pickles_are_never_loaded(file: Path) -> None:
    np.save(file, np.empty((69, 2), dtype=object), allow_pickle=True)
    with pytest.raises(DatasetError, match="array of object"):
        ha4m_features.load(file)


def test_truncated_arrays_are_refused(file: Path) -> None:
    np.save(file, np.zeros((69, 5)))
    whole = file.read_bytes()
    file.write_bytes(whole[:-100])
    with pytest.raises(DatasetError, match=r"2788 bytes, but an array \(69, 5\) takes 2888"):
        ha4m_features.load(file)
    file.write_bytes(whole[:20])
    with pytest.raises(DatasetError, match="not a NumPy array"):
        ha4m_features.load(file)


def test_a_header_that_promises_too_much_is_refused_unread(file: Path) -> None:
    with file.open("wb") as stream:
        header = {"descr": "<f8", "fortran_order": False, "shape": (69, 1 << 40)}
        np.lib.format.write_array_header_1_0(stream, header)
    with pytest.raises(DatasetError, match="larger than the limit"):
        ha4m_features.load(file)


def test_real_clip(data_root: Path) -> None:
    path = data_root / "ha4m_features_demo" / "UpSkel" / "IDU001V001.npy"
    (recording,) = ha4m_features.load(path)
    assert recording.positions.shape == (2427, 23, 3)
    assert recording.labels is not None
    assert recording.labels.count("gear bearings") == 281
    raw = np.load(path, allow_pickle=False)
    # Row 13 + 23 is y of the right wrist, down.
    np.testing.assert_array_equal(recording.joint("right_wrist")[:, 2], -raw[13 + 23] / 1000.0)
    upright = np.median(recording.positions, axis=0)
    height = dict(zip(recording.joints, upright[:, 2], strict=True))
    assert height["head"] > height["neck"] > height["chest"] > height["spine"]
