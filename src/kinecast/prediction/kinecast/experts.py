"""The experts: trivial predictors, and learned displacements of an arm's joints in a basis of time.

`RadialBasis` is ridge regression plus the mean of a sparse Gaussian process with shared pseudo-inputs; `Network` is
a small multilayer perceptron beside a linear skip. Both are fitted for the mean distance, not its square: that is
what is scored.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.errors import ModelError
from kinecast.prediction.kinecast.features import FeatureScale, arm_views, time_basis
from kinecast.prediction.linear import damped, slope_weights
from kinecast.prediction.model_file import Arrays

POSE_SHARE, LEVEL_SHARE = 1.5 / np.sqrt(18.0), 0.7
"""Weights of pose and level among the inputs of the kernel, beside the window's 16 principal components."""
COMPONENTS = 16

DAMPED = ((0, 1.0), (2, 16.0), (2, np.inf), (1, 4.0), (3, 12.0))
"""Trivial experts: degree of the polynomial whose slope is the velocity (0: none), and time constant [frames]."""
TRIVIAL = len(DAMPED)


Features: TypeAlias = Float[np.ndarray, "V D"]
Coefficients: TypeAlias = Float[np.ndarray, "V C"]

BLOCK = 4096
"""Rows handled at once, so that memory stays flat."""
ROUNDS = 4
"""Of reweighting: squares become distances."""
LEAST_ERROR = 0.003
"""Distances below this weigh alike [m]."""
WIDTH, DROPPED = 256, 0.4
"""Units of the network's layers, and the share of them left out at random while training."""


@cache
def trivial_experts(frames: int, steps: int) -> Float[np.ndarray, "E T N"]:
    """(E, T, N) weights over the window of each trivial expert's prediction."""
    velocities = [slope_weights(frames, degree) if degree else np.zeros(frames) for degree, _ in DAMPED]
    taus = [tau for _, tau in DAMPED]
    return np.stack([damped(v, tau, steps).weights for v, tau in zip(velocities, taus, strict=True)])


def forecasts(
    experts: Sequence[Expert], windows: Float[np.ndarray, "W N 6 3"], steps: int
) -> Float[np.ndarray, "W E T 6 3"]:
    """What every expert forecasts, trivial ones first, world [m]."""
    trivial = np.tensordot(trivial_experts(windows.shape[1], steps), windows, axes=(2, 1)).transpose(2, 0, 1, 3, 4)
    if not experts:
        return trivial
    views = arm_views(windows)
    coefficients = np.stack([expert.coefficients(expert.scale.features(views)) for expert in experts])
    displacement = time_basis(steps) @ coefficients.reshape(*coefficients.shape[:2], -1, 9)
    displacement *= views.amplitude[:, None, None]
    learned = views.to_world(displacement.reshape(*displacement.shape[:3], 3, 3))
    return np.concatenate([trivial, learned.transpose(1, 0, 2, 3, 4)], axis=1)


@dataclass(frozen=True)
class RadialBasis(Arrays):
    """coefficients = [features, 1, k(q, pseudo-inputs)] · weights with the RBF kernel k.

    Attributes:
        scale: of the features.
        mean, components: (F,), (F, 16) principal components of the steps, to unit spread of the first.
        pseudo_inputs: (M, 36) of q: components, pose, level.
        lengthscale: of the kernel.
        weights: (D + 1 + M, 9 K).
    """

    scale: FeatureScale
    mean: Float[np.ndarray, " F"]
    components: Float[np.ndarray, "F 16"]
    pseudo_inputs: Float[np.ndarray, "M Q"]
    lengthscale: float
    weights: Float[np.ndarray, "R C"]

    def coefficients(self, features: Features) -> Coefficients:
        inputs = features.shape[1]
        linear = features @ self.weights[:inputs] + self.weights[inputs]
        return linear + self._kernel(features) @ self.weights[inputs + 1 :]

    def regressors(self, features: Features) -> Float[np.ndarray, "V R"]:
        """(V, D + 1 + M) features, one, kernel: with the weights they make the coefficients."""
        return np.concatenate([features, np.ones((len(features), 1)), self._kernel(features)], axis=1)

    def _kernel(self, features: Features) -> Float[np.ndarray, "V M"]:
        q = kernel_inputs(features, self.mean, self.components)
        return np.exp((-0.5 / self.lengthscale**2) * _square_distances(q, self.pseudo_inputs))


