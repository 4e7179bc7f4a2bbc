"""Flaws: repeats, gaps and jumps are found, and a person's motion is not."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.body.tracking import Flaw, find_flaws


def reach(frames: int, rate: float, amplitude: float = 0.3, frequency: float = 1.0) -> np.ndarray:
    """(N, 2, 3) two joints swinging, peak speed 2π·frequency·amplitude, never twice the same."""
    t = np.arange(frames) / rate
    swing = amplitude * np.sin(2 * np.pi * frequency * t)
    drift = 0.01 * t
    first = np.stack([swing, 0.4 + drift, 1.0 + 0.5 * swing], axis=1)
    return np.stack([first, first + np.array([0.0, 0.3, -0.1])], axis=1)


@pytest.mark.parametrize("rate", [30.0, 60.0, 100.0, 240.0])
@pytest.mark.parametrize("frequency", [0.5, 1.0, 2.0, 3.0])
def test_fast_motion_has_no_flaw(rate: float, frequency: float) -> None:
    # 3 Hz at 0.3 m is 5.7 m/s and 107 m/s^2, as sharp as any stroke.
    positions = reach(200, rate, 0.3, frequency)
    assert not find_flaws(positions, np.arange(200) / rate).any()


@pytest.mark.parametrize("rate", [30.0, 100.0])
@pytest.mark.parametrize("length", [1, 2, 5, 10])
@pytest.mark.parametrize("size", [0.25, 0.5, 3.0])
def test_a_jump_away_and_back_is_found_in_its_own_joint_and_frames(rate: float, length: int, size: float) -> None:
    positions = reach(100, rate)
    positions[40 : 40 + length, 1] += [0.0, size, 0.0]
    expected = np.zeros((100, 2), dtype=int)
    expected[40 : 40 + length, 1] = Flaw.JUMP
    np.testing.assert_array_equal(find_flaws(positions, np.arange(100) / rate), expected)


def test_a_jump_of_a_hand_that_moves_on_is_found() -> None:
    positions = reach(100, 30.0, 0.3, 1.0)
    positions[20:26, 0] += [0.0, 0.6, 0.0]  # 0.2 s, in which the hand moves by up to 0.35 m
    found = np.flatnonzero(find_flaws(positions, np.arange(100) / 30.0)[:, 0])
    np.testing.assert_array_equal(found, np.arange(20, 26))


def test_a_joint_that_does_not_return_has_moved() -> None:
    positions = reach(100, 30.0)
    positions[50:, 0] += [0.5, 0.0, 0.0]
    assert not find_flaws(positions, np.arange(100) / 30.0).any()


def test_a_return_after_longest_jump_is_no_jump() -> None:
    positions, stamps = reach(100, 30.0), np.arange(100) / 30.0
    positions[40:60, 0] += [0.0, 0.5, 0.0]
    assert not find_flaws(positions, stamps).any()
    positions[51:60, 0] -= [0.0, 0.5, 0.0]
    np.testing.assert_array_equal(np.flatnonzero(find_flaws(positions, stamps)[:, 0] == Flaw.JUMP), np.arange(40, 51))


def test_noise_below_the_least_jump_has_no_flaw() -> None:
    rng = np.random.default_rng(1)
    positions = reach(2000, 100.0, 0.1, 0.3) + rng.normal(0.0, 0.003, (2000, 2, 3))
    assert not find_flaws(positions, np.arange(2000) / 100.0).any()


def test_repeats_and_gaps_are_found_and_a_repeat_in_a_jump_belongs_to_it() -> None:
    positions, stamps = reach(60, 30.0), np.arange(60) / 30.0
    positions[10] = positions[9]
    positions[20, 0] = np.nan
    positions[21, 1, 2] = np.nan
    positions[30:33, 0] += [0.0, 0.5, 0.0]
    positions[31] = positions[30]
    expected = np.zeros((60, 2), dtype=int)
    expected[10] = Flaw.REPEATED
    expected[20, 0] = expected[21, 1] = Flaw.MISSING
    expected[31, 1] = Flaw.REPEATED
    expected[30:33, 0] = Flaw.JUMP
    np.testing.assert_array_equal(find_flaws(positions, stamps), expected)


def test_a_frame_repeats_only_if_every_joint_does() -> None:
    positions = reach(6, 30.0)
    positions[2] = positions[1]
    positions[4, 0] = positions[3, 0]
    positions[5] = np.nan
    stamps = np.arange(6) / 30.0
    repeated = np.argwhere(find_flaws(positions, stamps) == Flaw.REPEATED)
    np.testing.assert_array_equal(repeated, [[2, 0], [2, 1]])
    positions[1:3, 0] = np.nan
    assert find_flaws(positions, stamps)[2].tolist() == [Flaw.MISSING, Flaw.REPEATED], "missing in both, same otherwise"
    assert (find_flaws(np.full((4, 2, 3), np.nan), stamps[:4]) == Flaw.MISSING).all()


def test_uneven_stamps_are_taken_as_they_are() -> None:
    rng = np.random.default_rng(2)
    stamps = np.cumsum(rng.uniform(0.02, 0.1, 80))
    positions = np.stack([np.sin(stamps), stamps * 0.01, np.cos(stamps)], axis=1)[:, None]
    assert not find_flaws(positions, stamps).any()
    positions[40] += [0.0, 1.5, 0.0]
    np.testing.assert_array_equal(np.flatnonzero(find_flaws(positions, stamps)), [40])


def test_windows_are_searched_each_on_its_own() -> None:
    positions = reach(60, 30.0)
    positions[30, 0] += 0.5
    windows = np.stack([positions[0:20], positions[20:40], positions[40:60]])
    stamps = np.tile(np.arange(20) / 30.0, (3, 1))
    flaws = find_flaws(windows, stamps)
    assert flaws.shape == (3, 20, 2)
    for window, times, found in zip(windows, stamps, flaws, strict=True):
        np.testing.assert_array_equal(find_flaws(window, times), found)
    assert np.flatnonzero(flaws).size == 1


@pytest.mark.parametrize("frames", [0, 1, 2, 3])
def test_series_too_short_for_a_jump_have_none(frames: int) -> None:
    positions = np.arange(frames)[:, None, None] * np.full((1, 2, 3), 5.0)
    assert not find_flaws(positions, np.arange(frames) / 30.0).any()
