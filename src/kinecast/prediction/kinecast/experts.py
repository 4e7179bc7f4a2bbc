"""The experts: trivial predictors, and small networks that give an arm's displacements in a basis of time.

They are fitted for the mean distance, not its square: that is what is scored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.errors import ModelError
from kinecast.prediction.kinecast.features import FeatureScale, arm_views, time_basis
from kinecast.prediction.linear import damped, slope_weights
from kinecast.prediction.model_file import Arrays

DAMPED = ((0, 1.0), (2, 16.0), (2, np.inf), (1, 4.0), (3, 12.0), (2, 6.0))
"""Trivial experts: degree of the polynomial whose slope is the velocity (0: none), and time constant [frames]."""
TRIVIAL = len(DAMPED)


Features: TypeAlias = Float[np.ndarray, "V D"]
Coefficients: TypeAlias = Float[np.ndarray, "G V C"]

LEAST_MOTION = 0.02
"""Added to a window's motion [m] where its error is weighed by it."""
WIDTH, DROPPED = 160, 0.4
"""Units of the network's layers, and the share of them left out at random while training."""


@cache
def trivial_experts(frames: int, steps: int) -> Float[np.ndarray, "E T N"]:
    """(E, T, N) weights over the window of each trivial expert's prediction."""
    velocities = [slope_weights(frames, degree) if degree else np.zeros(frames) for degree, _ in DAMPED]
    taus = [tau for _, tau in DAMPED]
    return np.stack([damped(v, tau, steps).weights for v, tau in zip(velocities, taus, strict=True)])


def forecasts(experts: Networks, windows: Float[np.ndarray, "W N 6 3"], steps: int) -> Float[np.ndarray, "W E T 6 3"]:
    """What every expert forecasts, trivial ones first, world [m]."""
    trivial = np.tensordot(trivial_experts(windows.shape[1], steps), windows, axes=(2, 1)).transpose(2, 0, 1, 3, 4)
    if not len(experts):
        return trivial
    views = arm_views(windows)
    coefficients = experts.coefficients(experts.scale.features(views))
    displacement = time_basis(steps) @ coefficients.reshape(*coefficients.shape[:2], -1, 9)
    displacement *= views.amplitude[:, None, None]
    learned = views.to_world(displacement.reshape(*displacement.shape[:3], 3, 3))
    return np.concatenate([trivial, learned.transpose(1, 0, 2, 3, 4)], axis=1)


@dataclass(frozen=True)
class Networks(Arrays):
    """G small networks on the same features: h = silu(x W1 + b1); h += silu(h W2 + b2);
    coefficients = h W3 + b3 + x' A, x' without the levels.

    Each knows another world: all collections as they are, all with the faults of poor sensors, or one alone.
    """

    scale: FeatureScale
    W1: Float[np.ndarray, "G D U"]
    b1: Float[np.ndarray, "G 1 U"]
    W2: Float[np.ndarray, "G U U"]
    b2: Float[np.ndarray, "G 1 U"]
    W3: Float[np.ndarray, "G U C"]
    b3: Float[np.ndarray, "G 1 C"]
    A: Float[np.ndarray, "G D2 C"]

    def __len__(self) -> int:
        return len(self.W1)

    def coefficients(self, features: Features) -> Coefficients:
        hidden = _silu(features @ self.W1 + self.b1)
        hidden = hidden + _silu(hidden @ self.W2 + self.b2)
        return hidden @ self.W3 + self.b3 + features[:, : self.A.shape[1]] @ self.A

    def to_arrays(self) -> dict[str, np.ndarray]:
        """See Arrays; weights in single precision, as they were trained."""
        arrays = super().to_arrays()
        return {name: a if name.startswith("scale.") else a.astype(np.float32) for name, a in arrays.items()}

    def take(self, which: Sequence[int]) -> Networks:
        """Some of the networks."""
        return Networks(self.scale, **{name: getattr(self, name)[list(which)] for name in Networks._weights()})

    @staticmethod
    def joined(parts: Sequence[Networks]) -> Networks:
        """The networks of several on one scale, in their order."""
        joint = {name: np.concatenate([getattr(part, name) for part in parts]) for name in Networks._weights()}
        return Networks(parts[0].scale, **joint)

    @staticmethod
    def _weights() -> list[str]:
        """Names of what each network has of its own."""
        return [each.name for each in fields(Networks) if each.name != "scale"]


def _silu(x: Float[np.ndarray, "G V U"]) -> Float[np.ndarray, "G V U"]:
    return x / (1.0 + np.exp(-np.clip(x, -60.0, 60.0)))


def networks_from_arrays(arrays: Mapping[str, np.ndarray]) -> Networks:
    """The networks that `to_arrays` described; ModelError where an array is missing."""
    try:
        return Networks.from_arrays(arrays, scale=FeatureScale.from_arrays(arrays, "scale."))
    except KeyError as error:
        raise ModelError(f"experts without the array {error}") from None


def fit_network(
    scale: FeatureScale,
    observed: Float[np.ndarray, "W N 6 3"],
    future: Float[np.ndarray, "W T 6 3"],
    steps: int,
    seed: int,
) -> Networks:
    """One multilayer perceptron beside a linear skip that starts from ridge.

    The loss is the mean distance of a window over the root of its motion: fast collections do not drown slow ones.
    """
    from kinecast.prediction.descent import descend

    views, basis = arm_views(observed), time_basis(future.shape[1])
    features, amplitude = scale.features(views), views.amplitude
    target = views.to_arms(future).reshape(len(features), -1, 9)
    scaled = (np.linalg.pinv(basis) @ (target / amplitude[:, None, None])).reshape(len(features), -1)
    inputs, outputs = features.shape[1], scaled.shape[1]
    seen, weight, rng = features[:, :-2], amplitude[:, None], np.random.default_rng(seed)
    moment = seen.T @ (seen * weight) + 1e-3 * len(seen) * weight.mean() * np.eye(inputs - 2)
    skip = np.linalg.solve(moment, seen.T @ (scaled * weight))

    def layer(before: int, after: int, gain: float) -> Float[np.ndarray, "A B"]:
        return rng.normal(0.0, gain / np.sqrt(before), (before, after))

    start = [
        layer(inputs, WIDTH, 1.0), np.zeros((1, WIDTH)), layer(WIDTH, WIDTH, 1.0), np.zeros((1, WIDTH)),
        layer(WIDTH, outputs, 0.1), np.zeros((1, outputs)), skip,
    ]  # fmt: skip
    fitted = descend(
        _network_loss(basis), start, (features, amplitude, target),
        steps=steps, batch=256, rate=2e-3, decay=1e-3, second=0.999, seed=seed,
    )  # fmt: skip
    return Networks(scale, *(array[None] for array in fitted))


def _network_loss(time: Float[np.ndarray, "T K"]):  # type: ignore[no-untyped-def]
    from kinecast.prediction.descent import jax_in_one_thread

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
        distance, motion = (
            jnp.sqrt((e.reshape(len(x), -1) ** 2).reshape(len(x), -1, 3).sum(-1) + 1e-6).mean(1)
            for e in (error, target)
        )
        return 3.0 * (distance / jnp.sqrt(motion + LEAST_MOTION)).mean()

    return loss