def _square_distances(a: Float[np.ndarray, "V Q"], b: Float[np.ndarray, "M Q"]) -> Float[np.ndarray, "V M"]:
    square = np.einsum("vq,vq->v", a, a)[:, None] + (b**2).sum(axis=1) - 2.0 * a @ b.T
    return np.maximum(square, 0.0)


def kernel_inputs(
    features: Float[np.ndarray, "V D"], mean: Float[np.ndarray, " F"], components: Float[np.ndarray, "F 16"]
) -> Float[np.ndarray, "V Q"]:
    """What the kernel compares: principal components of the steps, pose, level."""
    steps = len(mean)
    projected = (features[:, :steps] - mean) @ components
    pose, level = features[:, steps : steps + 18], features[:, steps + 18 :]
    return np.concatenate([projected, pose * POSE_SHARE, level * LEVEL_SHARE], axis=1)


@dataclass(frozen=True)
class Network(Arrays):
    """h = silu(x W1 + b1); h += silu(h W2 + b2); coefficients = h W3 + b3 + x' A, x' without the levels.

    W2 is block-diagonal: G networks of U/G hidden units each work side by side, and their mean is what counts.
    """

    scale: FeatureScale
    W1: Float[np.ndarray, "D U"]
    b1: Float[np.ndarray, " U"]
    W2: Float[np.ndarray, "G B B"]
    b2: Float[np.ndarray, " U"]
    W3: Float[np.ndarray, "U C"]
    b3: Float[np.ndarray, " C"]
    A: Float[np.ndarray, "D2 C"]

    def coefficients(self, features: Features) -> Coefficients:
        hidden = _silu(features @ self.W1 + self.b1)
        blocks = hidden.reshape(len(hidden), len(self.W2), -1).transpose(1, 0, 2) @ self.W2
        hidden = hidden + _silu(blocks.transpose(1, 0, 2).reshape(hidden.shape) + self.b2)
        return hidden @ self.W3 + self.b3 + features[:, : len(self.A)] @ self.A

    @staticmethod
    def mean_of(networks: Sequence[Network]) -> Network:
        """The mean of several networks on one scale, as one wider network."""
        share = 1.0 / len(networks)
        return Network(
            networks[0].scale,
            W1=np.concatenate([each.W1 for each in networks], axis=1),
            b1=np.concatenate([each.b1 for each in networks]),
            W2=np.concatenate([each.W2 for each in networks]),
            b2=np.concatenate([each.b2 for each in networks]),
            W3=share * np.concatenate([each.W3 for each in networks]),
            b3=np.mean([each.b3 for each in networks], axis=0),
            A=np.mean([each.A for each in networks], axis=0),
        )


Expert = RadialBasis | Network


def _silu(x: Float[np.ndarray, "V U"]) -> Float[np.ndarray, "V U"]:
    return x / (1.0 + np.exp(-np.clip(x, -60.0, 60.0)))


def expert_from_arrays(arrays: Mapping[str, np.ndarray]) -> Expert:
    """The expert that `to_arrays` described; ModelError where an array is missing."""
    kind = RadialBasis if "pseudo_inputs" in arrays else Network
    try:
        return kind.from_arrays(arrays, scale=FeatureScale.from_arrays(arrays, "scale."))
    except KeyError as error:
        raise ModelError(f"expert without the array {error}") from None


class ExpertExamples:
    """Both arms' views of windows, with what came in the arm's axes and as coefficients of the time basis."""

    def __init__(self, observed: Float[np.ndarray, "W N 6 3"], future: Float[np.ndarray, "W T 6 3"]) -> None:
        views = arm_views(observed)
        self.scale = FeatureScale.of(views)
        self.features = self.scale.features(views)
        self.amplitude = views.amplitude
        self.basis = time_basis(future.shape[1])
        self.target = views.to_arms(future).reshape(len(self.features), -1, 9)
        scaled = np.linalg.pinv(self.basis) @ (self.target / self.amplitude[:, None, None])
        self.coefficients = scaled.reshape(len(self.features), -1)

    def blocks(self) -> Iterator[slice]:
        """Rows to be handled at once, so that memory stays flat."""
        return (slice(start, start + BLOCK) for start in range(0, len(self.features), BLOCK))


