"""A prediction as fields of standard messages, and of kinecast's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.live.publication import UPPER_TRIANGLE, Publication, arms_of, colour_of
from kinecast.types import LIMBS, Status

__all__ = ["MARKERS", "distribution", "joint_pose", "markers", "no_markers", "pose_array"]

Fields = dict[str, Any]
LINE_LIST, TEXT, DELETE = 5, 9, 2
"""visualization_msgs/Marker."""
MARKERS = range(3)
"""Ids of a person's markers: the arms now, their mean at every step, the status."""
THICK, THIN, HIGH = 0.03, 0.01, 0.08
"""Lines and letters [m]."""
ABOVE = 0.3
"""Where the words stand, from the highest joint [m]."""
UNKNOWN_TURN = math.pi**2
"""Variance of an angle of which nothing is known [rad²]."""

_SEEN = (0.85, 0.85, 0.85)


def distribution(publication: Publication, stamp: float) -> Fields:
    """Fields of a kinecast_msgs/PredictedDistribution: mean, covariance and tubes of every step.

    Args:
        publication: what to tell.
        stamp: of the header [s].
    """
    prediction, tubes = publication.prediction, publication.tubes
    covariance = prediction.covariance[..., UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]]
    steps = [
        {
            "after": float(time - prediction.stamp),
            "mean": _points(mean),
            "covariance": own.ravel(),
            "tubes": [
                {"start": start, "end": end, "radius": float(radius)}
                for start, end, radius in zip(_points(starts), _points(ends), radii, strict=True)
            ],
        }
        for time, mean, own, starts, ends, radii in zip(
            prediction.times, prediction.mean, covariance, tubes.start, tubes.end, tubes.radius, strict=True
        )
    ]
    goals = [
        {"hand": hand, "goal": goal, "probability": float(share)}
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
        "observed": _points(arms_of(publication.frame)),
        "steps": steps,
        "level": tubes.level,
        "goals": goals,
    }


def pose_array(publication: Publication, stamp: float) -> Fields:
    """Fields of a geometry_msgs/PoseArray: the six joints' means at the first step, then at the next, …"""
    means = publication.prediction.mean.reshape(-1, 3)
    poses = [{"position": each, "orientation": {"w": 1.0}} for each in _points(means)]
    return {"header": _header(publication, stamp), "poses": poses}


def joint_pose(publication: Publication, stamp: float, joint: int) -> Fields:
    """Fields of a geometry_msgs/PoseWithCovarianceStamped: one joint at the last step; its stamp is that instant."""
    prediction = publication.prediction
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = prediction.covariance[-1, joint]
    covariance[3:, 3:] = np.eye(3) * UNKNOWN_TURN
    (position,) = _points(prediction.mean[-1, joint][None])
    pose = {"position": position, "orientation": {"w": 1.0}}
    ahead = float(prediction.times[-1] - prediction.stamp)
    return {
        "header": _header(publication, stamp + ahead),
        "pose": {"pose": pose, "covariance": covariance.ravel()},
    }


def markers(publication: Publication, stamp: float, lifetime: float) -> Fields:
    """Fields of a visualization_msgs/MarkerArray: the arms now, their mean at every step, fading, and the status.

    Args:
        publication: what to draw; joints that are NaN are left out.
        stamp: of the headers [s].
        lifetime: how long it stays without a newer one [s].
    """
    prediction = publication.prediction
    colour = colour_of(prediction.status)
    observed = arms_of(publication.frame)
    fading = 0.9 - 0.7 * np.arange(len(prediction.mean)) / max(len(prediction.mean), 1)
    top = np.nanmax(observed, axis=0) if np.isfinite(observed).any() else np.zeros(3)
    (words,) = _points((top + np.array([0.0, 0.0, ABOVE]))[None])
    text = f"{prediction.person}: {prediction.status.name}"
    drawn: list[Fields] = [
        _lines([observed], _SEEN, [1.0], THICK),
        _lines(prediction.mean, colour, fading, THIN),
        {"type": TEXT, "text": text, "scale": {"z": HIGH}, "color": _rgba(colour, 1.0), "pose": _at(words)},
    ]
    common = {"header": _header(publication, stamp), "ns": "/".join(publication.key), "lifetime": lifetime}
    return {"markers": [common | {"id": id_} | each for id_, each in zip(MARKERS, drawn, strict=True)]}


def no_markers(key: tuple[str, str], frame: str) -> Fields:
    """Fields of a visualization_msgs/MarkerArray that deletes what `markers` drew of a person."""
    common = {"header": {"frame_id": frame}, "ns": "/".join(key), "action": DELETE}
    return {"markers": [common | {"id": id_} for id_ in MARKERS]}


def _header(publication: Publication, stamp: float) -> Fields:
    return {"stamp": stamp, "frame_id": publication.frame.frame_id}


def _points(positions: Float[np.ndarray, "N 3"]) -> list[Fields]:
    return [{"x": x, "y": y, "z": z} for x, y, z in positions.tolist()]


def _at(position: Fields) -> Fields:
    return {"position": position, "orientation": {"w": 1.0}}


def _rgba(colour: tuple[float, float, float], opacity: float) -> Fields:
    return {"r": colour[0], "g": colour[1], "b": colour[2], "a": opacity}


def _lines(
    poses: Sequence[np.ndarray] | np.ndarray, colour: tuple[float, float, float], opacities: Any, width: float
) -> Fields:
    points: list[Fields] = []
    colours: list[Fields] = []
    for arms, opacity in zip(poses, opacities, strict=True):
        joints, seen = _points(arms), np.isfinite(arms).all(axis=1)
        for start, end in LIMBS:
            if seen[start] and seen[end]:
                points += [joints[start], joints[end]]
                colours += [_rgba(colour, float(opacity))] * 2
    return {
        "type": LINE_LIST, "points": points, "colors": colours, "color": _rgba(colour, 1.0), "scale": {"x": width},
        "pose": {"orientation": {"w": 1.0}},
    }  # fmt: skip
