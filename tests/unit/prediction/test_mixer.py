"""The neural forecaster learns what a straight line is, is the same from its file, and takes the constraint stage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.errors import ModelError
from kinecast.prediction.gaussian import PositionGaussian
from kinecast.prediction.linear import mean_from_arrays
from kinecast.prediction.method import forecast_in_scene
from kinecast.prediction.mixer import Mixer, fit_mixer
from kinecast.prediction.observation import Observation

FRAMES, STEPS = 6, 3


def lines(seed: int, count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Six points that go straight on, each at its own speed."""
    rng = np.random.default_rng(seed)
    start, velocity = rng.normal(0, 0.3, (count, 1, 18)), rng.normal(0, 0.03, (count, 1, 18))
    track = start + velocity * np.arange(FRAMES + STEPS)[:, None]
    return track[:, :FRAMES], track[:, FRAMES:]


@pytest.fixture(scope="module")
def mixer() -> Mixer:
    windows, futures = lines(0)
    return fit_mixer(windows, futures, steps=250, seed=0)


def test_it_learns_that_straight_motion_goes_on(mixer: Mixer) -> None:
    windows, futures = lines(1)
    error = np.abs(mixer.mean(windows) - futures).mean()
    assert error < 0.5 * np.abs(windows[:, -1:] - futures).mean()


def test_it_moves_with_whoever_stands_elsewhere_only_through_its_inputs(mixer: Mixer) -> None:
    windows, _ = lines(2, 1)
    assert mixer.mean(windows).shape == (1, STEPS, 18)
    assert np.isfinite(mixer.mean(windows + 100.0)).all()


def test_it_comes_back_from_its_arrays(mixer: Mixer) -> None:
    windows, _ = lines(3, 5)
    again = mean_from_arrays(mixer.to_arrays(), FRAMES, STEPS, 18)
    np.testing.assert_array_equal(again.mean(windows), mixer.mean(windows))
    with pytest.raises(ModelError, match="W"):
        mean_from_arrays({**mixer.to_arrays(), "W": np.zeros((2, 2))}, FRAMES, STEPS, 18)


def test_its_gaussian_is_held_inside_limits_and_the_mean_is_not_moved(mixer: Mixer, posed: Observation) -> None:
    free = PositionGaussian(FRAMES, STEPS, posed.dt, mixer, 0.05 * np.eye(18 * STEPS), 0.002)
    limits = JointLimits()
    held = replace(free, limits=limits)
    forecast = forecast_in_scene(held, None, posed, np.random.default_rng(0), 200, None)
    initial = postures_from_points(posed.points, continuous=True)[-1]
    postures = postures_from_points(posed.to_torso(forecast.samples), initial, continuous=True, usual=False)
    assert not np.logical_or(*violations(postures, initial, posed.dt, limits)).any()
    np.testing.assert_array_equal(
        forecast.mean, forecast_in_scene(free, None, posed, np.random.default_rng(0), 200, None).mean
    )
    assert np.isfinite(forecast.density.log_prob(forecast.mean)).all()
