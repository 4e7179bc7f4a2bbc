"""Resampling: rates, gaps, uneven stamps and labels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.datasets import resampling
from kinecast.datasets.recording import Recording
from kinecast.datasets.resampling import measured_rate, resample
from kinecast.errors import DatasetError, OptionError

JOINTS = ("left_wrist", "right_wrist")


def recording(stamps: np.ndarray, path: np.ndarray, rate: float) -> Recording:
    """Two joints on the same path, the second a metre away."""
    return Recording("made", JOINTS, stamps, np.stack([path, path + 1.0], axis=1), rate)


def wave(frequency: float, rate: float, seconds: float = 4.0) -> Recording:
    t = np.arange(round(seconds * rate)) / rate
    path = np.stack([np.sin(2 * np.pi * frequency * t), 0 * t, np.cos(2 * np.pi * frequency * t)], axis=1)
    return recording(t, path, rate)


def test_the_same_rate_gives_the_same_bits() -> None:
    source = wave(1.0, 30.0)
    source.positions[3, 0] = np.nan
    same = resample(source, 30.0)
    np.testing.assert_array_equal(same.positions, source.positions)
    np.testing.assert_array_equal(same.stamps, source.stamps)


@pytest.mark.parametrize("rate", [30.0, 50.0, 12.5])
def test_resampling_again_changes_nothing(rate: float) -> None:
    source = wave(1.0, 100.0)
    source.positions[40:60, 1] = np.nan
    once = resample(source, rate)
    twice = resample(once, rate)
    np.testing.assert_array_equal(once.positions, twice.positions)
    assert once.notes == twice.notes


def test_stamps_are_uniform_from_the_first_frame_to_the_last() -> None:
    resampled = resample(replace(wave(1.0, 100.0), stamps=5.0 + np.arange(400) / 100.0), 30.0)
    np.testing.assert_allclose(resampled.stamps, 5.0 + np.arange(120) / 30.0, rtol=0, atol=1e-12)
    assert resampled.rate == 30.0
    assert "resampled from 100 to 30 Hz" in resampled.notes


@pytest.mark.parametrize(("frequency", "loss"), [(1.0, 0.001), (3.0, 0.003), (6.0, 0.04)])
def test_motion_passes(frequency: float, loss: float) -> None:
    resampled = resample(wave(frequency, 100.0), 30.0)
    inner = slice(5, -5)
    t = resampled.stamps[inner]
    np.testing.assert_allclose(resampled.positions[inner, 0, 0], np.sin(2 * np.pi * frequency * t), atol=loss + 1e-3)


def test_gaps_stay_gaps_and_do_not_spread() -> None:
    source = wave(1.0, 100.0)
    source.positions[100:120, 0] = np.nan  # 1.00 to 1.19 s
    resampled = resample(source, 30.0)
    missing = np.isnan(resampled.positions).any(axis=2)
    np.testing.assert_array_equal(np.flatnonzero(missing[:, 0]), np.arange(30, 36))  # 1.000 to 1.167 s
    assert not missing[:, 1].any()
    seen = ~missing[:, 0]
    t = resampled.stamps[seen]
    np.testing.assert_allclose(resampled.positions[seen, 0, 0], np.sin(2 * np.pi * t), atol=2e-3)


def test_a_single_lost_frame_is_not_bridged_upwards() -> None:
    source = wave(0.5, 30.0)
    source.positions[30, 0] = np.nan
    resampled = resample(source, 120.0)
    missing = np.isnan(resampled.positions[:, 0, 0])
    np.testing.assert_array_equal(np.flatnonzero(missing), np.arange(117, 124))


def test_a_hole_in_the_stamps_is_not_bridged() -> None:
    source = wave(0.5, 30.0)
    keep = np.r_[0:30, 36 : len(source.stamps)]
    holed = replace(source, stamps=source.stamps[keep], positions=source.positions[keep])
    resampled = resample(holed, 30.0)
    assert len(resampled.stamps) == len(source.stamps)
    missing = np.isnan(resampled.positions[:, 0, 0])
    np.testing.assert_array_equal(np.flatnonzero(missing), np.arange(30, 36))


def test_uneven_stamps_are_believed() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(300) / 100.0 + rng.uniform(-0.002, 0.002, 300)
    path = np.stack([np.sin(2 * t), np.cos(2 * t), t], axis=1)
    for rate in (30.0, 100.0):
        resampled = resample(recording(t, path, 100.0), rate)
        s = resampled.stamps
        np.testing.assert_allclose(
            resampled.positions[:, 0], np.stack([np.sin(2 * s), np.cos(2 * s), s], axis=1), atol=3e-4
        )


def test_downwards_lies_on_the_chords_and_looks_no_further_than_the_next_frame() -> None:
    source = wave(2.0, 100.0)
    resampled = resample(source, 30.0)
    before = np.floor(resampled.stamps * 100.0 + 1e-6).astype(int)
    share = (resampled.stamps * 100.0 - before)[:, None, None]
    after = np.minimum(before + 1, len(source.stamps) - 1)
    chords = (1 - share) * source.positions[before] + share * source.positions[after]
    np.testing.assert_allclose(resampled.positions, chords, atol=1e-12)


def test_upwards_lies_on_the_chords() -> None:
    source = wave(1.0, 30.0)
    resampled = resample(source, 60.0)
    np.testing.assert_array_equal(resampled.positions[::2], source.positions)
    middle = 0.5 * (source.positions[1:] + source.positions[:-1])
    np.testing.assert_allclose(resampled.positions[1::2], middle, atol=1e-12)


def test_labels_are_the_nearest_frames() -> None:
    source = replace(wave(1.0, 100.0, 0.5), labels=tuple("a" * 22 + "b" * 28))
    resampled = resample(source, 30.0)
    assert resampled.labels is not None
    boundary = 0.215
    assert resampled.labels == tuple("a" if t < boundary else "b" for t in resampled.stamps)


@pytest.mark.parametrize("rate", [0.0, -30.0, 0.5, 1001.0, 1e9, np.nan, np.inf])
def test_an_absurd_rate_is_refused(rate: float) -> None:
    with pytest.raises(OptionError, match="1 to 1000 Hz"):
        resample(wave(1.0, 30.0), rate)


def test_fewer_than_two_frames_are_refused() -> None:
    with pytest.raises(DatasetError, match="at least 2"):
        resample(wave(1.0, 30.0).select(slice(0, 1)), 30.0)


def test_a_duration_that_would_fill_the_memory_is_refused() -> None:
    milliseconds = replace(wave(1.0, 30.0), stamps=np.arange(120) * 1e6, rate=1.0)
    with pytest.raises(DatasetError, match=str(resampling.MOST_FRAMES)):
        resample(milliseconds, 30.0)


def test_measured_rate_is_that_of_the_stamps() -> None:
    assert measured_rate(np.array([0.0, 0.1, 0.2, 5.0])) == pytest.approx(10.0)
    assert np.isnan(measured_rate(np.zeros(1)))
