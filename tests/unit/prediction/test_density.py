"""Densities over the pose of both arms integrate to one, scene and limits included, and say what their parts say.

The integrals are over 18 dimensions, by importance sampling: poses drawn from a Gaussian in posture coordinates, or
from another density already known to be one, weighted by density over proposal. The proposal reaches positions through
kinecast.body.posture, whose Jacobian is tested there by finite differences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from kinecast.body.limits import AngleLimit, JointLimits
from kinecast.body.posture import (
    block_log_det,
    coordinates_from_postures,
    points_from_postures,
    postures_from_coordinates,
    postures_from_points,
)
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Sphere
from kinecast.prediction import density as density_module
from kinecast.prediction.density import (
    BLOCKS,
    FAULT_PROBABILITY,
    FAULT_SPREAD,
    JOINT_ORDER,
    ConstraintFactor,
    GaussianMixture,
    PoseDensity,
    log_fault,
    with_faults,
)
from kinecast.prediction.method import Forecast, Method, forecast_in_scene
from kinecast.prediction.observation import Observation
from kinecast.types import Density

POSES = 400


@pytest.fixture
def faultless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the faultless part f of the density: what it integrates to is what matters, the mixture is algebra."""
    monkeypatch.setattr(density_module, "FAULT_PROBABILITY", 1e-300)


@dataclass(frozen=True)
class Proposal:
    """Poses (P, T, 6, 3) in the world and the log density (P, T) they were drawn from."""

    poses: np.ndarray
    log_density: np.ndarray


WIDER = (0.92, 1.05), (0.08, 1.8)
"""Weights and spreads of each whitened number of a proposal: law by law, its tails outlast those of a mixture."""


def around(forecast: Forecast, observation: Observation, angles: bool) -> Proposal:
    """What was fitted to the samples at each step, in positions or in posture coordinates, made wider."""
    if angles:
        points = observation.to_torso(forecast.samples)
        start = np.broadcast_to(postures_from_points(observation.points, continuous=True)[-1], (len(points), 18))
        coordinates = coordinates_from_postures(postures_from_points(points, start, continuous=True))
    else:
        coordinates = forecast.samples.reshape(*forecast.samples.shape[:2], 18)
    mean = coordinates.mean(axis=0)
    error = coordinates - mean
    factor = np.linalg.cholesky(np.einsum("sti,stj->tij", error, error) / len(error))
    rng = np.random.default_rng(100)
    (_, narrow), (share, wide) = WIDER
    white = rng.standard_normal((POSES, *mean.shape))
    white *= np.where(rng.random(white.shape) < share, wide, narrow)
    drawn = mean + np.einsum("tij,ptj->pti", factor, white)
    parts = [math.log(weight) + norm.logpdf(white, scale=spread) for weight, spread in WIDER]
    log_density = np.logaddexp(*parts).sum(axis=-1) - np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=-1)
    if not angles:
        return Proposal(drawn.reshape(POSES, -1, 6, 3), log_density)
    postures = postures_from_coordinates(drawn)
    # Coordinates to angles: θ4 an arm; angles to points: the Jacobian.
    log_density += np.log(postures[..., 9]) + np.log(postures[..., 15]) - block_log_det(postures).sum(axis=-1)
    return Proposal(observation.to_world(points_from_postures(postures)), log_density)


def assert_integrates_to_one(density: Density, proposal: Proposal, accuracy: float) -> None:
    """E_q[f / q] = 1 at every step, within four standard errors, which are small enough to mean something."""
    weights = np.exp(np.array([density.log_prob(pose) for pose in proposal.poses]) - proposal.log_density)
    error = weights.std(axis=0) / math.sqrt(len(weights))
    assert (error < accuracy).all(), error
    assert (np.abs(weights.mean(axis=0) - 1) < 4 * error).all(), (weights.mean(axis=0), error)


