"""Sparse GPs against the textbook formulas written out with dense matrices, against the truth, GPy and real motion."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from kinecast.errors import MissingExtraError, ModelError, OptionError
from kinecast.prediction.sparse_gp import JITTER, SparseGPs, fit_sparse_gp, negative_log_likelihood

jax = pytest.importorskip("jax")
pytestmark = pytest.mark.usefixtures("compiled_once")

NOISE_SD = 0.15
SMALL = {"seed": 0, "pseudo_inputs": 12, "iterations": 40}


def waves(seed: int, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """(W, 2) inputs and (W,) waves of the first of them with noise of NOISE_SD."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-2.0, 2.0, (count, 2))
    return x, np.sin(2.0 * x[:, 0]) + NOISE_SD * rng.standard_normal(count)


def predicted(model: SparseGPs, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(W,) means and standard deviations of a single process."""
    mean, sd = model.predict(x.T[None])
    return mean[0], sd[0]


def negative_log_density(model: SparseGPs, x: np.ndarray, y: np.ndarray) -> float:
    """Mean −log p of test outputs."""
    return -float(stats.norm.logpdf(y, *predicted(model, x)).mean())


def kernel(signal: float, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return signal * np.exp(-0.5 * np.square(a[:, None] - b).sum(axis=-1))


@pytest.fixture(scope="module")
def model() -> SparseGPs:
    return fit_sparse_gp(*waves(0), **SMALL)


def test_likelihood_and_gradient_equal_dense_matrices() -> None:
    """Gradient by central differences."""
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((200, 2)), rng.standard_normal(200)
    vector = np.concatenate([np.log([0.8, 1.3, 1.7, 0.2]), rng.standard_normal(24)])

    def dense(v: np.ndarray) -> float:
        lengths, signal, noise = np.exp(v[:2]), *np.exp(v[2:4])
        z, a = v[4:].reshape(12, 2) / lengths, x / lengths
        kzz = kernel(signal, z, z) + JITTER * signal * np.eye(12)
        low_rank = kernel(signal, a, z) @ np.linalg.solve(kzz, kernel(signal, z, a))
        covariance = low_rank + np.diag(signal - np.diag(low_rank) + noise)
        return -float(stats.multivariate_normal(np.zeros(200), covariance).logpdf(y))

    with jax.enable_x64(True):
        value, gradient = jax.jit(jax.value_and_grad(negative_log_likelihood))(vector, x, y)
        value, gradient = float(value), np.asarray(gradient)
    assert value == pytest.approx(dense(vector), rel=1e-10)
    differences = [(dense(vector + step) - dense(vector - step)) / 2e-5 for step in 1e-5 * np.eye(len(vector))]
    np.testing.assert_allclose(gradient, differences, rtol=1e-5, atol=1e-5)


def test_prediction_is_fitc_written_out_with_dense_matrices(model: SparseGPs) -> None:
    (x, y), (test, _) = waves(0), waves(1, 20)
    a, b = (each * model.gain - model.offset for each in (x, test))
    z, sd = model.pseudo[0].T, y.std()
    signal, noise = model.signal[0] / sd**2, model.noise[0] / sd**2
    kzz = kernel(signal, z, z) + JITTER * signal * np.eye(12)
    low_rank = kernel(signal, a, z) @ np.linalg.solve(kzz, kernel(signal, z, a))
    covariance = low_rank + np.diag(signal - np.diag(low_rank) + noise)
    cross = kernel(signal, b, z) @ np.linalg.solve(kzz, kernel(signal, z, a))
    explained = np.einsum("ij,ji->i", cross, np.linalg.solve(covariance, cross.T))
    mean, spread = predicted(model, test)
    np.testing.assert_allclose(mean, y.mean() + cross @ np.linalg.solve(covariance, y - y.mean()), atol=1e-7)
    np.testing.assert_allclose(spread**2, sd**2 * (signal - explained + noise), rtol=1e-5)


def test_far_from_the_data_it_returns_to_the_prior_and_missing_inputs_give_nan(model: SparseGPs) -> None:
    mean, spread = predicted(model, np.array([[1e6, 1e6], [np.nan, 0.0], [0.0, 0.0]]))
    assert mean[0] == pytest.approx(model.centre[0])
    assert spread[0] == pytest.approx(math.sqrt(model.signal[0] + model.noise[0]))
    assert np.isnan([mean[1], spread[1]]).all()
    assert np.isfinite([mean[2], spread[2]]).all()
    assert predicted(model, np.empty((0, 2)))[0].shape == (0,)


def test_variance_stays_between_noise_and_prior(model: SparseGPs) -> None:
    rng = np.random.default_rng(4)
    _, spread = predicted(model, np.concatenate([waves(0)[0], 9.0 * rng.standard_normal((300, 2))]))
    assert np.all(spread**2 >= model.noise * (1 - 1e-12))
    assert np.all(spread**2 <= (model.signal + model.noise) * (1 + 1e-12))


def test_processes_side_by_side_do_not_touch_one_another(model: SparseGPs) -> None:
    x, y = waves(5)
    other = fit_sparse_gp(100.0 + 30.0 * x, 0.01 * y, **{**SMALL, "iterations": 3})
    inputs = np.stack([x.T, 100.0 + 30.0 * x.T])
    mean, spread = SparseGPs.joined([model, other]).predict(inputs)
    for d, alone in enumerate((model, other)):
        np.testing.assert_allclose([mean[d], spread[d]], np.array(alone.predict(inputs[d : d + 1]))[:, 0], rtol=1e-12)


def test_it_finds_the_noise_and_the_function(model: SparseGPs) -> None:
    x, y = waves(1, 2000)
    entropy = 0.5 * math.log(2 * math.pi * math.e * NOISE_SD**2)  # the least any model can reach on average
    standard_error = math.sqrt(0.5 / y.size)
    # 200 numbers leave an excess of a few parameters over twice that.
    assert negative_log_density(model, x, y) == pytest.approx(entropy + 0.03, abs=0.03 + 4 * standard_error)
    assert math.sqrt(model.noise[0]) == pytest.approx(NOISE_SD, rel=4 * math.sqrt(0.5 / 200))
    assert model.gain[0, 0] > 3 * model.gain[0, 1]  # the second input says nothing


def test_the_same_seed_gives_the_same_model_and_another_seed_another(model: SparseGPs) -> None:
    before = jax.config.jax_enable_x64
    for ours, again in zip(model, fit_sparse_gp(*waves(0), **SMALL), strict=True):
        np.testing.assert_array_equal(again, ours)
    other = fit_sparse_gp(*waves(0), **{**SMALL, "seed": 1})
    assert not np.array_equal(other.pseudo, model.pseudo)
    assert jax.config.jax_enable_x64 == before


def test_degenerate_data_train_to_something_finite() -> None:
    x, y = waves(0)
    for inputs, outputs in ((np.repeat(x[:4], 50, axis=0), y), (x, np.zeros_like(y)), (x * [1.0, 0.0], 1e6 * y)):
        mean, spread = predicted(fit_sparse_gp(inputs, outputs, **{**SMALL, "iterations": 10}), inputs)
        assert np.isfinite(mean).all()
        assert np.all(spread > 0)


def test_without_jax_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(MissingExtraError, match=r"kinecast\[train\]"):
        fit_sparse_gp(*waves(0), **SMALL)


def test_data_it_cannot_be_trained_with_are_refused() -> None:
    x, y = waves(0)
    with pytest.raises(OptionError, match="at least 2 points, found 1"):
        fit_sparse_gp(x[:1], y[:1], **SMALL)
    y[7] = np.inf
    with pytest.raises(OptionError, match="finite"):
        fit_sparse_gp(x, y, **SMALL)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("weights", None, "weights is missing"),
        ("pseudo", None, "pseudo is missing"),
        ("weights", np.zeros((1, 7)), r"weights of shape \(1, 7\); expected \(1, 12\)"),
        ("gain", np.ones((1, 3)), r"gain of shape \(1, 3\); expected \(1, 2\)"),
        ("factor", np.zeros((1, 12, 4)), "factor of shape"),
        ("factor", np.zeros(1), "factor of shape"),
        ("noise", np.array([0.0]), "not above 0"),
        ("signal", np.array([-1.0]), "not above 0"),
    ],
)
def test_arrays_that_are_no_processes_are_named(
    model: SparseGPs, name: str, value: np.ndarray | None, message: str
) -> None:
    arrays = model._asdict()
    assert all(np.array_equal(a, b) for a, b in zip(SparseGPs.from_arrays(arrays, 1, 2), model, strict=True))
    del arrays[name]
    if value is not None:
        arrays[name] = value
    with pytest.raises(ModelError, match=message):
        SparseGPs.from_arrays(arrays, 1, 2)


@pytest.mark.filterwarnings("ignore")
def test_it_agrees_with_gpy() -> None:
    """GPy's FITC: the same prediction at the same parameters, the same score after its own training."""
    GPy = pytest.importorskip("GPy")
    x, y, test_x, test_y = (array.reshape(800, -1)[:, :1] for seed in (2, 1) for array in waves(seed, 800))
    ours = fit_sparse_gp(x, y[:, 0], seed=0, pseudo_inputs=8, iterations=150)
    mean, sd = y.mean(), y.std()
    a, b, test = x * ours.gain - ours.offset, (y - mean) / sd, test_x * ours.gain - ours.offset
    rbf = GPy.kern.RBF(1, variance=ours.signal[0] / sd**2, lengthscale=1.0)
    likelihood = GPy.likelihoods.Gaussian(variance=ours.noise[0] / sd**2)
    inference = GPy.inference.latent_function_inference.FITC()
    inference.const_jitter = JITTER * ours.signal[0] / sd**2
    peer = GPy.core.SparseGP(a, b, ours.pseudo[0].T.copy(), rbf, likelihood, inference_method=inference)

    vector = np.concatenate([np.log([1.0, ours.signal[0] / sd**2, ours.noise[0] / sd**2]), ours.pseudo[0, 0]])
    with jax.enable_x64(True):
        assert -float(jax.jit(negative_log_likelihood)(vector, a, b[:, 0])) == pytest.approx(
            float(peer.log_likelihood()), abs=1e-3
        )
    our_mean, our_sd = predicted(ours, test_x)
    peer_mean, peer_variance = peer.predict(test)
    np.testing.assert_allclose(mean + sd * peer_mean[:, 0], our_mean, atol=1e-6)
    np.testing.assert_allclose(sd**2 * peer_variance[:, 0], our_sd**2, rtol=1e-5)

    rbf.lengthscale, rbf.variance, likelihood.variance = 1.0, 1.0, 0.1
    peer[".*inducing"] = a[:: len(a) // 8][:8]
    peer.optimize(max_iters=100)
    peer_mean, peer_variance = peer.predict(test)
    score = -stats.norm.logpdf(test_y, mean + sd * peer_mean, sd * np.sqrt(peer_variance)).mean()
    assert negative_log_density(ours, test_x, test_y[:, 0]) == pytest.approx(score, abs=0.01)


def test_real_wrist_motion_is_predicted_better_than_by_standing_still(data_root: Path) -> None:
    """HA4M, one subject: trained on a clip, tested on another; next step of a wrist from its last 0.2 s."""
    folder = data_root / "ha4m_features_demo" / "UpSkel"
    if not folder.is_dir():
        pytest.skip("no HA4M feature files among the recordings")
    windows = []
    for clip in ("IDU001V001", "IDU001V002"):
        raw = np.load(folder / f"{clip}.npy", allow_pickle=False)
        wrist = raw.reshape(3, 23, -1)[1, 13] / 1000.0  # vertical coordinate of the right wrist [m]
        last = np.lib.stride_tricks.sliding_window_view(wrist, 7)
        inputs = np.column_stack([last[:, 5], np.diff(last[:, :6], axis=1)])
        windows.append((inputs, last[:, 6] - last[:, 5]))
    (x, y), (test_x, test_y) = windows
    trained = fit_sparse_gp(x[:2000], y[:2000], seed=0, pseudo_inputs=16, iterations=40)
    mean, spread = predicted(trained, test_x)

    # The best any constant Gaussian around the last position could do, fitted to the test itself.
    still = 0.5 * math.log(2 * math.pi * math.e * float(np.mean(test_y**2)))
    assert negative_log_density(trained, test_x, test_y) < still - 0.4
    moving = np.abs(test_x[:, 1:]).max(axis=1) > 0.01  # 0.3 m/s somewhere in the window
    error, displacement = np.abs(test_y - mean)[moving], np.abs(test_y)[moving]
    assert error.mean() < 0.9 * displacement.mean()
    inside = np.abs(test_y - mean) < 1.645 * spread
    assert 0.88 < inside.mean() < 0.98
