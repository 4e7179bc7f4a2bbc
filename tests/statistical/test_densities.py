"""Exact densities against what a large sample shows, within its standard error.

Series are independent, so the density of a pose is the product of the densities of its numbers over the Jacobian's
determinant. Each factor is estimated by counting: the share of 60,000 motions that fall into a small cell around the
pose. Nothing of the density's own code is used, and no kernel smooths anything.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from kinecast.body.limits import AngleLimit, JointLimits
from kinecast.body.posture import block_log_det, points_from_postures, postures_from_points
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Sphere
from kinecast.prediction import density as density_module
from kinecast.prediction.method import forecast_in_scene
from kinecast.prediction.methods import shipped_methods
from kinecast.prediction.observation import Observation
from kinecast.prediction.paper import PostureSeries

STEPS = 3
COUNT = 60_000
CELL = 0.12
"""Half width of a cell, in standard deviations: a normal's mean over it is 0.2 % off its middle."""
PAIRS = ((8, 9), (14, 15))
SCALARS = tuple(d for d in range(18) if d not in {8, 9, 14, 15})


@pytest.fixture(scope="module")
def method() -> PostureSeries:
    """The shipped model of the paper's method over a few steps, free."""
    shipped = shipped_methods()[1]["gp_constrained"]
    assert isinstance(shipped, PostureSeries)
    return replace(shipped, steps=STEPS, length_spread=shipped.length_spread[:STEPS], limits=None)


@pytest.fixture(scope="module")
def seen() -> Observation:
    """Both arms at work, bending."""
    start = np.array([0, 0, 0, 0, 0, 0.36, 0.4, 0.3, -0.5, 1.2, 0.30, 0.26, 0.5, 0.2, -0.4, 1.4, 0.28, 0.24])
    postures = np.repeat(start[None], 6, axis=0)
    postures[:, [6, 9, 12, 15]] += np.linspace(-0.1, 0.0, 6)[:, None]
    return Observation(points_from_postures(postures), np.array([0.0, 0.0, 1.0]), 1.0 / 30.0)


@pytest.fixture
def faultless(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sample has no tracker's faults."""
    monkeypatch.setattr(density_module, "FAULT_PROBABILITY", 1e-300)


def binding(seen: Observation) -> JointLimits:
    """Limits that cut a part off most angles' laws, at the first step and later."""
    last = postures_from_points(seen.points, continuous=True)[-1]
    arms = np.stack([last[6:10], last[12:16]])
    flexion, abduction, rotation, elbow = (
        AngleLimit(float(low), float(high), 1.2)
        for low, high in zip(arms.min(axis=0) - 0.5, arms.max(axis=0) + 0.01, strict=True)
    )
    return JointLimits(flexion, abduction, rotation, elbow)


def counted(postures: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T,) log density of a pose (T, 18) by counting (S, T, 18) postures around it, and its standard error."""
    half = CELL * postures.std(axis=0)
    near = np.abs(postures - pose) < half
    log_density, variance = np.zeros(len(pose)), np.zeros(len(pose))
    for group in (*((d,) for d in SCALARS), *PAIRS):
        inside = near[:, :, list(group)].all(axis=2).sum(axis=0)
        assert (inside > 100).all()
        volume = np.prod(2 * half[:, list(group)], axis=1)
        log_density += np.log(inside / len(postures) / volume)
        variance += 1.0 / inside
    return log_density - block_log_det(pose).sum(axis=-1), np.sqrt(variance)


@pytest.mark.usefixtures("faultless")
@pytest.mark.parametrize("constrained", [False, True])
def test_the_exact_density_is_that_of_the_samples(method: PostureSeries, seen: Observation, constrained: bool) -> None:
    limits = binding(seen) if constrained else None
    # All but no sensor noise: the law of the samples themselves.
    method = replace(method, limits=limits, noise=1e-7)
    samples = forecast_in_scene(method, None, seen, np.random.default_rng(0), COUNT, None).samples
    last = postures_from_points(seen.points, continuous=True)[-1]
    start = np.broadcast_to(last, (COUNT, 18))
    postures = postures_from_points(seen.to_torso(samples), start, continuous=True)
    density = forecast_in_scene(method, None, seen, np.random.default_rng(1), 2000, None).density
    for quantile in (0.4, 0.6):
        pose = np.quantile(postures, quantile, axis=0)
        expected, error = counted(postures, pose)
        assert (error < 0.2).all()
        found = density.log_prob(seen.to_world(points_from_postures(pose)))
        assert (np.abs(found - expected) < 4 * error).all(), (found - expected, error)


@pytest.mark.parametrize("constrained", [False, True])
def test_nll_of_few_draws_agrees_with_that_of_many(method: PostureSeries, seen: Observation, constrained: bool) -> None:
    method = replace(method, limits=binding(seen) if constrained else None)
    truth = forecast_in_scene(method, None, seen, np.random.default_rng(2), 1, None).samples[0]
    many = forecast_in_scene(method, None, seen, np.random.default_rng(3), 20_000, None).density.log_prob(truth)
    few = np.array(
        [
            forecast_in_scene(method, None, seen, np.random.default_rng(10 + k), 500, None).density.log_prob(truth)
            for k in range(30)
        ]
    )
    error = few.std(axis=0, ddof=1) / math.sqrt(len(few))
    # The first step's law has no draws in it; its difference is round-off.
    assert (np.abs(few.mean(axis=0) - many) < 4 * error + 1e-6).all()
    assert (few.std(axis=0) < 0.5).all()


@pytest.mark.usefixtures("faultless")
def test_with_a_scene_the_density_is_that_of_what_is_free_at_each_step(
    method: PostureSeries, seen: Observation
) -> None:
    everything = AngleLimit(-2 * math.pi, 2 * math.pi, math.inf)
    loose = JointLimits(everything, everything, everything, everything)
    ball = Scene((Sphere(seen.positions[-1, 2] + np.array([0.05, 0.0, 0.03]), 0.05),))
    method = replace(method, limits=loose, noise=0.0)
    free = forecast_in_scene(replace(method, limits=None), None, seen, np.random.default_rng(4), COUNT, None).samples
    allowed = ball.free(free, seen.times(STEPS))
    held = forecast_in_scene(method, None, seen, np.random.default_rng(5), 4000, ball)
    unheld = forecast_in_scene(replace(method, limits=None), None, seen, np.random.default_rng(5), 4000, None)
    pose = free[np.flatnonzero(allowed.all(axis=1))[0]]
    ratio = held.density.log_prob(pose) - unheld.density.log_prob(pose)
    share = allowed.mean(axis=0)
    assert 0.2 < share[-1] < 0.95
    error = np.sqrt((1 - share) / share * (1 / COUNT + 1 / 4000))
    assert (np.abs(ratio + np.log(share)) < 4 * error + 1e-4).all()
