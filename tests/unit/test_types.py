"""What a prediction says of tubes and obstacles, from samples whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import OptionError
from kinecast.geometry.shapes import Capsule, HalfSpace, Sphere
from kinecast.types import LIMBS, Density, Obstacle, Prediction, SkeletonFrame, Status

S, T = 400, 3


def predicted(samples: np.ndarray, density: Density | None = None) -> Prediction:
    mean = samples.mean(axis=0)
    steps = samples.shape[1]
    covariance = np.zeros((steps, 6, 3, 3))
    return Prediction(0.0, 0.1 * np.arange(1, steps + 1), samples, mean, covariance, ARM_JOINTS, density=density)


@pytest.fixture
def prediction() -> Prediction:
    rng = np.random.default_rng(0)
    centre = rng.standard_normal((T, 6, 3))
    return predicted(centre + 0.05 * rng.standard_normal((S, T, 6, 3)) * np.arange(1, T + 1)[:, None, None])


@pytest.mark.parametrize("level", [0.5, 0.9, 0.95, 1.0])
def test_tubes_hold_at_least_their_share_of_every_limb(prediction: Prediction, level: float) -> None:
    tubes = prediction.tubes(level)
    assert tubes.level == level
    np.testing.assert_array_equal(tubes.times, prediction.times)
    assert tubes.radius.shape == (T, len(LIMBS))
    for t in range(T):
        for limb, (a, b) in enumerate(LIMBS):
            capsule = Capsule(tubes.start[t, limb], tubes.end[t, limb], tubes.radius[t, limb] + 1e-12)
            # A limb lies inside where all of its points do; its ends and middle stand for them.
            points = [prediction.samples[:, t, a] * (1 - u) + prediction.samples[:, t, b] * u for u in (0.0, 0.5, 1.0)]
            inside = np.all([capsule.signed_distance(p) <= 0 for p in points], axis=0)
            assert inside.mean() >= level - 1e-12


def test_tubes_are_no_wider_than_they_must_be(prediction: Prediction) -> None:
    # Two ends of three Gaussian coordinates each: the larger of two independent chi(3) radii.
    radius = np.linspace(0, 5, 2001)
    chi = np.array([math.erf(r / math.sqrt(2)) - math.sqrt(2 / math.pi) * r * math.exp(-r * r / 2) for r in radius])
    expected = 0.05 * np.arange(1, T + 1) * radius[np.searchsorted(chi**2, 0.9)]
    found = prediction.tubes(0.9).radius
    np.testing.assert_allclose(found, np.repeat(expected[:, None], 4, axis=1), rtol=0.12)
    assert (np.diff([prediction.tubes(level).radius for level in (0.5, 0.8, 0.99)], axis=0) > 0).all()


def test_rare_distances_are_told_from_few_samples() -> None:
    rng = np.random.default_rng(2)

    def drawn(samples: int) -> Prediction:
        wide = rng.choice([0.3, 1.0, 2.0], (samples, 1, 1, 1), p=[0.4, 0.4, 0.2])
        return predicted(0.05 * wide * rng.standard_normal((samples, T, 6, 3)))

    away = np.linalg.norm(drawn(100_000).samples[:, 0, :2], axis=-1).max(axis=-1)
    few = [drawn(300) for _ in range(40)]
    for level in (0.99, 0.999):
        radii = np.array([each.tubes(level).radius for each in few])
        assert np.exp(np.log(radii).mean()) == pytest.approx(np.quantile(away, level), rel=0.06)


@pytest.mark.parametrize("level", [0.0, -0.1, 1.01, math.nan])
def test_levels_out_of_range(prediction: Prediction, level: float) -> None:
    with pytest.raises(OptionError, match="level"):
        prediction.tubes(level)


def test_one_sample_is_its_own_tube() -> None:
    alone = predicted(np.random.default_rng(1).standard_normal((1, T, 6, 3)))
    np.testing.assert_array_equal(alone.tubes().radius, 0.0)


def test_the_probability_of_hitting_is_the_share_of_samples_that_do() -> None:
    samples = np.zeros((10, 2, 6, 3))
    samples[..., 0] = np.arange(6) * 0.3
    samples[:3, 0, 2, 2] = 1.0  # the left wrist, three times, at the first step
    samples[2:4, 1, 5, 2] = 1.0  # the right one, twice, at the second
    above = HalfSpace(np.array([0.0, 0.0, 0.9]), np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(predicted(samples).probability_of_hitting(above), [0.3, 0.2])
    np.testing.assert_allclose(predicted(samples).probability_of_hitting(above, radius=1.0), 1.0)


def test_limbs_hit_with_their_middles_too() -> None:
    samples = np.zeros((1, 1, 6, 3))
    samples[0, 0, :, 0] = [0.0, 1.0, 2.0, 10.0, 11.0, 12.0]
    prediction = predicted(samples)
    ball = Sphere(np.array([1.5, 0.2, 0.0]), 0.1)
    assert prediction.probability_of_hitting(ball)[0] == 0.0
    assert prediction.probability_of_hitting(ball, radius=0.1 + 1e-9)[0] == 1.0
    # The two arms are not one limb: nothing lies between the left wrist and the right shoulder.
    assert prediction.probability_of_hitting(Sphere(np.array([6.0, 0.0, 0.0]), 1.0))[0] == 0.0


def test_a_limb_that_may_be_anywhere_may_be_there() -> None:
    samples = np.zeros((4, 1, 6, 3))
    samples[0, 0, 2] = np.nan
    far: Obstacle = Sphere(np.array([9.0, 9.0, 9.0]), 0.1)
    assert predicted(samples).probability_of_hitting(far)[0] == 0.25


def test_without_a_density_nothing_is_probable(prediction: Prediction) -> None:
    np.testing.assert_array_equal(prediction.log_prob(prediction.mean), -np.inf)


def test_a_frame_knows_which_joints_it_shows() -> None:
    positions = np.zeros((3, 3))
    positions[1, 2], positions[2, 0] = np.nan, np.inf
    frame = SkeletonFrame(0.0, ("a", "b", "c"), positions)
    np.testing.assert_array_equal(frame.valid, [True, False, False])


def test_every_status_advises() -> None:
    assert len({status.advice for status in Status}) == len(Status)
    assert all(status.advice.endswith(".") for status in Status)
