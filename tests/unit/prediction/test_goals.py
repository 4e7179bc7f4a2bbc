"""Goals: who is believed to head where, and a mixture that is one law in samples and density."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast import Predictor, PredictorOptions, Scene
from kinecast.body.limits import violations
from kinecast.body.posture import postures_from_points
from kinecast.datasets.reaching import Fetch, fetching
from kinecast.errors import DatasetError, OptionError
from kinecast.geometry.regions import Regions
from kinecast.geometry.shapes import Box, HalfSpace, Sphere
from kinecast.geometry.transforms import rotation_z
from kinecast.pipeline import frames
from kinecast.prediction import density as density_module
from kinecast.prediction.density import JOINT_ORDER, GaussianMixture, PoseDensity
from kinecast.prediction.goals import HANDS, goal_probabilities
from kinecast.prediction.kinecast.model import Kinecast, MixtureBlocks
from kinecast.prediction.method import Forecast, forecast_in_scene, shortened
from kinecast.prediction.methods import shipped_methods
from kinecast.prediction.observation import Observation
from kinecast.types import Prediction

RIGHT = np.array([0.45, -0.2, 1.0])
LEFT = np.array([0.45, 0.25, 1.0])
GOALS = {"part": Sphere(RIGHT, 0.05), "tray": Box(LEFT, np.array([0.1, 0.2, 0.04]), rotation_z(0.3))}
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def method() -> Kinecast:
    shipped = shipped_methods()[1]["kinecast"]
    assert isinstance(shipped, Kinecast)
    return shortened(shipped, 0.5)


@pytest.fixture(scope="module")
def seen() -> Observation:
    """A third of the way through a reach of the right hand."""
    person = fetching([Fetch(1.0, RIGHT)], 3.0, seed=2, rate=30.0)
    arms = np.stack(
        [person.joint(f"{side}_{joint}") for side in HANDS for joint in ("shoulder", "elbow", "wrist")], axis=1
    )
    way = np.linalg.norm(arms[:, 5] - RIGHT, axis=1)
    middle = int(np.argmax(way < 0.7 * way[30]))
    return Observation(arms[middle - 5 : middle + 1], UP, 1.0 / 30.0, middle / 30.0)


def forecast(method: Kinecast, seen: Observation, scene: Scene | None, samples: int = 400, seed: int = 0) -> Forecast:
    return forecast_in_scene(method, method.init_state(), seen, np.random.default_rng(seed), samples, scene)


def watched(fetches: list[Fetch], scene: Scene, duration: float) -> list[Prediction]:
    """What the online predictor says of somebody who reaches for places, frame by frame."""
    predictor = Predictor.shipped(scene, PredictorOptions(samples=40))
    return [predictor.observe(frame) for frame in frames(fetching(fetches, duration, seed=2, rate=30.0))]


def test_regions_measure_and_point_as_their_shapes_do() -> None:
    points = np.random.default_rng(0).normal([0.45, 0.0, 1.0], 0.3, (200, 3))
    regions = Regions.of(GOALS)
    expected = np.stack([np.maximum(shape.signed_distance(points), 0.0) for shape in GOALS.values()], axis=1)
    np.testing.assert_allclose(regions.distance(points), expected, atol=1e-12)
    inside = regions.within(points, 0.5)
    for g, shape in enumerate(GOALS.values()):
        assert (shape.signed_distance(inside[:, g]) < 0).all()
    # All of a region is within reach of its whole size: the nearest point is as far as the distance says.
    whole = np.linalg.norm(regions.within(points, 1.0) - points[:, None], axis=-1)
    np.testing.assert_allclose(whole, expected, atol=1e-12)


def test_probabilities_follow_a_hand_and_a_change_of_mind() -> None:
    place = {"a": Sphere(np.array([0.5, 0.0, 1.0]), 0.05), "b": Sphere(np.array([0.0, 0.5, 1.0]), 0.05)}
    regions, start, dt = Regions.of(place), np.array([0.0, 0.0, 1.0]), 1.0 / 30.0

    def after(path: np.ndarray) -> np.ndarray:
        end = path[-1] + 5 * (path[-1] - path[-2])
        both = np.stack([path, np.tile(start, (len(path), 1))], axis=1)
        return goal_probabilities(regions, both, np.stack([end, start]), dt)

    steps = np.arange(12)[:, None] * 0.025
    towards_a = start + steps * [1.0, 0.0, 0.0]
    turned = np.concatenate([towards_a, towards_a[-1] + (steps[1:] * [-0.7, 0.7, 0.0])])
    found = np.array([after(towards_a[:k])[0] for k in range(2, 13)])
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    assert (np.diff(found[:, 0]) > -1e-9).all()
    assert found[-1, 0] > 0.9
    assert after(turned)[0].argmax() == 1
    assert after(towards_a)[1].argmax() == 2  # the other hand rests


def test_online_each_hand_has_its_own_goal_and_the_right_one_wins() -> None:
    predictions = watched([Fetch(1.0, RIGHT, hold=0.5)], Scene((), GOALS), 2.5)
    named = [prediction.goals for prediction in predictions if prediction.goals]
    assert {tuple(hand) for goals in named for hand in goals.values()} == {("part", "tray", "none")}
    assert all(abs(sum(hand.values()) - 1) < 1e-9 for goals in named for hand in goals.values())
    early, late = named[10], max(named, key=lambda goals: goals["right"]["part"])
    assert early["right"]["none"] > 0.5
    assert late["right"]["part"] > 0.9
    assert all(goals["left"]["none"] > 0.5 for goals in named)


def test_without_goals_every_bit_is_as_before(method: Kinecast, seen: Observation) -> None:
    plain, empty = forecast(method, seen, None), forecast(method, seen, Scene())
    assert plain.goals == empty.goals == {}
    for one, other in ((plain.samples, empty.samples), (plain.mean, empty.mean)):
        assert np.array_equal(one, other)
    assert np.array_equal(plain.density.log_prob(plain.mean), empty.density.log_prob(plain.mean))


def test_a_goal_draws_mean_and_samples_to_it(method: Kinecast, seen: Observation) -> None:
    without, found = forecast(method, seen, Scene()), forecast(method, seen, Scene((), GOALS))
    assert found.goals["right"]["part"] > 0.5
    away = [np.linalg.norm(each.mean[-1, 5] - RIGHT) for each in (without, found)]
    assert away[1] < 0.70 * away[0]
    near = [(np.linalg.norm(each.samples[:, -1, 5] - RIGHT, axis=1) < 0.08).mean() for each in (without, found)]
    assert near[1] > 2 * near[0]
    # The left hand is not touched by the right one's goal.
    np.testing.assert_allclose(found.mean[:, 2], without.mean[:, 2], atol=0.02)


def mixture(found: Forecast) -> GaussianMixture:
    assert isinstance(found.density, PoseDensity)
    assert isinstance(found.density.blocks, MixtureBlocks)
    return found.density.blocks.mixture


def test_density_integrates_to_one(method: Kinecast, seen: Observation, monkeypatch: pytest.MonkeyPatch) -> None:
    """Importance sampling from the same places, all as likely, with 1.3 times the spread: no weight can run away."""
    monkeypatch.setattr(density_module, "FAULT_PROBABILITY", 1e-300)
    found = forecast(replace(method, limits=None), seen, Scene((), GOALS))
    law = mixture(found)
    rng, count, (places, steps, _) = np.random.default_rng(0), 250, law.mean.shape
    assert places > 3
    covariance = law.factor @ law.factor.swapaxes(2, 3)
    assert law.floor is not None
    covariance = covariance + law.floor[..., None] ** 2 * np.eye(18)
    lower = 1.3 * np.linalg.cholesky(covariance)[law.kind]
    inverse = np.linalg.inv(lower)
    volume = np.log(np.diagonal(lower, axis1=2, axis2=3)).sum(axis=-1) + 9 * np.log(2 * np.pi)
    ratio = np.empty((count, steps))
    for each in ratio:
        which, scale = rng.integers(places), law.scales[rng.integers(len(law.scales))]
        x = law.mean[which] + scale * np.einsum("tij,tj->ti", lower[which], rng.standard_normal((steps, 18)))
        square = (np.einsum("ctij,ctj->cti", inverse, x - law.mean) ** 2).sum(axis=-1)
        parts = [-0.5 * square / s**2 - 18 * np.log(s) - volume - np.log(places * len(law.scales)) for s in law.scales]
        pose = np.empty((steps, 6, 3))
        pose[:, JOINT_ORDER] = x.reshape(steps, 6, 3)
        each[:] = np.exp(found.density.log_prob(seen.to_world(pose)) - np.logaddexp.reduce(np.concatenate(parts)))
    error = ratio.mean(axis=1).std() / np.sqrt(count)
    assert error < 0.1
    assert ratio.mean() == pytest.approx(1.0, abs=4 * error)


def test_samples_and_density_are_one_law(method: Kinecast, seen: Observation) -> None:
    """Mean and spread of free samples are those of the mixture that the density states."""
    found = forecast(replace(method, limits=None), seen, Scene((), GOALS), samples=8000)
    law = mixture(found)
    own = seen.to_torso(found.samples)[:, -1, JOINT_ORDER].reshape(-1, 18)
    variance, centers = float(law.scale_weights @ law.scales**2), law.mean[:, -1]
    mean = law.weights @ centers
    covariance = np.einsum("c,ci,cj->ij", law.weights, centers - mean, centers - mean)
    for weight, kind in zip(law.weights, law.kind, strict=True):
        rows = law.factor[kind, -1]
        covariance += weight * variance * rows @ rows.T
    spread = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(own.mean(axis=0), mean, atol=6 * spread.max() / np.sqrt(len(own)))
    np.testing.assert_allclose(seen.to_torso(found.mean)[-1, JOINT_ORDER].ravel(), mean, atol=1e-9)
    np.testing.assert_allclose(own.std(axis=0), spread, rtol=0.12)


def test_goals_inside_obstacles_bring_no_sample_in(method: Kinecast, seen: Observation) -> None:
    table = HalfSpace(np.array([0.0, 0.0, 0.97]), UP)
    below = {"buried": Sphere(np.array([0.45, -0.2, 0.8]), 0.05)}
    found = forecast(method, seen, Scene((table,), below))
    assert found.effective_sample_size > 0
    assert Scene((table,)).free(found.samples, seen.times(15)).all()
    initial = postures_from_points(seen.points, continuous=True)[-1]
    postures = postures_from_points(seen.to_torso(found.samples), initial, continuous=True, usual=False)
    assert method.limits is not None
    assert not np.any(violations(postures, initial, seen.dt, method.limits))


def test_many_goals_and_forecasts_of_one_step(method: Kinecast, seen: Observation) -> None:
    rng = np.random.default_rng(0)
    many = {f"goal {k}": Sphere(rng.normal([0.4, 0.0, 1.0], 0.2), 0.03) for k in range(40)}
    found = forecast(method, seen, Scene((), many), samples=1)
    assert np.isfinite(found.samples).all()
    assert np.isfinite(found.density.log_prob(found.mean)).all()
    assert sum(found.goals["left"].values()) == pytest.approx(1.0)


def test_a_goal_named_none_is_refused_with_its_place() -> None:
    with pytest.raises(DatasetError, match=r"scene, goals\.none: a goal cannot be named 'none'"):
        Scene.from_yaml("goals: {none: {center: [0, 0, 1], radius: 0.1}}")
    with pytest.raises(DatasetError, match=r"scene, goals\.cup: sphere radius -0.1 m must be above 0"):
        Scene.from_yaml("goals: {cup: {center: [0, 0, 1], radius: -0.1}}")
    with pytest.raises(OptionError, match="cannot be named 'none'"):
        Scene((), {"none": Sphere(RIGHT, 0.05)})
