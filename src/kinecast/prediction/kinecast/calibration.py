"""Calibration that follows the person in view: the spread grows after surprises and shrinks after none."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float
from numba import njit

__all__ = ["LEVEL", "AdaptiveScale"]

LEVEL = 0.8
"""The region whose coverage is held."""
RATE, FORGET = 0.1, 0.995
"""How fast the log of the factor moves with each miss, and how fast it returns to nothing."""
MOST = 1.0
"""Most that the log of the factor strays from zero."""


@dataclass
class AdaptiveScale:
    """A factor on the spread at each step, moved by whether the truth fell where it should (adaptive conformal).

    log factor ← forget · log factor + rate · (share of joints outside the region − (1 − level)), each time a prediction
    comes due (Gibbs and Candès 2021, with leak).

    Attributes:
        steps: T.
        radius: of the region at `LEVEL`, in units of the spread.
    """

    steps: int
    radius: float
    _log: Float[np.ndarray, " T"] = field(init=False)
    _means: Float[np.ndarray, "T T 6 3"] = field(init=False)
    _whiteners: Float[np.ndarray, "T T 6 3 3"] = field(init=False)
    _known: Bool[np.ndarray, " T"] = field(init=False)
    _newest: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._log = np.zeros(self.steps)
        self._means = np.zeros((self.steps, self.steps, 6, 3))
        self._whiteners = np.zeros((self.steps, self.steps, 6, 3, 3))
        self._known = np.zeros(self.steps, dtype=np.bool_)

    @property
    def factor(self) -> Float[np.ndarray, " T"]:
        """(T,) by which to multiply the spread."""
        return np.exp(self._log)

    def skip(self) -> None:
        """A frame of which nothing is known."""
        self._newest = (self._newest + 1) % self.steps
        self._known[self._newest] = False

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing."""
        if np.isfinite(pose).all():
            _judge(self._means, self._whiteners, self._known, self._newest, pose, self.radius, self._log)

    def predicted(self, mean: Float[np.ndarray, "T 6 3"], whiteners: Float[np.ndarray, "T 6 3 3"]) -> None:
        """Keeps what is predicted from this frame on: mean [m] and the maps from errors [m] to unit errors."""
        self.skip()
        self._known[self._newest] = True
        self._means[self._newest], self._whiteners[self._newest] = mean, whiteners


@njit(cache=True)
@no_type_check
def _judge(
    means: Float[np.ndarray, "T T 6 3"],
    whiteners: Float[np.ndarray, "T T 6 3 3"],
    known: Bool[np.ndarray, " T"],
    newest: int,
    pose: Float[np.ndarray, "6 3"],
    radius: float,
    log_factor: Float[np.ndarray, " T"],
) -> None:
    """Moves the log of the factor at every step whose prediction has come due; the newest was made one step ago."""
    for step in range(len(log_factor)):
        row = (newest - step) % len(known)
        if not known[row]:
            continue
        reach = radius * math.exp(log_factor[step])
        missed = 0.0
        for j in range(6):
            error = pose[j] - means[row, step, j]
            square = 0.0
            for d in range(3):
                w = whiteners[row, step, j, d]
                square += (w[0] * error[0] + w[1] * error[1] + w[2] * error[2]) ** 2
            missed += square > reach * reach
        moved = FORGET * log_factor[step] + RATE * (missed / 6.0 - (1.0 - LEVEL))
        log_factor[step] = min(max(moved, -MOST), MOST)
