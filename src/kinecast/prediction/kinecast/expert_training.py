"""Fits the learned experts for the mean distance of the predicted joints (NumPy; JAX for the network)."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.prediction.descent import descend, jax_in_one_thread
from kinecast.prediction.kinecast.features import FeatureScale, arm_views, time_basis
from kinecast.prediction.kinecast.learned import COMPONENTS, Network, RadialBasis, kernel_inputs
from kinecast.prediction.sparse_gp import centres

__all__ = ["Examples", "fit_network", "fit_radial_basis"]

BLOCK = 4096
"""Rows handled at once, so that memory stays flat."""
ROUNDS = 4
"""Of reweighting: squares become distances."""
LEAST_ERROR = 0.003
"""Distances below this weigh alike [m]."""
WIDTH, DROPPED = 256, 0.4
"""Units of the network's layers, and the share of them left out at random while training."""


class Examples:
    """Both arms' views of windows, with what came in the arm's axes and as coefficients of the time basis."""

    def __init__(self, observed: Float[np.ndarray, "W N 6 3"], future: Float[np.ndarray, "W T 6 3"]) -> None:
        views = arm_views(observed)
        self.scale = FeatureScale.of(views)
        self.features = self.scale.features(views)
        self.amplitude = views.amplitude
        steps = future.shape[1]
        self.target = views.to_arms(future).reshape(len(self.features), steps, 9)
        self.basis = time_basis(steps)
        inverse = np.linalg.pinv(self.basis)
        self.coefficients = (inverse @ (self.target / self.amplitude[:, None, None])).reshape(len(self.features), -1)


def fit_radial_basis(
    observed: Float[np.ndarray, "W N 6 3"], future: Float[np.ndarray, "W T 6 3"], pseudo_inputs: int, seed: int
) -> RadialBasis:
    """Ridge on [features, 1, RBF]; iteratively reweighted, so that distances are minimised and not their squares.

    It is the mean of a sparse Gaussian process with a linear mean function and a heavy-tailed likelihood;
    pseudo-inputs are k-means centres.
    """
    data = Examples(observed, future)
    count = len(data.features)
    steps = data.features[:, :-20]
    mean = steps.mean(axis=0)
    _, size, axes = np.linalg.svd((steps - mean)[::3], full_matrices=False)
    kept = min(COMPONENTS, len(size))
    components = axes[:kept].T / (size[0] / np.sqrt(count / 3)) * 1.5
    q = kernel_inputs(data.features, mean, components)
    rng = np.random.default_rng(seed)
    found = centres(rng, q[rng.permutation(count)[: 8 * BLOCK]], min(pseudo_inputs, count // 2))
    some = q[:: max(count // 2000, 1)]
    square = ((some**2).sum(axis=1)[:, None] + (found**2).sum(axis=1) - 2.0 * some @ found.T).clip(0.0)
    lengthscale = 0.7 * float(np.sqrt(np.median(square)))
    columns = data.features.shape[1] + 1 + len(found)
    outputs = data.coefficients.shape[1]
    model = RadialBasis(data.scale, mean, components, found, lengthscale, np.zeros((columns, outputs)))
    penalty = np.full(columns, 1e-3)
    penalty[: data.features.shape[1] + 1] = 0.03
    weight = data.amplitude / data.amplitude.mean()
    for _ in range(ROUNDS + 1):
        moment, product = np.diag(penalty * count * 1e-2), np.zeros((columns, outputs))
        for start in range(0, count, BLOCK):
            rows = slice(start, start + BLOCK)
            regressors = model.regressors(data.features[rows])
            weighted = regressors * weight[rows, None]
            moment += regressors.T @ weighted
            product += weighted.T @ data.coefficients[rows]
        solution = np.linalg.solve(moment, product)
        model = RadialBasis(data.scale, mean, components, found, lengthscale, solution)
        weight = np.concatenate(
            [_reweighted(model, data, slice(start, start + BLOCK)) for start in range(0, count, BLOCK)]
        )
        weight = weight / weight.mean()
    return model


def _reweighted(model: RadialBasis, data: Examples, rows: slice) -> Float[np.ndarray, " R"]:
    """Amplitude squared over the mean distance: the weight that makes a square a distance."""
    coefficients = model.coefficients(data.features[rows])
    made = data.basis @ coefficients.reshape(len(coefficients), -1, 9) * data.amplitude[rows, None, None]
    error = (made - data.target[rows]).reshape(len(coefficients), -1, 3, 3)
    distance = np.linalg.norm(error, axis=-1).mean(axis=(1, 2))
    return data.amplitude[rows] ** 2 / np.maximum(distance, LEAST_ERROR)


def fit_network(
    observed: Float[np.ndarray, "W N 6 3"], future: Float[np.ndarray, "W T 6 3"], steps: int, seed: int
) -> Network:
    """Multilayer perceptron beside a linear skip that starts from ridge; mean distance as loss."""
    data = Examples(observed, future)
    inputs, outputs = data.features.shape[1], data.coefficients.shape[1]
    seen = data.features[:, : inputs - 2]
    weight = data.amplitude[:, None]
    moment = seen.T @ (seen * weight) + 1e-3 * len(seen) * weight.mean() * np.eye(inputs - 2)
    skip = np.linalg.solve(moment, seen.T @ (data.coefficients * weight))
    rng = np.random.default_rng(seed)

    def layer(before: int, after: int, gain: float) -> Float[np.ndarray, "A B"]:
        return rng.normal(0.0, gain / np.sqrt(before), (before, after))

    start = [
        layer(inputs, WIDTH, 1.0), np.zeros(WIDTH), layer(WIDTH, WIDTH, 1.0), np.zeros(WIDTH),
        layer(WIDTH, outputs, 0.1), np.zeros(outputs), skip,
    ]  # fmt: skip
    found = descend(
        _network_loss(data.basis), start, (data.features, data.amplitude, data.target),
        steps=steps, batch=256, rate=2e-3, decay=1e-3, second=0.999, seed=seed,
    )  # fmt: skip
    W1, b1, W2, *rest = found
    return Network(data.scale, W1, b1, W2[None], *rest)


def _network_loss(time: Float[np.ndarray, "T K"]):  # type: ignore[no-untyped-def]
    jax = jax_in_one_thread()
    import jax.numpy as jnp

    basis = jnp.asarray(time, jnp.float32)

    def loss(parameters, rows, key):  # type: ignore[no-untyped-def]
        W1, b1, W2, b2, W3, b3, A = parameters
        x, amplitude, target = rows
        first, other = jax.random.split(key)

        def dropped(h: Any, key: Any) -> Any:
            return h * jax.random.bernoulli(key, 1.0 - DROPPED, h.shape) / (1.0 - DROPPED)

        h = dropped(jax.nn.silu(x @ W1 + b1), first)
        h = h + dropped(jax.nn.silu(h @ W2 + b2), other)
        coefficients = (h @ W3 + b3 + x[:, : A.shape[0]] @ A).reshape(len(x), -1, 9)
        error = jnp.einsum("tk,bkc->btc", basis, coefficients) * amplitude[:, None, None] - target
        square = (error.reshape(len(x), -1, 3, 3) ** 2).sum(-1)
        return 10.0 * jnp.sqrt(square + 1e-6).mean()

    return loss
