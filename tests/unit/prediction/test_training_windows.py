"""Windows to train on: how noisy they are, how they are weighted, and that folds keep recordings whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Sphere
from kinecast.prediction.observation import Observation
from kinecast.prediction.training_windows import TrainingWindows


def windows_of(tracks: np.ndarray) -> TrainingWindows:
    """Windows from (W, K, 6, 3) positions, all but the last three frames observed."""
    count = len(tracks)
    own = np.zeros(count, dtype=int)
    return TrainingWindows(
        tracks[:, :-3], tracks[:, -3:], np.zeros((count, 3)), own, 1 / 30, np.arange(count), *(own,) * 3
    )


@pytest.mark.parametrize("spread", [0.001, 0.004])
def test_noise_put_in_is_found_again(spread: float) -> None:
    rng = np.random.default_rng(0)
    time = np.arange(10) / 30.0
    motion = 0.3 * np.sin(2.0 * time)[None, :, None, None] + rng.standard_normal((300, 1, 6, 3))
    noisy = motion + spread * rng.standard_normal(motion.shape)
    # A median of medians over 7 × 18 correlated differences, three hundred times: a few per cent.
    assert windows_of(noisy).noise == pytest.approx(spread, rel=0.06)


def test_a_few_tracker_jumps_change_the_noise_little(windows: TrainingWindows) -> None:
    jumping = windows.observed.copy()
    jumping[::10, 3] += 0.5
    assert replace(windows, observed=jumping).noise == pytest.approx(windows.noise, rel=0.1)


def test_noise_is_never_zero() -> None:
    assert windows_of(np.zeros((5, 8, 6, 3))).noise == 1e-4


def test_training_windows_are_seen_as_observations_are(windows: TrainingWindows, observation: Observation) -> None:
    np.testing.assert_allclose(windows.points[60], observation.points, atol=1e-6)  # single precision
    np.testing.assert_allclose(windows.future_points[60], observation.to_torso(windows.future[60]), atol=1e-6)


def owned(group: list[int], collection: list[int] | None = None, subject: list[int] | None = None) -> TrainingWindows:
    """Windows that only know what they belong to."""
    count = len(group)
    return TrainingWindows(
        observed=np.zeros((count, 2, 6, 3)),
        future=np.zeros((count, 1, 6, 3)),
        up=np.zeros((count, 3)),
        recording=np.array(group),
        dt=0.1,
        frame=np.arange(count),
        group=np.array(group),
        collection=np.array(collection or group),
        subject=np.array(subject or group),
    )


@pytest.mark.parametrize(("groups", "count"), [(7, 2), (7, 3), (7, 4), (3, 4), (2, 4)])
def test_folds_never_split_a_recording_or_task(groups: int, count: int) -> None:
    group = np.repeat(np.arange(groups), np.random.default_rng(count).integers(1, 40, groups))
    folds = owned(group.tolist()).folds(count)
    assert set(folds) == set(range(min(count, groups)))
    for owner in range(groups):
        assert len(set(folds[group == owner])) == 1


def test_folds_are_of_like_size() -> None:
    folds = owned([0] * 60 + [1] * 30 + [2] * 30 + [3] * 20 + [4] * 20 + [5] * 20).folds(3)
    assert np.ptp(np.bincount(folds)) <= 20  # the least group


def test_a_single_group_is_cut_into_blocks_of_time() -> None:
    np.testing.assert_array_equal(owned([5] * 10).folds(4), [0, 0, 0, 1, 1, 2, 2, 2, 3, 3])


def test_no_collection_and_no_person_drowns_the_others() -> None:
    collection, subject = [0] * 100 + [1] * 16, [0] * 64 + [1] * 36 + [2] * 16
    windows = owned([0] * 116, collection, subject)
    shares = windows.shares(np.arange(116))
    assert shares.sum() == pytest.approx(1.0)
    assert shares[:100].sum() / shares[100:].sum() == pytest.approx(10 / 4)
    assert shares[:64].sum() / shares[64:100].sum() == pytest.approx(8 / 6)
    np.testing.assert_allclose(windows.shares(np.arange(100, 116)), 1 / 16)


def test_windows_that_end_in_an_obstacle_are_left_out(windows: TrainingWindows) -> None:
    wrist = windows.observed[10, -1, 2]
    outside = windows.outside(Scene((Sphere(wrist, 0.02),)))
    assert 0 < len(outside) < len(windows)
    distances = np.linalg.norm(outside.observed[:, -1, 2] - wrist, axis=-1)
    assert distances.min() > 0.02
    assert len(windows.outside(Scene())) == len(windows)
