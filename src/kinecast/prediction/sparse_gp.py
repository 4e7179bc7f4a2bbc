"""Sparse pseudo-input Gaussian process of Eq. 3 (SPGP; FITC): fast prediction from cached products, no JAX.

Outputs share one kernel, one noise and one set of pseudo-inputs Z; inputs and outputs are standardised inside.
With K = k(Z, Z), k_n = k(Z, x_n) and the FITC noise λ_n = k(x_n, x_n) − k_nᵀ K⁻¹ k_n + σ²:

    A = K + Σ_n k_n k_nᵀ / λ_n                        mean(x) = k(x)ᵀ A⁻¹ Σ_n k_n y_n / λ_n
    variance(x) = σf² − k(x)ᵀ (K⁻¹ − A⁻¹) k(x) + σ²
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve, qr, solve_triangular

from kinecast.errors import ModelError, OptionError
from kinecast.prediction.kernels import RBF

__all__ = ["JITTER", "Scale", "SparseGP"]

JITTER = 1e-8
"""Added to the diagonal of K, as a share of σf²."""
BLOCK = 2048
"""Rows handled at once: memory stays flat in N."""


@dataclass(frozen=True)
class Scale:
    """Standardisation of columns: (data − mean) / sd.

    Attributes:
        mean: (D,) in the units of the data.
        sd: (D,) > 0; 1 for a column that does not vary.
    """

    mean: Float[np.ndarray, " D"]
    sd: Float[np.ndarray, " D"]

    @classmethod
    def of(cls, data: Float[np.ndarray, "N D"]) -> Scale:
        """The scale that standardises the columns of data, N ≥ 1."""
        mean, sd = data.mean(axis=0), data.std(axis=0)
        return cls(mean, np.where(sd > 1e-12 * (1.0 + np.abs(mean)), sd, 1.0))

    def standardise(self, data: Float[np.ndarray, "N D"]) -> Float[np.ndarray, "N D"]:
        """(data − mean) / sd."""
        return (data - self.mean) / self.sd


@dataclass(frozen=True)
class SparseGP:
    """A trained SPGP, ready to predict.

    Attributes:
        pseudo_inputs: (M, D) Z, standardised.
        kernel: in standardised units.
        noise_variance: σ² > 0, in standardised units, the same for every output.
        inputs: standardisation of the D inputs.
        outputs: standardisation of the P outputs.
        weights: (M, P) A⁻¹ Σ_n k_n y_n / λ_n.
        factor: (M, M) lower triangular U with U Uᵀ = K⁻¹ − A⁻¹, so that the latent variance is σf² − |Uᵀ k(x)|².

    Raises:
        ModelError: if a number is not finite or not positive where it must be, or the factor is not triangular.
    """

    pseudo_inputs: Float[np.ndarray, "M D"]
    kernel: RBF
    noise_variance: float
    inputs: Scale
    outputs: Scale
    weights: Float[np.ndarray, "M P"]
    factor: Float[np.ndarray, "M M"]

    def __post_init__(self) -> None:
        for name, array in self.to_arrays().items():
            if not np.isfinite(array).all():
                raise ModelError(f"sparse GP: {name} holds numbers that are not finite")
        if not (self.noise_variance > 0 and np.all(self.inputs.sd > 0) and np.all(self.outputs.sd > 0)):
            raise ModelError("sparse GP: noise variance and standard deviations must be positive")
        if np.triu(self.factor, 1).any():
            raise ModelError("sparse GP: factor must be lower triangular")

    def predict(self, x: Float[np.ndarray, "N D"]) -> tuple[Float[np.ndarray, "N P"], Float[np.ndarray, "N P"]]:
        """Predictive mean and variance, the noise included.

        Args:
            x: (N, D) inputs, in the units of the training inputs; NaN gives NaN.

        Returns:
            (N, P) means and (N, P) variances, in the units of the training outputs.
        """
        mean = np.empty((len(x), self.weights.shape[1]))
        variance = np.empty(len(x))
        for rows in _blocks(len(x)):
            k = self.kernel(self.inputs.standardise(x[rows]), self.pseudo_inputs)
            mean[rows] = k @ self.weights
            explained = np.square(k @ self.factor).sum(axis=1)
            variance[rows] = np.maximum(self.kernel.signal_variance - explained, 0.0) + self.noise_variance
        return self.outputs.mean + self.outputs.sd * mean, variance[:, None] * self.outputs.sd**2

    @classmethod
    def condition(
        cls,
        inputs: Float[np.ndarray, "N D"],
        outputs: Float[np.ndarray, "N P"],
        pseudo_inputs: Float[np.ndarray, "M D"],
        kernel: RBF,
        noise_variance: float,
        *,
        input_scale: Scale,
        output_scale: Scale,
    ) -> SparseGP:
        """The posterior given data, for settled hyperparameters. Memory does not grow with N beyond the data.

        Args:
            inputs: (N, D) in their own units.
            outputs: (N, P) in their own units.
            pseudo_inputs: (M, D) standardised by `input_scale`.
            kernel: in standardised units.
            noise_variance: σ², in standardised units.
            input_scale: standardisation of the inputs.
            output_scale: standardisation of the outputs.

        Raises:
            OptionError: if inputs or outputs are not finite.
        """
        if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
            raise OptionError("inputs and outputs of a sparse GP must be finite")
        count = len(pseudo_inputs)
        prior = kernel(pseudo_inputs, pseudo_inputs)
        root = np.linalg.cholesky(prior + JITTER * kernel.signal_variance * np.eye(count))  # L
        inner = np.eye(count)  # B = L⁻¹ A L⁻ᵀ
        target = np.zeros((count, outputs.shape[1]))
        for rows in _blocks(len(inputs)):
            k = kernel(input_scale.standardise(inputs[rows]), pseudo_inputs)
            v = solve_triangular(root, k.T, lower=True, check_finite=False)
            noise = kernel.signal_variance - np.square(v).sum(axis=0)
            scaled = v / (np.maximum(noise, 0.0) + noise_variance)
            inner += scaled @ v.T
            target += scaled @ output_scale.standardise(outputs[rows])
        weights = solve_triangular(root.T, cho_solve(cho_factor(inner), target), check_finite=False)
        shares, axes = np.linalg.eigh(inner)
        explained = axes * np.sqrt(np.maximum(1.0 - 1.0 / shares, 0.0))  # I − B⁻¹, its square root
        factor = solve_triangular(root.T, explained, check_finite=False)
        (triangle,) = qr(factor.T, mode="r", check_finite=False)  # the same product U Uᵀ
        return cls(
            pseudo_inputs=pseudo_inputs,
            kernel=kernel,
            noise_variance=noise_variance,
            inputs=input_scale,
            outputs=output_scale,
            weights=weights,
            factor=np.ascontiguousarray(triangle.T),
        )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for an npz file; `from_arrays` is the way back."""
        return {
            "pseudo_inputs": self.pseudo_inputs,
            "lengthscales": self.kernel.lengthscales,
            "signal_variance": np.array(self.kernel.signal_variance),
            "noise_variance": np.array(self.noise_variance),
            "input_mean": self.inputs.mean,
            "input_sd": self.inputs.sd,
            "output_mean": self.outputs.mean,
            "output_sd": self.outputs.sd,
            "weights": self.weights,
            "factor": self.factor,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> SparseGP:
        """The sparse GP that `to_arrays` wrote.

        Raises:
            ModelError: if an array is missing, of another type or shape, or holds impossible numbers.
        """
        sizes: dict[str, int] = {}
        found: dict[str, np.ndarray] = {}
        for name, axes in ARRAYS.items():
            if name not in arrays:
                raise ModelError(f"sparse GP: array {name!r} is missing")
            array = np.asarray(arrays[name])
            if array.dtype != np.float64 or array.ndim != len(axes):
                raise ModelError(
                    f"sparse GP: {name} must be float64 with {len(axes)} axes, found {array.dtype} {array.shape}"
                )
            for axis, size in zip(axes, array.shape, strict=True):
                if sizes.setdefault(axis, size) != size:
                    raise ModelError(f"sparse GP: {name} has shape {array.shape}, expected {axis} = {sizes[axis]}")
            found[name] = array
        try:
            kernel = RBF(found["lengthscales"], float(found["signal_variance"]))
        except OptionError as error:
            raise ModelError(f"sparse GP: {error}") from error
        return cls(
            pseudo_inputs=found["pseudo_inputs"],
            kernel=kernel,
            noise_variance=float(found["noise_variance"]),
            inputs=Scale(found["input_mean"], found["input_sd"]),
            outputs=Scale(found["output_mean"], found["output_sd"]),
            weights=found["weights"],
            factor=found["factor"],
        )


ARRAYS = {
    "pseudo_inputs": "MD",
    "lengthscales": "D",
    "signal_variance": "",
    "noise_variance": "",
    "input_mean": "D",
    "input_sd": "D",
    "output_mean": "P",
    "output_sd": "P",
    "weights": "MP",
    "factor": "MM",
}
"""Arrays of a stored sparse GP, each with its axes."""


def _blocks(count: int) -> Iterator[slice]:
    """Consecutive slices of at most BLOCK rows that cover `count` rows."""
    return (slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK))
