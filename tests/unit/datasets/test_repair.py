"""Repair of whole recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.body.tracking import Flaw, find_flaws
from kinecast.datasets.loading import load
from kinecast.datasets.recording import Recording
from kinecast.datasets.repair import repair

JOINTS = ("left_wrist", "right_wrist")


def waving(frames: int = 90, rate: float = 30.0) -> Recording:
    """Two hands waving slowly, no frame like another."""
    t = np.arange(frames) / rate
    left = np.stack([0.2 * np.sin(2 * t), 0.1 * t, 1.0 + 0.1 * np.cos(2 * t)], axis=1)
    return Recording("waving", JOINTS, t, np.stack([left, left + 0.4], axis=1), rate, labels=("wave",) * frames)


def broken() -> Recording:
    """Waving with one of each: a repeat, a short gap, a long gap, a short jump, a long jump."""
    recording = waving()
    p = recording.positions
    p[5] = p[4]
    p[10:12, 0] = np.nan
    p[20:35, 1] = np.nan
    p[40:42, 0] += [0.0, 0.0, 0.6]
    p[50:60, 1] += [0.0, 0.8, 0.0]
    return recording


def test_a_sound_recording_is_unchanged() -> None:
    recording = waving()
    repaired = repair(recording)
    np.testing.assert_array_equal(repaired.positions, recording.positions)
    assert repaired.labels == recording.labels


def test_short_flaws_are_interpolated_long_ones_removed() -> None:
    recording, truth = broken(), waving().positions
    before = recording.positions.copy()
    repaired = repair(recording)
    np.testing.assert_array_equal(recording.positions, before)
    touched = np.zeros((90, 2), dtype=bool)
    for frames, joint in (([5], 0), ([5], 1), ([10, 11], 0), ([40, 41], 0)):
        np.testing.assert_allclose(repaired.positions[frames, joint], truth[frames, joint], atol=1e-3)
        touched[frames, joint] = True
    assert np.isnan(repaired.positions[20:35, 1]).all()
    assert np.isnan(repaired.positions[50:60, 1]).all()
    touched[50:60, 1] = touched[20:35, 1] = True
    np.testing.assert_array_equal(repaired.positions[~touched], before[~touched])
    np.testing.assert_array_equal(repair(repaired).positions, repaired.positions)


def test_all_missing_and_a_single_frame_are_accepted() -> None:
    empty = Recording("empty", JOINTS, np.arange(9) / 30.0, np.full((9, 2, 3), np.nan), 30.0)
    assert np.isnan(repair(empty).positions).all()
    np.testing.assert_array_equal(repair(waving(1)).positions, waving(1).positions)


def test_injected_jumps_are_found_in_clean_real_motion(data_root: Path) -> None:
    (clean,) = load(data_root / "human_assembly_data" / "Task3" / "Human1" / "trial2.txt.gz")
    assert not (find_flaws(clean.positions, clean.stamps) == Flaw.JUMP).any()
    rng = np.random.default_rng(5)
    column = clean.joints.index("right_wrist")
    truth = clean.positions[:, column].copy()
    starts = np.arange(20, len(truth) - 20, 25) + rng.integers(0, 10)
    for start in starts:
        way = rng.normal(size=3)
        size = 0.35 * way / np.linalg.norm(way)
        clean.positions[start : start + rng.integers(1, 4), column] += size
    moved = (clean.positions[:, column] != truth).any(axis=1)
    repaired = repair(clean)
    found = find_flaws(clean.positions, clean.stamps)[:, column] == Flaw.JUMP
    # Measured: 100 % found, nothing else marked.
    assert found[moved].mean() > 0.97
    assert found[~moved].mean() < 0.002
    error = np.linalg.norm(repaired.positions[:, column] - truth, axis=1)[moved & found]
    assert np.median(error) < 0.02


@pytest.mark.parametrize(
    ("clip", "repeated", "jumps"), [("IDU001V001", 68, (1025, 1063, 1136)), ("IDU001V002", 62, (1727,))]
)
def test_the_known_slips_of_a_real_camera_are_found(
    data_root: Path, clip: str, repeated: int, jumps: tuple[int, ...]
) -> None:
    (recording,) = load(data_root / "ha4m_features_demo" / "UpSkel" / f"{clip}.npy")
    flaws = find_flaws(recording.positions, recording.stamps)
    assert (flaws == Flaw.REPEATED).any(axis=1).sum() == repeated  # 2.8 and 2.3 %
    arms = [recording.joints.index(joint) for joint in ARM_JOINTS]
    assert (flaws[np.ix_(jumps, arms)] == Flaw.JUMP).all(), "the whole body is thrown aside at once"
    same = repair(recording).positions == recording.positions
    assert same.all(axis=2).mean() > 0.95
