"""A prediction as Foxglove draws it: the schema `foxglove.SceneUpdate` as JSON, and messages of it.

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

__all__ = ["SCENE_UPDATE", "scene_update", "skeleton_update"]

LIFETIME = 0.5
"""How long what is drawn stays without a newer one [s]."""
LINE_LIST = 2
ABOVE = np.array([0.0, 0.0, 0.3])
"""Where the words stand, from the highest joint [m]."""
Colour = tuple[float, float, float]
Point = Sequence[float]

_SEEN: Colour = (0.85, 0.85, 0.85)
_NO_TURN = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_ORIGIN = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": _NO_TURN}


def scene_update(publication: Publication, time: float) -> dict[str, Any]:
    """One person: the arms now, their mean at every step, tubes at the middle and the last step, the status.

    Args:
        publication: what to draw; joints and limbs that are NaN are left out.
        time: of the drawing [s], 0 or more.
    """
    prediction, tubes = publication.prediction, publication.tubes
    colour = colour_of(prediction.status)
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
    entity = _entity("/".join(publication.key), publication.frame.frame_id, time) | {
        "metadata": [
            {"key": "status", "value": prediction.status.name},
            {"key": "source", "value": publication.source},
        ],
        "spheres": [_sphere(end, radius, colour) for ends, radius in capsules for end in ends],
        "cylinders": [_cylinder(start, end, radius, colour) for (start, end), radius in capsules],
        "lines": [line for line in lines if line["points"]],
        "texts": [_text(f"{prediction.person}: {prediction.status.name}", _rounded(top + ABOVE), colour)],
    }
    return {"deletions": [], "entities": [entity]}


def skeleton_update(frame: SkeletonFrame, time: float) -> dict[str, Any]:
    """One person as measured: lines for the arms, a small sphere for every joint that is seen.

    Args:
        frame: what to draw.
        time: of the drawing [s], 0 or more.
    """
    line = _lines(arms_of(frame), _SEEN, 1.0, 0.03)
    entity = _entity(frame.person, frame.frame_id, time) | {
        "spheres": [_sphere(joint, 0.02, _SEEN, 1.0) for joint in _rounded(frame.positions[frame.valid])],
        "lines": [line] if line["points"] else [],
    }
    return {"deletions": [], "entities": [entity]}


def _entity(name: str, frame_id: str, time: float) -> dict[str, Any]:
    """Nothing drawn yet."""
    nothing: dict[str, Any] = {
        part: []
        for part in ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    }
    return nothing | {
        "timestamp": {"sec": int(time), "nsec": int(time % 1 * 1e9)},
        "frame_id": frame_id,
        "id": name,
        "lifetime": {"sec": int(LIFETIME), "nsec": int(LIFETIME % 1 * 1e9)},
        "frame_locked": False,
    }


def _rounded(values: np.ndarray) -> Any:
    """As Python's numbers, to 0.1 mm."""
    return np.round(values, 4).tolist()


def _point(values: Point) -> dict[str, float]:
    return {"x": values[0], "y": values[1], "z": values[2]}


def _rgba(colour: Colour, opacity: float) -> dict[str, float]:
    return {"r": colour[0], "g": colour[1], "b": colour[2], "a": round(opacity, 2)}


def _lines(arms: Float[np.ndarray, "6 3"], colour: Colour, opacity: float, thickness: float) -> dict[str, Any]:
    joints, seen = _rounded(arms), np.isfinite(arms).all(axis=1).tolist()
    points = [_point(joints[joint]) for limb in LIMBS if seen[limb[0]] and seen[limb[1]] for joint in limb]
    return {
        "type": LINE_LIST, "pose": _ORIGIN, "thickness": thickness, "scale_invariant": False, "points": points,
        "color": _rgba(colour, opacity), "colors": [], "indices": [],
    }  # fmt: skip


def _sphere(centre: Point, radius: float, colour: Colour, opacity: float = 0.15) -> dict[str, Any]:
    pose = {"position": _point(centre), "orientation": _NO_TURN}
    return {"pose": pose, "size": _point([2 * radius] * 3), "color": _rgba(colour, opacity)}


def _cylinder(start: Point, end: Point, radius: float, colour: Colour) -> dict[str, Any]:
    axis = [b - a for a, b in zip(start, end, strict=True)]
    middle = [(a + b) / 2 for a, b in zip(start, end, strict=True)]
    length = math.hypot(*axis)
    pose = {"position": _point(middle), "orientation": _from_z_to(axis, length)}
    size = {"x": 2 * radius, "y": 2 * radius, "z": length}
    return {"pose": pose, "size": size, "bottom_scale": 1.0, "top_scale": 1.0, "color": _rgba(colour, 0.15)}


def _text(text: str, place: Point, colour: Colour) -> dict[str, Any]:
    pose = {"position": _point(place), "orientation": _NO_TURN}
    return {
        "pose": pose, "billboard": True, "font_size": 0.06, "scale_invariant": False,
        "color": _rgba(colour, 1.0), "text": text,
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


# The schema, from the fields of its parts.


def _object(title: str, **fields: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": fields, "required": list(fields)}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


def _schema() -> dict[str, Any]:
    number, text, truth, whole = ({"type": name} for name in ("number", "string", "boolean", "integer"))
    natural = {"type": "integer", "minimum": 0}
    fraction = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
    time = {"title": "time", "type": "object", "properties": {"sec": natural, "nsec": fraction}}
    duration = {"title": "duration", "type": "object", "properties": {"sec": whole, "nsec": fraction}}
    point = _object("foxglove.Point3", x=number, y=number, z=number)
    vector = _object("foxglove.Vector3", x=number, y=number, z=number)
    turn = _object("foxglove.Quaternion", x=number, y=number, z=number, w=number)
    pose = _object("foxglove.Pose", position=vector, orientation=turn)
    colour = _object("foxglove.Color", r=number, g=number, b=number, a=number)
    pair = _object("foxglove.KeyValuePair", key=text, value=text)
    line = _object(
        "foxglove.LinePrimitive", type={"enum": [0, 1, 2]}, pose=pose, thickness=number, scale_invariant=truth,
        points=_list(point), color=colour, colors=_list(colour), indices=_list(natural),
    )  # fmt: skip
    cylinder = _object(
        "foxglove.CylinderPrimitive", pose=pose, size=vector, bottom_scale=number, top_scale=number, color=colour
    )
    words = _object(
        "foxglove.TextPrimitive", pose=pose, billboard=truth, font_size=number, scale_invariant=truth, color=colour,
        text=text,
    )  # fmt: skip
    unused = _list({"type": "object"})
    entity = _object(
        "foxglove.SceneEntity", timestamp=time, frame_id=text, id=text, lifetime=duration, frame_locked=truth,
        metadata=_list(pair), arrows=unused, cubes=unused,
        spheres=_list(_object("foxglove.SpherePrimitive", pose=pose, size=vector, color=colour)),
        cylinders=_list(cylinder), lines=_list(line), triangles=unused, texts=_list(words), models=unused,
    )  # fmt: skip
    deletion = _object("foxglove.SceneEntityDeletion", timestamp=time, type={"enum": [0, 1]}, id=text)
    return _object("foxglove.SceneUpdate", deletions=_list(deletion), entities=_list(entity))


SCENE_UPDATE = _schema()
"""JSON schema of `foxglove.SceneUpdate`, without what is in arrows, cubes, triangles and models: they stay empty."""
