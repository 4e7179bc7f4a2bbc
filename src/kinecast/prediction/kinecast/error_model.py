"""How far the truth strays from the mean: a scale mixture of Gaussians over all steps and joints at once.

The error of a joint at a step, in the arm's own axes, is scale · shape · z: a scale that depends on the window, a fixed
3 × 3 shape, and z, a vector of unit spread. The z of all steps and joints share one low-rank correlation, smooth in
time, so that samples are whole motions, and one common factor, drawn anew for each sample. How often that factor is
small or large depends on the window too: who rests mostly stays, but may start.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.transforms import lengths
from kinecast.prediction.kinecast.experts import MIRROR, TRIVIAL, WindowMotion
from kinecast.prediction.kinecast.weights import JOINT_TYPE, GateInputs
from kinecast.prediction.model_file import Arrays

CEILING, STRAYS = 0.75, 3.0
"""How much of the reach the scale may be, and how far drawn motions stray."""

SPEEDS = (0.05, 0.3)
"""What parts joints that rest, slow and fast ones [m/s]."""
LEVEL = 0.8
"""The region whose coverage `AdaptiveScale` holds."""
RATE, FORGET = 0.1, 0.995
"""How fast the log of its factor moves with each miss, and how fast it returns to nothing."""
MOST = 1.5
"""Most that the log of its factor strays from zero."""

Errors: TypeAlias = Float[np.ndarray, "B T 6 3"]

SCALES = np.array([0.2, 0.35, 0.6, 1.0, 1.7, 3.0])
"""The common factors of the mixture; their weights depend on the window."""
RADII = np.geomspace(1e-2, 60.0, 3000)
"""At which the share of the mixture is tabulated: 0.3 % apart, so that a radius between two is right to 1e-5."""
SIDES = np.stack([np.eye(3)] * 3 + [np.diag(MIRROR)] * 3)
"""(6, 3, 3) from the arm's own axes to the person's: the right arm was seen in a mirror."""


def mixture_radius(weights: Float[np.ndarray, " K"], level: float) -> float:
    """Radius that holds a share of a three-dimensional scale mixture of unit normals."""
    return float(np.interp(level, _balls() @ weights, RADII))


@cache
def _balls() -> Float[np.ndarray, "R K"]:
    """(R, K) share of a normal of each of `SCALES` within each of `RADII`."""
    r = RADII[:, None] / SCALES
    within = np.array([math.erf(x) for x in (r / math.sqrt(2.0)).ravel()]).reshape(r.shape)
    return np.asarray(within - math.sqrt(2.0 / math.pi) * r * np.exp(-0.5 * r * r))


def error_features(
    window: Float[np.ndarray, "N 6 3"],
    motion: WindowMotion,
    forecasts: Float[np.ndarray, "E T 6 3"],
    mean: Float[np.ndarray, "T 6 3"],
    gate: GateInputs,
    due: Float[np.ndarray, "6 L"],
) -> Float[np.ndarray, "6 F"]:
    """(6, F) what the scale depends on, joint by joint: the window, its motion, what experts and mixture forecast [m],
    the gate's inputs, and the mean error of the mixture come due lately [m], NaN while unknown.
    """
    learned = forecasts[TRIVIAL:] if len(forecasts) > TRIVIAL else forecasts
    apart = lengths(learned - mean).mean(axis=(0, 1))
    unknown = np.isnan(due)
    features = np.empty((6, 10 + due.shape[1]))
    features[:, 0] = 1.0
    for column, value in enumerate((motion.speed, motion.change, apart)):
        features[:, 1 + column] = np.log(value + 0.001) + 4.0
    features[:, 4:8] = gate.window[:, :4]
    features[:, 8:-2] = np.log(due + 0.002) + 3.5
    features[:, 8:-2][unknown] = 0.0
    features[:, -2] = ~unknown[:, 0]
    features[:, -1] = np.log(lengths(mean[len(mean) // 2] - window[-1]) + 0.003) + 3.0
    return features


@dataclass(frozen=True)
class ErrorModel(Arrays):
    """Fitted on errors of recordings that the means were not trained on.

    Attributes:
        slope: (3, T, F) log scale of each joint type and step from the features, where it is far below its ceiling.
        reach: (3, T) distance from the mean that one error in a thousand exceeds [m].
        shape: (3, T, 3, 3) lower factor of the error's covariance in the arm's axes.
        factor: (T, 6, 3, R) low-rank factor of the correlation of all z.
        rough: (T, 6, 3) share of z's spread that is not smooth in time: a sensor's noise, left out of drawn motions.
        tail: (F, K) logits of the common factors `SCALES` from the joints' mean features.
    """

    slope: Float[np.ndarray, "3 T F"]
    reach: Float[np.ndarray, "3 T"]
    shape: Float[np.ndarray, "3 T 3 3"]
    factor: Float[np.ndarray, "T 6 3 R"]
    rough: Float[np.ndarray, "T 6 3"]
    tail: Float[np.ndarray, "F K"]

    @property
    def steps(self) -> int:
        """T."""
        return len(self.factor)

    def scale(self, features: Float[np.ndarray, "6 F"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) scale of each joint's error."""
        inverse = np.exp(-np.einsum("jtf,jf->tj", self.slope[JOINT_TYPE], features))
        return 1.0 / (inverse + self._least_inverse)

    @property
    def farthest(self) -> Float[np.ndarray, "T 6"]:
        """(T, 6) how far from the mean a drawn motion goes [m]."""
        return STRAYS * self.reach[JOINT_TYPE].T

    def weights(self, features: Float[np.ndarray, "6 F"]) -> Float[np.ndarray, " K"]:
        """(K,) of the common factors; they sum to one."""
        logits = features.mean(axis=0) @ self.tail
        weights = np.exp(logits - logits.max())
        return weights / weights.sum()

    def factor_in(
        self, scale: Float[np.ndarray, "K 6"], rotation: Float[np.ndarray, "3 3"]
    ) -> Float[np.ndarray, "K 6 3 R"]:
        """(K, 6, 3, R) factor of the first steps' covariance [m], where `rotation` takes the person's axes."""
        steps = len(scale)
        return (scale[..., None, None] * (rotation @ self._axes[:steps])) @ self.factor[:steps]

    def whitened(
        self,
        error: Float[np.ndarray, "K 6 3"],
        scale: Float[np.ndarray, "K 6"],
        rotation: Float[np.ndarray, "K 3 3"],
        steps: Int[np.ndarray, " K"],
    ) -> Float[np.ndarray, "K 6 3"]:
        """(K, 6, 3) z of errors [m] in the world at some of the steps; rotations take the person's axes there."""
        own = self._inverse_axes[steps] @ (error @ rotation)[..., None]
        return own[..., 0] / scale[..., None]

    @cached_property
    def _axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        """Maps from z to the error over its scale, in the person's axes."""
        return SIDES @ self.shape[JOINT_TYPE].transpose(1, 0, 2, 3)

    @cached_property
    def _least_inverse(self) -> Float[np.ndarray, "T 6"]:
        return inverse_ceiling(self.reach, self.shape)[JOINT_TYPE].T

    @cached_property
    def _inverse_axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        return np.linalg.inv(self._axes)


