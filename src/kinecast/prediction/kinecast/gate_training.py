"""Fits the gate on forecasts of experts for recordings they did not see (JAX)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinecast.prediction.descent import descend, jax_in_one_thread
from kinecast.prediction.kinecast.gate import JOINT_TYPE, Gate, step_basis

__all__ = ["fit_gate"]

STEPS, BATCH, RATE, DECAY = 400, 192, 0.03, 1e-3


def fit_gate(
    errors: Float[np.ndarray, "B E 6 Q"],
    windows: Float[np.ndarray, "B 6 5"],
    forecasts: Float[np.ndarray, "B E T 6 3"],
    futures: Float[np.ndarray, "B T 6 3"],
    seed: int,
) -> Gate:
    """The gate with the least mean distance of the mixture, windows weighted by one over the root of their motion.

    Args:
        errors, windows: the gate's inputs.
        forecasts: of the experts, relative to the last pose [m].
        futures: what came, likewise [m].
        seed: of the batches.
    """
    jax = jax_in_one_thread()
    import jax.numpy as jnp

    experts, steps, sources = forecasts.shape[1], forecasts.shape[2], errors.shape[-1]
    basis = jnp.asarray(step_basis(steps))
    data = (errors, windows, forecasts, futures)

    def loss(parameters, rows, _key):  # type: ignore[no-untyped-def]
        bias, share, slope = parameters
        error, look, made, came = rows
        logits = (bias @ basis.T)[:, JOINT_TYPE][None]
        logits = logits - (error @ share) @ basis.T
        logits = logits + jnp.einsum("bjg,egk->bejk", look, slope) @ basis.T
        weights = jax.nn.softmax(logits, axis=1).transpose(0, 1, 3, 2)
        mixed = (weights[..., None] * made).sum(axis=1)
        distance = jnp.sqrt(((mixed - came) ** 2).sum(-1) + 1e-7)
        motion = jnp.sqrt((came**2).sum(-1)).mean((1, 2)) + 0.02
        penalty = DECAY * ((bias**2).sum() + (slope**2).sum())
        return 3.0 * (distance.mean((1, 2)) / jnp.sqrt(motion)).mean() + penalty

    share = np.zeros((sources, 3))
    share[:, 0] = 3.0 / sources
    start = [np.zeros((experts, 3, 3)), share, np.zeros((experts, 5, 3))]
    bias, share, slope = descend(
        loss, start, data, steps=STEPS, batch=BATCH, rate=RATE, decay=0.0, second=0.99, seed=seed
    )
    return Gate(bias, share, slope)
