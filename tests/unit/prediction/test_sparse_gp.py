"""Sparse GP prediction against the textbook formulas written out with dense matrices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinecast.errors import ModelError, OptionError
from kinecast.prediction import sparse_gp
from kinecast.prediction.kernels import RBF
from kinecast.prediction.sparse_gp import Scale, SparseGP

NOISE = 0.05


def wavy(rng: np.random.Generator, count: int, outputs: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) inputs and (N, P) noisy waves of them, in units far from 1."""
    x = rng.uniform(-2.0, 2.0, (count, 2))
    waves = [np.sin((1.0 + p) * x[:, 0]) + 0.5 * np.cos(2.0 * x[:, 1] - p) for p in range(outputs)]
    y = np.stack(waves, axis=1) + 0.2 * rng.standard_normal((count, outputs))
    return 100.0 + 30.0 * x, -5.0 + 0.01 * y


def conditioned(x: np.ndarray, y: np.ndarray, pseudo_inputs: np.ndarray) -> SparseGP:
    """The posterior for fixed, sensible hyperparameters; pseudo-inputs in the units of x."""
    scale = Scale.of(x)
    return SparseGP.condition(
        x,
        y,
        scale.standardise(pseudo_inputs),
        RBF(np.array([0.9, 1.1]), 1.7),
        NOISE,
        input_scale=scale,
        output_scale=Scale.of(y),
    )


def test_rbf_is_the_formula() -> None:
    kernel = RBF(np.array([0.5, 2.0]), 3.0)
    x, z = np.array([[1.0, 2.0]]), np.array([[1.0, 2.0], [1.5, 0.0]])
    np.testing.assert_allclose(kernel(x, z), [[3.0, 3.0 * np.exp(-0.5 * (1.0 + 1.0))]], rtol=1e-15)


@pytest.mark.parametrize("lengthscales", [[0.0, 1.0], [1.0, np.inf], [1.0, -1.0], [np.nan, 1.0]])
def test_rbf_refuses_impossible_lengthscales(lengthscales: list[float]) -> None:
    with pytest.raises(OptionError, match="lengthscales"):
        RBF(np.array(lengthscales), 1.0)


def test_rbf_refuses_an_impossible_variance() -> None:
    with pytest.raises(OptionError, match="signal variance"):
        RBF(np.array([1.0]), 0.0)


def test_with_every_input_a_pseudo_input_it_is_the_exact_gp() -> None:
    rng = np.random.default_rng(0)
    x, y = wavy(rng, 60)
    test = wavy(rng, 25)[0]
    model = conditioned(x, y, x)
    mean, variance = model.predict(test)

    inputs, outputs = Scale.of(x), Scale.of(y)
    a, b = inputs.standardise(x), inputs.standardise(test)
    noisy = model.kernel(a, a) + NOISE * np.eye(60)
    cross = model.kernel(b, a)
    exact = outputs.mean + outputs.sd * (cross @ np.linalg.solve(noisy, outputs.standardise(y)))
    explained = np.einsum("ij,ji->i", cross, np.linalg.solve(noisy, cross.T))
    spread = outputs.sd**2 * (1.7 - explained + NOISE)[:, None]
    np.testing.assert_allclose(mean, exact, atol=1e-5 * outputs.sd[0])
    np.testing.assert_allclose(variance, spread, rtol=1e-4)


def test_it_is_fitc_written_out_with_dense_matrices() -> None:
    rng = np.random.default_rng(1)
    x, y = wavy(rng, 150, outputs=3)
    test = wavy(rng, 20)[0]
    model = conditioned(x, y, x[:15])
    mean, variance = model.predict(test)

    a, b, z = model.inputs.standardise(x), model.inputs.standardise(test), model.pseudo_inputs
    kzz = model.kernel(z, z) + sparse_gp.JITTER * 1.7 * np.eye(15)
    low_rank = model.kernel(a, z) @ np.linalg.solve(kzz, model.kernel(z, a))
    covariance = low_rank + np.diag(1.7 - np.diag(low_rank) + NOISE)
    cross = model.kernel(b, z) @ np.linalg.solve(kzz, model.kernel(z, a))
    standard = cross @ np.linalg.solve(covariance, model.outputs.standardise(y))
    explained = np.einsum("ij,ji->i", cross, np.linalg.solve(covariance, cross.T))
    np.testing.assert_allclose(mean, model.outputs.mean + model.outputs.sd * standard, rtol=0, atol=1e-9)
    np.testing.assert_allclose(variance, np.outer(1.7 - explained + NOISE, model.outputs.sd**2), rtol=1e-6)


