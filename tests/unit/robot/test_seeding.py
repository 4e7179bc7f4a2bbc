"""Paths by RRTConnect: free, shortened, the same for the same seed."""

from __future__ import annotations

import numpy as np

from kinecast.robot.collision import CollisionChecker
from kinecast.robot.seeding import Seeder, evenly

from .conftest import HOME, staying

AWAY = HOME + np.array([-1.5, 0, 0, 0, 0, 0])
WALL = staying(*[[-0.9, 0.0, z, -0.42, 0.0, z, 0.06] for z in (0.1, 0.25, 0.4, 0.55)])
MARGINS = (0.01, 0.0, 0.0)


def seeder(checker: CollisionChecker) -> Seeder:
    return Seeder(checker, WALL, np.zeros(1), MARGINS)


def test_a_path_leads_from_the_start_to_a_goal_and_is_free(checker: CollisionChecker) -> None:
    search = seeder(checker)
    assert not search.edge_is_free(HOME, AWAY)
    corners = search.path(HOME, AWAY[None], 20.0, 5000)
    assert corners is not None
    np.testing.assert_allclose(corners[[0, -1]], [HOME, AWAY], atol=1e-12)
    finely = evenly(corners, np.linspace(0, 1, 800))
    clear = checker.clearances(finely, np.zeros(800), WALL)
    assert clear[:, 0].min() > 0.0
    assert clear.min() > -1e-3


def test_the_same_seed_finds_the_same_path_and_another_another(checker: CollisionChecker) -> None:
    paths = [seeder(checker).path(HOME, AWAY[None], 20.0, 5000, seed) for seed in (3, 4, 3)]
    assert all(path is not None for path in paths)
    np.testing.assert_array_equal(paths[0], paths[2])
    assert paths[0].shape != paths[1].shape or not np.allclose(paths[0], paths[1])


def test_it_stops_when_iterations_or_time_are_over(checker: CollisionChecker) -> None:
    everywhere = staying(*[[-1.2, 0.0, z, 1.2, 0.0, z, 0.15] for z in np.arange(0.0, 1.6, 0.2)])
    for seconds, iterations in ((30.0, 50), (0.2, 10**9)):
        assert Seeder(checker, everywhere, np.zeros(1), MARGINS).path(HOME, AWAY[None], seconds, iterations) is None


def test_a_blocked_end_has_no_path(checker: CollisionChecker) -> None:
    assert Seeder(checker, staying([-0.4, -0.3, 0.1, -0.4, -0.3, 0.4, 0.1]), np.zeros(1), MARGINS).path(
        HOME, AWAY[None], 1.0, 10
    ) is None  # fmt: skip


def test_places_are_evenly_spread_along_the_legs() -> None:
    corners = np.array([[0.0] * 6, [1.0] + [0.0] * 5, [1.0] + [0.0] * 5, [1.0, 3.0] + [0.0] * 4])
    places = evenly(corners, np.linspace(0, 1, 5))
    np.testing.assert_allclose(places[:, :2], [[0, 0], [1, 0], [1, 1], [1, 2], [1, 3]], atol=1e-12)
