"""What limits and scene leave of a density: sharp without noise, smooth with it, and normalised by its own mean."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr

from kinecast.body.limits import AngleLimit, JointLimits, bounds
from kinecast.body.posture import ANGLES, points_from_postures, postures_from_points
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import ConstantVelocity, HalfSpace, MovingObstacle, Sphere
from kinecast.prediction.density import LEAST, ConstraintFactor
from kinecast.prediction.noise import angle_noise
from kinecast.prediction.observation import Observation


@pytest.fixture
def initial(posed: Observation) -> np.ndarray:
    """The last observed posture."""
    return postures_from_points(posed.points, continuous=True)[-1]


def floor(observation: Observation, height: float) -> Scene:
    """Everything below the lower wrist, moved down by a height."""
    lowest = observation.positions[-1, [2, 5]].min(axis=0)
    return Scene((HalfSpace(lowest - np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0])),))


def factor(
    observation: Observation,
    draws: np.ndarray,
    limits: JointLimits | None = None,
    scene: Scene | None = None,
    noise: float = 0.0,
) -> ConstraintFactor:
    return ConstraintFactor(lambda: draws, observation, limits, noise, scene)


def test_without_constraints_everything_is_allowed(posed: Observation) -> None:
    free = factor(posed, posed.points[None, :3])
    np.testing.assert_array_equal(free.log_given(posed.points[:3]), 0.0)
    np.testing.assert_array_equal(free.log_total, 0.0)


@pytest.mark.parametrize("height", [-0.02, -0.003, 0.0, 0.003, 0.02])
def test_near_an_obstacle_the_noise_decides(posed: Observation, height: float) -> None:
    pose = posed.points[-1:]
    smooth = factor(posed, pose[None], None, floor(posed, height), 0.004).log_given(pose)
    assert math.exp(smooth[0]) == pytest.approx(ndtr(height / 0.004), abs=1e-9)
    if height:
        sharp = factor(posed, pose[None], None, floor(posed, height)).log_given(pose)
        assert sharp[0] == (0.0 if height > 0 else -np.inf)


def test_angles_beyond_their_bounds_are_allowed_as_far_as_the_noise_explains(
    posed: Observation, initial: np.ndarray
) -> None:
    limits = JointLimits(elbow=AngleLimit(0.0, initial[9] + 0.1, 12.0))
    noise = 0.003
    for excess in (-0.05, -0.005, 0.0, 0.01):
        posture = initial.copy()
        posture[9] = limits.elbow.upper + excess
        posture[15] = 0.4
        pose = points_from_postures(posture)[None]
        spread = angle_noise(posture[6:12], np.full(3, noise))[3]
        found = factor(posed, pose[None], limits, None, noise).log_given(pose)
        assert math.exp(found[0]) == pytest.approx(ndtr(-excess / spread), abs=1e-4)


def test_speed_bounds_widen_with_time(posed: Observation, initial: np.ndarray) -> None:
    limits = JointLimits(flexion=AngleLimit(-1.0, 3.0, 1.0))
    posture = initial.copy()
    posture[6] += 2.5 * posed.dt
    poses = np.repeat(points_from_postures(posture)[None], 4, axis=0)
    found = factor(posed, poses[None], limits, None, 1e-5).log_given(poses)
    assert (found[:2] < math.log(1e-9)).all()
    np.testing.assert_allclose(found[2:], 0.0, atol=1e-6)


def test_a_start_outside_its_range_widens_it_but_no_further(posed: Observation, initial: np.ndarray) -> None:
    limits = JointLimits(flexion=AngleLimit(-1.0, initial[6] - 0.3, 2.0))
    for change, allowed in ((-0.02, True), (-0.001, True), (0.03, False)):
        posture = initial.copy()
        posture[[6, 12]] += change
        poses = np.repeat(points_from_postures(posture)[None], 3, axis=0)
        found = factor(posed, poses[None], limits, None, 1e-5).log_given(poses)
        assert ((found > math.log(0.5)) == allowed).all()


def test_axial_rotation_does_not_matter_at_a_straight_elbow(posed: Observation, initial: np.ndarray) -> None:
    limits = JointLimits(axial_rotation=AngleLimit(-0.6, -0.3, 50.0), elbow=AngleLimit(0.0, 2.6, 50.0))
    found = []
    for bend in (math.radians(1.0), math.radians(20.0)):
        posture = initial.copy()
        posture[8], posture[9] = 1.5, bend
        pose = points_from_postures(posture)[None]
        found.append(factor(posed, pose[None], limits, None, 1e-4).log_given(pose)[0])
    assert found[0] > -1e-6
    assert found[1] == pytest.approx(math.log(LEAST))


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_the_total_is_the_mean_over_draws(posed: Observation, noise: float) -> None:
    rng = np.random.default_rng(0)
    draws = posed.points[-3:] + 0.02 * rng.standard_normal((500, 3, 6, 3))
    limits = JointLimits(elbow=AngleLimit(0.0, 0.75, 12.0))
    everything = factor(posed, draws, limits, floor(posed, 0.01), noise)
    each = np.array([everything.log_given(pose) for pose in draws])
    np.testing.assert_allclose(everything.log_given(draws), each, atol=1e-12)
    np.testing.assert_allclose(np.exp(everything.log_total), np.exp(each).mean(axis=0), rtol=1e-9)
    assert 0.05 < np.exp(everything.log_total).min() < 0.95


def test_sharp_edges_agree_with_the_bounds_and_the_scene_themselves(posed: Observation, initial: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    draws = posed.points[-3:] + 0.02 * rng.standard_normal((500, 3, 6, 3))
    limits = JointLimits(flexion=AngleLimit(-1.0, 0.11, 1.0), elbow=AngleLimit(0.0, 0.75, 3.0))
    scene = floor(posed, 0.01)
    start = np.broadcast_to(initial, (500, 18))
    postures = postures_from_points(draws, start, continuous=False)
    lower, upper, speed = limits.of_posture()
    inside = np.ones((500, 3), dtype=bool)
    for t, d in ((t, d) for t in range(3) for d in ANGLES):
        lb, ub = bounds(lower[d], upper[d], speed[d], initial[d], (t + 1) * posed.dt)
        inside[:, t] &= (postures[:, t, d] >= lb) & (postures[:, t, d] <= ub)
    inside &= scene.free(posed.to_world(draws), posed.times(3))
    found = factor(posed, draws, limits, scene).log_given(draws)
    np.testing.assert_array_equal(found > math.log(0.5), inside)


def test_where_no_draw_is_allowed_the_share_is_half_a_draws(posed: Observation) -> None:
    draws = np.repeat(posed.points[None, -2:], 50, axis=0)
    blocked = factor(posed, draws, None, floor(posed, -3.0))
    np.testing.assert_allclose(np.exp(blocked.log_total), 1 / 100)
    # So the density elsewhere cannot explode: what was never drawn is not promised either.
    assert np.exp(-blocked.log_total).max() <= 100.0 + 1e-9


def test_moving_obstacles_are_taken_where_they_are_at_each_step(posed: Observation) -> None:
    wrist = posed.positions[-1, 2]
    # A ball that flies through the wrist, and is there at the second step.
    ball = MovingObstacle(Sphere(wrist, 0.05), ConstantVelocity(np.array([0.0, 0.0, 6.0]), posed.times(2)[1]))
    poses = np.repeat(posed.points[-1:], 3, axis=0)
    found = factor(posed, poses[None], None, Scene((ball,))).log_given(poses)
    np.testing.assert_array_equal(found, [0.0, -np.inf, 0.0])
