"""What Foxglove draws of a prediction or a skeleton: messages of `foxglove.SceneUpdate`, as JSON.

Source: the message schemas of the Foxglove SDK (https://docs.foxglove.dev/docs/visualization/message-schemas).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import arms_of
from kinecast.live.drawing import (
    SEEN,
    THICK,
    THIN,
    Colour,
    Fields,
    fading,
    limb_ends,
    points,
    pose,
    rgba,
    turn_of_z,
    words_of,
)
from kinecast.live.publication import Publication, colour_of
from kinecast.types import SkeletonFrame

LIFETIME = 0.5  # how long what is drawn stays without a newer one [s]
LINE_LIST = 2
TUBE_OPACITY = 0.15
JOINT = 0.02  # radius of a joint [m]
PARTS = ("metadata", "arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")


def scene_update(publication: Publication, time: float) -> Fields:
    """One person at a time [s]: arms now, their mean at every step, tubes at the middle and the last step, status.

    Joints and limbs that are NaN are left out.
    """
    prediction, tubes = publication.prediction, publication.tubes
    colour, steps = colour_of(prediction.status), len(prediction.times)
    lines = [_lines(arms_of(publication.frame), SEEN, 1.0, THICK)]
    lines += [_lines(mean, colour, opacity, THIN) for mean, opacity in zip(prediction.mean, fading(steps), strict=True)]
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
        lines=[line for line in lines if line["points"]],
        texts=[words],
    )


def skeleton_update(frame: SkeletonFrame, time: float) -> Fields:
    """One person as measured, at a time [s]: lines for the arms, a small sphere for every joint that is seen."""
    line = _lines(arms_of(frame), SEEN, 1.0, THICK)
    spheres = [_sphere(joint, JOINT, SEEN, 1.0) for joint in frame.positions[frame.valid]]
    return _update(frame.person, frame.frame_id, time, spheres=spheres, lines=[line] if line["points"] else [])


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


def _lines(arms: Float[np.ndarray, "6 3"], colour: Colour, opacity: float, thickness: float) -> Fields:
    return {
        "type": LINE_LIST, "pose": pose(_point(0.0, 0.0, 0.0)), "thickness": thickness, "scale_invariant": False,
        "points": limb_ends(np.round(arms, 4)), "color": rgba(colour, opacity), "colors": [], "indices": [],
    }  # fmt: skip


def _sphere(centre: Float[np.ndarray, "3"], radius: float, colour: Colour, opacity: float) -> Fields:
    return {"pose": pose(_point(*centre)), "size": _point(*[2 * radius] * 3), "color": rgba(colour, opacity)}


def _cylinder(start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], radius: float, colour: Colour) -> Fields:
    axis = end - start
    return {
        "pose": pose(_point(*(start + end) / 2), turn_of_z(axis)),
        "size": _point(2 * radius, 2 * radius, float(np.linalg.norm(axis))),
        "bottom_scale": 1.0, "top_scale": 1.0, "color": rgba(colour, TUBE_OPACITY),
    }  # fmt: skip
