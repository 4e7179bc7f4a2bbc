"""What the benchmark of context counts as a reach, a place and a goal; the rest of it is the evaluation's."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

if find_spec("benchmarks") is None:
    pytest.skip("no benchmarks: they come with the repository", allow_module_level=True)

from benchmarks import context
from benchmarks.generated_people import table_scene

from kinecast.datasets.reaching import Fetch, fetching
from kinecast.prediction.kinecast.model import Kinecast
from kinecast.prediction.method import shortened
from kinecast.prediction.methods import shipped_methods

SCENE = table_scene()
GOALS = {name: SCENE.goals[name] for name in context.CUBES}


def test_a_reach_is_from_where_a_hand_sets_out_to_where_it_stops() -> None:
    person = fetching([Fetch(1.0, GOALS["red_cube"].center, hold=1.0)], 5.0, seed=0, rate=30.0)
    there, back = context.reaches(person.joint("left_wrist"), 30.0)
    assert there[0] == pytest.approx(30, abs=6)
    assert there[1] < back[0]
    assert SCENE.regions.distance(person.joint("left_wrist")[there[1]]).min() < context.CLOSE
    assert context.reaches(person.joint("right_wrist"), 30.0) == []


def test_places_are_where_wrists_rested() -> None:
    person = fetching([Fetch(1.0, GOALS["red_cube"].center, hold=3.0)], 8.0, seed=0, rate=30.0)
    found = [shape.center for shape in context.places([person]).values()]
    assert 3 <= len(found) <= context.MOST
    for place in (GOALS["red_cube"].center, person.joint("left_wrist")[10], person.joint("right_wrist")[10]):
        assert np.linalg.norm(np.array(found) - place, axis=1).min() < 0.06


def test_moved_goals_and_people_who_ignore_them_keep_their_distance() -> None:
    away = context.moved(GOALS, 0.15, np.random.default_rng(0))
    for goal, shape in GOALS.items():
        assert np.linalg.norm(away[goal].center - shape.center) == pytest.approx(0.15)
    person = context.elsewhere(GOALS, 3)
    for side in ("left", "right"):
        path = person.joint(f"{side}_wrist")
        for _, last in context.reaches(path, 30.0):
            assert replace(SCENE, goals=GOALS).regions.distance(path[last]).min() > context.CLOSE


def test_goals_are_told_better_late_than_early() -> None:
    method = shortened(shipped_methods()[1]["kinecast"], 0.5)
    assert isinstance(method, Kinecast)
    fetches = [Fetch(1.0 + 3 * k, GOALS[goal].center, 0.5) for k, goal in enumerate(("red_cube", "blue_cube"))]
    person = fetching(fetches, 7.0, seed=1, rate=30.0)
    told = context.accuracy(method, replace(SCENE, goals=GOALS), [person], [person])
    assert told["uniform_log_loss"] == pytest.approx(np.log(6))
    assert sum(told[part]["frames"] for part in told if part.endswith("third")) == told["all"]["frames"]
    assert told["last third"]["log_loss_to_goals"] < told["first third"]["log_loss_to_goals"]
    assert told["last third"]["accuracy_to_goals"] > 0.8