def obstacles(observation: Observation) -> Scene:
    """A ball beside the left wrist and a slab under the right one."""
    left, right = observation.positions[-1, [2, 5]]
    return Scene(
        (
            Sphere(left + np.array([0.05, 0.0, 0.02]), 0.05),
            Box(right - np.array([0.0, 0.0, 0.12]), np.array([0.5, 0.5, 0.2])),
        )
    )


def narrow(observation: Observation, slack: float) -> JointLimits:
    """Limits that end a little beyond where both arms are."""
    arms = postures_from_points(observation.points, continuous=True)[-1, 6:].reshape(2, 6)[:, :4]
    ranges = zip(arms.min(axis=0) - 0.6, arms.max(axis=0) + slack, strict=True)
    flexion, abduction, rotation, elbow = (AngleLimit(low, high, 4.0) for low, high in ranges)
    return JointLimits(flexion, abduction, rotation, AngleLimit(0.0, elbow.upper, 4.0))


@pytest.mark.usefixtures("faultless")
@pytest.mark.parametrize(
    ("name", "angles"), [("kalman", False), ("ridge_angles", True), ("gp_xyz", False), ("gp_angles", True)]
)
def test_free_densities_integrate_to_one(
    trained: dict[str, Method[Any]], posed: Observation, name: str, angles: bool
) -> None:
    method = trained[name]
    proposal = around(forecast_in_scene(method, None, posed, np.random.default_rng(0), 4000, None), posed, angles)
    density = forecast_in_scene(method, None, posed, np.random.default_rng(1), 200, None).density
    assert_integrates_to_one(density, proposal, 0.08)


@pytest.mark.usefixtures("faultless")
@pytest.mark.parametrize(
    ("name", "with_scene", "noise"), [("kalman", False, 0.003), ("kalman", True, 0.0), ("ridge", True, 0.003)]
)
def test_constrained_gaussian_densities_integrate_to_one(
    trained: dict[str, Method[Any]], posed: Observation, name: str, with_scene: bool, noise: float
) -> None:
    free = trained[f"{name}_angles"]
    held = replace(trained[f"{name}_constrained"], limits=narrow(posed, 0.1), noise=noise)
    drawn = forecast_in_scene(free, None, posed, np.random.default_rng(2), 300, None)
    proposal = Proposal(drawn.samples, np.array([drawn.density.log_prob(pose) for pose in drawn.samples]))
    scene = obstacles(posed) if with_scene else None
    density = forecast_in_scene(held, None, posed, np.random.default_rng(3), 4000, scene).density
    allowed = np.exp(density.constraint.log_total)
    assert (allowed < 0.8).all()
    # The share of 4,000 draws that is allowed is itself an estimate; its error adds to that of the integral.
    assert_integrates_to_one(density, proposal, 0.25)


@pytest.mark.usefixtures("faultless")
@pytest.mark.parametrize("noise", [1e-4, 0.002])
def test_constrained_series_integrate_to_one(trained: dict[str, Method[Any]], posed: Observation, noise: float) -> None:
    method = replace(trained["gp_constrained"], limits=narrow(posed, 0.1), noise=noise)
    proposal = around(forecast_in_scene(method, None, posed, np.random.default_rng(4), 4000, None), posed, True)
    density = forecast_in_scene(method, None, posed, np.random.default_rng(5), 120, None).density
    assert_integrates_to_one(density, proposal, 0.12)


@pytest.mark.usefixtures("faultless")
def test_series_within_a_scene_integrate_to_one(trained: dict[str, Method[Any]], posed: Observation) -> None:
    method = trained["gp_constrained"]
    free = forecast_in_scene(method, None, posed, np.random.default_rng(6), 4000, None)
    proposal = around(free, posed, True)
    forecast = forecast_in_scene(method, None, posed, np.random.default_rng(7), 300, obstacles(posed))
    assert forecast.accepted[-1] < 0.9
    assert_integrates_to_one(forecast.density, proposal, 0.15)


