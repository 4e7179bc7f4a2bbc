"""Which cube next, with hysteresis; postures and straight ways at it."""

from __future__ import annotations

import numpy as np

from kinecast.robot.cell import Cell
from kinecast.robot.pick_place import VERTICAL, TaskSequence, nearest, postures, straight
from kinecast.robot.ur5 import UR5

CELL = Cell()
ORDER = CELL.order
START = np.array([-0.9, -1.5, -1.6, -1.6, 1.57, 0.0])


def test_order_is_kept_while_nobody_reaches_for_anything() -> None:
    sequence = TaskSequence(ORDER)
    sequence.update(0.0, dict.fromkeys(ORDER, 0.1))
    assert not any(map(sequence.is_taken, ORDER))
    sequence.finish("red", 0.0)
    assert sequence.remaining == ["green", "blue"]


def test_a_cube_that_is_reached_for_is_taken_and_comes_back_later() -> None:
    sequence = TaskSequence(ORDER)
    sequence.finish("red", 0.0)
    sequence.update(0.0, {"green": 0.6, "blue": 0.0})
    assert sequence.is_taken("green")
    sequence.update(1.0, {"green": 0.1})
    assert sequence.is_taken("green"), "not free at once"
    sequence.update(1.49, {"green": 0.1})
    assert sequence.is_taken("green")
    sequence.update(1.5, {"green": 0.1})
    assert not sequence.is_taken("green")


def test_a_probability_between_the_thresholds_changes_nothing() -> None:
    sequence = TaskSequence(ORDER)
    sequence.update(0.0, {"red": 0.4})
    assert not sequence.is_taken("red")
    sequence.update(0.1, {"red": 0.5})
    for k in range(20):
        sequence.update(0.2 + 0.1 * k, {"red": 0.15 if k % 2 else 0.3})
        assert sequence.is_taken("red"), "each rise starts the waiting anew"


def test_what_is_given_up_is_left_no_more() -> None:
    sequence = TaskSequence(ORDER)
    sequence.finish("green", 0.0)
    sequence.give_up()
    assert sequence.remaining == []
    assert sequence.given_up == ["red", "blue"]


def test_straight_lines_are_straight_and_keep_the_tool_turned(arm: UR5) -> None:
    red = CELL.cubes[0]
    q = nearest(postures(arm, CELL.grasp(red.position, CELL.hover), CELL.hover), START, arm.q_range)[0]
    down = CELL.grasp(red.position)[:3, 3]
    way = straight(arm, q, down, 5.0)
    assert way is not None
    poses = [arm.forward_kinematics(way.at(t)) for t in np.linspace(way.times[0], way.times[-1], 60)]
    places = np.array([pose[:3, 3] for pose in poses])
    np.testing.assert_allclose(places[:, :2], np.tile(down[:2], (60, 1)), atol=2e-3)
    np.testing.assert_allclose(places[-1], down, atol=1e-6)
    assert all(pose[2, 2] < -0.999 for pose in poses)
    assert np.abs(np.diff(places[:, 2])).max() / (way.duration / 59) < 1.1 * VERTICAL
    assert straight(arm, q, np.array([2.0, 0.0, 0.0]), 0.0) is None


def test_postures_hold_the_tool_there_and_the_nearest_comes_first(arm: UR5) -> None:
    T = CELL.grasp(CELL.cubes[1].position, CELL.hover)
    rows = postures(arm, T, CELL.hover)
    assert len(rows) >= 4
    for q in rows:
        np.testing.assert_allclose(arm.forward_kinematics(q)[:3, 3], T[:3, 3], atol=1e-9)
    ways = np.abs(nearest(rows, START, arm.q_range) - START).max(axis=1)
    assert np.all(np.diff(ways) >= 0)
    far = T.copy()
    far[0, 3] = 3.0
    assert postures(arm, far).shape == (0, 6)
