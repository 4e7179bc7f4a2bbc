"""What a predictor remembers of the person in view: how wrong each expert has been lately, come due frame by frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

__all__ = ["DueErrors"]


@dataclass
class DueErrors:
    """Exponentially forgotten mean error of each forecaster's past predictions, once their time has come.

    Attributes:
        forecasters: E, how many are followed.
        leads: steps ahead at which they are judged.
        half_lives: memories, in frames.
    """

    forecasters: int
    leads: tuple[int, ...]
    half_lives: tuple[float, ...]
    frames: int = 0
    _sum: Float[np.ndarray, "E 6 L H"] = field(init=False)
    _weight: Float[np.ndarray, "L H"] = field(init=False)
    _past: Float[np.ndarray, "K E L 6 3"] = field(init=False)
    _known: Bool[np.ndarray, " K"] = field(init=False)
    _newest: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        shape, kept = (len(self.leads), len(self.half_lives)), max(self.leads)
        self._sum = np.zeros((self.forecasters, 6, *shape))
        self._weight = np.zeros(shape)
        self._past = np.zeros((kept, self.forecasters, len(self.leads), 6, 3))
        self._known = np.zeros(kept, dtype=np.bool_)
        self._leads = np.array(self.leads)
        self._decay = 0.5 ** (1.0 / np.array(self.half_lives))

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. Call once a frame, before `predicted`."""
        self.frames += 1
        if np.isfinite(pose).all():
            _judge(self._past, self._known, self._newest, self._leads, pose, self._decay, self._sum, self._weight)

    def predicted(self, forecasts: Float[np.ndarray, "E T 6 3"] | None) -> None:
        """Keeps what is predicted from this frame on; None where nothing could be."""
        self._newest = (self._newest + 1) % len(self._past)
        self._known[self._newest] = forecasts is not None
        if forecasts is not None:
            self._past[self._newest] = forecasts[:, self._leads - 1]

    def mean(self) -> Float[np.ndarray, "E 6 L H"]:
        """(E, 6, L, H) mean errors [m]; NaN where nothing has come due."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self._sum / self._weight


@njit(cache=True)
@no_type_check
def _judge(
    past: Float[np.ndarray, "K E L 6 3"],
    known: Bool[np.ndarray, " K"],
    newest: int,
    leads: Int[np.ndarray, " L"],
    pose: Float[np.ndarray, "6 3"],
    decay: Float[np.ndarray, " H"],
    total: Float[np.ndarray, "E 6 L H"],
    weight: Float[np.ndarray, "L H"],
) -> None:
    """Adds the errors that have come due to their forgotten sums; the newest entry was predicted one step ago."""
    for k in range(len(leads)):
        row = (newest + 1 - leads[k]) % len(past)
        if not known[row]:
            continue
        for e in range(past.shape[1]):
            for j in range(6):
                made = past[row, e, k, j]
                x, y, z = made[0] - pose[j, 0], made[1] - pose[j, 1], made[2] - pose[j, 2]
                error = math.sqrt(x * x + y * y + z * z)
                for h in range(len(decay)):
                    total[e, j, k, h] = total[e, j, k, h] * decay[h] + error
        for h in range(len(decay)):
            weight[k, h] = weight[k, h] * decay[h] + 1.0
