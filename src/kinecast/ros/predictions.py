"""A prediction as fields of standard messages, and of kinecast's own. A stamp is of a message's header [s]."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.live.publication import UPPER_TRIANGLE, Publication, arms_of, colour_of
from kinecast.types import LIMBS, Status

Fields = dict[str, Any]
Colour = tuple[float, float, float]
LINE_LIST, TEXT, DELETE = 5, 9, 2  # types and an action of visualization_msgs/Marker
MARKERS = range(3)  # ids of a person's markers: the arms now, their mean at every step, the status
THICK, THIN, HIGH = 0.03, 0.01, 0.08  # lines and letters [m]
ABOVE = np.array([0.0, 0.0, 0.3])  # where the words stand, from the highest joint [m]
UNKNOWN_TURN = math.pi**2  # variance of an angle of which nothing is known [rad²]
SEEN: Colour = (0.85, 0.85, 0.85)


def distribution(publication: Publication, stamp: float) -> Fields:
    """Fields of a kinecast_msgs/PredictedDistribution: mean, covariance and tubes of every step."""
    prediction, tubes = publication.prediction, publication.tubes
    covariance = prediction.covariance[..., UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]]
    steps = []
    for k, time in enumerate(prediction.times):
        ends = zip(points(tubes.start[k]), points(tubes.end[k]), tubes.radius[k], strict=True)
        steps.append({
            "after": time - prediction.stamp,
            "mean": points(prediction.mean[k]),
            "covariance": covariance[k].ravel(),
            "tubes": [{"start": start, "end": end, "radius": radius} for start, end, radius in ends],
        })  # fmt: skip
    goals = [
        {"hand": hand, "goal": goal, "probability": share}
        for hand, shares in prediction.goals.items()
        for goal, share in shares.items()
    ]
    return {
        "header": _header(publication, stamp),
        "person": prediction.person,
        "source": publication.source,
        "status": list(Status).index(prediction.status),
        "advice": prediction.status.advice,
        "joints": list(prediction.joints),
        "observed": points(arms_of(publication.frame)),
        "steps": steps,
        "level": tubes.level,
        "goals": goals,
    }


def pose_array(publication: Publication, stamp: float) -> Fields:
    """Fields of a geometry_msgs/PoseArray: the six joints' means at the first step, then at the next, …"""
    means = points(publication.prediction.mean.reshape(-1, 3))
    return {"header": _header(publication, stamp), "poses": [upright(each) for each in means]}


def joint_pose(publication: Publication, stamp: float, joint: int) -> Fields:
    """Fields of a geometry_msgs/PoseWithCovarianceStamped: one joint at the last step; its stamp is that instant."""
    prediction = publication.prediction
    covariance = np.eye(6) * UNKNOWN_TURN
    covariance[:3, :3] = prediction.covariance[-1, joint]
    (position,) = points(prediction.mean[-1, joint : joint + 1])
    return {
        "header": _header(publication, stamp + prediction.times[-1] - prediction.stamp),
        "pose": {"pose": upright(position), "covariance": covariance.ravel()},
    }


def markers(publication: Publication, stamp: float, lifetime: float) -> Fields:
    """Fields of a visualization_msgs/MarkerArray: the arms now, their mean at every step, fading, and the status.

    Joints that are NaN are left out. It stays for its lifetime [s] without a newer one.
    """
    prediction, observed = publication.prediction, arms_of(publication.frame)
    colour = colour_of(prediction.status)
    fading = np.linspace(0.9, 0.2, len(prediction.mean), endpoint=False).tolist()
    top = np.nanmax(observed, axis=0) if np.isfinite(observed).any() else np.zeros(3)
    (place,) = points((top + ABOVE)[None])
    text = f"{prediction.person}: {prediction.status.name}"
    drawn: list[Fields] = [
        _lines(observed[None], SEEN, [1.0], THICK),
        _lines(prediction.mean, colour, fading, THIN),
        {"type": TEXT, "text": text, "scale": {"z": HIGH}, "color": _rgba(colour, 1.0), "pose": upright(place)},
    ]
    common = {"header": _header(publication, stamp), "ns": "/".join(publication.key), "lifetime": lifetime}
    return {"markers": [common | {"id": id_} | each for id_, each in zip(MARKERS, drawn, strict=True)]}


def no_markers(key: tuple[str, str], frame: str) -> Fields:
    """Fields of a visualization_msgs/MarkerArray that deletes what `markers` drew of a person."""
    common = {"header": {"frame_id": frame}, "ns": "/".join(key), "action": DELETE}
    return {"markers": [common | {"id": id_} for id_ in MARKERS]}


def points(positions: Float[np.ndarray, "N 3"]) -> list[Fields]:
    """Fields of a geometry_msgs/Point each."""
    return [{"x": x, "y": y, "z": z} for x, y, z in positions.tolist()]


def upright(position: Fields) -> Fields:
    """Fields of a geometry_msgs/Pose that is not turned."""
    return {"position": position, "orientation": {"w": 1.0}}


def _header(publication: Publication, stamp: float) -> Fields:
    return {"stamp": stamp, "frame_id": publication.frame.frame_id}


def _rgba(colour: Colour, opacity: float) -> Fields:
    return dict(zip("rgba", (*colour, opacity), strict=True))


def _lines(poses: Float[np.ndarray, "N 6 3"], colour: Colour, opacities: Sequence[float], width: float) -> Fields:
    ends: list[Fields] = []
    colours: list[Fields] = []
    for arms, opacity in zip(poses, opacities, strict=True):
        joints, seen = points(arms), np.isfinite(arms).all(axis=1)
        for limb in LIMBS:
            if seen[list(limb)].all():
                ends += [joints[end] for end in limb]
                colours += [_rgba(colour, opacity)] * 2
    common = {"type": LINE_LIST, "color": _rgba(colour, 1.0), "scale": {"x": width}, "pose": upright({})}
    return common | {"points": ends, "colors": colours}
