"""Probabilities over samples."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest

from kinecast.robot.occupancy import OccupancyOptions
from kinecast.robot.overlap import reach_probabilities
from kinecast.types import Prediction


def two_ways(share: float, samples: int = 100) -> Prediction:
    """The left wrist goes to x = 0.5 with this probability, and stays at x = 1 otherwise."""
    arms = np.array([[1.2, -0.2, 0.5], [1.2, -0.25, 0.2], [1.0, -0.2, 0.1]])
    arms = np.concatenate([arms, arms + np.array([0.0, 2.0, 0.0])])
    drawn = np.repeat(np.repeat(arms[None, None], samples, axis=0), 15, axis=1)
    drawn[: round(share * samples), -1, 2, 0] = 0.5
    times = np.arange(1, 16) / 30
    return Prediction(0.0, times, drawn, drawn.mean(axis=0), np.zeros((15, 6, 3, 3)), ("",) * 6)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.7, 1.0])
def test_probabilities_are_shares_of_samples(share: float) -> None:
    prediction = two_ways(share)
    cubes = np.array([[0.45, -0.2, 0.05], [0.45, 0.6, 0.05]])
    np.testing.assert_allclose(reach_probabilities(prediction, cubes, 0.06), [share, 0.0])


def test_a_limb_that_is_not_known_may_be_anywhere() -> None:
    prediction = two_ways(0.0)
    prediction.samples[:10, 3, 2] = np.nan
    assert reach_probabilities(prediction, np.array([[5.0, 5.0, 5.0]]), 0.1)[0] == pytest.approx(0.1)


def test_radii_are_those_of_the_occupied_space() -> None:
    prediction, cube = two_ways(1.0), np.array([[0.5 - 0.1 - 0.06 - 0.15, -0.2, 0.1]])
    thick = OccupancyOptions(hand=0.3)
    assert reach_probabilities(prediction, cube, 0.06)[0] == 0.0
    assert reach_probabilities(prediction, cube, 0.06, thick)[0] == 1.0
    assert import_module("kinecast.robot.body").TRUE_BODY.hand < OccupancyOptions().hand
