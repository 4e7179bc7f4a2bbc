"""Speed and separation monitoring against its formula."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.robot.separation import Moving, Separation, SeparationOptions, closest_points, compare, separation

OPTIONS = SeparationOptions(across=0.0)  # the plain formula


def post(x: float, *velocity: float, age: float = 0.0) -> Moving:
    """An upright capsule of radius 0.1 m that moves along x (and y)."""
    velocity = np.array([*velocity, 0.0, 0.0])[:3]
    return Moving(np.array([[x, 0.0, 0.0, x, 0.0, 1.0, 0.1]]), np.tile(velocity, (1, 2)), np.array([age]))


def pair(
    distance: float, arm_speed: float, person_speed: float, age: float = 0.0, options: SeparationOptions = OPTIONS
) -> Separation:
    """Two parallel capsules of radius 0.1 m at a distance along x, moving towards one another."""
    return separation(post(0.0, arm_speed), post(distance + 0.2, -person_speed, age=age), options)


def needed(robot: float, human: float, age: float = 0.0) -> float:
    """S_p by hand."""
    stopping = robot / OPTIONS.braking
    return (
        human * (age + OPTIONS.reaction + stopping)
        + robot * OPTIONS.reaction
        + robot**2 / (2 * OPTIONS.braking)
        + OPTIONS.constant
    )


@pytest.mark.parametrize("robot", [0.2, 1.0])
@pytest.mark.parametrize("human", [0.3, 1.6])
@pytest.mark.parametrize("age", [0.0, 0.08])
def test_required_distance_is_the_sum_of_its_terms(robot: float, human: float, age: float) -> None:
    found = pair(1.7, robot, human, age)
    assert found.distance == pytest.approx(1.7)
    assert found.required == pytest.approx(needed(robot, human, age))
    assert found.margin == pytest.approx(1.7 - needed(robot, human, age))


@pytest.mark.parametrize("distance", [0.15, 0.3, 0.6])
@pytest.mark.parametrize("human", [0.2, 0.8])
def test_the_allowed_speed_is_the_one_whose_required_distance_is_there(distance: float, human: float) -> None:
    found = pair(distance, 3.0, human)
    assert 0 < found.scale < 1
    assert needed(3.0 * found.scale, human) == pytest.approx(distance)


def test_a_person_nearer_than_the_constant_terms_stops_the_arm_unless_it_draws_back() -> None:
    assert pair(0.01, 0.5, 0.0).scale == 0.0
    assert pair(0.01, -0.5, 0.0).scale == 1.0
    assert pair(-0.05, -0.5, 1.0).scale == 1.0


def test_who_is_not_seen_often_enough_counts_as_fast() -> None:
    assert pair(0.5, 0.5, 0.0, age=0.2).required == pytest.approx(needed(0.5, 1.6, 0.2))
    assert pair(0.5, 0.5, np.nan).required == pytest.approx(needed(0.5, 1.6))


@pytest.mark.parametrize("distance", [0.02, 0.3])
def test_a_share_of_the_speed_across_counts_as_towards_the_person(distance: float) -> None:
    def moving(*velocity: float) -> Separation:
        return separation(post(0.0, *velocity), post(distance + 0.2, 0.0), SeparationOptions())

    towards = moving(0.3 * 0.8)
    assert moving(0.0, 0.8).required == pytest.approx(towards.required)
    assert moving(0.0, 0.8).scale == pytest.approx(towards.scale)
    assert moving(-0.3 * 0.8, 0.8).scale == 1.0  # drawing back more than across


def test_who_stands_still_may_start() -> None:
    assert pair(0.5, 0.5, -1.0).required == pytest.approx(needed(0.5, OPTIONS.least_speed))


def test_unknown_places_are_left_out_and_nobody_is_infinitely_far() -> None:
    assert pair(np.nan, 0.5, 0.0) == Separation()


def test_nearest_points_against_a_fine_grid() -> None:
    rng = np.random.default_rng(0)
    grid = np.linspace(0, 1, 201)
    for _ in range(50):
        a0, a1, b0, b1 = rng.normal(size=(4, 3))
        s, t = closest_points(np.concatenate([a0, a1]), np.concatenate([b0, b1]))
        found = np.linalg.norm(a0 + s * (a1 - a0) - b0 - t * (b1 - b0))
        first = a0 + grid[:, None] * (a1 - a0)
        second = b0 + grid[:, None] * (b1 - b0)
        brute = np.linalg.norm(first[:, None] - second[None], axis=-1).min()
        assert found <= brute + 1e-12
        assert found >= brute - 0.05


def test_pairs_passed_over_change_nothing() -> None:
    """Of many capsules, the same as of each alone; and where the share of the speed alone is wanted, the same share."""
    rng = np.random.default_rng(1)
    for _ in range(30):
        arm, people = (
            Moving(np.c_[rng.normal(size=(5, 6)), np.full(5, 0.1)], rng.normal(size=(5, 6)), np.full(5, 0.05))
            for _ in range(2)
        )
        alone = [
            separation(Moving(*(x[[i]] for x in arm)), Moving(*(x[[j]] for x in people)), OPTIONS)
            for i in range(5) for j in range(5)
        ]  # fmt: skip
        worst = min(alone, key=lambda each: each.margin)
        least, scale = min(each.distance for each in alone), min(each.scale for each in alone)
        assert separation(arm, people, OPTIONS) == Separation(least, worst.required, worst.margin, scale)
        assert compare(arm, people, OPTIONS, 0.0, True)[3] == scale
