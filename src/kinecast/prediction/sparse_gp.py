"""Sparse pseudo-input Gaussian processes of Eq. 3 (SPGP; FITC), one a series, all evaluated at once.

With K = k(Z, Z), k_n = k(Z, x_n), k(x, z) = σf² exp(−½ Σ_d (x_d − z_d)² / ℓ_d²) and the FITC noise
λ_n = σf² − k_nᵀ K⁻¹ k_n + σ²:

    A = K + Σ_n k_n k_nᵀ / λ_n                        mean(x) = k(x)ᵀ A⁻¹ Σ_n k_n y_n / λ_n
    variance(x) = σf² − k(x)ᵀ (K⁻¹ − A⁻¹) k(x) + σ²

Pseudo-inputs Z, lengthscales and variances maximise the marginal likelihood: JAX gradients, SciPy's L-BFGS, float64.
Only training needs JAX (`pip install 'kinecast[train]'`).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.errors import ModelError, OptionError
from kinecast.prediction.descent import jax_in_one_thread
from kinecast.prediction.model_file import shaped

JITTER = 1e-8
"""Added to the diagonal of K, as a share of σf²."""
SIGNAL_START, NOISE_START = 1.0, 0.05
"""Variances that L-BFGS starts from, in standardised units."""
CENTRING_ROUNDS, CENTRING_POINTS = 10, 8192
"""Iterations of the k-means that places the pseudo-inputs, and points it looks at."""
LENGTHSCALES, SIGNAL_VARIANCES, NOISE_VARIANCES = (1e-2, 1e3), (1e-4, 1e6), (1e-6, 10.0)
"""Ranges of the hyperparameters, in standardised units: wide enough never to bind on data worth fitting."""


class SparseGPs(NamedTuple):
    """D independent processes of N inputs, M pseudo-inputs and one output each, ready to predict.

    With u = gain ∘ x − offset and k_m = exp(−½ |u − pseudo_m|²): mean = centre + Σ_m weights_m k_m and
    variance = signal − Σ_r (Σ_m factor_rm k_m)² + noise, in the units of the outputs.

    Attributes:
        gain, offset: (D, N) standardise an input and divide it by its lengthscale.
        pseudo: (D, N, M) pseudo-inputs, likewise.
        weights: (D, M) cached product for the mean.
        factor: (D, R, M) cached product for the variance.
        centre, signal, noise: (D,) mean of the output, prior variance, noise variance.
    """

    gain: Float[np.ndarray, "D N"]
    offset: Float[np.ndarray, "D N"]
    pseudo: Float[np.ndarray, "D N M"]
    weights: Float[np.ndarray, "D M"]
    factor: Float[np.ndarray, "D R M"]
    centre: Float[np.ndarray, " D"]
    signal: Float[np.ndarray, " D"]
    noise: Float[np.ndarray, " D"]

    def predict(self, x: Float[np.ndarray, "D N S"]) -> tuple[Float[np.ndarray, "D S"], Float[np.ndarray, "D S"]]:
        """Predictive mean and standard deviation (the noise included) of S inputs, in the units of the outputs.

        With w = (u, 1, |u|²) each log k_m = w · (pseudo_m, −½ |pseudo_m|², −½) is part of one product, and so are the
        mean and what the variance lacks. NaN gives NaN.
        """
        squares = -0.5 * np.square(self.pseudo).sum(axis=1)[:, :, None]
        exponents = np.concatenate([self.pseudo.transpose(0, 2, 1), squares, np.full_like(squares, -0.5)], axis=2)
        u = self.gain[:, :, None] * x - self.offset[:, :, None]
        square = np.einsum("dns,dns->ds", u, u)[:, None]
        k = np.exp(exponents @ np.concatenate([u, np.ones_like(square), square], axis=1))
        out = np.concatenate([self.weights[:, None], self.factor], axis=1) @ k
        explained = np.einsum("drs,drs->ds", out[:, 1:], out[:, 1:])
        variance = np.maximum(self.signal[:, None] - explained, 0.0) + self.noise[:, None]
        return out[:, 0] + self.centre[:, None], np.sqrt(variance)

    @staticmethod
    def joined(processes: Sequence[SparseGPs]) -> SparseGPs:
        """All processes of several, in their order; each must have as many inputs and pseudo-inputs."""
        return SparseGPs(*map(np.concatenate, zip(*processes, strict=True)))

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray], count: int, inputs: int) -> SparseGPs:
        """The D = count processes of N = inputs whose arrays were stored under these fields' names.

        Raises:
            ModelError: an array is missing, of another shape, or a variance is not above 0.
        """
        pseudo, rank = (
            (*np.shape(arrays.get(name, 0.0)), 1, 1, 1)[axis] for name, axis in (("pseudo", 2), ("factor", 1))
        )
        shapes = [(inputs,), (inputs,), (inputs, pseudo), (pseudo,), (rank, pseudo), (), (), ()]
        named = zip(SparseGPs._fields, shapes, strict=True)
        processes = SparseGPs(*(shaped(arrays, name, count, *shape) for name, shape in named))
        if not ((processes.noise > 0) & (processes.signal > 0)).all():
            raise ModelError("arrays signal and noise hold variances that are not above 0")
        return processes


def fit_sparse_gp(
    inputs: Float[np.ndarray, "W N"],
    outputs: Float[np.ndarray, " W"],
    *,
    seed: int,
    pseudo_inputs: int,
    iterations: int,
) -> SparseGPs:
    """One SPGP (D = 1) of the marginal likelihood's maximum, starting from k-means centres.

    The same seed and data give the same result on the same machine; `iterations` are those of L-BFGS.

    Raises:
        MissingExtraError: without JAX.
        OptionError: if the data hold too few points or numbers that are not finite.
    """
    if len(inputs) < 2:
        raise OptionError(f"a sparse GP needs at least 2 points, found {len(inputs)}")
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        raise OptionError("inputs and outputs of a sparse GP must be finite")
    input_mean, input_sd = _standard(inputs)
    output_mean, output_sd = _standard(outputs)
    x, y = (inputs - input_mean) / input_sd, (outputs - output_mean) / output_sd
    z = centres(np.random.default_rng(seed), x, min(pseudo_inputs, len(x)))
    start = np.log([math.sqrt(x.shape[1])] * x.shape[1] + [SIGNAL_START, NOISE_START])
    best = _maximise(np.concatenate([start, z.ravel()]), x, y, iterations)
    *lengths, signal, noise = np.exp(best[: x.shape[1] + 2])
    z = best[x.shape[1] + 2 :].reshape(z.shape)
    weights, factor = _posterior(x / lengths, y, z / lengths, signal, noise)
    return SparseGPs(
        gain=1.0 / (input_sd * lengths)[None],
        offset=(input_mean / (input_sd * lengths))[None],
        pseudo=(z / lengths).T[None],
        weights=output_sd * signal * weights[None],
        factor=output_sd * signal * factor[None],
        centre=np.array([output_mean]),
        signal=np.array([signal * output_sd**2]),
        noise=np.array([noise * output_sd**2]),
    )


def _standard(data: np.ndarray) -> Any:
    """Mean and standard deviation of columns, or of one; 1 for a column that does not vary."""
    mean, sd = data.mean(axis=0), data.std(axis=0)
    return mean, np.where(sd > 1e-12 * (1.0 + np.abs(mean)), sd, 1.0)


def _fitc(lib: Any, solve: Callable[..., Any], x: Any, z: Any, signal: Any, noise: Any) -> Any:
    """L with L Lᵀ = K, V = L⁻¹ k(Z, X), and Λ + σ² as a vector, in NumPy or JAX; inputs over their lengthscales."""

    def kernel(a: Any, b: Any) -> Any:
        squared = lib.sum(a * a, -1)[:, None] + lib.sum(b * b, -1) - 2.0 * a @ b.T
        return signal * lib.exp(-0.5 * lib.maximum(squared, 0.0))

    root = lib.linalg.cholesky(kernel(z, z) + JITTER * signal * lib.eye(len(z)))
    v = solve(root, kernel(z, x), lower=True)
    return root, v, lib.maximum(signal - lib.sum(v * v, 0), 0.0) + noise


def _posterior(
    x: Float[np.ndarray, "W N"], y: Float[np.ndarray, " W"], z: Float[np.ndarray, "M N"], signal: float, noise: float
) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M M"]]:
    """A⁻¹ Σ_n k_n y_n / λ_n, and U with Uᵀ U = K⁻¹ − A⁻¹; inputs over their lengthscales."""
    from scipy.linalg import solve_triangular

    root, v, diagonal = _fitc(np, solve_triangular, x, z, signal, noise)
    scaled = v / diagonal
    inner = np.eye(len(z)) + scaled @ v.T  # B = L⁻¹ A L⁻ᵀ
    weights = solve_triangular(root, np.linalg.solve(inner, scaled @ y), lower=True, trans="T")
    shares, axes = np.linalg.eigh(inner)
    explained = axes * np.sqrt(np.maximum(1.0 - 1.0 / shares, 0.0))  # I − B⁻¹, its square root
    return weights, solve_triangular(root, explained, lower=True, trans="T").T


def centres(rng: np.random.Generator, points: Float[np.ndarray, "W N"], count: int) -> Float[np.ndarray, "M N"]:
    """`count` k-means centres of points (from points drawn at random), all distinct."""
    from scipy.cluster.vq import kmeans2

    if len(points) > CENTRING_POINTS:
        points = points[rng.choice(len(points), CENTRING_POINTS, replace=False)]
    found = points[rng.choice(len(points), count, replace=False)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a cluster left empty keeps its centre
        found, _ = kmeans2(points, found, iter=CENTRING_ROUNDS, minit="matrix")
    return found + 1e-3 * rng.standard_normal(found.shape)  # repeated points would share a centre


def negative_log_likelihood(vector: Any, x: Any, y: Any) -> Any:
    """−log N(y; 0, Kₙₘ K⁻¹ Kₘₙ + Λ), Λ the FITC diagonal (JAX).

    Args:
        vector: (N + 2 + M N,) log lengthscales, log σf², log σ², pseudo-inputs.
        x: (W, N) inputs.
        y: (W,) outputs.
    """
    import jax.numpy as jnp
    from jax.scipy.linalg import solve_triangular

    inputs = x.shape[-1]
    lengths, signal, noise = jnp.exp(vector[:inputs]), *jnp.exp(vector[inputs : inputs + 2])
    z = vector[inputs + 2 :].reshape(-1, inputs) / lengths
    _, v, diagonal = _fitc(jnp, solve_triangular, x / lengths, z, signal, noise)
    scaled = v / diagonal
    inner = jnp.linalg.cholesky(jnp.eye(len(z)) + scaled @ v.T)
    explained = solve_triangular(inner, scaled @ y, lower=True)
    fit = jnp.sum(y * y / diagonal) - jnp.sum(explained**2)
    return 0.5 * (fit + jnp.sum(jnp.log(2.0 * math.pi * diagonal))) + jnp.sum(jnp.log(jnp.diag(inner)))


@cache
def _value_and_gradient() -> Callable[..., Any]:
    """Compiled once per shape of the data."""
    import jax

    return jax.jit(jax.value_and_grad(negative_log_likelihood))


def _maximise(
    start: Float[np.ndarray, " K"], x: Float[np.ndarray, "W N"], y: Float[np.ndarray, " W"], iterations: int
) -> Float[np.ndarray, " K"]:
    """Where L-BFGS ends from start, on the negative log marginal likelihood per number."""
    double_precision = jax_in_one_thread().enable_x64(True)
    from scipy.optimize import Bounds, minimize  # here, since predicting does without and it is slow to import

    def cost(vector: Float[np.ndarray, " K"]) -> tuple[float, Float[np.ndarray, " K"]]:
        value, slope = _value_and_gradient()(vector, x, y)
        value, slope = float(value) / len(y), np.asarray(slope) / len(y)
        if math.isfinite(value) and np.isfinite(slope).all():
            return value, slope
        return 1e10, np.zeros_like(vector)  # the line search steps back

    ranges = np.repeat([[-math.inf, math.inf]], len(start), axis=0)
    ranges[: x.shape[1] + 2] = np.log([LENGTHSCALES] * x.shape[1] + [SIGNAL_VARIANCES, NOISE_VARIANCES])
    with double_precision:  # the caller's own setting comes back after it
        found = minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=Bounds(*ranges.T),
            options={"maxiter": iterations, "maxcor": 20, "ftol": 1e-9, "gtol": 1e-7},
        )  # fmt: skip
    return np.asarray(found.x)
