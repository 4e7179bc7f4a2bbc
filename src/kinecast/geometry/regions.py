"""Named regions as arrays: distances and nearest points of all of them at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.geometry.distances import ROW
from kinecast.geometry.shapes import Box, Sphere


@dataclass(frozen=True, eq=False)
class Regions:
    """G spheres and boxes."""

    names: tuple[str, ...]
    centers: Float[np.ndarray, "G 3"]  # [m]
    axes: Float[np.ndarray, "G 3 3"]  # rotations whose columns are each region's own axes in the world
    halves: Float[np.ndarray, "G 3"]  # half lengths along them [m]; 0 for a sphere
    radii: Float[np.ndarray, " G"]  # by which the surface lies farther out [m]; 0 for a box

    @staticmethod
    def of(shapes: Mapping[str, Sphere | Box]) -> Regions:
        """The shapes, in their order."""
        rows = np.array([shape.row for shape in shapes.values()]).reshape(-1, ROW)
        return Regions(tuple(shapes), rows[:, 1:4], rows[:, 4:13].reshape(-1, 3, 3), rows[:, 13:16], rows[:, 16])

    def distance(self, points: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b G"]:
        """(…, G) distance [m] from each point to each region; 0 inside."""
        beyond = np.maximum(np.abs(self._own(points)) - self.halves, 0.0)
        return np.maximum(np.sqrt((beyond**2).sum(axis=-1)) - self.radii, 0.0)

    def within(self, points: Float[np.ndarray, "*b 3"], share: float) -> Float[np.ndarray, "*b G 3"]:
        """(…, G, 3) the nearest point [m] of each region shrunk to a share of its size about its centre."""
        own = self._own(points)
        edge = np.clip(own, -share * self.halves, share * self.halves)
        away = own - edge
        length = np.sqrt((away**2).sum(axis=-1, keepdims=True))
        edge += away * np.minimum(1.0, share * self.radii[:, None] / np.maximum(length, 1e-12))
        return self.centers + np.einsum("gij,...gj->...gi", self.axes, edge)

    def _own(self, points: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b G 3"]:
        """Points in each region's own axes, about its centre."""
        return np.einsum("gji,...gj->...gi", self.axes, points[..., None, :] - self.centers)
