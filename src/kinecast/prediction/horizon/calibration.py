"""Calibration that follows the person in view: the spread grows after surprises and shrinks after none."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

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
    _past: deque[tuple[Float[np.ndarray, "T 6 3"], Float[np.ndarray, "T 6 3 3"]] | None] = field(init=False)

    def __post_init__(self) -> None:
        self._log = np.zeros(self.steps)
        self._past = deque(maxlen=self.steps)

    @property
    def factor(self) -> Float[np.ndarray, " T"]:
        """(T,) by which to multiply the spread."""
        return np.exp(self._log)

    def skip(self) -> None:
        """A frame of which nothing is known."""
        self._past.append(None)

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing."""
        if not self._past or not np.isfinite(pose).all():
            return
        # The newest entry was predicted one step ago.
        kept = [(k, made) for k, made in enumerate(reversed(self._past)) if made is not None]
        if not kept:
            return
        leads = np.array([k for k, _ in kept])
        mean = np.stack([made[0][k] for k, made in kept])
        inverse = np.stack([made[1][k] for k, made in kept])
        white = np.einsum("tjde,tje->tjd", inverse, pose - mean) / self.factor[leads, None, None]
        missed = (np.linalg.norm(white, axis=-1) > self.radius).mean(axis=1)
        moved = FORGET * self._log[leads] + RATE * (missed - (1.0 - LEVEL))
        self._log[leads] = np.clip(moved, -MOST, MOST)

    def predicted(self, mean: Float[np.ndarray, "T 6 3"], maps: Float[np.ndarray, "T 6 3 3"]) -> None:
        """Keeps what is predicted from this frame on: mean [m] and the maps from unit errors to errors [m]."""
        self._past.append((mean, np.linalg.inv(maps)))
