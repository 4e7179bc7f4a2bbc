"""Slower at once, faster gently; words that do not flicker."""

from __future__ import annotations

import pytest

from kinecast.robot.conduct import Conduct, Level
from kinecast.robot.pace import Pace, Restraint
from kinecast.robot.separation import Separation

DT = 0.01


def pace(speed: float, restraint: Restraint) -> Pace:
    return Pace(speed, restraint, Separation())


def through(conduct: Conduct, paces: list[Pace], start: float = DT) -> list[tuple[float, Level, Restraint]]:
    """Speed, level and cause after each of the paces, one a control step."""
    states = []
    for k, each in enumerate(paces):
        conduct.update(each, each.speed, start + k * DT)
        states.append((conduct.speed, conduct.level, conduct.cause))
    return states


def test_it_brakes_at_once_and_speeds_up_gently() -> None:
    conduct = Conduct(rise=3.0, settle=0.15)
    conduct.begin(at_rest=True)
    braked, *rising = through(conduct, [pace(0.1, Restraint.DOUBT)] + [pace(1.0, Restraint.NOTHING)] * 40)
    assert braked == (0.1, Level.SLOW, Restraint.DOUBT)
    assert rising[0][0] == pytest.approx(0.1 + 3.0 * DT)
    assert rising[-1] == (1.0, Level.FULL, Restraint.NOTHING)


def test_what_flickers_is_said_once() -> None:
    conduct = Conduct(rise=3.0, settle=0.15)
    flicker = [
        pace(0.0, Restraint.SEPARATION), pace(0.03, Restraint.DOUBT), pace(0.0, Restraint.SEPARATION),
        pace(1.0, Restraint.NOTHING),
    ] * 20  # fmt: skip
    assert {state[1:] for state in through(conduct, flicker)} == {(Level.HELD, Restraint.SEPARATION)}


def test_what_lasts_is_said() -> None:
    conduct = Conduct(rise=3.0, settle=0.15)
    states = through(conduct, [pace(0.0, Restraint.SEPARATION)] * 5 + [pace(0.4, Restraint.DOUBT)] * 30)
    changes = [k for k in range(1, len(states)) if states[k][1:] != states[k - 1][1:]]
    assert states[-1][1:] == (Level.SLOW, Restraint.DOUBT)
    assert [(k - 4) * DT for k in changes] == pytest.approx([0.15], abs=2 * DT)


@pytest.mark.parametrize("cause", [Restraint.SILENCE, Restraint.UNSEEN])
def test_that_nothing_is_known_is_said_at_once_and_so_is_that_something_is_again(cause: Restraint) -> None:
    conduct = Conduct(rise=3.0, settle=0.15)
    paces = [pace(0.3, Restraint.DOUBT), pace(0.0, cause), pace(0.3, Restraint.DOUBT)]
    assert [state[2] for state in through(conduct, paces)] == [Restraint.DOUBT, cause, Restraint.DOUBT]
