"""How wrong each forecaster has been on the person in view: errors come due frame by frame, and are forgotten."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from kinecast.geometry.transforms import lengths

__all__ = ["RollingForecastErrors"]


@dataclass
class RollingForecastErrors:
    """Exponentially forgotten mean error of each forecaster's past predictions, once their time has come.

    Attributes:
        forecasters: E, how many are followed.
        leads: (L,) steps ahead at which they are judged.
        half_lives: (H,) memories, in frames.
        frames: how many frames were seen.
    """

    forecasters: int
    leads: tuple[int, ...]
    half_lives: tuple[float, ...]
    frames: int = 0
    _sum: Float[np.ndarray, "L E 6 H"] = field(init=False)
    _weight: Float[np.ndarray, "L H"] = field(init=False)
    _past: Float[np.ndarray, "K L E 6 3"] = field(init=False)
    _known: Bool[np.ndarray, " K"] = field(init=False)
    _newest: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        leads, kept = len(self.leads), max(self.leads)
        self._sum = np.zeros((leads, self.forecasters, 6, len(self.half_lives)))
        self._weight = np.zeros((leads, len(self.half_lives)))
        self._past = np.zeros((kept, leads, self.forecasters, 6, 3))
        self._known = np.zeros(kept, dtype=np.bool_)
        self._lead = np.array(self.leads)
        self._decay = 0.5 ** (1.0 / np.array(self.half_lives))

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. Call once a frame, before `predicted`."""
        self.frames += 1
        if not np.isfinite(pose).all():
            return
        rows = (self._newest + 1 - self._lead) % len(self._past)
        for k, row in enumerate(rows.tolist()):
            if self._known[row]:
                self._sum[k] *= self._decay
                self._sum[k] += lengths(self._past[row, k] - pose)[..., None]
                self._weight[k] = self._weight[k] * self._decay + 1.0

    def predicted(self, forecasts: Float[np.ndarray, "E T 6 3"] | None) -> None:
        """Keeps what is predicted from this frame on; None where nothing could be."""
        self._newest = (self._newest + 1) % len(self._past)
        self._known[self._newest] = forecasts is not None
        if forecasts is not None:
            self._past[self._newest] = forecasts[:, self._lead - 1].swapaxes(0, 1)

    def mean(self) -> Float[np.ndarray, "E 6 L H"]:
        """(E, 6, L, H) mean errors [m]; NaN where nothing has come due."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return (self._sum / self._weight[:, None, None]).transpose(1, 2, 0, 3)
