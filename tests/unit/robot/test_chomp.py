"""The descent: the smoothest path without obstacles, a free one past them."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.geometry.shapes import Capsule
from kinecast.geometry.transforms import apply
from kinecast.robot.cell import CAMERA
from kinecast.robot.chomp import Chomp, People
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.trajectory import Trajectory, minimum_jerk
from kinecast.robot.ur5 import UR5

from .conftest import AWAY, HOME, POST, SEALED, posts

TIMES = np.linspace(0, 2, 40)
STRAIGHT = HOME + minimum_jerk(40)[:, None] * (AWAY - HOME)


def among(arm: UR5, *rows: list[float]) -> Chomp:
    return Chomp(arm, posts(*rows).rows(np.zeros(1))[0])


def test_what_pushes_is_the_derivative_of_the_cost(arm: UR5, monkeypatch: pytest.MonkeyPatch) -> None:
    """∇U of the inner waypoints by finite differences of ∫ c |x'| dt, summed over body points."""
    monkeypatch.setattr("kinecast.robot.chomp.SLOWEST", 1e-9)
    chomp = among(arm, POST)
    shapes = [*posts(POST).obstacles, Capsule(arm.pedestal[:3], arm.pedestal[3:6], arm.pedestal[6])]

    def cost(q: np.ndarray) -> float:
        places = apply(arm.frames(q)[:, chomp._joint], chomp._sites)
        far = np.array([shape.signed_distance(places) for shape in shapes])
        far[np.broadcast_to(~chomp._meets[:, None], far.shape)] = np.inf
        gap = far.min(axis=0) - chomp._radius - 0.005
        price = np.where(gap < 0, 0.025 - gap, np.where(gap < 0.05, 0.5 * (gap - 0.05) ** 2 / 0.05, 0.0))
        return float((0.5 * (price[1:] + price[:-1]) * np.linalg.norm(np.diff(places, axis=0), axis=-1)).sum())

    fine = HOME + np.linspace(0, 1, 400)[:, None] * (AWAY - HOME)  # evenly, so that nothing is at rest
    _, torque = chomp._forces(fine, 0.005, None)
    for seed in range(3):
        turn = np.random.default_rng(seed).normal(size=6)
        bump = np.sin(np.pi * np.linspace(0, 1, 400))[:, None] ** 2 * turn
        slope = (cost(fine + 1e-5 * bump) - cost(fine - 1e-5 * bump)) / 2e-5
        assert float((torque * bump[1:-1]).sum()) == pytest.approx(slope, rel=0.05)


def test_without_obstacles_nothing_moves(arm: UR5) -> None:
    path, excess = Chomp(arm, np.empty((0, 17))).optimise(STRAIGHT, 0.005)
    np.testing.assert_allclose(path, STRAIGHT, atol=1e-12)
    assert excess > 0


def test_it_goes_around_keeps_its_ends_and_answers_the_same_again(arm: UR5) -> None:
    checker = CollisionChecker(arm, posts(POST))
    assert checker.check(Trajectory(TIMES, STRAIGHT))
    path, excess = among(arm, POST).optimise(STRAIGHT, 0.02)
    assert excess > 0
    np.testing.assert_array_equal(path[[0, -1]], STRAIGHT[[0, -1]])
    assert not checker.check(Trajectory(TIMES, path))
    np.testing.assert_array_equal(path, among(arm, POST).optimise(STRAIGHT, 0.02)[0])


def test_it_knows_when_people_are_beside_it(arm: UR5) -> None:
    """Somebody who is gone before the arm comes, or comes after it has passed, changes nothing."""
    gone = np.array(POST) + np.array([9.0, 0, 0, 9, 0, 0, 0])
    rows = np.tile(gone, (40, 1, 1))
    for here, moves in ((slice(0, 4), False), (slice(36, 40), False), (slice(0, 40), True)):
        capsules = rows.copy()
        capsules[here] = POST
        path, _ = among(arm).optimise(STRAIGHT, 0.005, People(capsules, CAMERA))
        assert (np.abs(path - STRAIGHT).max() > 0.05) == moves


def test_the_price_of_people_is_the_time_lost_and_its_slope_the_derivative() -> None:
    people = People(np.empty((40, 1, 7)), CAMERA)
    distance = np.linspace(-0.2, 1.5, 200)
    price, slope = people.price(distance)
    numeric = (people.price(distance + 1e-6)[0] - people.price(distance - 1e-6)[0]) / 2e-6
    assert np.abs(slope - numeric).max() < 1e-4
    assert price[-1] == 0
    assert (np.diff(price) <= 0).all()
    assert slope.min() == pytest.approx(-0.3)


def test_angles_stay_within_their_range() -> None:
    tight = UR5()
    tight.q_range = np.stack([STRAIGHT.min(axis=0) - 0.02, STRAIGHT.max(axis=0) + 0.02], axis=1)
    path, _ = among(tight, POST).optimise(STRAIGHT, 0.02)
    assert (path >= tight.q_range[:, 0] - 1e-12).all()
    assert (path <= tight.q_range[:, 1] + 1e-12).all()


def test_where_there_is_no_way_it_says_so(arm: UR5) -> None:
    _, excess = among(arm, *SEALED).optimise(STRAIGHT, 0.005)
    assert excess < 0
