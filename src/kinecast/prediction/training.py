"""Training of sparse GPs by the marginal likelihood: JAX gradients, SciPy's L-BFGS, float64.

Only this file needs JAX (`pip install 'kinecast[train]'`); what it returns does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.prediction.jax_in_one_thread import jax_in_one_thread
from kinecast.prediction.kernels import RBF
from kinecast.prediction.sparse_gp import JITTER, Scale, SparseGP

__all__ = ["SparseGPOptions", "fit_sparse_gp"]

Progress = Callable[[int, int], None]

BLOCK = 1024
"""Rows per block of the streamed likelihood; its gradient recomputes blocks, so memory stays flat in N."""
SIGNAL_START, NOISE_START = 10.0, 0.05
"""Variances that L-BFGS starts from: of several tried on wrist series, these reached the best likelihood soonest."""
CENTRING_ROUNDS = 10
"""Lloyd iterations of the k-means that places the pseudo-inputs."""
CENTRING_POINTS = 8192
"""Points that k-means looks at."""
LENGTHSCALES = (1e-2, 1e3)
SIGNAL_VARIANCES = (1e-4, 1e6)
NOISE_VARIANCES = (1e-6, 10.0)
"""Ranges of the hyperparameters, in standardised units: wide enough never to bind on data worth fitting."""


@dataclass(frozen=True)
class SparseGPOptions:
    """How to train a sparse GP.

    Attributes:
        pseudo_inputs: M, at most the number of points.
        iterations: L-BFGS iterations.
        max_points: points the hyperparameters are learned from, drawn at random where there are more. The posterior
            is conditioned on all of them.
        seed: of the k-means and of the draw of points.

    Raises:
        OptionError: if one of them is out of range.
    """

    pseudo_inputs: int = 32
    iterations: int = 150
    max_points: int = 20_000
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("pseudo_inputs", 1), ("iterations", 0), ("max_points", 2), ("seed", 0)):
            if getattr(self, name) < least:
                raise OptionError(f"{name} must be at least {least}, found {getattr(self, name)}")


def fit_sparse_gp(
    inputs: Float[np.ndarray, "N D"],
    outputs: Float[np.ndarray, "N P"],
    options: SparseGPOptions | None = None,
    *,
    progress: Progress | None = None,
) -> SparseGP:
    """Train one SPGP whose P outputs share pseudo-inputs, kernel and noise.

    Maximises Σ_p log N(y_p; 0, Kₙₘ K⁻¹ Kₘₙ + Λ), Λ the FITC diagonal, over pseudo-inputs, lengthscales, signal
    and noise variance, starting from k-means centres.

    Args:
        inputs: (N, D), any units; N ≥ 2.
        outputs: (N, P), any units.
        options: None takes the defaults.
        progress: called with (iterations done, iterations at most).

    Returns:
        The posterior given all N points. The same seed and data give the same result on the same machine.

    Raises:
        MissingExtraError: without JAX.
        OptionError: if the data hold too few points or numbers that are not finite.
    """
    options = options or SparseGPOptions()
    if len(inputs) < 2:
        raise OptionError(f"a sparse GP needs at least 2 points, found {len(inputs)}")
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        raise OptionError("inputs and outputs of a sparse GP must be finite")
    rng = np.random.default_rng(options.seed)
    input_scale, output_scale = Scale.of(inputs), Scale.of(outputs)
    rows = np.arange(len(inputs))
    if len(rows) > options.max_points:
        rows = np.sort(rng.choice(rows, options.max_points, replace=False))
    x, y = input_scale.standardise(inputs[rows]), output_scale.standardise(outputs[rows])
    start = _pack(
        centres(rng, x, min(options.pseudo_inputs, len(x))),
        np.full(x.shape[1], math.sqrt(x.shape[1])),
        1.0,
        0.05,
    )
    best = _maximise(start, x, y, options.iterations, progress)
    pseudo_inputs, kernel, noise_variance = _unpack(best, x.shape[1])
    return SparseGP.condition(
        inputs,
        outputs,
        pseudo_inputs,
        kernel,
        noise_variance,
        input_scale=input_scale,
        output_scale=output_scale,
    )


def centres(rng: np.random.Generator, points: Float[np.ndarray, "N D"], count: int) -> Float[np.ndarray, "M D"]:
    """`count` k-means centres of points (Lloyd's iterations from points drawn at random), all distinct."""
    if len(points) > CENTRING_POINTS:
        points = points[rng.choice(len(points), CENTRING_POINTS, replace=False)]
    found = points[rng.choice(len(points), count, replace=False)]
    norms = np.square(points).sum(axis=1)
    for _ in range(CENTRING_ROUNDS):
        distances = norms[:, None] - 2.0 * points @ found.T + np.square(found).sum(axis=1)
        nearest = distances.argmin(axis=1)
        members = np.bincount(nearest, minlength=count)
        sums = np.stack([np.bincount(nearest, column, minlength=count) for column in points.T], axis=1)
        found = np.where(members[:, None] > 0, sums / np.maximum(members, 1)[:, None], found)
    return found + 1e-3 * rng.standard_normal(found.shape)  # repeated points would share a centre


def _pack(
    pseudo_inputs: Float[np.ndarray, "M D"],
    lengthscales: Float[np.ndarray, " D"],
    signal_variance: float,
    noise_variance: float,
) -> Float[np.ndarray, " K"]:
    """One vector for the optimiser: log lengthscales, log variances, pseudo-inputs."""
    variances = np.log([signal_variance, noise_variance])
    return np.concatenate([np.log(lengthscales), variances, pseudo_inputs.ravel()])


def _unpack(vector: Float[np.ndarray, " K"], dimension: int) -> tuple[Float[np.ndarray, "M D"], RBF, float]:
    """The pseudo-inputs, kernel and noise variance of a vector of `_pack`."""
    lengthscales, variances = np.exp(vector[:dimension]), np.exp(vector[dimension : dimension + 2])
    pseudo_inputs = vector[dimension + 2 :].reshape(-1, dimension)
    return pseudo_inputs, RBF(lengthscales, float(variances[0])), float(variances[1])


def _maximise(
    start: Float[np.ndarray, " K"],
    x: Float[np.ndarray, "N D"],
    y: Float[np.ndarray, "N P"],
    iterations: int,
    progress: Progress | None,
) -> Float[np.ndarray, " K"]:
    """The best vector met by L-BFGS from start, on the negative log marginal likelihood per number."""
    blocks = -(-len(x) // BLOCK)
    size = -(-len(x) // blocks)
    padding = ((0, blocks * size - len(x)), (0, 0))
    data = [np.pad(array, padding).reshape(blocks, size, -1) for array in (x, y)]
    present = np.pad(np.ones(len(x)), padding[0]).reshape(blocks, size)
    best, lowest = start, math.inf
    done = 0

    def cost(vector: Float[np.ndarray, " K"]) -> tuple[float, Float[np.ndarray, " K"]]:
        nonlocal best, lowest
        value, slope = value_and_gradient(vector, *data, present)
        value, slope = float(value) / y.size, np.asarray(slope) / y.size
        if not (math.isfinite(value) and np.isfinite(slope).all()):
            return 1e10, np.zeros_like(vector)  # the line search steps back
        if value < lowest:
            best, lowest = vector.copy(), value
        return value, slope

    def report(xk: Float[np.ndarray, " K"]) -> None:  # noqa: ARG001, the name SciPy calls it by
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, iterations)

    from scipy.optimize import minimize  # here, since predicting does without and it is slow to import

    ranges = [LENGTHSCALES] * x.shape[1] + [SIGNAL_VARIANCES, NOISE_VARIANCES]
    bounds: list[tuple[float | None, float | None]] = [(math.log(least), math.log(most)) for least, most in ranges]
    bounds += [(None, None)] * (len(start) - len(bounds))
    with _double_precision():
        value_and_gradient = _compiled()
        minimize(
            cost,
            start,
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            callback=report,
            options={"maxiter": iterations, "maxcor": 20, "ftol": 1e-9, "gtol": 1e-7},
        )
    return best


def _double_precision() -> Any:
    """A context in which JAX computes in float64; the caller's own setting comes back after it."""
    return jax_in_one_thread().enable_x64(True)


@cache
def _compiled() -> Callable[..., Any]:
    """The negative log marginal likelihood and its gradient, compiled once per shape of the data."""
    import jax
    import jax.numpy as jnp
    from jax.scipy.linalg import solve_triangular

    def cost(vector: Any, x: Any, y: Any, present: Any) -> Any:
        """−Σ_p log N(y_p; 0, Kₙₘ K⁻¹ Kₘₙ + Λ); rows that only pad a block are not present."""
        dimension, count = x.shape[-1], (len(vector) - 2) // x.shape[-1] - 1
        lengths, signal, noise = jnp.exp(vector[:dimension]), *jnp.exp(vector[dimension : dimension + 2])
        z = vector[dimension + 2 :].reshape(count, dimension) / lengths

        def kernel(a: Any, b: Any) -> Any:
            squared = jnp.sum(a * a, -1)[:, None] + jnp.sum(b * b, -1) - 2.0 * a @ b.T
            return signal * jnp.exp(-0.5 * jnp.maximum(squared, 0.0))

        root = jnp.linalg.cholesky(kernel(z, z) + JITTER * signal * jnp.eye(count))
        whitener = solve_triangular(root, jnp.eye(count), lower=True)  # a product per block, not a solve

        def add(total: Any, block: Any) -> Any:
            inner, target, scalars = total
            x_block, y_block, here = block
            v = whitener @ kernel(z, x_block / lengths)
            diagonal = jnp.maximum(signal - jnp.sum(v * v, 0), 0.0) + noise
            scaled = v * (here / diagonal)
            fit = jnp.sum(here * jnp.sum(y_block * y_block, -1) / diagonal)
            size = jnp.sum(here * jnp.log(2.0 * math.pi * diagonal))
            return (inner + scaled @ v.T, target + scaled @ y_block, scalars + jnp.stack([fit, size])), None

        empty = (jnp.eye(count), jnp.zeros((count, y.shape[-1])), jnp.zeros(2))
        (inner, target, scalars), _ = jax.lax.scan(jax.checkpoint(add), empty, (x, y, present))
        inner_root = jnp.linalg.cholesky(inner)
        explained = solve_triangular(inner_root, target, lower=True)
        determinant = scalars[1] + 2.0 * jnp.sum(jnp.log(jnp.diag(inner_root)))
        return 0.5 * (scalars[0] - jnp.sum(explained**2) + y.shape[-1] * determinant)

    return jax.jit(jax.value_and_grad(cost))
