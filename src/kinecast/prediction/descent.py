"""JAX for training: one thread, and stochastic gradient descent (Adam, cosine rate, decoupled decay) as one loop."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np

from kinecast.errors import MissingExtraError

FIRST = 0.9
WARM_UP = 50


def jax_in_one_thread() -> ModuleType:
    """JAX, its CPU backend started with one thread unless the program had started it before.

    Sums over several threads would depend on their number, and these fits gain nothing from more.

    Raises:
        MissingExtraError: JAX is not installed.
    """
    try:
        import jax
    except ImportError as error:
        raise MissingExtraError("training", "train") from error
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = "1"  # read once, by XLA, when its CPU backend starts
    jax.local_devices(backend="cpu")
    del os.environ["NPROC"]
    if before is not None:
        os.environ["NPROC"] = before
    return jax


def descend(
    loss: Callable[..., Any],
    start: Sequence[np.ndarray],
    data: Sequence[np.ndarray],
    *,
    steps: int,
    batch: int,
    rate: float,
    decay: float,
    second: float,
    seed: int,
) -> list[np.ndarray]:
    """Minimises the mean of a loss over random batches; float32, the same for the same seed.

    Args:
        loss: (JAX, parameters, rows of the data, random key) to a number.
        start: parameters to start from.
        data: arrays with the examples along the first axis.
        steps, batch, rate: number of steps, rows in each, greatest step size.
        decay: of the parameters, decoupled from the gradient.
        second: forgetting of the squared gradient.
        seed: of batches and keys.
    """
    jax = jax_in_one_thread()
    import jax.numpy as jnp

    arrays = [jnp.asarray(array, jnp.float32) for array in data]
    parameters = [jnp.asarray(array, jnp.float32) for array in start]
    count = len(data[0])

    def step(carry, k):  # type: ignore[no-untyped-def]
        parameters, mean, square, key = carry
        key, pick, drop = jax.random.split(key, 3)
        rows = jax.random.randint(pick, (min(batch, count),), 0, count)
        gradient = jax.grad(partial(loss, jax))(parameters, [array[rows] for array in arrays], drop)
        size = rate * jnp.minimum(1.0, (k + 1) / WARM_UP) * 0.5 * (1.0 + jnp.cos(jnp.pi * k / steps))
        mean = [FIRST * m + (1 - FIRST) * g for m, g in zip(mean, gradient, strict=True)]
        square = [second * s + (1 - second) * g * g for s, g in zip(square, gradient, strict=True)]
        parameters = [
            p * (1 - size * decay)
            - size * (m / (1 - FIRST ** (k + 1.0))) / (jnp.sqrt(s / (1 - second ** (k + 1.0))) + 1e-8)
            for p, m, s in zip(parameters, mean, square, strict=True)
        ]
        return (parameters, mean, square, key), None

    zeros = [jnp.zeros_like(p) for p in parameters]
    key = jax.random.key(seed, impl="unsafe_rbg")
    run = jax.jit(lambda carry: jax.lax.scan(step, carry, jnp.arange(steps)))
    (parameters, *_), _ = run((parameters, zeros, zeros, key))
    return [np.asarray(p, dtype=float) for p in parameters]