def test_outputs_that_share_a_kernel_do_not_touch_one_another() -> None:
    rng = np.random.default_rng(2)
    x, y = wavy(rng, 80, outputs=2)
    together = conditioned(x, y, x[:10]).predict(x[:5])
    apart = [conditioned(x, y[:, [p]], x[:10]).predict(x[:5]) for p in range(2)]
    for p in range(2):
        np.testing.assert_allclose(together[0][:, [p]], apart[p][0], rtol=1e-12)
        np.testing.assert_allclose(together[1][:, [p]], apart[p][1], rtol=1e-12)


def test_far_from_the_data_it_returns_to_the_prior() -> None:
    x, y = wavy(np.random.default_rng(3), 80)
    model = conditioned(x, y, x[:10])
    mean, variance = model.predict(np.full((1, 2), 1e6))
    np.testing.assert_allclose(mean[0], model.outputs.mean)
    np.testing.assert_allclose(variance[0], (1.7 + NOISE) * model.outputs.sd**2)


def test_variance_stays_between_noise_and_prior() -> None:
    rng = np.random.default_rng(4)
    x, y = wavy(rng, 400)
    model = conditioned(x, y, x[:40])
    variance = model.predict(np.concatenate([x, 100.0 + 90.0 * rng.standard_normal((300, 2))]))[1]
    squared = model.outputs.sd[0] ** 2
    assert np.all(variance >= NOISE * squared)
    assert np.all(variance <= (1.7 + NOISE) * squared * (1 + 1e-12))


def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = wavy(np.random.default_rng(5), 100, outputs=2)
    whole = conditioned(x, y, x[:10]).predict(x)
    monkeypatch.setattr(sparse_gp, "BLOCK", 7)
    pieces = conditioned(x, y, x[:10]).predict(x)
    np.testing.assert_allclose(pieces[0], whole[0], rtol=1e-11)
    np.testing.assert_allclose(pieces[1], whole[1], rtol=1e-9)


def test_repeated_pseudo_inputs_and_constant_columns_are_survived() -> None:
    x, y = wavy(np.random.default_rng(6), 50)
    x[:, 1] = 3.0
    y[:] = -1.0
    model = conditioned(x, y, x[[0, 0, 0, 1, 2]])
    mean, variance = model.predict(x)
    np.testing.assert_allclose(mean, -1.0, atol=1e-9)
    assert np.isfinite(variance).all()


def test_no_inputs_and_missing_inputs() -> None:
    x, y = wavy(np.random.default_rng(7), 50, outputs=2)
    model = conditioned(x, y, x[:5])
    mean, variance = model.predict(np.empty((0, 2)))
    assert mean.shape == variance.shape == (0, 2)
    mean, variance = model.predict(np.array([[np.nan, 100.0], [100.0, 100.0]]))
    assert np.isnan(mean[0]).all()
    assert np.isnan(variance[0]).all()
    assert np.isfinite(mean[1]).all()


def test_training_data_must_be_finite() -> None:
    x, y = wavy(np.random.default_rng(8), 20)
    y[3] = np.nan
    with pytest.raises(OptionError, match="finite"):
        conditioned(x, y, x[:5])


def test_an_npz_file_brings_it_back_exactly(tmp_path: Path) -> None:
    x, y = wavy(np.random.default_rng(9), 60, outputs=2)
    model = conditioned(x, y, x[:8])
    np.savez(tmp_path / "model.npz", **model.to_arrays())
    with np.load(tmp_path / "model.npz", allow_pickle=False) as arrays:
        back = SparseGP.from_arrays(dict(arrays))
    for ours, theirs in zip(model.predict(x), back.predict(x), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("weights", None, "'weights' is missing"),
        ("weights", np.zeros((7, 1)), r"weights has shape \(7, 1\), expected M = 8"),
        ("lengthscales", np.ones(3), "expected D = 2"),
        ("output_sd", np.ones(2), r"output_sd has shape \(2,\), expected P = 1"),
        ("factor", np.zeros((8, 4)), "expected M = 8"),
        ("factor", np.ones((8, 8)), "triangular"),
        ("pseudo_inputs", np.zeros(16), "2 axes"),
        ("pseudo_inputs", np.zeros((8, 2), dtype=np.float32), "float64"),
        ("input_mean", np.array([0.0, np.nan]), "input_mean holds numbers that are not finite"),
        ("input_sd", np.array([0.0, 1.0]), "positive"),
        ("noise_variance", np.array(0.0), "positive"),
        ("signal_variance", np.array(-1.0), "signal variance"),
        ("lengthscales", np.array([1.0, np.inf]), "lengthscales"),
    ],
)
def test_arrays_that_are_not_a_sparse_gp_are_named(name: str, value: np.ndarray | None, message: str) -> None:
    x, y = wavy(np.random.default_rng(10), 40)
    arrays = conditioned(x, y, x[:8]).to_arrays()
    if value is None:
        del arrays[name]
    else:
        arrays[name] = value
    with pytest.raises(ModelError, match=message):
        SparseGP.from_arrays(arrays)
