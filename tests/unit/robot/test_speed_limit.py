"""Slower at once, faster gently; words that do not flicker."""

from __future__ import annotations

import pytest

from kinecast.robot.separation import Separation
from kinecast.robot.speed_limit import FULL, HELD, SLOW, LimitReason, SpeedHysteresis, SpeedLimit

DT = 0.01


def limit(speed: float, reason: LimitReason) -> SpeedLimit:
    return SpeedLimit(speed, reason, Separation())


def through(
    going: SpeedHysteresis, limits: list[SpeedLimit], start: float = DT
) -> list[tuple[float, int, LimitReason]]:
    """Speed, level and cause after each of the limits, one a control step."""
    states = []
    for k, each in enumerate(limits):
        going.update(each, each.speed, start + k * DT)
        states.append((going.speed, going.level, going.reason))
    return states


def test_it_brakes_at_once_and_speeds_up_gently() -> None:
    going = SpeedHysteresis()
    going.begin()
    braked, *rising = through(going, [limit(0.1, LimitReason.DOUBT)] + [limit(1.0, LimitReason.NOTHING)] * 40)
    assert braked == (0.1, SLOW, LimitReason.DOUBT)
    assert rising[0][0] == pytest.approx(0.1 + 3.0 * DT)
    assert rising[-1] == (1.0, FULL, LimitReason.NOTHING)


def test_what_flickers_is_said_once() -> None:
    going = SpeedHysteresis()
    flicker = [
        limit(0.0, LimitReason.SEPARATION), limit(0.03, LimitReason.DOUBT), limit(0.0, LimitReason.SEPARATION),
        limit(1.0, LimitReason.NOTHING),
    ] * 20  # fmt: skip
    assert {state[1:] for state in through(going, flicker)} == {(HELD, LimitReason.SEPARATION)}


def test_what_lasts_is_said() -> None:
    going = SpeedHysteresis()
    states = through(going, [limit(0.0, LimitReason.SEPARATION)] * 5 + [limit(0.4, LimitReason.DOUBT)] * 30)
    changes = [k for k in range(1, len(states)) if states[k][1:] != states[k - 1][1:]]
    assert states[-1][1:] == (SLOW, LimitReason.DOUBT)
    assert [(k - 4) * DT for k in changes] == pytest.approx([0.15], abs=2 * DT)


@pytest.mark.parametrize("cause", [LimitReason.SILENCE, LimitReason.UNSEEN])
def test_that_nothing_is_known_is_said_at_once_and_so_is_that_something_is_again(cause: LimitReason) -> None:
    going = SpeedHysteresis()
    limits = [limit(0.3, LimitReason.DOUBT), limit(0.0, cause), limit(0.3, LimitReason.DOUBT)]
    assert [state[2] for state in through(going, limits)] == [LimitReason.DOUBT, cause, LimitReason.DOUBT]
