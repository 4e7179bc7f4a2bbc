"""How the spread follows the person in view."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from kinecast.prediction.kinecast.error_model import ErrorModel, mixture_radius

SPEEDS = (0.05, 0.3)
"""What parts joints that rest, slow and fast ones [m/s]."""
LEVEL = 0.8
"""The region whose coverage is held."""
RATE, FORGET = 0.1, 0.995
"""How fast the log of the factor moves with each miss, and how fast it returns to nothing."""
MOST = 1.5
"""Most that the log of the factor strays from zero."""


class AdaptiveScale:
    """Factors on the spread at each step, moved by whether the truth fell where it should (adaptive conformal).

    There is one for joints that rest, for slow and for fast ones. log factor ← forget · log factor + rate · (joints
    outside the region − (1 − level) · joints) / 6, each time a prediction comes due (Gibbs and Candès 2021, with leak).
    """

    def __init__(self, model: ErrorModel, steps: int, dt: float) -> None:
        self._model = model
        self._edges = np.array(SPEEDS) * dt
        self._log = np.zeros((steps, len(SPEEDS) + 1))
        self._means = np.zeros((steps, steps, 6, 3))
        self._scales = np.ones((steps, steps, 6))
        self._rotations = np.zeros((steps, 3, 3))
        self._radii = np.ones(steps)
        self._bins = np.zeros((steps, 6), dtype=np.intp)
        self._known = np.zeros(steps, dtype=np.bool_)
        self._newest = 0

    def factor(self, speed: Float[np.ndarray, "6"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) by which to multiply the spread of joints of these speeds [m per frame]."""
        return np.exp(self._log[:, self._bins_of(speed)])

    def _bins_of(self, speed: Float[np.ndarray, "6"]) -> Int[np.ndarray, "6"]:
        return np.searchsorted(self._edges, speed)

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        for _ in range(frames):
            self._newest = (self._newest + 1) % len(self._known)
            self._known[self._newest] = False

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. The newest was predicted one step ago."""
        if not np.isfinite(pose).all():
            return
        rows = (self._newest - np.arange(len(self._log))) % len(self._log)
        due = np.flatnonzero(self._known[rows])
        rows = rows[due]
        z = self._model.whitened(pose - self._means[rows, due], self._scales[rows, due], self._rotations[rows], due)
        bins = self._bins[rows]
        reach = self._radii[rows, None] * np.exp(np.take_along_axis(self._log[due], bins, axis=1))
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
        self.skip(1)
        self._known[self._newest] = True
        self._radii[self._newest] = mixture_radius(weights, LEVEL)
        self._bins[self._newest] = self._bins_of(speed)
        self._means[self._newest], self._scales[self._newest], self._rotations[self._newest] = mean, scale, rotation