class AdaptiveScale:
    """Factors on the spread at each step, moved by whether the truth fell where it should (adaptive conformal).

    There is one for joints that rest, for slow and for fast ones. log factor ← forget · log factor + rate · (joints
    outside the region − (1 − level) · joints) / 6, each time a prediction comes due (Gibbs and Candès 2021, with leak).
    """

    def __init__(self, model: ErrorModel, steps: int, dt: float) -> None:
        self._model, self._edges = model, np.array(SPEEDS) * dt
        self._log = np.zeros((steps, len(SPEEDS) + 1))
        self._past: deque[tuple[Any, ...] | None] = deque(maxlen=steps)

    def factor(self, speed: Float[np.ndarray, "6"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) by which to multiply the spread of joints of these speeds [m per frame]."""
        return np.exp(self._log[:, np.searchsorted(self._edges, speed)])

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        self._past.extend([None] * frames)

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. The newest was predicted one step ago."""
        known = [(step, *made) for step, made in enumerate(reversed(self._past)) if made is not None]
        if not known or not np.isfinite(pose).all():
            return
        due, means, scales, rotations, radii, bins = map(np.array, zip(*known, strict=True))
        rows = np.arange(len(due))
        z = self._model.whitened(pose - means[rows, due], scales[rows, due], rotations, due)
        reach = radii[:, None] * np.exp(np.take_along_axis(self._log[due], bins, axis=1))
        missed = ((z**2).sum(axis=-1) > reach**2) - (1.0 - LEVEL)
        for k in range(self._log.shape[1]):
            moved = self._log[due, k] + RATE * np.where(bins == k, missed, 0.0).mean(axis=1)
            self._log[due, k] = np.clip(np.where((bins == k).any(axis=1), FORGET * moved, moved), -MOST, MOST)

    def predicted(
        self,
        mean: Float[np.ndarray, "T 6 3"],
        scale: Float[np.ndarray, "T 6"],
        rotation: Float[np.ndarray, "3 3"],
        weights: Float[np.ndarray, " K"],
        speed: Float[np.ndarray, "6"],
    ) -> None:
        """Keeps what is predicted from this frame on.

        Mean [m], scale, rotation of the person's axes, weights of common factors, speed of the joints [m per frame].
        """
        self._past.append((mean, scale, rotation, mixture_radius(weights, LEVEL), np.searchsorted(self._edges, speed)))


def inverse_ceiling(reach: Float[np.ndarray, "3 T"], shape: Float[np.ndarray, "3 T 3 3"]) -> Float[np.ndarray, "3 T"]:
    """(3, T) one over the largest scale: no error is expected to be larger than people were ever wrong about."""
    return np.cbrt(np.linalg.det(shape)) / (CEILING * reach)
