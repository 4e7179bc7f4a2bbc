"""How far the truth strays from the mean: a scale mixture of Gaussians over all steps and joints at once.

The error of a joint at a step, in the arm's own axes, is scale · shape · z: a scale that depends on the window, a fixed
3 × 3 shape, and z, a vector of unit spread. The z of all steps and joints share one low-rank correlation, so that
samples are whole motions, and one common factor, drawn anew for each sample, that gives them their heavy tails.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import gammainc

from kinecast.prediction.kinecast.features import MIRROR
from kinecast.prediction.kinecast.gate import JOINT_TYPE, TRIVIAL, GateInputs

__all__ = ["SCALES", "Spread", "mixture_radius", "spread_features"]

SCALES = np.array([0.3, 0.6, 1.0, 1.7, 3.0, 6.0])
"""The common factors of the mixture; their weights are fitted."""
SIDES = np.stack([np.eye(3)] * 3 + [np.diag(MIRROR)] * 3)
"""(6, 3, 3) from the arm's own axes to the person's: the right arm was seen in a mirror."""


def mixture_radius(weights: Float[np.ndarray, " K"], level: float) -> float:
    """Radius that holds a share of a three-dimensional scale mixture of unit normals."""
    # gammainc is the distribution function of |z|² in three dimensions; scipy's own normals, and its root finders,
    # would make every start slow.
    radii = np.linspace(0.0, 60.0, 60_001)
    return float(np.interp(level, weights @ gammainc(1.5, 0.5 * (radii / SCALES[:, None]) ** 2), radii))


def spread_features(
    window: Float[np.ndarray, "N 6 3"],
    forecasts: Float[np.ndarray, "E T 6 3"],
    mean: Float[np.ndarray, "T 6 3"],
    gate: GateInputs,
    due: Float[np.ndarray, "6 L"],
) -> Float[np.ndarray, "6 F"]:
    """(6, F) what the scale depends on, joint by joint.

    Args:
        window: (N, 6, 3) observed [m].
        forecasts: (E, T, 6, 3) of the experts [m].
        mean: (T, 6, 3) of the mixture [m].
        gate: the gate's inputs.
        due: (6, L) mean error of the mixture come due lately [m], NaN while unknown.
    """
    steps = np.diff(window, axis=0)
    speed = np.linalg.norm(steps, axis=-1).mean(axis=0)
    change = np.linalg.norm(steps[-1] - steps[-3], axis=-1)
    apart = np.linalg.norm(forecasts[TRIVIAL:] - mean, axis=-1).mean(axis=(0, 1))
    known = np.isfinite(due)
    errors = np.where(known, np.log(np.where(known, due, 1.0) + 0.002) + 3.5, 0.0)
    reach = np.linalg.norm(mean[len(mean) // 2] - window[-1], axis=-1)
    return np.concatenate(
        [
            np.ones((6, 1)),
            np.log(np.stack([speed, change, apart], axis=1) + 0.001) + 4.0,
            gate.window[:, :4],
            errors,
            known[:, :1],
            np.log(reach + 0.003)[:, None] + 3.0,
        ],
        axis=1,
    )


@dataclass(frozen=True)
class Spread:
    """Fitted on errors of recordings that the means were not trained on.

    Attributes:
        slope: (3, T, F) log scale of each joint type and step from the features.
        shape: (3, T, 3, 3) lower factor of the error's covariance in the arm's axes.
        factor: (T, 6, 3, R) low-rank factor of the correlation of all z.
        weights: (K,) of the common factors `SCALES`.
        edges: (2,) speeds that part the three bins [m per frame].
        conformal: (3, T, 3) correction per joint type, step and speed bin.
    """

    slope: Float[np.ndarray, "3 T F"]
    shape: Float[np.ndarray, "3 T 3 3"]
    factor: Float[np.ndarray, "T 6 3 R"]
    weights: Float[np.ndarray, " K"]
    edges: Float[np.ndarray, "2"]
    conformal: Float[np.ndarray, "3 T 3"]

    def scale(self, features: Float[np.ndarray, "6 F"], window: Float[np.ndarray, "N 6 3"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) scale of each joint's error, conformal correction included."""
        log_scale = (self._slope @ features[:, :, None])[:, :, 0].T
        speed = np.linalg.norm(np.diff(window, axis=0), axis=-1).mean(axis=0)
        bins = np.digitize(speed, self.edges)
        return np.exp(log_scale) * self.conformal[JOINT_TYPE, :, bins].T

    def matrices(
        self, scale: Float[np.ndarray, "T 6"], rotation: Float[np.ndarray, "3 3"]
    ) -> Float[np.ndarray, "T 6 3 3"]:
        """(T, 6, 3, 3) maps from z to the error in the world [m]."""
        return scale[..., None, None] * (rotation @ self._axes)

    def whiteners(
        self, scale: Float[np.ndarray, "T 6"], rotation: Float[np.ndarray, "3 3"]
    ) -> Float[np.ndarray, "T 6 3 3"]:
        """(T, 6, 3, 3) inverses of `matrices`."""
        return (self._inverse_axes @ rotation.T) / scale[..., None, None]

    @cached_property
    def _slope(self) -> Float[np.ndarray, "6 T F"]:
        return self.slope[JOINT_TYPE]

    @cached_property
    def _axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        """Maps from z to the error over its scale, in the person's axes."""
        return SIDES @ self.shape[JOINT_TYPE].transpose(1, 0, 2, 3)

    @cached_property
    def _inverse_axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        return np.linalg.inv(self._axes)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Plain arrays for a checkpoint."""
        return {field.name: getattr(self, field.name) for field in fields(self)}
