"""What the benchmark of generalisation trains on, chooses and scores by itself; the rest of it is the evaluation's."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

if find_spec("benchmarks") is None:
    pytest.skip("no benchmarks: they come with the repository", allow_module_level=True)

from benchmarks import generalisation, generalisation_scores
from benchmarks.generated_people import SyntheticOptions, generate

from kinecast.errors import OptionError
from kinecast.prediction.methods import read_shipped
from kinecast.prediction.observation import STANDING, Observation

SEEN = Observation(np.tile(STANDING, (6, 1, 1)), np.array([0.0, 0.0, 1.0]), 1.0 / 30.0)


def test_no_split_trains_on_what_it_tests_or_on_what_is_only_tested() -> None:
    splits = list(generalisation.splits())
    assert len(splits) == 8 + 3 + 6 + 1
    assert all(split.tested not in split.training for split in splits)
    left_out = {split.name: split for split in splits[:11]}
    assert not any(folder in split.training for split in splits[:-1] for folder in generalisation.ONLY_TESTED)
    assert "ui_prmd_kinect" not in left_out["ui_prmd_vicon"].training
    assert left_out["ui_prmd_kinect"].model == left_out["ui_prmd_vicon"].model
    assert set(left_out["mhad"].training) == {folder for folders in generalisation.SETS.values() for folder in folders}


def test_recordings_are_spread_over_subjects_and_tasks() -> None:
    [one] = generate(SyntheticOptions(subjects=1, recordings=1, duration=2.0), seed=0)
    many = [replace(one, name=f"{k}", subject=f"s{k % 3}", task=f"t{k % 2}") for k in range(60)]
    chosen = generalisation.spread(many, 12)
    assert len(chosen) == 12
    pairs = [(each.subject, each.task) for each in chosen]
    assert all(pairs.count(pair) == 2 for pair in pairs)
    assert generalisation.spread(many, 60) == many


def test_windows_are_drawn_from_all_frames_of_all_recordings() -> None:
    many = generate(SyntheticOptions(subjects=2, recordings=10, duration=4.0), seed=0)
    recordings, about = generalisation.scored_on(many, 60)
    frames = np.concatenate([each.frames for each in recordings])
    assert about["windows"] == len(frames) == 60
    assert np.mean(frames == 5) < 0.1  # a stride would begin every recording with its first window
    whole, _ = generalisation.scored_on(many, 10**6)
    assert sum(len(each.frames) for each in whole) == about["windows_of"]
    truth = {(each.name, at): future for each in whole for at, future in zip(each.frames, each.future, strict=True)}
    for each in recordings:
        for at, future in zip(each.frames, each.future, strict=True):
            np.testing.assert_array_equal(future, truth[each.name, at])


def test_a_longer_prediction_is_cut_and_keeps_its_density() -> None:
    _, method = read_shipped("zero_velocity")
    truth = np.tile(STANDING, (5, 1, 1)) + 0.01
    watched = generalisation_scores.Watched(method, 5, {id(SEEN): truth}, motions=True)
    state = watched.update(watched.init_state(), SEEN, STANDING)
    whole = method.forecast(state, SEEN, np.random.default_rng(0), 50)
    forecast = watched.forecast(state, SEEN, np.random.default_rng(0), 50)
    assert forecast.samples.shape == (50, 5, 6, 3)
    padded = np.concatenate([truth, np.tile(truth[-1], (method.steps - 5, 1, 1))])
    np.testing.assert_allclose(forecast.density.log_prob(truth), whole.density.log_prob(padded)[:5])
    [note] = watched.notes
    assert note.paths.shape == (1 + generalisation_scores.DRAWN, 3 + 5, 2, 3)
    found = generalisation_scores.summary(watched.notes, np.array([0.2]))
    assert found["followed"]["at first"]["mpjpe_mm"] == pytest.approx(1e3 * note.error.mean())
    assert [found["followed"][name]["windows"] for name in ("at first", "later")] == [1, 0]
    assert [found["coverage_by_speed"][name]["joints"] for name in ("rest", "slow", "fast")] == [6, 0, 0]
    assert found["tubes"]["reach"]["motions"] == 1.0
    with pytest.raises(OptionError, match="steps"):
        generalisation_scores.Watched(method, method.steps + 1, {})


def test_reach_is_a_capsule_that_grows_with_a_persons_speed() -> None:
    tubes = generalisation_scores.reach(SEEN, 15)
    np.testing.assert_allclose(tubes.radius[-1], 0.8)
    length = np.linalg.norm(STANDING[1] - STANDING[0])
    expected = np.pi * 0.8**2 * length + 4.0 / 3.0 * np.pi * 0.8**3
    assert generalisation_scores.volume(tubes)[-1, 0] == pytest.approx(expected)
    moved = np.tile(STANDING, (15, 1, 1))
    moved[:, 2] += [0.0, 0.4, 0.0]  # the left wrist, 0.39 m off: the radius is 0.37 m at step 7, 0.43 m at step 8
    held = generalisation_scores.limbs_held(tubes, moved)
    assert held[:, [0, 2, 3]].all()
    assert held[:, 1].tolist() == [0.0] * 7 + [1.0] * 8
    moved[0, 0] = np.nan
    assert np.isnan(generalisation_scores.limbs_held(tubes, moved)[0, 0])


def test_the_classifier_tells_jitter_from_smooth_motion_and_like_from_like_not() -> None:
    rng = np.random.default_rng(0)

    def paths(jitter: float) -> np.ndarray:
        pace = rng.uniform(0.2, 1.0, (200, 1, 2, 3))
        return pace * np.arange(18)[:, None, None] / 30 + jitter * rng.standard_normal((200, 18, 2, 3))

    def auc(first: float, second: float) -> float:
        halves = []
        for _ in range(2):
            both = [generalisation_scores.features(paths(jitter), 1 / 30) for jitter in (first, second)]
            halves += [np.concatenate(both), np.repeat([1.0, 0.0], 400)]
        found = generalisation_scores.told_apart(*halves)
        assert found is not None
        return found

    assert auc(1e-3, 5e-3) > 0.95
    # One standard error of the AUC of 400 against 400 like motions is about √(1 / (6 · 400)) = 0.02.
    assert auc(1e-3, 1e-3) == pytest.approx(0.5, abs=0.08)


def test_gains_are_over_the_least_of_the_trivial_methods_figure_by_figure() -> None:
    def entry(*figures: float) -> dict[str, float]:
        return dict(zip(generalisation.GAINS, figures, strict=True))

    methods = {"zero_velocity": entry(10, 40, 4), "damped_085": entry(20, 20, 8), "kinecast": entry(5, 10, 2)}
    assert generalisation.gains(methods) == {"kinecast": entry(-0.5, -0.5, -0.5)}
