"""Motions held within bounds: a pose inside them stays as it is, one outside comes inside; nothing else moves."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.body.limits import AngleLimit, JointLimits, violations
from kinecast.body.posture import points_from_postures, postures_from_points
from kinecast.prediction.observation import Observation
from kinecast.prediction.sampling import sample_motions

DT = 1.0 / 30.0
STEPS, SAMPLES, RANK = 4, 150, 7
START = np.array([0, 0, 0, 0.1, 0.05, 0.36, 0.4, 0.3, -0.5, 1.2, 0.30, 0.26, 0.5, 0.2, -0.4, 1.4, 0.28, 0.24])
ORIGIN = np.array([1.0, -2.0, 1.4])
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TIGHT = JointLimits(
    flexion=AngleLimit(-1.0, 0.52, 2.0),
    abduction=AngleLimit(-0.9, 0.31, 2.0),
    axial_rotation=AngleLimit(-1.7, -0.35, 2.0),
    elbow=AngleLimit(0.0, 1.42, 2.0),
)
# Beyond the usual range, where the other branch of the arm's angles would be taken for a tracked person.
WIDE = JointLimits(
    flexion=AngleLimit(-2.2, 3.2, 12.0),
    abduction=AngleLimit(-1.5, 3.2, 12.0),
    axial_rotation=AngleLimit(-2.6, 2.6, 12.0),
    elbow=AngleLimit(0.0, 2.7, 12.0),
)


def drawn(
    spread: float, limits: JointLimits | None, start: np.ndarray = START, samples: int = SAMPLES, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Motions in the torso frame, and what they would be without limits."""
    rng = np.random.default_rng(seed)
    mean = np.repeat(points_from_postures(start)[None], STEPS, axis=0)
    factor = spread * rng.standard_normal((STEPS, 6, 3, RANK)) / np.sqrt(RANK)
    draws = rng.standard_normal((RANK, samples))
    observation = Observation(np.repeat(mean[:1] @ TURN.T + ORIGIN, 6, axis=0), np.array([0.0, 0.0, 1.0]), DT)
    observation.__dict__.update(posture=start, frame=(TURN, ORIGIN))  # as if it had been seen on this branch
    moved = sample_motions(observation, mean, factor, draws, limits)
    return (moved - ORIGIN) @ TURN, mean + np.tensordot(draws, factor, axes=(0, 3))


def broken(motions: np.ndarray, limits: JointLimits, start: np.ndarray) -> np.ndarray:
    postures = postures_from_points(motions, start, continuous=True, usual=False)
    return np.logical_or(*violations(postures, start, DT, limits))


@pytest.mark.parametrize("samples", [1, 103, 104, 105, 300])
def test_without_limits_motions_are_the_gaussians(samples: int) -> None:
    motions, free = drawn(0.05, None, samples=samples)
    np.testing.assert_allclose(motions, free, rtol=0, atol=1e-12)


@pytest.mark.parametrize("limits", [TIGHT, WIDE], ids=["tight", "wide"])
@pytest.mark.parametrize("spread", [1e-4, 0.01, 0.1, 1.0])
def test_every_motion_keeps_its_limits_as_counted_from_positions(spread: float, limits: JointLimits) -> None:
    motions, _ = drawn(spread, limits)
    assert not broken(motions, limits, START).any()


@pytest.mark.parametrize("flexion", [-2.1, 3.1])
def test_limits_wider_than_the_usual_range_do_not_change_the_branch(flexion: float) -> None:
    start = START.copy()
    start[[6, 12]] = flexion
    motions, _ = drawn(0.02, WIDE, start)
    assert not broken(motions, WIDE, start).any()
    postures = postures_from_points(motions, start, continuous=True, usual=False)
    assert np.abs(postures[..., [6, 12]] - flexion).max() < 1.5


def test_motions_that_kept_their_limits_are_left_as_they_were() -> None:
    motions, free = drawn(0.004, WIDE)
    kept = ~broken(free, WIDE, START).any(axis=1)
    assert kept.mean() > 0.2
    np.testing.assert_allclose(motions[kept], free[kept], rtol=0, atol=1e-12)


def test_shoulders_and_bones_are_never_moved() -> None:
    motions, free = drawn(0.05, TIGHT)
    np.testing.assert_allclose(motions[:, :, [0, 3]], free[:, :, [0, 3]], rtol=0, atol=1e-12)
    for end, start in ((1, 0), (2, 1), (4, 3), (5, 4)):
        length = np.linalg.norm(motions[:, :, end] - motions[:, :, start], axis=-1)
        np.testing.assert_allclose(
            length, np.linalg.norm(free[:, :, end] - free[:, :, start], axis=-1), rtol=0, atol=1e-9
        )


def at_rest() -> tuple[Observation, np.ndarray]:
    mean = np.repeat(points_from_postures(START)[None], 12, axis=0)
    observation = Observation(np.repeat(mean[:1] @ TURN.T + ORIGIN, 6, axis=0), np.array([0.0, 0.0, 1.0]), DT)
    observation.__dict__.update(posture=START, frame=(TURN, ORIGIN))
    return observation, mean


def test_motions_held_at_a_bound_rest_there() -> None:
    (observation, mean), rng = at_rest(), np.random.default_rng(1)
    factor = np.repeat(0.05 * rng.standard_normal((1, 6, 3, RANK)), len(mean), axis=0)
    limits = JointLimits(elbow=AngleLimit(0.0, 1.42, 12.0), flexion=AngleLimit(-1.0, 0.52, 12.0))
    draws = rng.standard_normal((RANK, SAMPLES))
    moved = (sample_motions(observation, mean, factor, draws, limits) - ORIGIN) @ TURN
    free = mean + np.tensordot(draws, factor, axes=(0, 3))
    assert (np.abs(moved - free) > 1e-3).any(axis=(1, 2, 3)).mean() > 0.3
    np.testing.assert_allclose(moved[:, -1], moved[:, -2], rtol=0, atol=1e-9)


def test_a_motion_that_strays_is_brought_nearer_as_a_whole() -> None:
    (observation, mean), rng = at_rest(), np.random.default_rng(2)
    factor, draws = 0.2 * rng.standard_normal((len(mean), 6, 3, RANK)), rng.standard_normal((RANK, SAMPLES))
    farthest = rng.uniform(0.3, 1.5, (len(mean), 6))
    moved = (sample_motions(observation, mean, factor, draws, None, farthest) - ORIGIN) @ TURN - mean
    free = np.tensordot(draws, factor, axes=(0, 3))
    assert (np.linalg.norm(moved, axis=-1) <= farthest + 1e-9).all()
    share = (moved * free).sum(axis=(1, 2, 3)) / (free**2).sum(axis=(1, 2, 3))
    np.testing.assert_allclose(moved, share[:, None, None, None] * free, rtol=0, atol=1e-9)
    assert (share < 0.9).any()
    assert (share[(np.linalg.norm(free, axis=-1) < 0.5 * farthest).all(axis=(1, 2))] > 0.999).all()


def test_a_wrist_that_may_be_no_faster_is_not() -> None:
    limits = JointLimits(wrist_speed=0.3)
    motions, _ = drawn(0.02, limits)
    assert not broken(motions, limits, START).any()


def test_the_same_seed_draws_the_same_and_another_does_not() -> None:
    one, _ = drawn(0.05, TIGHT)
    again, _ = drawn(0.05, TIGHT)
    other, _ = drawn(0.05, TIGHT, seed=1)
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
