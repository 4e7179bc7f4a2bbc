"""The benchmark of plans runs, in a tiny setting, and says what it should."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

if find_spec("benchmarks") is None:
    pytest.skip("no benchmarks: they come with the repository", allow_module_level=True)

from benchmarks import planning

from kinecast.robot.collision import CollisionChecker
from kinecast.robot.ur5 import UR5


def test_a_problem_is_free_at_both_ends_and_not_between() -> None:
    checker = CollisionChecker(UR5(), planning.TABLE)
    blocked = 0
    for seed in range(5):
        task = planning.problem(checker, np.random.default_rng(seed))
        ends = np.array([task.start, task.goal])
        assert checker.clearances(ends, np.zeros(2), task.occupancy).min() > 0.02
        between = task.start + np.linspace(0, 1, 50)[:, None] * (task.goal - task.start)
        blocked += checker.clearances(between, np.zeros(50), task.occupancy)[:, 0].min() < 0
        again = planning.problem(checker, np.random.default_rng(seed))
        np.testing.assert_array_equal(task.occupancy.radius, again.occupancy.radius)
    assert blocked >= 4


def test_both_planners_are_timed_and_compared(capsys: pytest.CaptureFixture[str]) -> None:
    result = {
        **planning.random_problems(2, 2.0, look=0.02),
        "descent": planning.descent(2),
        "replan": planning.replans(4),
        "signed_distance": planning.signed_distance(5),
        "cell": planning.decisions(2, limit=1.0),
    }
    assert set(result["planners"]) == {"rrt_connect", "kinecast"}
    assert result["recheck_collisions"] == 0
    assert 0 <= result["share_of_rrt_connect"] <= 1
    assert result["descent"]["waypoints"] == 40
    assert result["replan"]["count"] == 4
    assert result["signed_distance"]["p50_ms"] > 0
    assert result["cell"]["processor"]["decision"]["count"] > result["cell"]["clock"]["decision"]["count"] > 20
    planning.report(result)
    assert "RRTConnect" in capsys.readouterr().out