@pytest.mark.usefixtures("faultless")
@pytest.mark.parametrize("name", ["kalman_constrained", "ridge_constrained", "gp_constrained"])
def test_inside_an_obstacle_the_density_is_zero(trained: dict[str, Method[Any]], posed: Observation, name: str) -> None:
    scene = obstacles(posed)
    pose = np.repeat(posed.positions[-1:], 3, axis=0)
    pose[:, 2] += np.array([0.05, 0.0, 0.02])  # the left wrist in the middle of the ball
    for noise, most in ((0.0, -600.0), (0.002, -200.0)):
        method = replace(trained[name], noise=noise)
        free, held = (
            forecast_in_scene(method, None, posed, np.random.default_rng(8), 300, s).density for s in (None, scene)
        )
        assert (held.log_prob(pose) - free.log_prob(pose) < most).all()


@pytest.mark.parametrize("name", ["kalman_constrained", "gp_constrained"])
def test_inside_an_obstacle_only_the_tracker_can_be_at_fault(
    trained: dict[str, Method[Any]], posed: Observation, name: str
) -> None:
    pose = np.repeat(posed.positions[-1:], 3, axis=0)
    pose[:, 2] += np.array([0.05, 0.0, 0.02])
    forecast = forecast_in_scene(trained[name], None, posed, np.random.default_rng(9), 300, obstacles(posed))
    inside = forecast.density.log_prob(pose)
    assert np.isfinite(inside).all()
    # At least one of three blocks is a fault: its price is ε and the width of an arm's length.
    assert (inside < forecast.density.log_prob(forecast.mean) - 10).all()


def test_density_outside_limits_is_a_fault_too(trained: dict[str, Method[Any]], posed: Observation) -> None:
    postures = postures_from_points(posed.points, continuous=True)[-1:]
    for name in ("ridge_constrained", "gp_constrained"):
        method = replace(trained[name], limits=narrow(posed, 0.1), noise=0.001)
        forecast = forecast_in_scene(method, None, posed, np.random.default_rng(10), 300, None)
        prices = []
        for excess in (-0.05, 0.15):
            bent = np.repeat(postures, 3, axis=0)
            bent[:, 15] += 0.1 + excess
            prices.append(forecast.density.log_prob(posed.to_world(points_from_postures(bent))))
        assert (prices[0] - prices[1] > 5).all()


