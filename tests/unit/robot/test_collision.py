"""Clearances against brute force, and the fine check against coal."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pytest

from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, ConstantVelocity, HalfSpace, MovingObstacle, Sphere
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.distances import nearest_obstacle, segments_apart
from kinecast.robot.occupancy import Occupancy
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import LINKS, UR5

from .conftest import HOME, staying

POST = [-0.45, 0.0, 0.0, -0.45, 0.0, 0.6, 0.08]


def sweep(seconds: float = 2.0) -> Trajectory:
    """The arm turning about its base, past x = −0.45."""
    s = np.linspace(0, 1, 30)
    q = HOME + (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * np.array([-1.6, 0, 0, 0, 0, 0])
    return Trajectory(seconds * s, q)


def test_segments_are_as_far_apart_as_their_nearest_points() -> None:
    rng, shares = np.random.default_rng(0), np.linspace(0, 1, 201)[:, None]
    for _ in range(60):
        p, q, a, b = rng.normal(size=(4, 3))
        between = np.linalg.norm((p + shares * (q - p))[:, None] - (a + shares * (b - a)), axis=-1)
        exact = segments_apart(p, q, a, b)
        assert exact <= between.min() + 1e-12
        assert exact >= between.min() - 0.03


@pytest.mark.parametrize(
    ("p", "q", "a", "b", "distance"),
    [
        ([0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], 1.0),  # parallel
        ([0, 0, 0], [1, 0, 0], [3, 0, 0], [4, 0, 0], 2.0),  # in line
        ([0, 0, 0], [0, 0, 0], [0, 3, 4], [0, 3, 4], 5.0),  # two points
        ([0, 0, 0], [0, 0, 0], [-1, 2, 0], [1, 2, 0], 2.0),  # a point
        ([-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], 0.0),  # crossing
    ],
)
def test_degenerate_segments(p: list[int], q: list[int], a: list[int], b: list[int], distance: float) -> None:
    assert segments_apart(*np.array([p, q, a, b], dtype=float)) == pytest.approx(distance, abs=1e-12)


def test_distance_to_obstacles_is_that_of_the_shapes_with_its_derivative() -> None:
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    shapes = [
        Box(np.array([0.3, 0, 0]), np.array([0.4, 0.2, 0.6]), turn),
        Sphere(np.array([-0.5, 0, 0]), 0.2),
        Capsule(np.array([0, 0.6, 0]), np.array([0.3, 0.6, 0.2]), 0.1),
        HalfSpace(np.array([0, 0, -0.4]), np.array([0.1, 0, 1.0])),
    ]
    rows, first = np.stack([shape.row for shape in shapes]), np.zeros(4, dtype=np.int64)
    for point in rng.uniform(-0.8, 0.8, (200, 3)):
        distance, *gradient = nearest_obstacle(rows, first, 0, *point, np.inf)
        assert distance == pytest.approx(min(float(shape.signed_distance(point)) for shape in shapes), abs=1e-12)
        ahead = nearest_obstacle(rows, first, 0, *(point + 1e-6 * np.array(gradient)), np.inf)[0]
        assert ahead - distance == pytest.approx(1e-6, rel=1e-3)


def test_clearances_are_coals(arm: UR5) -> None:
    """Random configurations among random capsules: the compiled distances are those of coal."""
    rng = np.random.default_rng(2)
    rows = np.concatenate([rng.uniform(-0.8, 0.8, (6, 6)), rng.uniform(0.03, 0.1, (6, 1))], axis=1)
    checker, region = CollisionChecker(arm), staying(*rows.tolist())
    q = rng.uniform(-3, 3, (30, 6))
    found, capsules = checker.clearances(q, np.zeros(30), region), arm.capsules(q)
    for n in range(30):
        links = [_placed(a, b, r) for a, b, r in zip(capsules.start[n], capsules.end[n], capsules.radius, strict=True)]
        persons = [_placed(row[:3], row[3:6], row[6]) for row in rows]
        person = min(_distance(link, other) for link in links for other in persons)
        assert found[n, 0] == pytest.approx(person, abs=1e-4) or (found[n, 0] < 0 and person < 0)
        pedestal = _placed(*arm.pedestal)
        own = min(_distance(links[k], pedestal if other < 0 else links[other]) for k, other in checker.pairs)
        assert found[n, 2] == pytest.approx(own, abs=1e-4) or (found[n, 2] < 0 and own < 0)


def _placed(a: np.ndarray, b: np.ndarray, radius: float) -> tuple[coal.Capsule, coal.Transform3s]:
    z = (b - a) / np.linalg.norm(b - a)
    x = np.linalg.svd(z[None])[2][1]
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return coal.Capsule(float(radius), float(np.linalg.norm(b - a))), coal.Transform3s(rotation, (a + b) / 2)


def _distance(a: tuple[coal.Capsule, coal.Transform3s], b: tuple[coal.Capsule, coal.Transform3s]) -> float:
    return float(coal.distance(a[0], a[1], b[0], b[1], coal.DistanceRequest(), coal.DistanceResult()))


def test_a_motion_in_the_open_is_free(checker: CollisionChecker) -> None:
    found = checker.check(sweep(), Occupancy.empty())
    assert found.free
    assert found.person == 2.0
    assert 0 < found.scene < 0.3
    assert np.isnan(found.time)


def test_a_post_in_the_way_is_found_in_time_and_named(checker: CollisionChecker) -> None:
    found = checker.check(sweep(), staying(POST))
    assert not found.free
    assert "person" in found.what
    first = checker.clearances(sweep().at(np.array([found.time]))[0], np.array([found.time]), staying(POST))
    assert first[0, 0] < 0.01


def test_what_comes_later_is_passed_and_what_comes_then_is_hit(checker: CollisionChecker) -> None:
    """The same post, as it falls in at a given time: each look is at its own moment."""
    up, gone = np.array([POST]), np.array([POST]) + np.array([9.0, 0, 0, 9, 0, 0, 0])
    for late, free in ((2.5, True), (0.3, False)):
        rows = np.stack([gone, gone, up])
        region = Occupancy(
            0.0, np.array([0.0, late, late + 0.01]), rows[..., :3], rows[..., 3:6], rows[..., 6], 0.0, 0.0
        )
        assert checker.check(sweep(), region).free is free


def test_a_thin_thing_between_two_waypoints_is_found(arm: UR5) -> None:
    """Only two waypoints, on either side: the looks between them find it."""
    coarse = Trajectory(np.array([0.0, 2.0]), sweep().q[[0, -1]])
    thin = staying([-0.45, 0.0, 0.0, -0.45, 0.0, 0.6, 0.002])
    assert not CollisionChecker(arm).check(coarse, thin).free


def test_the_scene_and_the_arm_itself_are_in_the_way(arm: UR5, table: Scene) -> None:
    low = HOME + np.array([0, 0.5, 0, 0, 0, 0])
    into_table = Trajectory(np.array([0.0, 1.0]), np.stack([HOME, low]))
    found = CollisionChecker(arm, table).check(into_table, Occupancy.empty())
    assert found.what.startswith("the scene")
    assert CollisionChecker(arm).check(into_table, Occupancy.empty()).free
    folded = HOME.copy()
    folded[2] = 3.0
    into_itself = Trajectory(np.array([0.0, 1.0]), np.stack([HOME, folded]))
    assert CollisionChecker(arm).check(into_itself, Occupancy.empty()).what.startswith("the arm itself")


def test_a_moving_obstacle_is_met_where_it_is_then(arm: UR5) -> None:
    ball = Sphere(np.array([-0.45, -3.0, 0.2]), 0.1)
    hits = MovingObstacle(ball, ConstantVelocity(np.array([0.0, 3.0, 0.0])))
    misses = replace(hits, motion=ConstantVelocity(np.array([0.0, 0.5, 0.0])))
    assert not CollisionChecker(arm, Scene((hits,))).check(sweep(), Occupancy.empty()).free
    assert CollisionChecker(arm, Scene((misses,))).check(sweep(), Occupancy.empty()).free


def test_coal_alone_sees_the_same(checker: CollisionChecker) -> None:
    """Where the compiled distances say that something is touched, coal says so too, and where not, not."""
    rng = np.random.default_rng(5)
    q, times = rng.uniform(-2, 2, (60, 6)), np.zeros(60)
    found, words = checker.clearances(q, times, staying(POST)), checker.touched(q, times, staying(POST))
    for clear, word in zip(found, words, strict=True):
        if np.abs(clear).min() > 1e-4:
            assert bool(word) == bool((clear < 0).any())


@pytest.mark.parametrize(
    "shape",
    [
        Box(np.array([-0.45, 0, 0.3]), np.array([0.1, 0.1, 0.6])),
        Capsule(np.array([-0.45, 0, 0]), np.array([-0.45, 0, 0.6]), 0.05),
        HalfSpace(np.array([0, 0, 0.1]), np.array([0, 0, 1.0])),
    ],
)
def test_every_shape_can_be_an_obstacle(arm: UR5, shape: Box) -> None:
    checker = CollisionChecker(arm, Scene((shape,)))
    times = checker.looks(sweep(), 0.02)
    q = sweep().at(times)[0]
    touched = [bool(word) for word in checker.touched(q, times, Occupancy.empty())]
    expected = checker.clearances(q, times, Occupancy.empty())[:, 1:].min(axis=1) < 0
    assert np.mean(np.array(touched) == expected) > 0.98
    assert expected.any()


def test_looks_leave_no_gap_wider_than_the_step(checker: CollisionChecker, arm: UR5) -> None:
    q, _ = sweep().at(checker.looks(sweep(), 0.01))
    capsules = arm.capsules(q)
    way = np.linalg.norm(np.diff(capsules.end, axis=0), axis=-1)
    assert way.max() < 0.0125
    assert len(LINKS) == way.shape[1]
