"""What a predictor remembers of the person in view: how wrong each expert has been lately, come due frame by frame."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

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
    _past: deque[Float[np.ndarray, "E L 6 3"] | None] = field(init=False)

    def __post_init__(self) -> None:
        shape = (len(self.leads), len(self.half_lives))
        self._sum = np.zeros((self.forecasters, 6, *shape))
        self._weight = np.zeros(shape)
        self._past = deque(maxlen=max(self.leads))

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. Call once a frame, before `predicted`."""
        self.frames += 1
        if not np.isfinite(pose).all():
            return
        decay = 0.5 ** (1.0 / np.array(self.half_lives))
        for k, lead in enumerate(self.leads):
            if lead > len(self._past):
                continue
            made = self._past[-lead]
            if made is None:
                continue
            error = np.linalg.norm(made[:, k] - pose, axis=-1)
            self._sum[:, :, k] = self._sum[:, :, k] * decay + error[..., None]
            self._weight[k] = self._weight[k] * decay + 1.0

    def predicted(self, forecasts: Float[np.ndarray, "E T 6 3"] | None) -> None:
        """Keeps what is predicted from this frame on; None where nothing could be."""
        self._past.append(None if forecasts is None else forecasts[:, [lead - 1 for lead in self.leads]])

    def mean(self) -> Float[np.ndarray, "E 6 L H"]:
        """(E, 6, L, H) mean errors [m]; NaN where nothing has come due."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self._sum / self._weight
