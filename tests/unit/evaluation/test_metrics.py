"""Scores against closed forms, against peers' implementations, and where values are missing."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import chi2, gaussian_kde

from kinecast.evaluation import metrics
from kinecast.evaluation.metrics import crps, energy_score, is_moving, joint_errors, kde_nll, regions, scored

SAMPLE_SCORES = (crps, energy_score, kde_nll)


@pytest.fixture(scope="module")
def scoringrules() -> Any:
    """The peer; where it finds numba, importing it compiles for 4 s what is not used here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "numba", None)
        return pytest.importorskip("scoringrules")


def correlated(rng: np.random.Generator, count: int, steps: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Samples of a Gaussian with unequal, correlated axes per step and joint; one more draw is the truth."""
    root = 0.05 * rng.standard_normal((steps, 6, 3, 3))
    centre = rng.standard_normal((steps, 6, 3))
    draws = np.einsum("tjik,stjk->stji", root, rng.standard_normal((count + 1, steps, 6, 3))) + centre
    return draws[:-1], draws[-1]


def isotropic(rng: np.random.Generator, count: int, windows: int, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """(S, W, 6, 3) samples and (W, 6, 3) truths of independent N(0, sigma²)."""
    draws = sigma * rng.standard_normal((count + 1, windows, 6, 3))
    return draws[:-1], draws[-1]


def test_joint_errors_are_distances_and_nan_where_the_truth_is() -> None:
    mean = np.zeros((2, 6, 3))
    truth = np.full((2, 6, 3), (0.03, 0.04, 0.12))
    truth[1, 2, 0] = np.nan
    errors = joint_errors(mean, truth)
    assert np.isnan(errors[1, 2])
    assert np.count_nonzero(np.isnan(errors)) == 1
    np.testing.assert_allclose(errors[0], 0.13, rtol=1e-14)
    assert joint_errors(np.zeros((5, 2, 6, 3)), np.ones((5, 2, 6, 3))).shape == (5, 2, 6)


def test_crps_equals_a_peers_fair_estimator(scoringrules: Any) -> None:
    samples, truth = correlated(np.random.default_rng(1), 200)
    expected = scoringrules.crps_ensemble(truth, samples, m_axis=0, estimator="fair", backend="numpy")
    np.testing.assert_allclose(crps(samples, truth), expected, rtol=1e-10, atol=1e-14)


def test_crps_of_a_gaussian_is_its_closed_form() -> None:
    """σ [z (2 Φ(z) − 1) + 2 φ(z) − 1/√π], by averaging many estimates of 50 samples each."""
    rng = np.random.default_rng(2)
    sigma, offset = 0.04, 0.05
    samples = sigma * rng.standard_normal((50, 2000, 6, 3))
    scores = crps(samples, np.full((2000, 6, 3), offset)).ravel()
    z = offset / sigma
    density = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    exact = sigma * (z * (2 * ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi))
    assert abs(scores.mean() - exact) < 4 * scores.std() / np.sqrt(scores.size)


def test_energy_score_on_a_line_is_the_crps() -> None:
    """With up to 17 samples all pairs are compared, so the two are equal to rounding."""
    samples, truth = correlated(np.random.default_rng(3), 17)
    samples[..., 1:] = 0.0
    truth[..., 1:] = 0.0
    np.testing.assert_allclose(energy_score(samples, truth), crps(samples, truth)[..., 0], rtol=1e-10)


def test_energy_score_agrees_with_all_pairs(scoringrules: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many sets of samples, scored with 16 S pairs and with all: equal within the mean's standard error."""
    rng = np.random.default_rng(4)
    samples, truth = isotropic(rng, 100, windows=60, sigma=0.05)
    some = energy_score(samples, truth)
    monkeypatch.setattr(metrics, "PAIR_SHIFTS", 99)
    every = energy_score(samples, truth)
    difference = (some - every).ravel()
    assert 0 < difference.std() < 0.001
    assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(difference.size)
    expected = scoringrules.es_ensemble(truth, samples, m_axis=0, v_axis=-1, estimator="fair", backend="numpy")
    np.testing.assert_allclose(every, expected, rtol=1e-9)


def test_energy_score_does_not_mind_antithetic_order() -> None:
    """Sample i + S/2 mirrors sample i: pairing neighbours in the given order would be far off."""
    rng = np.random.default_rng(5)
    half, truth = isotropic(rng, 8 * 64, windows=1, sigma=0.05)
    mirrored = np.stack([half, -half], axis=1).reshape(-1, 1, 6, 3)
    gap = energy_score(mirrored, truth) - energy_score(rng.permutation(mirrored), truth)
    # One estimate's error: pair distances have a standard deviation under 0.05 m, 16 S of them, halved.
    assert np.abs(gap).max() < 6 * 0.5 * 0.05 / np.sqrt(len(mirrored))


def test_kde_nll_equals_scipy() -> None:
    samples, truth = correlated(np.random.default_rng(6), 300)
    scores = kde_nll(samples, truth)
    assert scores.shape == (4, 6)
    for step, joint in np.ndindex(4, 6):
        density = gaussian_kde(samples[:, step, joint].T).logpdf(truth[step, joint])[0]
        assert scores[step, joint] == pytest.approx(min(-density, 20.0), rel=1e-9)
    assert scores.max() < 20.0


def test_kde_nll_is_clipped_far_away() -> None:
    samples, truth = correlated(np.random.default_rng(7), 50)
    np.testing.assert_array_equal(kde_nll(samples, truth + 1e3), 20.0)
    assert np.all(kde_nll(samples, truth) < 20.0)


def test_zero_spread_scores_as_the_smallest_spread_told() -> None:
    samples, truth = np.zeros((100, 2, 6, 3)), np.zeros((2, 6, 3))
    truth[1] = 0.03 / np.sqrt(3)
    np.testing.assert_allclose(crps(samples, truth), np.abs(truth))
    np.testing.assert_allclose(energy_score(samples, truth), np.linalg.norm(truth, axis=-1), rtol=1e-12)
    scores = kde_nll(samples, truth)
    bandwidth = 1e-4 * 100 ** (-1 / 7)
    np.testing.assert_allclose(scores[0], 3 * np.log(bandwidth * np.sqrt(2 * np.pi)), rtol=1e-12)
    np.testing.assert_array_equal(scores[1], 20.0)
    inside, volume, _ = regions(samples, truth)
    assert inside[:, 0].all()
    assert not inside[:, 1].any()
    np.testing.assert_array_equal(volume, 0.0)


def test_one_sample_is_a_point() -> None:
    rng = np.random.default_rng(8)
    samples, truth = isotropic(rng, 1, windows=2, sigma=0.1)
    np.testing.assert_allclose(crps(samples, truth), np.abs(samples[0] - truth))
    np.testing.assert_allclose(energy_score(samples, truth), joint_errors(samples[0], truth))
    assert np.all(np.isfinite(kde_nll(samples, truth)))
    inside, volume, _ = regions(samples, truth)
    assert not inside.any()
    np.testing.assert_array_equal(volume, 0.0)


@pytest.mark.parametrize("score", SAMPLE_SCORES)
def test_missing_truth_is_not_scored(score) -> None:  # type: ignore[no-untyped-def]
    samples, truth = correlated(np.random.default_rng(9), 40)
    whole = score(samples, truth)
    truth[1, 3, 2] = np.nan
    holed = score(samples, truth)
    known = scored(truth)
    assert np.count_nonzero(~known) == 1
    assert np.isnan(holed[~known]).all()
    np.testing.assert_array_equal(holed[known], whole[known])


@pytest.mark.parametrize("score", SAMPLE_SCORES)
def test_a_sample_that_is_not_finite_spoils_its_own_joint_alone(score) -> None:  # type: ignore[no-untyped-def]
    samples, truth = correlated(np.random.default_rng(10), 9)
    samples[3, 2, 4] = np.nan
    scores = score(samples, truth)
    assert np.isnan(scores[2, 4]).all()
    assert np.isfinite(np.delete(scores.reshape(24, -1), 2 * 6 + 4, axis=0)).all()


def test_no_sample_is_no_score() -> None:
    samples, truth = np.zeros((0, 2, 6, 3)), np.zeros((2, 6, 3))
    for score in SAMPLE_SCORES:
        assert np.isnan(score(samples, truth)).all()
    inside, volume, _ = regions(samples, truth)
    assert not inside.any()
    assert np.isnan(volume).all()


def test_regions_without_truth_or_samples() -> None:
    samples, truth = correlated(np.random.default_rng(11), 40)
    truth[0, 0, 0] = np.nan
    samples[7, 1, 1] = np.nan
    inside, volume, _ = regions(samples, truth)
    assert not inside[:, 0, 0].any()
    assert not inside[:, 1, 1].any()
    assert np.isfinite(volume[:, 0, 0]).all()
    assert np.isnan(volume[:, 1, 1]).all()


def test_coverage_of_a_gaussian_is_the_level_within_its_standard_error() -> None:
    rng = np.random.default_rng(12)
    samples, truth = isotropic(rng, 200, windows=1500, sigma=0.03)
    inside, _, _ = regions(samples, truth)
    cells = inside[0].size
    for level, held in zip(metrics.LEVELS, inside.mean(axis=(1, 2)), strict=True):
        # Mean and covariance come from the samples and lean towards them: worth up to about d / S = 1.5 %.
        assert abs(held - level) < 4 * np.sqrt(level * (1 - level) / cells) + 0.015


def test_volume_of_a_gaussians_region() -> None:
    """4/3 π (σ r)³, where r² is the χ²(3) quantile."""
    rng = np.random.default_rng(13)
    samples, truth = isotropic(rng, 4000, windows=5, sigma=0.03)
    _, volume, _ = regions(samples, truth)
    for level, litres in zip(metrics.LEVELS, volume.reshape(5, -1), strict=True):
        exact = 4 / 3 * np.pi * (0.03 * np.sqrt(chi2(3).ppf(level))) ** 3
        assert abs(litres.mean() - exact) < 4 * litres.std() / np.sqrt(litres.size) + 0.01 * exact


def test_regions_follow_the_samples_shape() -> None:
    """Long along x: a truth far along x is inside, one less far along y is not."""
    rng = np.random.default_rng(14)
    samples = rng.standard_normal((500, 2, 6, 3)) * (0.2, 0.01, 0.01)
    truth = np.zeros((2, 6, 3))
    truth[0, :, 0] = 0.3
    truth[1, :, 1] = 0.1
    inside, _, _ = regions(samples, truth)
    most = metrics.LEVELS.index(0.9)
    assert inside[most, 0].all()
    assert not inside[most, 1].any()


def test_scores_leave_their_inputs_alone() -> None:
    samples, truth = correlated(np.random.default_rng(16), 30)
    before = samples.copy(), truth.copy()
    for score in (*SAMPLE_SCORES, regions):
        score(samples, truth)
    np.testing.assert_array_equal(samples, before[0])
    np.testing.assert_array_equal(truth, before[1])


def test_moving_is_a_matter_of_the_wrists_usual_speed() -> None:
    rest = np.zeros((6, 6, 3))
    assert not is_moving(rest, dt=0.1)
    for wrist in (2, 5):
        walk = rest.copy()
        walk[:, wrist, 1] = 0.031 * np.arange(6)
        assert is_moving(walk, dt=0.1)
        assert not is_moving(walk[:, :], dt=0.2)
    elbow = rest.copy()
    elbow[:, 1] = np.arange(6)[:, None]
    assert not is_moving(elbow, dt=0.1)
    jump = rest.copy()
    jump[3, 2] = 0.5
    jump[1, 5] = np.nan
    assert not is_moving(jump, dt=0.1)
    assert not is_moving(np.full((6, 6, 3), np.nan), dt=0.1)
    assert not is_moving(rest[:1], dt=0.1)
