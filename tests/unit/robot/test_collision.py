"""Touches and clearances of the arm against the shapes' own distances, and the fine check of a motion."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.geometry.distances import point_distance
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, ConstantVelocity, HalfSpace, MovingObstacle, Shape, Sphere
from kinecast.robot.collision import FIRST_LINK, CollisionChecker
from kinecast.robot.trajectory import Trajectory, minimum_jerk
from kinecast.robot.ur5 import LINKS, UR5

from .conftest import HOME, posts

POST = [-0.45, 0.0, 0.0, -0.45, 0.0, 0.6, 0.08]
TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
SHAPES = (
    Box(np.array([-0.45, 0, 0.3]), np.array([0.1, 0.3, 0.6]), TURN * np.sign(np.linalg.det(TURN))),
    Sphere(np.array([-0.5, 0.1, 0.2]), 0.2),
    Capsule(np.array([-0.45, 0, 0]), np.array([-0.4, 0.3, 0.6]), 0.05),
    HalfSpace(np.array([0, 0, -0.1]), np.array([0.1, 0, 1.0])),
)


def sweep(seconds: float = 2.0) -> Trajectory:
    """The arm turning about its base, past x = −0.45."""
    q = HOME + minimum_jerk(30)[:, None] * np.array([-1.6, 0, 0, 0, 0, 0])
    return Trajectory(seconds * np.linspace(0, 1, 30), q)


def test_distance_of_points_is_that_of_the_shapes_with_its_derivative() -> None:
    for shape in SHAPES:
        for point in np.random.default_rng(2).uniform(-0.8, 0.8, (50, 3)):
            distance, gradient = point_distance(shape.row, tuple(point))
            assert distance == pytest.approx(float(shape.signed_distance(point)), abs=1e-12)
            ahead = point_distance(shape.row, tuple(point + 1e-6 * np.array(gradient)))[0]
            assert ahead - distance == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_every_shape_can_be_an_obstacle_and_is_where_it_is_said_to_be(arm: UR5, shape: Shape) -> None:
    checker = CollisionChecker(arm, Scene((shape,)))
    rng, touched = np.random.default_rng(3), 0
    for q in rng.uniform(-3, 3, (100, 6)):
        links = arm.capsules(q)
        apart = shape.segment_distance(links[:, :3], links[:, 3:6]) - links[:, 6]
        expected = float(apart[FIRST_LINK:].min())
        found, own = checker.clearance(q)
        assert found == pytest.approx(expected, abs=1e-5) or (found < 0 and expected < 0)
        if abs(expected) > 1e-4 and abs(own) > 1e-4:
            assert bool(checker.touched(q)) == (min(expected, own) < 0)
        if expected > 1e-3 and own > 1e-3:
            assert checker.touched(q, min(expected, own) + 1e-3)
            assert not checker.touched(q, min(expected, own) - 1e-3)
        touched += expected < 0
    assert 3 < touched < 97


def test_the_arm_meets_itself_where_its_capsules_do(arm: UR5) -> None:
    checker, pairs = CollisionChecker(arm), 0
    for q in np.random.default_rng(4).uniform(-3, 3, (30, 6)):
        links, least = arm.capsules(q), np.inf
        for k in range(len(LINKS)):
            others = [(arm.pedestal, k > 1), *((links[j], k > j + 2) for j in range(4))]
            for row, meets in others:
                if meets:
                    apart = Capsule(row[:3], row[3:6], row[6]).segment_distance(links[k, :3], links[k, 3:6])
                    least, pairs = min(least, float(apart - links[k, 6])), pairs + 1
        _, own = checker.clearance(q)
        assert own == pytest.approx(least, abs=1e-5) or (own < 0 and least < 0)
    assert pairs > 0


def test_a_motion_in_the_open_is_free_and_what_is_in_the_way_is_named(arm: UR5, checker: CollisionChecker) -> None:
    assert checker.check(sweep()) == ""
    assert CollisionChecker(arm, posts(POST)).check(sweep()).startswith("the scene (")
    folded = HOME.copy()
    folded[2] = 3.0
    into_itself = Trajectory(np.array([0.0, 1.0]), np.stack([HOME, folded]))
    assert CollisionChecker(arm).check(into_itself).startswith("the arm itself (")
    under = Trajectory(np.array([0.0, 1.0]), np.stack([HOME, HOME + np.array([0, 0.5, 0, 0, 0, 0])]))
    assert checker.check(under).startswith("the scene (")
    assert CollisionChecker(arm).check(under) == ""


def test_a_thin_thing_between_two_waypoints_is_found(arm: UR5) -> None:
    """Only two waypoints, on either side: the looks between them find it."""
    coarse = Trajectory(np.array([0.0, 2.0]), sweep().q[[0, -1]])
    thin = posts([-0.45, 0.0, 0.0, -0.45, 0.0, 0.6, 0.002])
    assert CollisionChecker(arm, thin).check(coarse)


def test_looks_leave_no_gap_wider_than_the_step(checker: CollisionChecker, arm: UR5) -> None:
    q = sweep().at(checker.looks(sweep(), 0.01))
    way = np.linalg.norm(np.diff(arm.capsules(q)[..., 3:6], axis=0), axis=-1)
    assert way.max() < 0.0125


def test_what_moves_by_itself_is_refused(arm: UR5) -> None:
    moving = MovingObstacle(SHAPES[1], ConstantVelocity(np.array([0.0, 3.0, 0.0])))
    with pytest.raises(OptionError, match="MovingObstacle"):
        CollisionChecker(arm, Scene((moving,)))
