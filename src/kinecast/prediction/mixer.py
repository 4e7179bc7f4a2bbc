"""A small neural forecaster: a multilayer perceptron that mixes frames, in the manner of siMLPe.

It knows nothing of joints, limits or scenes: with the covariance of its errors it shows what the constraint stage does
to a model from elsewhere. After Guo et al., "Back to MLP: A Simple Baseline for Human Motion Prediction" (WACV 2023): a
cosine transform over time, blocks that mix frames with a normalised residual, and a linear way out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.prediction.descent import descend
from kinecast.prediction.model_file import Arrays, shaped

WIDTH, BLOCKS = 48, 4
STEPS = 1500
"""Of stochastic descent."""
LEAST = 1e-5
"""Added to variances [of units squared]."""


@dataclass(frozen=True)
class Mixer(Arrays):
    """h = C x W + b; h += norm(A_k h + a_k) for every block k; displacement = O h V + v.

    x is the window relative to its last frame, beside that last frame, both over `scale`; C the cosine transform over
    time.

    Attributes:
        scale: (2 D,) spread of the inputs.
        W, b: (2 D, H), (H,) way in.
        A, a: (B, N, N), (B, N) mixing of frames.
        gain, shift: (B, H) of the normalisation.
        O: (T, N) from frames to steps.
        V, v: (H, D), (D,) way out.
    """

    scale: Float[np.ndarray, " D2"]
    W: Float[np.ndarray, "D2 H"]
    b: Float[np.ndarray, " H"]
    A: Float[np.ndarray, "B N N"]
    a: Float[np.ndarray, "B N"]
    gain: Float[np.ndarray, "B H"]
    shift: Float[np.ndarray, "B H"]
    O: Float[np.ndarray, "T N"]  # noqa: E741, the letter of the formula
    V: Float[np.ndarray, "H D"]
    v: Float[np.ndarray, " D"]

    def mean(self, windows: Float[np.ndarray, "W N D"]) -> Float[np.ndarray, "W T D"]:
        """(W, N, D) windows in, (W, T, D) means out."""
        _, *parameters = self.to_arrays().values()
        x = _transform(windows.shape[1]) @ (_inputs(windows) / self.scale)
        return windows[:, -1:] + _displacement(np, parameters, x)


def mixer_from_arrays(arrays: Mapping[str, np.ndarray], frames: int, steps: int, size: int) -> Mixer:
    """The model of N frames, T steps and D coordinates that `to_arrays` described; ModelError for any other."""
    shapes = {
        "scale": (2 * size,), "W": (2 * size, WIDTH), "b": (WIDTH,), "A": (BLOCKS, frames, frames),
        "a": (BLOCKS, frames), "gain": (BLOCKS, WIDTH), "shift": (BLOCKS, WIDTH), "O": (steps, frames),
        "V": (WIDTH, size), "v": (size,),
    }  # fmt: skip
    return Mixer(**{name: shaped(arrays, name, *shape) for name, shape in shapes.items()})


def fit_mixer(
    windows: Float[np.ndarray, "W N D"], futures: Float[np.ndarray, "W T D"], *, seed: int, steps: int = STEPS
) -> Mixer:
    """Trained by `steps` of stochastic descent on the mean distance between points, coordinates in threes."""
    frames, size = windows.shape[1:]
    inputs, target = _inputs(windows), futures - windows[:, -1:]
    scale, unit = np.sqrt(inputs.var(axis=(0, 1)) + LEAST), np.sqrt(target.var() + LEAST)
    rng = np.random.default_rng(seed)
    start = (
        rng.normal(0.0, 1.0 / np.sqrt(2 * size), (2 * size, WIDTH)), np.zeros(WIDTH),
        rng.normal(0.0, 1.0 / np.sqrt(frames), (BLOCKS, frames, frames)), np.zeros((BLOCKS, frames)),
        np.full((BLOCKS, WIDTH), 0.5), np.zeros((BLOCKS, WIDTH)),
        rng.normal(0.0, 1.0 / np.sqrt(frames), (target.shape[1], frames)),
        rng.normal(0.0, 0.1 / np.sqrt(WIDTH), (WIDTH, size)), np.zeros(size),
    )  # fmt: skip
    x = _transform(frames) @ (inputs / scale)
    W, b, A, a, gain, shift, O, V, v = descend(  # noqa: E741
        _loss, start, (x, target / unit), steps=steps, batch=128, rate=2e-3, decay=1e-4, second=0.999, seed=seed
    )
    return Mixer(scale, W, b, A, a, gain, shift, O, unit * V, unit * v)


def _inputs(windows: Float[np.ndarray, "W N D"]) -> Float[np.ndarray, "W N D2"]:
    last = windows[:, -1:]
    return np.concatenate([windows - last, np.broadcast_to(last, windows.shape)], axis=2)


def _transform(frames: int) -> Float[np.ndarray, "N N"]:
    """Orthonormal cosine transform (DCT-II) over time."""
    k, n = np.arange(frames)[:, None], np.arange(frames)
    rows = np.cos(np.pi * (n + 0.5) * k / frames) * np.sqrt(2.0 / frames)
    rows[0] *= np.sqrt(0.5)
    return rows


def _displacement(np_: Any, parameters: Any, x: Any) -> Any:
    """The network itself, for NumPy and JAX alike: (W, N, 2 D) to (W, T, D)."""
    W, b, A, a, gain, shift, O, V, v = parameters  # noqa: E741
    h = x @ W + b
    for k in range(BLOCKS):
        mixed = A[k] @ h + a[k][:, None]
        centred = mixed - mixed.mean(axis=-1, keepdims=True)
        h = h + gain[k] * centred / np_.sqrt((centred**2).mean(axis=-1, keepdims=True) + LEAST) + shift[k]
    return O @ h @ V + v


def _loss(jax: Any, parameters: Any, rows: Any, _key: Any) -> Any:
    x, target = rows
    error = _displacement(jax.numpy, parameters, x) - target
    square = (error.reshape(*error.shape[:2], -1, 3) ** 2).sum(axis=-1)
    return jax.numpy.sqrt(square + 1e-6).mean()
