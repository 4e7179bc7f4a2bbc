"""How wrong each forecaster has been on the person in view: errors come due frame by frame, and are forgotten."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinecast.geometry.transforms import lengths


class RollingForecastErrors:
    """Exponentially forgotten mean error of each forecaster's past predictions, once their time has come.

    Args:
        forecasters: E, how many are followed.
        leads: (L,) steps ahead at which they are judged.
        half_lives: (H,) memories, in frames.
    """

    def __init__(self, forecasters: int, leads: tuple[int, ...], half_lives: tuple[float, ...]) -> None:
        self.frames = 0  # seen so far
        self._sum = np.zeros((len(leads), forecasters, 6, len(half_lives)))
        self._weight = np.zeros((len(leads), len(half_lives)))
        self._past = np.zeros((max(leads), len(leads), forecasters, 6, 3))
        self._known = np.zeros(max(leads), dtype=np.bool_)
        self._newest = 0
        self._lead = np.array(leads)
        self._decay = 0.5 ** (1.0 / np.array(half_lives))

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

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        for _ in range(frames):
            self.observe(np.full((6, 3), np.nan))
            self.predicted(None)

    def mean(self) -> Float[np.ndarray, "E 6 L H"]:
        """(E, 6, L, H) mean errors [m]; NaN where nothing has come due."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return (self._sum / self._weight[:, None, None]).transpose(1, 2, 0, 3)
