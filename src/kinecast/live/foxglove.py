"""What Foxglove draws of a prediction or a skeleton: messages of `foxglove.SceneUpdate`, as JSON.

Source: the message schemas of the Foxglove SDK (https://docs.foxglove.dev/docs/visualization/message-schemas).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.live.publication import Publication, arms_of, colour_of
from kinecast.types import LIMBS, SkeletonFrame

LIFETIME = 0.5
"""How long what is drawn stays without a newer one [s]."""
LINE_LIST = 2
ABOVE = np.array([0.0, 0.0, 0.3])
"""Where the words stand, from the highest joint [m]."""
TUBE_OPACITY = 0.15
Colour = tuple[float, float, float]
Point = Sequence[float]

_SEEN: Colour = (0.85, 0.85, 0.85)
_NO_TURN = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def scene_update(publication: Publication, time: float) -> dict[str, Any]:
    """One person at a time [s]: arms now, their mean at every step, tubes at the middle and the last step, status.

    Joints and limbs that are NaN are left out.
    """
    prediction, tubes = publication.prediction, publication.tubes
    colour, status = colour_of(prediction.status), prediction.status.name
    observed = arms_of(publication.frame)
    steps = len(prediction.times)
    lines = [_lines(observed, _SEEN, 1.0, 0.03)]
    lines += [_lines(mean, colour, 0.9 - 0.7 * k / steps, 0.01) for k, mean in enumerate(prediction.mean)]
    drawn = sorted({steps // 2, steps - 1})
    ends = np.stack((tubes.start[drawn], tubes.end[drawn]), axis=2).reshape(-1, 2, 3)
    radii = tubes.radius[drawn].reshape(-1)
    known = np.isfinite(radii)
    capsules = list(zip(_rounded(ends[known]), _rounded(radii[known]), strict=True))
    top = np.nanmax(observed, axis=0) if np.isfinite(observed).any() else np.zeros(3)
    words = {
        "pose": _pose(_rounded(top + ABOVE)), "billboard": True, "font_size": 0.06, "scale_invariant": False,
        "color": _rgba(colour, 1.0), "text": f"{prediction.person}: {status}",
    }  # fmt: skip
    return _update(
        "/".join(publication.key),
        publication.frame.frame_id,
        time,
        metadata=[{"key": "status", "value": status}, {"key": "source", "value": publication.source}],
        spheres=[_sphere(end, radius, colour, TUBE_OPACITY) for ends, radius in capsules for end in ends],
        cylinders=[_cylinder(start, end, radius, colour) for (start, end), radius in capsules],
        lines=[line for line in lines if line["points"]],
        texts=[words],
    )


def skeleton_update(frame: SkeletonFrame, time: float) -> dict[str, Any]:
    """One person as measured, at a time [s]: lines for the arms, a small sphere for every joint that is seen."""
    line = _lines(arms_of(frame), _SEEN, 1.0, 0.03)
    spheres = [_sphere(joint, 0.02, _SEEN, 1.0) for joint in _rounded(frame.positions[frame.valid])]
    return _update(frame.person, frame.frame_id, time, spheres=spheres, lines=[line] if line["points"] else [])


def _update(name: str, frame_id: str, time: float, **parts: list[dict[str, Any]]) -> dict[str, Any]:
    """One entity; the schema wants a list of every kind of part, empty ones too."""
    kinds = ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    entity = {kind: parts.get(kind, []) for kind in kinds} | {
        "timestamp": {"sec": int(time), "nsec": int(time % 1 * 1e9)},
        "frame_id": frame_id,
        "id": name,
        "lifetime": {"sec": int(LIFETIME), "nsec": int(LIFETIME % 1 * 1e9)},
        "frame_locked": False,
    }
    return {"deletions": [], "entities": [entity]}


def _rounded(values: np.ndarray) -> Any:
    """As Python's numbers, to 0.1 mm."""
    return np.round(values, 4).tolist()


def _point(values: Point) -> dict[str, float]:
    return {"x": values[0], "y": values[1], "z": values[2]}


def _pose(position: Point, orientation: dict[str, float] = _NO_TURN) -> dict[str, Any]:
    return {"position": _point(position), "orientation": orientation}


def _rgba(colour: Colour, opacity: float) -> dict[str, float]:
    return {"r": colour[0], "g": colour[1], "b": colour[2], "a": round(opacity, 2)}


def _lines(arms: Float[np.ndarray, "6 3"], colour: Colour, opacity: float, thickness: float) -> dict[str, Any]:
    joints, seen = _rounded(arms), np.isfinite(arms).all(axis=1).tolist()
    points = [_point(joints[joint]) for limb in LIMBS if seen[limb[0]] and seen[limb[1]] for joint in limb]
    return {
        "type": LINE_LIST, "pose": _pose((0.0, 0.0, 0.0)), "thickness": thickness, "scale_invariant": False,
        "points": points, "color": _rgba(colour, opacity), "colors": [], "indices": [],
    }  # fmt: skip


def _sphere(centre: Point, radius: float, colour: Colour, opacity: float) -> dict[str, Any]:
    return {"pose": _pose(centre), "size": _point([2 * radius] * 3), "color": _rgba(colour, opacity)}


def _cylinder(start: Point, end: Point, radius: float, colour: Colour) -> dict[str, Any]:
    axis = [b - a for a, b in zip(start, end, strict=True)]
    middle = [(a + b) / 2 for a, b in zip(start, end, strict=True)]
    length = math.hypot(*axis)
    return {
        "pose": _pose(middle, _from_z_to(axis, length)), "size": _point((2 * radius, 2 * radius, length)),
        "bottom_scale": 1.0, "top_scale": 1.0, "color": _rgba(colour, TUBE_OPACITY),
    }  # fmt: skip


def _from_z_to(axis: Point, length: float) -> dict[str, float]:
    """The shortest turn of the z axis into a direction d, as a unit quaternion: (1 + z·d, z × d), made unit."""
    if length < 1e-9:
        return _NO_TURN
    x, y, z = (each / length for each in axis)
    if z < -1 + 1e-9:
        return {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}
    w = math.sqrt((1 + z) / 2)
    return {"x": -y / (2 * w), "y": x / (2 * w), "z": 0.0, "w": w}
