"""How far the truth strays from the mean: a scale mixture of Gaussians over all steps and joints at once.

The error of a joint at a step, in the arm's own axes, is scale · shape · z: a scale that depends on the window, a fixed
3 × 3 shape, and z, a vector of unit spread. The z of all steps and joints share one low-rank correlation, smooth in
time, so that samples are whole motions, and one common factor, drawn anew for each sample. How often that factor is
small or large depends on the window too: who rests mostly stays, but may start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.transforms import lengths
from kinecast.prediction.kinecast.experts import MIRROR, TRIVIAL, WindowMotion
from kinecast.prediction.kinecast.weights import JOINT_TYPE, GateInputs, Outstanding, step_basis
from kinecast.prediction.model_file import Arrays

CEILING, STRAYS = 0.75, 3.0
"""How much of the reach the scale may be, and how far drawn motions stray."""

SPEEDS = (0.05, 0.3)
"""What parts joints that rest, slow and fast ones [m/s]."""
LEVEL, SHARP, BROAD = 0.8, 0.5, 0.95
"""Regions whose coverage `AdaptiveScale` holds: by its factors, and by its exponent."""
RATE, EXPONENT_RATE = 0.07, 0.02
"""How fast the logs of its factors and of its exponent move with each miss."""
MOST, MOST_EXPONENT = 3.0, 0.7
"""Most that the logs stray from zero."""

Errors: TypeAlias = Float[np.ndarray, "B T 6 3"]

SCALES = np.array([0.2, 0.35, 0.6, 1.0, 1.7, 3.0])
"""The common factors of the mixture; their weights depend on the window."""
RADII = np.geomspace(1e-2, 60.0, 3000)
"""At which the share of a unit normal in three dimensions is tabulated."""
SIDES = np.stack([np.eye(3)] * 3 + [np.diag(MIRROR)] * 3)
"""(6, 3, 3) from the arm's own axes to the person's: the right arm was seen in a mirror."""


def share_within(
    radius: Float[np.ndarray, "B 6"], weights: Float[np.ndarray, "B K"], scales: Float[np.ndarray, " K"] = SCALES
) -> Float[np.ndarray, "B 6"]:
    """(B, 6) share of a mixture of normals in three dimensions, of these weights and spreads, within a radius."""
    each = np.interp(radius[..., None] / scales, RADII, _unit_balls())
    return np.asarray((each @ weights[..., None])[..., 0])


@cache
def _unit_balls() -> Float[np.ndarray, " R"]:
    """(R,) share of a unit normal within each of `RADII`."""
    within = np.array([math.erf(r) for r in (RADII / math.sqrt(2.0)).tolist()])
    return np.asarray(within - math.sqrt(2.0 / math.pi) * RADII * np.exp(-0.5 * RADII * RADII))


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


class AdaptiveScale(Outstanding):
    """Corrects the spread on the person in view, by where the truth fell in what was predicted (adaptive conformal,
    Gibbs and Candès 2021).

    There is a factor at each step for joints that rest, for slow and for fast ones: log factor ← log factor + rate ·
    (share of these joints outside the 80 % region − 20 %), each time a prediction comes due; smooth over the steps, as
    drawn motions are. And there is an exponent on the common factors, as much above one as more fall into the 50 %
    region, and out of the 95 % one, than should: some people and trackers stay or leap, others move evenly.
    """

    def __init__(self, model: ErrorModel, steps: int, dt: float) -> None:
        super().__init__(steps)
        self._model, self._edges = model, np.array(SPEEDS) * dt
        self._log = np.zeros((steps, len(SPEEDS) + 1))
        self._log_exponent = 0.0

    def factor(self, speed: Float[np.ndarray, "6"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) by which to multiply the spread of joints of these speeds [m per frame]."""
        return np.exp(self._log[:, np.searchsorted(self._edges, speed)])

    @property
    def scales(self) -> Float[np.ndarray, " K"]:
        """(K,) the common factors."""
        return np.asarray(SCALES ** math.exp(self._log_exponent))

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. Call once a frame, before `predicted`."""
        known = [(step, *made) for step, made in self._due(range(1, len(self._log) + 1))]
        if not known or not np.isfinite(pose).all():
            return
        due, means, scales, rotations, weights, bins = map(np.array, zip(*known, strict=True))
        rows = np.arange(len(due))
        z = self._model.whitened(pose - means[rows, due], scales[rows, due], rotations, due)
        radius = lengths(z) / np.exp(np.take_along_axis(self._log[due], bins, axis=1))
        inside = share_within(radius, weights, self.scales)
        astray = np.count_nonzero(inside <= SHARP) + np.count_nonzero(inside > BROAD)
        moved = self._log_exponent + EXPONENT_RATE * (astray / inside.size - (SHARP + 1.0 - BROAD))
        self._log_exponent = min(max(moved, -MOST_EXPONENT), MOST_EXPONENT)
        here = bins[..., None] == np.arange(self._log.shape[1])
        missed = ((inside > LEVEL) - (1.0 - LEVEL))[..., None]
        self._log[due] += RATE * (here * missed).mean(axis=1)
        self._log = np.clip(_smoothing(len(self._log)) @ self._log, -MOST, MOST)

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
        self._made.append((mean, scale, rotation, weights, np.searchsorted(self._edges, speed)))


@cache
def _smoothing(steps: int) -> Float[np.ndarray, "T T"]:
    """(T, T) takes what there is at each step to the nearest that `step_basis` can say."""
    basis = step_basis(steps)
    return np.asarray(basis @ np.linalg.pinv(basis))


def inverse_ceiling(reach: Float[np.ndarray, "3 T"], shape: Float[np.ndarray, "3 T 3 3"]) -> Float[np.ndarray, "3 T"]:
    """(3, T) one over the largest scale: no error is expected to be larger than people were ever wrong about."""
    return np.cbrt(np.linalg.det(shape)) / (CEILING * reach)
