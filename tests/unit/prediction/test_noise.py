"""Noise of the joints is carried to angles as a simulation carries it."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.body.posture import coordinates_from_postures, points_from_postures, postures_from_points
from kinecast.prediction.noise import angle_noise, coordinate_noise

NOISE = np.array([0.002, 0.003, 0.004, 0.001, 0.002, 0.003])
POSTURES = {
    "at work": [0, 0, 0, 0, 0, 0.36, 0.4, 0.3, -0.5, 1.2, 0.30, 0.26, 0.5, 0.2, -0.4, 1.4, 0.28, 0.24],
    "raised": [0, 0, 0, 0, 0, 0.40, 1.4, 1.0, 0.2, 0.8, 0.33, 0.27, 1.2, -0.5, 0.5, 2.0, 0.33, 0.27],
}


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
