"""KTH handover folders."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import KTH_13
from kinecast.datasets import kth_handover
from kinecast.errors import DatasetError


@pytest.fixture
def handover(tmp_path: Path, motion: Callable[..., np.ndarray]) -> Path:
    folder = tmp_path / "handover_7"
    folder.mkdir()
    positions = motion(KTH_13.joints, 8)
    for person in ("giver", "taker"):
        for segment, points in zip(KTH_13.aliases, positions.transpose(1, 0, 2), strict=True):
            table = np.column_stack([points + (person == "taker"), np.ones(8), np.zeros((8, 3))])
            file = folder / f"{person}_{segment}_pose_saved.csv"
            np.savetxt(file, table, delimiter=",", header="x,y,z,q0,q1,q2,q3", comments="", fmt="%.6f")
    (folder / "baton_pose_saved.csv").write_text("x,y,z,q0,q1,q2,q3\n")
    return folder


def test_giver_and_taker(handover: Path, motion: Callable[..., np.ndarray]) -> None:
    assert kth_handover.matches(handover)
    giver, taker = kth_handover.load(handover)
    assert (giver.name, taker.name) == ("handover_7/giver", "handover_7/taker")
    assert (giver.person, taker.person) == ("giver", "taker")
    assert giver.rate == 120.0
    expected = motion(KTH_13.joints, 8)
    for place, joint in enumerate(KTH_13.joints):
        np.testing.assert_allclose(giver.joint(joint), expected[:, place], atol=1e-9)
        np.testing.assert_allclose(taker.joint(joint), expected[:, place] + 1, atol=1e-9)


def test_lengths_must_agree(handover: Path) -> None:
    file = handover / "taker_RHand_pose_saved.csv"
    file.write_text("\n".join(file.read_text().splitlines()[:-2]))
    with pytest.raises(DatasetError, match=r"taker_RHand_pose_saved\.csv: 6 rows, but .* has 8"):
        kth_handover.load(handover)


def test_header_and_segments_are_checked(handover: Path) -> None:
    file = handover / "giver_LHand_pose_saved.csv"
    good = file.read_text()
    file.write_text(good.replace("q0", "qw"))
    with pytest.raises(DatasetError, match=r"giver_LHand_pose_saved\.csv, line 1: header is 'x,y,z,qw"):
        kth_handover.load(handover)
    file.write_text(good)
    (handover / "giver_Tail_pose_saved.csv").write_text(good)
    with pytest.raises(DatasetError, match="joint 'Tail' is unknown"):
        kth_handover.load(handover)


def test_another_folder_is_refused(tmp_path: Path) -> None:
    assert not kth_handover.matches(tmp_path)
    with pytest.raises(DatasetError, match="expected a folder of giver_"):
        kth_handover.load(tmp_path)


def test_real_handover(data_root: Path) -> None:
    giver, taker = kth_handover.load(data_root / "kth_handover_sample" / "handover_sample")
    for recording in (giver, taker):
        assert recording.positions.shape == (801, 13, 3)
        assert np.isfinite(recording.positions).all()
    np.testing.assert_allclose(
        giver.joint("left_wrist")[0], [-0.515718281269, 0.0943142548203, 0.857032001019], atol=1e-12
    )
    # They hand over a baton: the nearest wrists come close to one another.
    apart = [
        np.linalg.norm(giver.joint(f"{a}_wrist") - taker.joint(f"{b}_wrist"), axis=-1).min()
        for a in ("left", "right")
        for b in ("left", "right")
    ]
    assert min(apart) < 0.5
