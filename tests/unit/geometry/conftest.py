"""Distances of points to everything in a scene."""

from __future__ import annotations

import numpy as np

from kinecast.geometry.distances import limb_distances
from kinecast.geometry.scene import Scene


def distances(scene: Scene, points: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(…, T, J) distance [m] of each point (…, T, J, 3) to the nearest obstacle where it is at its time [s]."""
    return limb_distances(scene.rows(times), points, np.arange(points.shape[-2])[:, None].repeat(2, axis=1))