def test_the_gaussian_over_positions_is_the_marginal_of_the_joint_one(
    trained: dict[str, Method[Any]], observation: Observation, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(density_module, "FAULT_PROBABILITY", 1e-300)
    method = trained["damped_velocity"]
    forecast = forecast_in_scene(method, None, observation, np.random.default_rng(11), 10, None)
    covariance = method.cholesky @ method.cholesky.T
    for pose in forecast.samples:
        points, mean = observation.to_torso(pose), observation.to_torso(forecast.mean)
        expected = [
            multivariate_normal(mean[t].ravel(), covariance[18 * t : 18 * t + 18, 18 * t : 18 * t + 18]).logpdf(
                points[t].ravel()
            )
            for t in range(3)
        ]
        np.testing.assert_allclose(forecast.density.log_prob(pose), expected, atol=1e-8)


def test_faults_are_broad_normals_of_each_block() -> None:
    rng = np.random.default_rng(12)
    points, mean = rng.standard_normal((2, 4, 6, 3))
    for column, block in enumerate(BLOCKS):
        peer = multivariate_normal(np.zeros(6), FAULT_SPREAD**2 * np.eye(6))
        expected = peer.logpdf((points - mean)[:, list(block)].reshape(4, 6))
        np.testing.assert_allclose(log_fault(points, mean)[:, column], expected)
    assert sorted(JOINT_ORDER) == list(range(6))


def test_with_faults_is_the_product_over_blocks_of_two_ways_each() -> None:
    rng = np.random.default_rng(13)
    inlier, fault = rng.normal(0.0, 3.0, (2, 50, 3))
    f, h = np.exp(inlier), np.exp(fault)
    e = FAULT_PROBABILITY
    np.testing.assert_allclose(with_faults(inlier[None], fault)[0], np.log(((1 - e) * f + e * h).prod(axis=1)))
    allowed = rng.normal(0.0, 2.0, 50)
    expected = sum(
        np.prod([(e * h if bad else (1 - e) * f)[:, b] for b, bad in enumerate(way)], axis=0)
        * (1.0 if any(way) else np.exp(allowed))
        for way in product((False, True), repeat=3)
    )
    np.testing.assert_allclose(with_faults(inlier[None], fault, allowed)[0], np.log(expected))


def test_with_faults_takes_impossible_poses_as_faults() -> None:
    inlier, fault = np.full((1, 3), -np.inf), np.zeros((1, 3))
    assert with_faults(inlier[None], fault)[0, 0] == pytest.approx(3 * math.log(FAULT_PROBABILITY))
    assert with_faults(np.zeros((1, 1, 3)), fault, np.array([-np.inf]))[0, 0] < 0.0


def test_a_jump_of_one_joint_costs_a_bounded_price(trained: dict[str, Method[Any]], posed: Observation) -> None:
    for name in ("kalman", "ridge_angles", "gp_xyz", "gp_angles", "gp_constrained"):
        forecast = forecast_in_scene(trained[name], None, posed, np.random.default_rng(14), 200, None)
        usual = forecast.density.log_prob(forecast.mean)
        for joint in range(6):
            jumped = forecast.mean.copy()
            jumped[:, joint] += np.array([0.4, -0.3, 0.2])
            # All blocks faulty, at worst: a hundred nats for eighteen coordinates.
            assert (usual - forecast.density.log_prob(jumped) < 100).all(), (name, joint)


@pytest.mark.parametrize("joint", range(6))
def test_nan_where_a_joint_is_nan_and_only_there(
    trained: dict[str, Method[Any]], posed: Observation, joint: int
) -> None:
    for name, method in trained.items():
        forecast = forecast_in_scene(method, None, posed, np.random.default_rng(16), 20, None)
        pose = forecast.mean.copy()
        whole = forecast.density.log_prob(pose)
        pose[1, joint, 2] = np.nan
        found = forecast.density.log_prob(pose)
        np.testing.assert_array_equal(np.isnan(found), [False, True, False], err_msg=name)
        np.testing.assert_allclose(found[[0, 2]], whole[[0, 2]], err_msg=name)
        assert np.isnan(forecast.density.log_prob(np.full((3, 6, 3), np.nan))).all()


def test_densities_take_a_straight_elbow(trained: dict[str, Method[Any]], posed: Observation) -> None:
    postures = np.repeat(postures_from_points(posed.points, continuous=True)[-1:], 3, axis=0)
    postures[:, [9, 15]] = 0.0
    pose = posed.to_world(points_from_postures(postures))
    for name, method in trained.items():
        log_prob = forecast_in_scene(method, None, posed, np.random.default_rng(17), 50, None).density.log_prob(pose)
        assert np.isfinite(log_prob).all(), name


def test_a_gaussian_of_positions_takes_constraints_as_well(posed: Observation) -> None:
    mean = np.repeat(posed.points[-1:], 2, axis=0)
    factor = np.repeat(0.03 * np.eye(18)[None], 2, axis=0)
    rng = np.random.default_rng(18)
    draws = mean + 0.03 * rng.standard_normal((3000, 2, 6, 3))
    blocks = GaussianMixture(mean[None, :, JOINT_ORDER].reshape(1, 2, 18), factor[None])
    constraint = ConstraintFactor(lambda: draws, posed, None, 0.002, obstacles(posed))
    free, held = PoseDensity(posed, mean, blocks), PoseDensity(posed, mean, blocks, constraint)
    fresh = posed.to_world(mean + 0.03 * rng.standard_normal((500, 2, 6, 3)))
    ratio = np.exp([held.log_prob(pose) - free.log_prob(pose) for pose in fresh])
    # The faultless part dominates here, so the ratio is that of P(allowed | x) to its mean.
    error = ratio.std(axis=0) * math.sqrt(1 / 500 + 1 / 3000)
    assert (np.abs(ratio.mean(axis=0) - 1) < 4 * error).all()
