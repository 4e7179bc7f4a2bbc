"""Scenes: obstacles where they are at each time, and arms that are free of them."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, ConstantVelocity, HalfSpace, MovingObstacle, Sphere, Waypoints
from kinecast.geometry.transforms import from_rotation_vector

from .conftest import distances

LIMBS = np.array([(0, 1), (1, 2), (3, 4), (4, 5)])
TURNED = from_rotation_vector(np.array([0.3, -0.8, 0.5]))
TABLE = Box(np.array([0.5, 0.0, 0.88]), np.array([0.8, 1.6, 0.04]))
POSE = np.array(
    [
        [0.0, 0.2, 1.4],
        [0.1, 0.25, 1.12],
        [0.35, 0.2, 1.05],
        [0.0, -0.2, 1.4],
        [0.1, -0.25, 1.12],
        [0.35, -0.2, 1.05],
    ]
)


def arms_around_the_table(samples: int, times: int, seed: int = 0) -> np.ndarray:
    return POSE + np.random.default_rng(seed).normal(0, 0.1, (samples, times, 6, 3))


def test_an_empty_scene_is_free_everywhere() -> None:
    arms, times = arms_around_the_table(3, 2), np.array([0.0, 0.1])
    assert Scene().free(arms, times).all()
    assert np.all(distances(Scene(), arms, times) == np.inf)


@pytest.mark.parametrize("radius", [0.0, 0.05])
def test_free_agrees_with_the_distance_of_every_limb(radius: float) -> None:
    obstacles = (
        TABLE,
        Box(np.array([0.3, 0.1, 1.1]), np.array([0.1, 0.2, 0.3]), TURNED),
        Sphere(np.array([0.2, -0.2, 1.2]), 0.05),
        Capsule(np.array([0.3, -0.5, 1.0]), np.array([0.2, 0.5, 1.3]), 0.03),
        HalfSpace(np.array([0.45, 0.0, 1.0]), np.array([-1.0, 0.1, 0.2])),
    )  # fmt: skip
    times = np.linspace(0.0, 0.5, 5)
    arms = arms_around_the_table(400, 5) - np.array([0.0, 0.0, 0.1])
    start, end = LIMBS.T
    for obstacle in obstacles:
        clearance = obstacle.segment_distance(arms[..., start, :], arms[..., end, :]).min(axis=-1)
        free = Scene((obstacle,)).free(arms, times, radius)
        np.testing.assert_array_equal(free, clearance > radius)
        assert 0.02 < free.mean() < 0.98, "the test must see both outcomes"
    everything = Scene(obstacles).free(arms, times, radius)
    np.testing.assert_array_equal(
        everything, np.all([Scene((o,)).free(arms, times, radius) for o in obstacles], axis=0)
    )


def test_a_limb_through_a_thin_table_is_not_free_though_both_its_ends_are() -> None:
    arm = POSE.copy()
    arm[1], arm[2] = [0.3, 0.2, 0.95], [0.4, 0.2, 0.8]
    scene, times = Scene((TABLE,)), np.zeros(1)
    assert np.all(distances(scene, arm[None], times) > 0)
    assert not scene.free(arm[None, None], times)[0, 0]


def test_an_obstacle_is_met_where_it_is_at_each_time() -> None:
    ball = Sphere(np.array([0.35, 1.2, 1.05]), 0.1)
    moving = MovingObstacle(ball, ConstantVelocity(np.array([0.0, -1.0, 0.0]), since=10.0))
    times = 10.0 + np.array([0.0, 0.5, 1.0, 1.4, 2.0])
    arms = np.broadcast_to(POSE, (1, 5, 6, 3))
    free = Scene((moving,)).free(arms, times)[0]
    np.testing.assert_array_equal(free, [True, True, False, False, True])  # left wrist, right wrist, then past
    wrist = distances(Scene((moving,)), np.ascontiguousarray(arms[:, :, 2:3]), times)[0, :, 0]
    np.testing.assert_allclose(wrist, [0.9, 0.4, -0.1, 0.3, 0.9], atol=1e-12)


def test_waypoints_hold_before_the_first_and_after_the_last() -> None:
    path = Waypoints(np.array([1.0, 3.0]), np.array([[0.0, 0.0, 0.0], [0.0, 4.0, 0.0]]))
    ball = MovingObstacle(Sphere(np.array([9.0, 9.0, 9.0]), 0.5), path)
    times = np.array([0.0, 1.0, 2.0, 9.0])
    origin = np.zeros((4, 1, 3))
    np.testing.assert_allclose(distances(Scene((ball,)), origin, times)[:, 0], [-0.5, -0.5, 1.5, 3.5])


def test_unknown_joints_are_never_free() -> None:
    arms = np.stack([POSE, POSE, POSE])[:, None] + np.array([0.0, 0.0, 5.0])
    arms[1, 0, 4, 1] = np.nan
    assert Scene((TABLE,)).free(arms, np.zeros(1))[:, 0].tolist() == [True, False, True]


def test_leading_axes_are_kept_and_inputs_may_be_strided() -> None:
    scene, times = Scene((TABLE, Sphere(np.zeros(3), 1.0))), np.linspace(0, 1, 4)
    points = np.random.default_rng(3).normal(size=(4, 2, 3, 3))
    whole = distances(scene, points.transpose(1, 2, 0, 3)[..., None, :], times)
    assert whole.shape == (2, 3, 4, 1)
    one = min(s.signed_distance(points[3, 1, 2]) for s in (TABLE, Sphere(np.zeros(3), 1.0)))
    assert whole[1, 2, 3, 0] == one


@pytest.mark.parametrize("radius", [-0.1, np.nan, np.inf])
def test_an_impossible_limb_radius_is_refused(radius: float) -> None:
    with pytest.raises(OptionError, match="limb_radius"):
        Scene((TABLE,)).free(POSE[None, None], np.zeros(1), radius)


@pytest.mark.parametrize(
    ("times", "positions", "message"),
    [
        ([1.0, 1.0], [[0.0, 0.0, 0.0]] * 2, "must increase"),
        ([np.nan], [[0.0, 0.0, 0.0]], "finite"),
        ([], np.empty((0, 3)), "positions for"),
    ],
)
def test_impossible_waypoints_are_refused(times: list[float], positions: list[list[float]], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        Waypoints(np.array(times, dtype=float), np.array(positions))
