"""Training of sparse GPs: the likelihood against dense matrices, the result against the truth, GPy and real motion."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from kinecast.errors import MissingExtraError, OptionError
from kinecast.prediction import training
from kinecast.prediction.sparse_gp import JITTER, SparseGP
from kinecast.prediction.training import SparseGPOptions, fit_sparse_gp

NOISE_SD = 0.15
SMALL = SparseGPOptions(pseudo_inputs=12, iterations=40)


def waves(seed: int, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) inputs and (N, 2) waves of the first of them with noise of NOISE_SD."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-2.0, 2.0, (count, 2))
    y = np.column_stack([np.sin(2.0 * x[:, 0]), np.cos(2.0 * x[:, 0])])
    return x, y + NOISE_SD * rng.standard_normal((count, 2))


def negative_log_density(model: SparseGP, x: np.ndarray, y: np.ndarray) -> float:
    """Mean −log p of test outputs."""
    mean, variance = model.predict(x)
    return float(np.mean(0.5 * ((y - mean) ** 2 / variance + np.log(2 * np.pi * variance))))


@pytest.fixture(scope="module", autouse=True)
def _short_blocks() -> Iterator[None]:
    """Blocks of 100 rows: every test streams, and nearly all share one compiled shape."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "BLOCK", 100)
        yield


@pytest.fixture(scope="module")
def model() -> SparseGP:
    pytest.importorskip("jax")
    return fit_sparse_gp(*waves(0), SMALL)


def test_likelihood_and_gradient_equal_dense_matrices_in_padded_blocks() -> None:
    """N = 150 in two blocks of 100, two outputs; gradient by central differences."""
    pytest.importorskip("jax")
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((150, 2)), rng.standard_normal((150, 2))
    vector = training._pack(rng.standard_normal((12, 2)), np.array([0.8, 1.3]), 1.7, 0.2)
    pad = ((0, 50), (0, 0))
    blocks = np.pad(x, pad).reshape(2, 100, 2), np.pad(y, pad).reshape(2, 100, 2)
    present = np.pad(np.ones(150), (0, 50)).reshape(2, 100)

    def dense(v: np.ndarray) -> float:
        z, kernel, noise = training._unpack(v, 2)
        kzz = kernel(z, z) + JITTER * kernel.signal_variance * np.eye(len(z))
        low_rank = kernel(x, z) @ np.linalg.solve(kzz, kernel(z, x))
        covariance = low_rank + np.diag(kernel.signal_variance - np.diag(low_rank) + noise)
        return -float(stats.multivariate_normal(np.zeros(150), covariance).logpdf(y.T).sum())

    with training._double_precision():
        value, gradient = training._compiled()(vector, *blocks, present)
        value, gradient = float(value), np.asarray(gradient)
    assert gradient.dtype == np.float64
    assert value == pytest.approx(dense(vector), rel=1e-10)
    differences = [(dense(vector + step) - dense(vector - step)) / 2e-5 for step in 1e-5 * np.eye(len(vector))]
    np.testing.assert_allclose(gradient, differences, rtol=1e-5, atol=1e-5)


def test_it_finds_the_noise_and_the_function(model: SparseGP) -> None:
    x, y = waves(1, 2000)
    entropy = 0.5 * math.log(2 * math.pi * math.e * NOISE_SD**2)  # the least any model can reach on average
    standard_error = math.sqrt(0.5 / y.size)
    # 400 numbers leave an excess of a few parameters over twice that.
    assert negative_log_density(model, x, y) == pytest.approx(entropy + 0.03, abs=0.03 + 4 * standard_error)
    noise_sd = math.sqrt(model.noise_variance) * model.outputs.sd[0]
    assert noise_sd == pytest.approx(NOISE_SD, rel=4 * math.sqrt(0.5 / 400))
    assert model.kernel.lengthscales[1] > 3 * model.kernel.lengthscales[0]  # the second input says nothing


def test_the_same_seed_gives_the_same_model_and_another_seed_another(model: SparseGP) -> None:
    again = fit_sparse_gp(*waves(0), SMALL)
    for name, array in model.to_arrays().items():
        np.testing.assert_array_equal(again.to_arrays()[name], array, err_msg=name)
    other = fit_sparse_gp(*waves(0), SparseGPOptions(pseudo_inputs=12, iterations=40, seed=1))
    assert not np.array_equal(other.pseudo_inputs, model.pseudo_inputs)


def test_progress_counts_iterations_and_precision_is_left_alone() -> None:
    jax = pytest.importorskip("jax")
    before = jax.config.jax_enable_x64
    told: list[tuple[int, int]] = []
    fit_sparse_gp(*waves(0), SparseGPOptions(pseudo_inputs=12, iterations=3), progress=lambda *now: told.append(now))
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert jax.config.jax_enable_x64 == before


def test_degenerate_data_train_to_something_finite() -> None:
    pytest.importorskip("jax")
    x, y = waves(0)
    for inputs, outputs in ((np.repeat(x[:4], 50, axis=0), y), (x, np.zeros_like(y)), (x * [1.0, 0.0], 1e6 * y)):
        trained = fit_sparse_gp(inputs, outputs, SparseGPOptions(pseudo_inputs=12, iterations=10))
        mean, variance = trained.predict(inputs)
        assert np.isfinite(mean).all()
        assert np.all(variance > 0)


