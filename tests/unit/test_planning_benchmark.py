"""The benchmark of plans runs, in a tiny setting, and says what it should."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

if find_spec("benchmarks") is None:
    pytest.skip("no benchmarks: they come with the repository", allow_module_level=True)

from benchmarks import planning

from kinecast.robot.collision import CollisionChecker
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5


def test_a_problem_is_free_at_both_ends_and_not_between() -> None:
    blocked = 0
    for seed in range(5):
        task = planning.problem(np.random.default_rng(seed))
        checker = CollisionChecker(UR5(), task.scene)
        assert not checker.touched(task.start, 0.02)
        assert not checker.touched(task.goal, 0.02)
        blocked += bool(checker.check(Trajectory(np.array([0.0, 1.0]), np.stack([task.start, task.goal]))))
        again = planning.problem(np.random.default_rng(seed))
        np.testing.assert_array_equal(task.scene.rows(np.zeros(1)), again.scene.rows(np.zeros(1)))
    assert blocked >= 4


def test_both_planners_are_timed_and_compared(capsys: pytest.CaptureFixture[str]) -> None:
    result = {
        **planning.random_problems(2, 1.0),
        "descent": planning.descent(1),
        "cell": planning.decisions(1, limit=1.0),
    }
    assert set(result["planners"]) == {"rrt_connect", "kinecast"}
    assert result["recheck_collisions"] == 0
    assert 0 <= result["share_of_rrt_connect"] <= 1
    assert result["descent"]["waypoints"] == 40
    assert result["cell"]["decision"]["count"] > 20
    planning.report(result)
    assert "RRTConnect" in capsys.readouterr().out
