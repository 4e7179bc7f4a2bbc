"""What Foxglove and RViz draw alike of a prediction: fields of points, turns and colours, as both have them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import arms_of
from kinecast.live.publication import Publication
from kinecast.types import LIMBS

Fields = dict[str, Any]
Colour = tuple[float, float, float]

SEEN: Colour = (0.85, 0.85, 0.85)
THICK, THIN = 0.03, 0.01  # lines of the arms as they are seen, and as they are predicted [m]
ABOVE = np.array([0.0, 0.0, 0.3])  # where the words stand, from the highest joint [m]
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def points(positions: Float[np.ndarray, "N 3"]) -> list[Fields]:
    """Each as x, y, z [m]."""
    return [{"x": x, "y": y, "z": z} for x, y, z in positions.tolist()]


def pose(position: Fields, turn: Fields = UPRIGHT) -> Fields:
    """A pose; not turned unless it is said."""
    return {"position": position, "orientation": turn}


def turn_of_z(axis: Float[np.ndarray, "3"]) -> Fields:
    """The shortest turn of the z axis into a direction d, as a unit quaternion: (1 + z·d, z × d), made unit."""
    length = np.linalg.norm(axis)
    x, y, z = (axis / length).tolist() if length > 1e-9 else (0.0, 0.0, 1.0)
    if z < -1 + 1e-9:
        return {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}
    w = math.sqrt((1 + z) / 2)
    return {"x": -y / (2 * w), "y": x / (2 * w), "z": 0.0, "w": w}


def rgba(colour: Colour, opacity: float) -> Fields:
    """A colour, 0..1."""
    return dict(zip("rgba", (*colour, round(opacity, 2)), strict=True))


def limb_ends(arms: Float[np.ndarray, "6 3"]) -> list[Fields]:
    """Start and end of each limb that is known, one after another."""
    ends = arms[np.array(LIMBS)]
    return points(ends[np.isfinite(ends).all(axis=(1, 2))].reshape(-1, 3))


def fading(steps: int) -> list[float]:
    """How opaque the mean is drawn at each step."""
    return np.linspace(0.9, 0.2, steps, endpoint=False).tolist()


def words_of(publication: Publication) -> tuple[str, Fields]:
    """Who it is and how far to trust it, and where that is written."""
    arms, prediction = arms_of(publication.frame), publication.prediction
    top = np.nanmax(arms, axis=0) if np.isfinite(arms).any() else np.zeros(3)
    (place,) = points(np.round(top + ABOVE, 4)[None])
    return f"{prediction.person}: {prediction.status.name}", place
