"""Source axes turned into the world's: right-handed, z up."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = ["from_camera", "from_y_up"]


def from_camera(points: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """Camera axes (x right, y down, z forward) to the world: (x, y, z) → (x, z, −y)."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def from_y_up(points: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """Axes with y up (x right, z towards the viewer) to the world: (x, y, z) → (x, −z, y)."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)
