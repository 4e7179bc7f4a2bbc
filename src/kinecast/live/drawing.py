"""What is drawn of predictions and skeletons: fields that Foxglove and RViz share, and Foxglove's `SceneUpdate`.

Source: the message schemas of the Foxglove SDK (https://docs.foxglove.dev/docs/visualization/message-schemas).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import arms_of
from kinecast.live.publication import Publication, colour_of
from kinecast.types import LIMBS, SkeletonFrame

Fields = dict[str, Any]
Colour = tuple[float, float, float]

SEEN: Colour = (0.85, 0.85, 0.85)
THICK, THIN = 0.03, 0.01  # lines of the arms as they are seen, and as they are predicted [m]
ABOVE = np.array([0.0, 0.0, 0.3])  # where the words stand, from the highest joint [m]
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
LIFETIME = 0.5  # how long what Foxglove draws stays without a newer one [s]
LINE_LIST = 2
TUBE_OPACITY, JOINT = 0.15, 0.02  # radius of a joint [m]
PARTS = ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")


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


def limb_lines(poses: Float[np.ndarray, "T 6 3"], colour: Colour, opacities: Sequence[float]) -> Fields:
    """A list of lines: limbs that are known in each pose, from start to end, as opaque as the pose."""
    ends, colours = list[Fields](), list[Fields]()
    for arms, opacity in zip(poses[:, np.array(LIMBS)], opacities, strict=True):
        ends += points(arms[np.isfinite(arms).all(axis=(1, 2))].reshape(-1, 3))
        colours += [rgba(colour, opacity)] * (len(ends) - len(colours))
    return {"points": ends, "colors": colours, "color": rgba(colour, 1.0)}


def fading(steps: int) -> list[float]:
    """How opaque the mean is drawn at each step."""
    return np.linspace(0.9, 0.2, steps, endpoint=False).tolist()


def words_of(publication: Publication) -> tuple[str, Fields]:
    """Who it is and how far to trust it, and where that is written."""
    arms, prediction = arms_of(publication.frame), publication.prediction
    top = np.nanmax(arms, axis=0) if np.isfinite(arms).any() else np.zeros(3)
    (place,) = points(np.round(top + ABOVE, 4)[None])
    return f"{prediction.person}: {prediction.status.name}", place


def scene_update(publication: Publication, time: float) -> Fields:
    """One person at a time [s]: arms now, their mean at every step, tubes at the middle and the last step, status.

    Joints and limbs that are NaN are left out.
    """
    prediction, tubes = publication.prediction, publication.tubes
    colour, steps = colour_of(prediction.status), len(prediction.times)
    lines = _arms_now(publication.frame) + _lines(prediction.mean, colour, fading(steps), THIN)
    spheres, cylinders = [], []
    for k in sorted({steps // 2, steps - 1}):
        for start, end, radius in zip(tubes.start[k], tubes.end[k], tubes.radius[k], strict=True):
            if np.isfinite(radius):
                spheres += [_sphere(each, radius, colour, TUBE_OPACITY) for each in (start, end)]
                cylinders.append(_cylinder(start, end, radius, colour))
    text, place = words_of(publication)
    words = {
        "pose": pose(place), "billboard": True, "font_size": 0.06, "scale_invariant": False,
        "color": rgba(colour, 1.0), "text": text,
    }  # fmt: skip
    facts = {"status": prediction.status.name, "source": publication.source}
    return _update(
        "/".join(publication.key),
        publication.frame.frame_id,
        time,
        metadata=[{"key": key, "value": value} for key, value in facts.items()],
        spheres=spheres,
        cylinders=cylinders,
        lines=lines,
        texts=[words],
    )


def skeleton_update(frame: SkeletonFrame, time: float) -> Fields:
    """One person as measured, at a time [s]: lines for the arms, a small sphere for every joint that is seen."""
    spheres = [_sphere(joint, JOINT, SEEN, 1.0) for joint in frame.positions[frame.valid]]
    return _update(frame.person, frame.frame_id, time, spheres=spheres, lines=_arms_now(frame))


def _update(name: str, frame_id: str, time: float, **parts: list[Fields]) -> Fields:
    """One entity; the schema wants a list of every kind of part, empty ones too."""
    entity = {kind: parts.get(kind, []) for kind in PARTS} | {
        "timestamp": {"sec": int(time), "nsec": int(time % 1 * 1e9)},
        "frame_id": frame_id,
        "id": name,
        "lifetime": {"sec": 0, "nsec": int(LIFETIME * 1e9)},
        "frame_locked": False,
    }
    return {"deletions": [], "entities": [entity]}


def _point(*xyz: float) -> Fields:
    """To 0.1 mm."""
    return points(np.round([xyz], 4))[0]


def _arms_now(frame: SkeletonFrame) -> list[Fields]:
    return _lines(arms_of(frame)[None], SEEN, [1.0], THICK)


def _lines(
    poses: Float[np.ndarray, "T 6 3"], colour: Colour, opacities: Sequence[float], thickness: float
) -> list[Fields]:
    """One list of lines, or nothing where no limb is known."""
    lines = limb_lines(np.round(poses, 4), colour, opacities)
    common = {"type": LINE_LIST, "pose": pose(_point(0.0, 0.0, 0.0)), "scale_invariant": False, "indices": []}
    return [common | lines | {"thickness": thickness}] if lines["points"] else []


def _sphere(centre: Float[np.ndarray, "3"], radius: float, colour: Colour, opacity: float) -> Fields:
    return {"pose": pose(_point(*centre)), "size": _point(*[2 * radius] * 3), "color": rgba(colour, opacity)}


def _cylinder(start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], radius: float, colour: Colour) -> Fields:
    axis = end - start
    return {
        "pose": pose(_point(*(start + end) / 2), turn_of_z(axis)),
        "size": _point(2 * radius, 2 * radius, float(np.linalg.norm(axis))),
        "bottom_scale": 1.0, "top_scale": 1.0, "color": rgba(colour, TUBE_OPACITY),
    }  # fmt: skip
