"""Windows in the torso frame: nothing depends on where a person stands, and folds keep recordings whole."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Sphere
from kinecast.prediction.method import Method, forecast_in_scene
from kinecast.prediction.observation import Observation, TrainingWindows, reference_frame

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


def test_training_windows_are_seen_as_observations_are(windows: TrainingWindows, observation: Observation) -> None:
    np.testing.assert_allclose(windows.points[60], observation.points, atol=1e-6)  # single precision
    np.testing.assert_allclose(windows.future_points[60], observation.to_torso(windows.future[60]), atol=1e-6)


def owned(group: list[int], collection: list[int] | None = None, subject: list[int] | None = None) -> TrainingWindows:
    """Windows that only know what they belong to."""
    count = len(group)
    return TrainingWindows(
        observed=np.zeros((count, 2, 6, 3)),
        future=np.zeros((count, 1, 6, 3)),
        up=np.zeros((count, 3)),
        recording=np.array(group),
        dt=0.1,
        frame=np.arange(count),
        group=np.array(group),
        collection=np.array(collection or group),
        subject=np.array(subject or group),
    )


@pytest.mark.parametrize(("groups", "count"), [(7, 2), (7, 3), (7, 4), (3, 4), (2, 4)])
def test_folds_never_split_a_recording_or_task(groups: int, count: int) -> None:
    group = np.repeat(np.arange(groups), np.random.default_rng(count).integers(1, 40, groups))
    folds = owned(group.tolist()).folds(count)
    assert set(folds) == set(range(min(count, groups)))
    for owner in range(groups):
        assert len(set(folds[group == owner])) == 1


def test_folds_are_of_like_size() -> None:
    folds = owned([0] * 60 + [1] * 30 + [2] * 30 + [3] * 20 + [4] * 20 + [5] * 20).folds(3)
    assert np.ptp(np.bincount(folds)) <= 20  # the least group


def test_a_single_group_is_cut_into_blocks_of_time() -> None:
    np.testing.assert_array_equal(owned([5] * 10).folds(4), [0, 0, 0, 1, 1, 2, 2, 2, 3, 3])


def test_no_collection_and_no_person_drowns_the_others() -> None:
    collection, subject = [0] * 100 + [1] * 16, [0] * 64 + [1] * 36 + [2] * 16
    windows = owned([0] * 116, collection, subject)
    shares = windows.shares(np.arange(116))
    assert shares.sum() == pytest.approx(1.0)
    assert shares[:100].sum() / shares[100:].sum() == pytest.approx(10 / 4)
    assert shares[:64].sum() / shares[64:100].sum() == pytest.approx(8 / 6)
    np.testing.assert_allclose(windows.shares(np.arange(100, 116)), 1 / 16)


def test_windows_that_end_in_an_obstacle_are_left_out(windows: TrainingWindows) -> None:
    wrist = windows.observed[10, -1, 2]
    outside = windows.outside(Scene((Sphere(wrist, 0.02),)))
    assert 0 < len(outside) < len(windows)
    distances = np.linalg.norm(outside.observed[:, -1, 2] - wrist, axis=-1)
    assert distances.min() > 0.02
    assert len(windows.outside(Scene())) == len(windows)
