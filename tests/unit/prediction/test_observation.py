"""Windows in the torso frame: nothing depends on where a person stands."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinecast.prediction.method import Method, forecast_in_scene
from kinecast.prediction.observation import Observation, reference_frame
from kinecast.prediction.training_windows import TrainingWindows

SOMEWHERE = Rotation.from_euler("zyx", [100.0, 20.0, -30.0], degrees=True).as_matrix(), np.array([3.0, -2.0, 0.7])


def moved(observation: Observation) -> Observation:
    """The same window of a person somewhere else, turned about all axes, gravity with them."""
    rotation, shift = SOMEWHERE
    return replace(observation, positions=observation.positions @ rotation.T + shift, up=rotation @ observation.up)


def test_the_torso_frame_is_right_handed_and_as_defined(observation: Observation) -> None:
    rotation, origin = observation.frame
    left, right = observation.positions[-1, 0], observation.positions[-1, 3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(origin, 0.5 * (left + right))
    np.testing.assert_allclose(rotation[:, 1], (left - right) / np.linalg.norm(left - right))
    assert rotation[:, 2] @ observation.up > 0.9


def test_the_length_of_up_does_not_matter(observation: Observation) -> None:
    for scale in (1e-6, 1e6):
        rotation, _ = reference_frame(observation.positions[-1], scale * observation.up)
        np.testing.assert_allclose(rotation, observation.frame[0], atol=1e-12)


def test_points_are_the_same_wherever_the_person_stands(observation: Observation) -> None:
    np.testing.assert_allclose(moved(observation).points, observation.points, atol=1e-12)


def test_to_world_undoes_to_torso(observation: Observation) -> None:
    there_and_back = observation.to_world(observation.to_torso(observation.positions))
    np.testing.assert_allclose(there_and_back, observation.positions, atol=1e-14)


def test_times_follow_the_stamp(observation: Observation) -> None:
    np.testing.assert_allclose(observation.times(3), 100.0 + observation.dt * np.array([1, 2, 3]))


# gp_xyz is the paper's: raw world positions, and so not equivariant, on purpose.
@pytest.mark.parametrize("name", ["damped_velocity", "ridge", "kalman_constrained", "ridge_angles", "gp_constrained"])
def test_a_forecast_moves_along_with_the_person(
    trained: dict[str, Method[Any]], observation: Observation, windows: TrainingWindows, name: str
) -> None:
    rotation, shift = SOMEWHERE
    here = forecast_in_scene(trained[name], None, observation, np.random.default_rng(3), 40, None)
    there = forecast_in_scene(trained[name], None, moved(observation), np.random.default_rng(3), 40, None)
    np.testing.assert_allclose(there.samples, here.samples @ rotation.T + shift, atol=1e-7)
    np.testing.assert_allclose(there.mean, here.mean @ rotation.T + shift, atol=1e-7)
    truth = windows.future[60]
    np.testing.assert_allclose(
        there.density.log_prob(truth @ rotation.T + shift), here.density.log_prob(truth), atol=1e-4
    )
