"""A sink's attempts: none raises, and a fault is told once."""

from __future__ import annotations

import pytest

from kinecast.live.attempts import Attempts


def fails(error: Exception) -> None:
    raise error


def test_what_goes_well_is_done() -> None:
    done: list[int] = []
    attempts = Attempts("sink", "sent", OSError)
    assert attempts.succeeds(done.append, 1)
    assert (done, attempts.failure) == ([1], None)


def test_a_fault_costs_one_and_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    done: list[int] = []
    attempts = Attempts("sink", "drawn", OSError)
    assert not attempts.succeeds(fails, ValueError("odd"))
    assert not attempts.succeeds(fails, ValueError("odd"))
    assert attempts.succeeds(done.append, 1)
    assert attempts.failure is None
    assert caplog.text.count("sink: a prediction could not be drawn") == 1


def test_after_a_fatal_one_nothing_more_is_tried(caplog: pytest.LogCaptureFixture) -> None:
    done: list[int] = []
    attempts = Attempts("sink", "written", OSError)
    assert not attempts.succeeds(fails, OSError("disc full"))
    assert not attempts.succeeds(done.append, 1)
    attempts.fail(OSError("later"))
    assert (done, attempts.failure) == ([], "sink: disc full")
    assert caplog.text.count("nothing more is written") == 1
    assert "later" not in caplog.text


def test_without_fatal_errors_it_goes_on() -> None:
    attempts = Attempts("sink", "sent")
    assert not attempts.succeeds(fails, OSError("away"))
    assert attempts.succeeds(int)
    assert attempts.failure is None
