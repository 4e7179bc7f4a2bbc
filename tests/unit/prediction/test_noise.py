"""Noise: found in a recording as it was put in, and carried to angles as a simulation carries it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.body.posture import coordinates_from_postures, points_from_postures, postures_from_points
from kinecast.prediction.noise import angle_noise, coordinate_noise, sensor_noise
from kinecast.prediction.observation import TrainingWindows

NOISE = np.array([0.002, 0.003, 0.004, 0.001, 0.002, 0.003])
POSTURES = {
    "at work": [0, 0, 0, 0, 0, 0.36, 0.4, 0.3, -0.5, 1.2, 0.30, 0.26, 0.5, 0.2, -0.4, 1.4, 0.28, 0.24],
    "raised": [0, 0, 0, 0, 0, 0.40, 1.4, 1.0, 0.2, 0.8, 0.33, 0.27, 1.2, -0.5, 0.5, 2.0, 0.33, 0.27],
}


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
    assert sensor_noise(windows_of(noisy)) == pytest.approx(spread, rel=0.06)


def test_a_few_tracker_jumps_change_the_noise_little(windows: TrainingWindows) -> None:
    jumping = windows.observed.copy()
    jumping[::10, 3] += 0.5
    assert sensor_noise(replace(windows, observed=jumping)) == pytest.approx(sensor_noise(windows), rel=0.1)


def test_noise_is_never_zero() -> None:
    assert sensor_noise(windows_of(np.zeros((5, 8, 6, 3)))) == 1e-4


def simulated(posture: list[float]) -> np.ndarray:
    """(K, 18) postures measured with NOISE."""
    points = points_from_postures(np.array(posture))
    rng = np.random.default_rng(1)
    noisy = points + NOISE[:, None] * rng.standard_normal((4000, 6, 3))
    near = np.broadcast_to(np.array(posture), (4000, 18))
    return postures_from_points(noisy[:, None], near, continuous=False)[:, 0]


@pytest.mark.parametrize("name", POSTURES)
def test_noise_of_angles_is_what_a_simulation_shows(name: str) -> None:
    postures = simulated(POSTURES[name])
    for first, at in ((0, 6), (3, 12)):
        claimed = angle_noise(np.array(POSTURES[name][at : at + 6]), NOISE[first : first + 3])
        found = postures[:, at : at + 4].std(axis=0)
        # To first order, joint by joint as if independent, the torso's own turning left out: within a factor of 2.
        assert (claimed / found > 0.5).all()
        assert (claimed / found < 2.0).all()


@pytest.mark.parametrize("name", POSTURES)
def test_noise_of_coordinates_is_what_a_simulation_shows(name: str) -> None:
    found = coordinates_from_postures(simulated(POSTURES[name])).std(axis=0)
    claimed = coordinate_noise(np.array(POSTURES[name]), NOISE)
    assert (claimed / found > 0.4).all(), claimed / found
    assert (claimed / found < 2.5).all(), claimed / found


def test_noise_of_angles_stays_finite_in_degenerate_poses() -> None:
    arm = np.array([0.0, np.pi / 2, 0.0, 0.0, 0.3, 0.25])
    assert np.isfinite(angle_noise(arm, np.full(3, 0.003))).all()


def test_noise_grows_in_proportion() -> None:
    posture = np.array(POSTURES["at work"])
    np.testing.assert_allclose(coordinate_noise(posture, 3 * NOISE), 3 * coordinate_noise(posture, NOISE))
    np.testing.assert_array_equal(coordinate_noise(posture, np.zeros(6)), 0.0)
