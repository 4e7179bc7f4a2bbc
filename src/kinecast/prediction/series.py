"""Many scalar series, each with its own one-step sparse Gaussian process, stacked for compiled loops (lanes)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.errors import ModelError
from kinecast.prediction.sparse_gp import SparseGP

__all__ = ["SeriesStack", "stack_from_arrays", "stack_of"]


class SeriesStack(NamedTuple):
    """D sparse Gaussian processes of N inputs and M pseudo-inputs each.

    With u = gain ∘ x − offset and k_m = exp(−½ |u − pseudo_m|²): mean = centre + Σ_m weights_m k_m and
    variance = signal − Σ_r (Σ_m factor_rm k_m)² + noise, in the units of the series.

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


def stack_of(processes: Sequence[SparseGP]) -> SeriesStack:
    """Trained processes of one output each, their standardisation folded in."""
    rank = max(max(process.factor.shape[1] for process in processes), 1)
    lengths = [process.kernel.lengthscales for process in processes]
    scales = [process.kernel.signal_variance * process.outputs.sd[0] for process in processes]
    return SeriesStack(
        gain=np.array([1.0 / (p.inputs.sd * ell) for p, ell in zip(processes, lengths, strict=True)]),
        offset=np.array([p.inputs.mean / (p.inputs.sd * ell) for p, ell in zip(processes, lengths, strict=True)]),
        pseudo=np.array([(p.pseudo_inputs / ell).T for p, ell in zip(processes, lengths, strict=True)]),
        weights=np.array([scale * p.weights[:, 0] for p, scale in zip(processes, scales, strict=True)]),
        factor=np.array(
            [
                scale * np.pad(p.factor, ((0, 0), (0, rank - p.factor.shape[1]))).T
                for p, scale in zip(processes, scales, strict=True)
            ]
        ),
        centre=np.array([p.outputs.mean[0] for p in processes]),
        signal=np.array([p.kernel.signal_variance * p.outputs.sd[0] ** 2 for p in processes]),
        noise=np.array([p.noise_variance * p.outputs.sd[0] ** 2 for p in processes]),
    )


def stack_from_arrays(arrays: Mapping[str, np.ndarray], count: int, inputs: int) -> SeriesStack:
    """The stack of `count` processes of `inputs` inputs whose arrays were stored under its fields' names.

    Raises:
        ModelError: shapes that do not belong together.
    """
    stack = SeriesStack(*(np.ascontiguousarray(arrays[name], dtype=float) for name in SeriesStack._fields))
    pseudo, rank = stack.pseudo.shape[-1], stack.factor.shape[1]
    expected = {
        "gain": (count, inputs),
        "offset": (count, inputs),
        "pseudo": (count, inputs, pseudo),
        "weights": (count, pseudo),
        "factor": (count, rank, pseudo),
        "centre": (count,),
        "signal": (count,),
        "noise": (count,),
    }
    for name, shape in expected.items():
        if getattr(stack, name).shape != shape:
            raise ModelError(f"array {name} of shape {getattr(stack, name).shape}; expected {shape}")
    if not ((stack.noise > 0) & (stack.signal > 0)).all():
        raise ModelError("arrays signal and noise hold variances that are not above 0")
    return stack
