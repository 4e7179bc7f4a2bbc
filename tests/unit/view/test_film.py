"""A film of a run, and playing it."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.robot.episode import Scenery
from kinecast.types import Decision, RobotState
from kinecast.view.film import Film
from kinecast.view.playback import Playback


def moment(stamp: float) -> Scenery:
    nothing = np.empty((0, 3))
    decision = Decision(stamp, RobotState.MOVING, "On its way.")
    region = np.empty((0, 0, 2, 3), dtype=np.float32)
    return Scenery(stamp, np.zeros(6), (), {}, region, np.empty((0, 7)), nothing, decision)


def film_of(count: int, capacity: int = 2000) -> Film:
    """So many moments, one a second."""
    film = Film(capacity)
    for stamp in range(count):
        film.add(moment(float(stamp)))
    return film


def stamp_at(film: Film, time: float) -> float:
    found = film.at(time)
    assert found is not None
    return found.stamp


def test_a_film_gives_the_last_moment_not_after_a_time() -> None:
    film = film_of(5)
    assert [stamp_at(film, time) for time in (-1.0, 0.0, 0.9, 1.0, 3.5, 99.0)] == [0, 0, 0, 1, 3, 4]
    assert Film().at(0.0) is None
    assert Film().end == 0.0


@pytest.mark.parametrize("capacity", [2, 3, 50, 51])
def test_a_film_of_any_length_stays_bounded_even_and_whole(capacity: int) -> None:
    film = Film(capacity)
    for stamp in range(1000):
        film.add(moment(float(stamp)))
        assert len(film) <= capacity
        assert stamp_at(film, np.inf) == stamp  # the newest is always there
    assert stamp_at(film, 0.0) == 0.0
    kept = sorted({stamp_at(film, time) for time in np.arange(0.0, 999.0)})
    assert len(kept) >= capacity // 2
    assert len(set(np.diff(kept))) == 1


def test_decisions_are_told_up_to_a_time_newest_first() -> None:
    film = Film()
    for stamp in range(6):
        film.tell(Decision(float(stamp), RobotState.MOVING, str(stamp)))
    assert [each.reason for each in film.decisions(3.5, 3)] == ["3", "2", "1"]
    assert [each.reason for each in film.decisions(0.5, 3)] == ["0"]


def test_playing_waits_at_the_newest_moment_and_stops_at_the_end() -> None:
    film = film_of(3)
    playback = Playback(film)
    playback.advance(1.5)
    assert playback.position == 1.5
    playback.advance(5.0)
    assert playback.position == 2.0
    assert playback.playing  # more may come
    film.add(moment(3.0))
    film.finish("done")
    playback.advance(5.0)
    assert playback.position == 3.0
    assert not playback.playing
    playback.toggle()  # again from the beginning
    assert playback.playing
    assert playback.position == 0.0


def test_pausing_and_going_to_a_time_stand_still() -> None:
    playback = Playback(film_of(11))
    playback.seek(4.0)
    playback.advance(1.0)
    assert playback.position == 4.0
    assert not playback.playing
    playback.seek(99.0)
    assert playback.position == 10.0
    playback.seek(-1.0)
    assert playback.position == 0.0
    playback.toggle()
    playback.pace(0.5)
    playback.advance(1.0)
    assert playback.position == 0.5
    playback.toggle()
    playback.advance(1.0)
    assert playback.position == 0.5
    playback.load(film_of(2))
    assert playback.position == 0.0
    assert playback.playing


def test_bad_values_are_named() -> None:
    with pytest.raises(OptionError, match="capacity is 1"):
        Film(1)
    with pytest.raises(OptionError, match="rate 0"):
        Playback(Film()).pace(0.0)