def fit_radial_basis(
    observed: Float[np.ndarray, "W N 6 3"], future: Float[np.ndarray, "W T 6 3"], pseudo_inputs: int, seed: int
) -> RadialBasis:
    """Ridge on [features, 1, RBF]; iteratively reweighted, so that distances are minimised and not their squares.

    It is the mean of a sparse Gaussian process with a linear mean function and a heavy-tailed likelihood;
    pseudo-inputs are k-means centres.
    """
    from kinecast.prediction.sparse_gp import centres

    data = ExpertExamples(observed, future)
    count, inputs = data.features.shape
    steps = data.features[:, :-20]
    mean = steps.mean(axis=0)
    _, size, axes = np.linalg.svd((steps - mean)[::3], full_matrices=False)
    components = axes[:COMPONENTS].T / (size[0] / np.sqrt(count / 3)) * 1.5
    q = kernel_inputs(data.features, mean, components)
    rng = np.random.default_rng(seed)
    found = centres(rng, q[rng.permutation(count)[: 8 * BLOCK]], min(pseudo_inputs, count // 2))
    some = q[:: max(count // 2000, 1)]
    lengthscale = 0.7 * float(np.sqrt(np.median(_square_distances(some, found))))
    penalty = np.concatenate([np.full(inputs + 1, 0.03), np.full(len(found), 1e-3)])
    empty = np.zeros((len(penalty), data.coefficients.shape[1]))
    model = RadialBasis(data.scale, mean, components, found, lengthscale, empty)
    weight = data.amplitude / data.amplitude.mean()
    for _ in range(ROUNDS + 1):
        moment, product = np.diag(penalty * count * 1e-2), empty.copy()
        for rows in data.blocks():
            regressors = model.regressors(data.features[rows])
            weighted = regressors * weight[rows, None]
            moment += regressors.T @ weighted
            product += weighted.T @ data.coefficients[rows]
        model = replace(model, weights=np.linalg.solve(moment, product))
        weight = np.concatenate([_reweighted(model, data, rows) for rows in data.blocks()])
        weight = weight / weight.mean()
    return model


def _reweighted(model: RadialBasis, data: ExpertExamples, rows: slice) -> Float[np.ndarray, " R"]:
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
    from kinecast.prediction.descent import descend

    data = ExpertExamples(observed, future)
    inputs, outputs = data.features.shape[1], data.coefficients.shape[1]
    seen, weight, rng = data.features[:, :-2], data.amplitude[:, None], np.random.default_rng(seed)
    moment = seen.T @ (seen * weight) + 1e-3 * len(seen) * weight.mean() * np.eye(inputs - 2)
    skip = np.linalg.solve(moment, seen.T @ (data.coefficients * weight))

    def layer(before: int, after: int, gain: float) -> Float[np.ndarray, "A B"]:
        return rng.normal(0.0, gain / np.sqrt(before), (before, after))

    start = [
        layer(inputs, WIDTH, 1.0), np.zeros(WIDTH), layer(WIDTH, WIDTH, 1.0), np.zeros(WIDTH),
        layer(WIDTH, outputs, 0.1), np.zeros(outputs), skip,
    ]  # fmt: skip
    W1, b1, W2, *rest = descend(
        _network_loss(data.basis), start, (data.features, data.amplitude, data.target),
        steps=steps, batch=256, rate=2e-3, decay=1e-3, second=0.999, seed=seed,
    )  # fmt: skip
    return Network(data.scale, W1, b1, W2[None], *rest)


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
        square = (error.reshape(len(x), -1, 3, 3) ** 2).sum(-1)
        return 10.0 * jnp.sqrt(square + 1e-6).mean()

    return loss
