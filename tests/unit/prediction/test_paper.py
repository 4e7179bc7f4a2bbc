"""The paper's three methods: free or constrained they share one law, and each sees only what the paper lets it see."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from kinecast.body.limits import AngleLimit, JointLimits
from kinecast.body.posture import points_from_postures, postures_from_points
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Sphere
from kinecast.prediction.method import Method, forecast_in_scene
from kinecast.prediction.observation import Observation
from kinecast.prediction.paper import PostureSeries
from kinecast.prediction.rollout import BONES, SERIES
from kinecast.prediction.training_windows import TrainingWindows

EVERYTHING = AngleLimit(-2 * math.pi, 2 * math.pi, math.inf)
LOOSE = JointLimits(EVERYTHING, EVERYTHING, EVERYTHING, EVERYTHING)


def test_limits_and_scene_that_never_bind_leave_law_and_density(
    trained: dict[str, Method[Any]], posed: Observation
) -> None:
    free = forecast_in_scene(trained["gp_angles"], None, posed, np.random.default_rng(0), 300, None)
    far = Scene((Sphere(np.array([9.0, 9.0, 9.0]), 0.1),))
    held = forecast_in_scene(
        replace(trained["gp_angles"], limits=LOOSE), None, posed, np.random.default_rng(0), 300, far
    )
    np.testing.assert_array_equal(held.samples, free.samples)
    assert held.accepted_fraction == 1.0
    assert held.effective_sample_size == 300
    # The sensor's noise is part of each learned spread: split off and added again it changes nothing.
    for pose in free.samples[:20]:
        np.testing.assert_allclose(held.density.log_prob(pose), free.density.log_prob(pose), atol=1e-6)


def test_constrained_and_free_differ_by_their_limits_alone(trained: dict[str, Method[Any]]) -> None:
    free, held = trained["gp_angles"], trained["gp_constrained"]
    assert isinstance(free, PostureSeries)
    assert isinstance(held, PostureSeries)
    assert free.limits is None
    assert held.limits is not None
    for name, array in free.to_arrays().items():
        np.testing.assert_allclose(held.to_arrays()[name], array, err_msg=name)


def test_the_free_methods_disregard_the_scene(trained: dict[str, Method[Any]], posed: Observation) -> None:
    scene = Scene((Sphere(posed.positions[-1, 2], 0.2),))
    for name in ("gp_xyz", "gp_angles"):
        with_scene = forecast_in_scene(trained[name], None, posed, np.random.default_rng(1), 50, scene)
        without = forecast_in_scene(trained[name], None, posed, np.random.default_rng(1), 50, None)
        np.testing.assert_array_equal(with_scene.samples, without.samples)
        assert with_scene.accepted_fraction == 1.0


def test_bones_keep_their_last_length_to_within_what_they_varied_by(
    trained: dict[str, Method[Any]], windows: TrainingWindows, posed: Observation
) -> None:
    method = trained["gp_constrained"]
    samples = posed.to_torso(forecast_in_scene(method, None, posed, np.random.default_rng(2), 2000, None).samples)
    last = postures_from_points(posed.points, continuous=True)[-1, BONES]
    bones = np.stack([np.linalg.norm(samples[:, :, b] - samples[:, :, a], axis=-1) for a, b in
                      ((0, 1), (1, 2), (3, 4), (4, 5))], axis=-1)  # fmt: skip
    # Standard errors of a mean and of a standard deviation.
    spread = method.length_spread
    assert (np.abs(bones.mean(axis=0) - last) < 4 * spread / math.sqrt(2000)).all()
    assert (np.abs(bones.std(axis=0) / spread - 1) < 4 / math.sqrt(4000)).all()
    stray = postures_from_points(windows.future_points, continuous=True)[:, :, BONES]
    assert (spread < 3 * stray.std(axis=(0, 1))).all()


def test_the_mean_is_that_of_the_samples(trained: dict[str, Method[Any]], posed: Observation) -> None:
    for name in ("gp_xyz", "gp_angles", "gp_constrained"):
        forecast = forecast_in_scene(trained[name], None, posed, np.random.default_rng(3), 50, None)
        np.testing.assert_allclose(forecast.mean, forecast.samples.mean(axis=0), atol=1e-12)


def test_positions_know_where_a_person_stands_and_angles_do_not(
    trained: dict[str, Method[Any]], observation: Observation
) -> None:
    elsewhere = replace(observation, positions=observation.positions + np.array([2.0, 1.0, 0.0]))
    shifts = {}
    for name in ("gp_xyz", "gp_angles"):
        here, there = (
            forecast_in_scene(trained[name], None, o, np.random.default_rng(4), 20, None)
            for o in (observation, elsewhere)
        )
        shifts[name] = np.abs(there.mean - here.mean - [2.0, 1.0, 0.0]).max()
    assert shifts["gp_angles"] < 1e-9
    assert shifts["gp_xyz"] > 0.1  # the paper's raw positions do not carry over to other places


def test_still_people_stay_about_where_they_are(trained: dict[str, Method[Any]], observation: Observation) -> None:
    still = replace(observation, positions=np.repeat(observation.positions[-1:], 6, axis=0))
    for name in ("gp_angles", "gp_constrained"):
        mean = forecast_in_scene(trained[name], None, still, np.random.default_rng(5), 300, None).mean
        assert np.linalg.norm(mean - observation.positions[-1], axis=-1).max() < 0.06


def test_a_process_sees_the_last_values_of_its_own_series_alone(
    trained: dict[str, Method[Any]], posed: Observation
) -> None:
    postures = postures_from_points(posed.points, continuous=True)
    bent = postures.copy()
    bent[:, 15] += np.linspace(0.3, 0.0, 6)  # the right elbow's past, not its present
    changed = replace(posed, positions=posed.to_world(points_from_postures(bent)))
    before, after = (
        forecast_in_scene(trained["gp_angles"], None, o, np.random.default_rng(6), 40, None) for o in (posed, changed)
    )
    first = before.density.blocks.rollout.means[:, 0], after.density.blocks.rollout.means[:, 0]
    differs = np.abs(first[0] - first[1]).max(axis=0) > 1e-9
    assert set(np.flatnonzero(differs)) <= {14, 15}
    assert differs.any()


def test_there_is_a_process_for_all_but_the_bones(trained: dict[str, Method[Any]]) -> None:
    assert set(range(18)) - set(SERIES) == set(BONES)
    assert trained["gp_angles"].processes.centre.shape == (len(SERIES),)
    assert trained["gp_xyz"].processes.centre.shape == (18,)