def test_hyperparameters_may_come_from_fewer_points_than_the_posterior() -> None:
    pytest.importorskip("jax")
    x, y = waves(3, 1500)
    options = SparseGPOptions(pseudo_inputs=12, iterations=40, max_points=200)
    assert negative_log_density(fit_sparse_gp(x, y, options), *waves(1, 2000)) < -0.44


def test_without_jax_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(MissingExtraError, match=r"kinecast\[train\]"):
        fit_sparse_gp(*waves(0), SMALL)


def test_data_it_cannot_be_trained_on_are_refused() -> None:
    x, y = waves(0)
    with pytest.raises(OptionError, match="at least 2 points, found 1"):
        fit_sparse_gp(x[:1], y[:1])
    y[7] = np.inf
    with pytest.raises(OptionError, match="finite"):
        fit_sparse_gp(x, y)


@pytest.mark.parametrize("option", [{"pseudo_inputs": 0}, {"iterations": -1}, {"max_points": 1}, {"seed": -1}], ids=str)
def test_options_out_of_range_are_named(option: dict[str, int]) -> None:
    with pytest.raises(OptionError, match=next(iter(option))):
        SparseGPOptions(**option)


@pytest.mark.filterwarnings("ignore")
def test_it_agrees_with_gpy() -> None:
    """GPy's FITC: the same likelihood and prediction at the same parameters, the same score after its own training."""
    pytest.importorskip("jax")
    GPy = pytest.importorskip("GPy")
    x, y, test_x, test_y = (array[:, :1] for seed in (2, 1) for array in waves(seed, 800))
    ours = fit_sparse_gp(x, y, SparseGPOptions(pseudo_inputs=8))
    a, b = ours.inputs.standardise(x), ours.outputs.standardise(y)
    kernel = GPy.kern.RBF(1, variance=ours.kernel.signal_variance, lengthscale=ours.kernel.lengthscales[0])
    likelihood = GPy.likelihoods.Gaussian(variance=ours.noise_variance)
    inference = GPy.inference.latent_function_inference.FITC()
    inference.const_jitter = JITTER * ours.kernel.signal_variance
    peer = GPy.core.SparseGP(a, b, ours.pseudo_inputs.copy(), kernel, likelihood, inference_method=inference)

    vector = training._pack(
        ours.pseudo_inputs, ours.kernel.lengthscales, ours.kernel.signal_variance, ours.noise_variance
    )
    with training._double_precision():
        blocks = a.reshape(8, 100, 1), b.reshape(8, 100, 1), np.ones((8, 100))
        cost = float(training._compiled()(vector, *blocks)[0])
    assert -cost == pytest.approx(float(peer.log_likelihood()), abs=1e-3)
    mean, variance = ours.predict(test_x)
    peer_mean, peer_variance = peer.predict(ours.inputs.standardise(test_x))
    np.testing.assert_allclose(ours.outputs.mean + ours.outputs.sd * peer_mean, mean, atol=1e-6)
    np.testing.assert_allclose(ours.outputs.sd**2 * peer_variance, variance, rtol=1e-5)

    kernel.lengthscale, kernel.variance, likelihood.variance = 1.0, 1.0, 0.1
    peer[".*inducing"] = a[:: len(a) // 8][:8]
    peer.optimize(max_iters=100)
    peer_mean, peer_variance = peer.predict(ours.inputs.standardise(test_x))
    residual = ours.outputs.standardise(test_y) - peer_mean
    score = np.mean(0.5 * (residual**2 / peer_variance + np.log(2 * np.pi * peer_variance)))
    assert negative_log_density(ours, test_x, test_y) == pytest.approx(score + math.log(ours.outputs.sd[0]), abs=0.01)


def test_real_wrist_motion_is_predicted_better_than_by_standing_still(data_root: Path) -> None:
    """HA4M, one subject: trained on a clip, tested on another; next step of a wrist from its last 0.2 s."""
    pytest.importorskip("jax")
    folder = data_root / "ha4m_features_demo" / "UpSkel"
    if not folder.is_dir():
        pytest.skip("no HA4M feature files among the recordings")
    windows = []
    for clip in ("IDU001V001", "IDU001V002"):
        raw = np.load(folder / f"{clip}.npy", allow_pickle=False)
        wrist = raw.reshape(3, 23, -1)[1, 13] / 1000.0  # vertical coordinate of the right wrist [m]
        last = np.lib.stride_tricks.sliding_window_view(wrist, 7)
        inputs = np.column_stack([last[:, 5], np.diff(last[:, :6], axis=1)])
        windows.append((inputs, last[:, 6:] - last[:, 5:6]))
    (x, y), (test_x, test_y) = windows
    trained = fit_sparse_gp(x[:2000], y[:2000], SparseGPOptions(pseudo_inputs=16, iterations=40))
    mean, variance = trained.predict(test_x)
    score = negative_log_density(trained, test_x, test_y)

    # The best any constant Gaussian around the last position could do, fitted to the test itself.
    still = 0.5 * math.log(2 * math.pi * math.e * float(np.mean(test_y**2)))
    assert score < still - 0.4
    moving = np.abs(test_x[:, 1:]).max(axis=1) > 0.01  # 0.3 m/s somewhere in the window
    error, displacement = np.abs(test_y - mean)[moving], np.abs(test_y)[moving]
    assert error.mean() < 0.9 * displacement.mean()
    inside = np.abs(test_y - mean) < 1.645 * np.sqrt(variance)
    assert 0.88 < inside.mean() < 0.98
