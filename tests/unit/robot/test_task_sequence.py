"""Which cube next, with hysteresis."""

from __future__ import annotations

from kinecast.robot.task_sequence import TaskSequence

ORDER = ("red", "green", "blue")


def test_order_is_kept_while_nobody_reaches_for_anything() -> None:
    sequence = TaskSequence(ORDER)
    sequence.update(0.0, dict.fromkeys(ORDER, 0.1))
    assert not any(map(sequence.is_taken, ORDER))
    sequence.finish("red")
    assert sequence.remaining == ["green", "blue"]


def test_a_cube_that_is_reached_for_is_taken_and_comes_back_later() -> None:
    sequence = TaskSequence(ORDER)
    sequence.finish("red")
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
    sequence.give_up("red")
    assert sequence.remaining == ["green", "blue"]
    assert sequence.given_up == ["red"]
