"""Learned experts: displacement of an arm's joints from the features of a window, in a basis of time.

`RadialBasis` is ridge regression plus the mean of a sparse Gaussian process with shared pseudo-inputs; `Network` is
a small multilayer perceptron beside a linear skip. Both are fitted for the mean distance, not its square: that is
what is scored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from kinecast.errors import ModelError
from kinecast.prediction.kinecast.features import ArmViews, FeatureScale, time_basis

__all__ = ["Expert", "Network", "RadialBasis", "expert_from_arrays", "forecast"]

POSE_SHARE, LEVEL_SHARE = 1.5 / np.sqrt(18.0), 0.7
"""Weights of pose and level among the inputs of the kernel, beside the window's 16 principal components."""
COMPONENTS = 16


@runtime_checkable
class Expert(Protocol):
    """Coefficients of the time basis, over the amplitude, from windows seen by each arm."""

    @property
    def scale(self) -> FeatureScale:
        """Of its features."""
        ...

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        ...

    def coefficients(self, features: Float[np.ndarray, "V D"]) -> Float[np.ndarray, "V C"]:
        """(V, 9 K) K coefficients of each of the arm's nine coordinates."""
        ...


def forecast(expert: Expert, views: ArmViews, steps: int) -> Float[np.ndarray, "W T 6 3"]:
    """An expert's mean positions in the world [m]."""
    coefficients = expert.coefficients(expert.scale.features(views))
    basis = time_basis(steps)
    displacement = basis @ coefficients.reshape(len(coefficients), basis.shape[1], 9)
    displacement = displacement * views.amplitude[:, None, None]
    return views.to_world(displacement.reshape(len(coefficients), steps, 3, 3))


@dataclass(frozen=True)
class RadialBasis:
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

    def coefficients(self, features: Float[np.ndarray, "V D"]) -> Float[np.ndarray, "V C"]:
        return self.regressors(features) @ self.weights

    def regressors(self, features: Float[np.ndarray, "V D"]) -> Float[np.ndarray, "V R"]:
        """(V, D + 1 + M) features, one, kernel."""
        q = kernel_inputs(features, self.mean, self.components)
        square = (q**2).sum(axis=1)[:, None] + (self.pseudo_inputs**2).sum(axis=1) - 2.0 * q @ self.pseudo_inputs.T
        kernel = np.exp(-0.5 * np.maximum(square, 0.0) / self.lengthscale**2)
        return np.concatenate([features, np.ones((len(features), 1)), kernel], axis=1)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        return {
            **{f"scale.{name}": array for name, array in self.scale.to_arrays().items()},
            "mean": self.mean,
            "components": self.components,
            "pseudo_inputs": self.pseudo_inputs,
            "lengthscale": np.array(self.lengthscale),
            "weights": self.weights,
        }


def kernel_inputs(
    features: Float[np.ndarray, "V D"], mean: Float[np.ndarray, " F"], components: Float[np.ndarray, "F 16"]
) -> Float[np.ndarray, "V Q"]:
    """What the kernel compares: principal components of the steps, pose, level."""
    steps = len(mean)
    projected = (features[:, :steps] - mean) @ components
    pose, level = features[:, steps : steps + 18], features[:, steps + 18 :]
    return np.concatenate([projected, pose * POSE_SHARE, level * LEVEL_SHARE], axis=1)


@dataclass(frozen=True)
class Network:
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

    def coefficients(self, features: Float[np.ndarray, "V D"]) -> Float[np.ndarray, "V C"]:
        hidden = _silu(features @ self.W1 + self.b1)
        blocks = hidden.reshape(len(hidden), len(self.W2), -1).transpose(1, 0, 2) @ self.W2
        hidden = hidden + _silu(blocks.transpose(1, 0, 2).reshape(hidden.shape) + self.b2)
        return hidden @ self.W3 + self.b3 + features[:, : len(self.A)] @ self.A

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "scale"}
        return {**{f"scale.{name}": array for name, array in self.scale.to_arrays().items()}, **own}

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


def _silu(x: Float[np.ndarray, "V U"]) -> Float[np.ndarray, "V U"]:
    return x / (1.0 + np.exp(-np.clip(x, -60.0, 60.0)))


def expert_from_arrays(arrays: Mapping[str, np.ndarray]) -> Expert:
    """The expert that `to_arrays` described.

    Raises:
        ModelError: arrays of no known expert.
    """
    try:
        parts = {f.name: np.asarray(arrays[f"scale.{f.name}"], float) for f in fields(FeatureScale)}
        scale = FeatureScale(float(parts.pop("steps")), **parts)
        kind = RadialBasis if "pseudo_inputs" in arrays else Network
        own = {f.name: np.asarray(arrays[f.name], float) for f in fields(kind) if f.name != "scale"}
    except KeyError as error:
        raise ModelError(f"expert without the array {error}") from None
    if kind is Network:
        return Network(scale, **own)
    lengthscale = float(own.pop("lengthscale"))
    return RadialBasis(scale=scale, lengthscale=lengthscale, **own)
