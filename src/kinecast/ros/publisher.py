"""What a prediction is told as, on which topic, and when that is taken back.

Functions give the fields of one message each; a stamp is of its header [s].
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from kinecast.body.skeleton import arms_of
from kinecast.errors import OptionError
from kinecast.live.drawing import SEEN, THICK, THIN, Fields, fading, limb_lines, points, pose, rgba, words_of
from kinecast.live.publication import UPPER_TRIANGLE, Publication, colour_of
from kinecast.ros.planning_scene import CollisionObjects
from kinecast.types import Status

OUTPUTS = "prediction,markers,poses,planning_scene"
_TYPES = {
    "prediction": "kinecast_msgs/PredictedDistribution",
    "markers": "visualization_msgs/MarkerArray",
    "planning_scene": "moveit_msgs/PlanningScene",
}
MOST_PERSONS = 64  # with topics of their own, all through a run
SAME_CLOCK = 60.0  # stamps within so much [s] of the ROS clock are of that clock, and go out as they came
AT_LEAST = 0.1  # how long anything stays [s]

LINE_LIST, TEXT, DELETE = 5, 9, 2  # types and an action of visualization_msgs/Marker
MARKERS = range(3)  # ids of a person's markers: the arms now, their mean at every step, the status
HIGH = 0.08  # letters [m]
UNKNOWN_TURN = math.pi**2  # variance of an angle of which nothing is known [rad²]


class Posting(NamedTuple):
    """Fields of a message, see `Messages.encode`, for a topic with its namespace."""

    topic: str
    type_: str
    fields: Fields


@dataclass(frozen=True)
class OutputOptions:
    """What is sent, and where."""

    outputs: str = OUTPUTS  # some of them, with commas between
    planning_scene: str = ""  # its topic; "" is below the namespace. MoveIt listens on /planning_scene
    parts: Annotated[int, Meta(ge=1, le=8)] = 3  # of the horizon, each an object a limb that holds its steps' tubes
    thickness: Annotated[float, Meta(ge=0, le=0.5)] = 0.05
    """Of a limb around its centre line, added to every radius in the scene [m]."""


class PredictionPublisher:
    """Turns predictions into messages on topics of a namespace, and remembers what must be deleted.

    Times are [s] on a clock of this machine that never jumps, but for `ros_now` and stamps. An OptionError for what is
    no name in ROS, or no output.
    """

    def __init__(self, options: OutputOptions, namespace: str = "/kinecast") -> None:
        for name in filter(None, (namespace, options.planning_scene)):
            if not re.fullmatch(r"(/[A-Za-z][A-Za-z0-9_]*)+", name):
                raise OptionError(f"{name!r} is no ROS name: expected /letters/and_digits")
        self._outputs = options.outputs.split(",")
        if unknown := set(self._outputs) - set(OUTPUTS.split(",")):
            raise OptionError(f"output {', '.join(sorted(unknown))}: expected some of {OUTPUTS}")
        self._namespace, self._scene_topic = namespace, options.planning_scene or f"{namespace}/planning_scene"
        self._objects = CollisionObjects(options.parts, options.thickness)
        self._shown: dict[tuple[str, str], tuple[str, float]] = {}  # coordinate frame and expiry of each person
        self._tokens: dict[tuple[str, str], str] = {}

    @property
    def topics(self) -> dict[str, str]:
        """Those that are there from the beginning, with their types; a person's own come with the person."""
        return {self._topic(each): _TYPES[each] for each in self._outputs if each in _TYPES}

    def tell(self, publication: Publication, now: float, ros_now: float) -> Iterator[Posting]:
        """Messages of a prediction; what it rests on has been acquired by `now`, on `Publication.acquired`'s clock."""
        outputs, prediction = self._outputs, publication.prediction
        token = self._token(publication.key)
        stamp = prediction.stamp
        if abs(stamp - ros_now) > SAME_CLOCK:
            stamp = max(ros_now - (now - publication.acquired), 0.0)
        horizon = float(prediction.times[-1] - prediction.stamp)
        expires = max(publication.acquired + horizon, now + AT_LEAST)
        self._shown[publication.key] = publication.frame.frame_id, expires
        if "prediction" in outputs:
            yield self._posting("prediction", _distribution(publication, stamp))
        if "markers" in outputs:
            yield self._posting("markers", _markers(publication, stamp, expires - now))
        if "poses" in outputs and token:
            means = points(prediction.mean.reshape(-1, 3))  # the six joints' at the first step, then at the next, …
            fields = {"header": _header(publication, stamp), "poses": [pose(each) for each in means]}
            yield Posting(self._topic(f"{token}/poses"), "geometry_msgs/PoseArray", fields)
            for joint, name in enumerate(prediction.joints):
                if np.isfinite(prediction.mean[-1, joint]).all():
                    fields = _joint_pose(publication, stamp, joint)
                    yield Posting(self._topic(f"{token}/{name}"), "geometry_msgs/PoseWithCovarianceStamped", fields)
        if "planning_scene" in outputs and token:
            changes = self._objects.update(publication, token, stamp, now, expires)
            yield from self._scene(changes + self._objects.remove(now))

    def take_back(self, now: float) -> Iterator[Posting]:
        """Messages that delete what has expired; inf takes back everything."""
        for key, (frame, expires) in list(self._shown.items()):
            if expires <= now:
                del self._shown[key]
                if "markers" in self._outputs:
                    common = {"header": {"frame_id": frame}, "ns": "/".join(key), "action": DELETE}
                    yield self._posting("markers", {"markers": [common | {"id": id_} for id_ in MARKERS]})
        yield from self._scene(self._objects.remove(now))

    def _scene(self, objects: list[Fields]) -> Iterator[Posting]:
        if objects:
            diff = {"is_diff": True, "robot_state": {"is_diff": True}, "world": {"collision_objects": objects}}
            yield self._posting("planning_scene", diff)

    def _posting(self, output: str, fields: Fields) -> Posting:
        return Posting(self._topic(output), _TYPES[output], fields)

    def _topic(self, name: str) -> str:
        return self._scene_topic if name == "planning_scene" else f"{self._namespace}/{name}"

    def _token(self, key: tuple[str, str]) -> str:
        """A person's name as part of a topic; "" where there have been too many persons."""
        if key not in self._tokens and len(self._tokens) < MOST_PERSONS:
            plain = re.sub(r"[^A-Za-z0-9]+", "_", key[1]).strip("_") or "0"
            names = (f"person_{plain}", *(f"person_{plain}_{count}" for count in range(2, MOST_PERSONS + 2)))
            self._tokens[key] = next(name for name in names if name not in self._tokens.values())
        return self._tokens.get(key, "")


def _distribution(publication: Publication, stamp: float) -> Fields:
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
    goals = [(hand, goal, share) for hand, shares in prediction.goals.items() for goal, share in shares.items()]
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
        "goals": [{"hand": hand, "goal": goal, "probability": share} for hand, goal, share in goals],
    }


def _joint_pose(publication: Publication, stamp: float, joint: int) -> Fields:
    """Fields of a geometry_msgs/PoseWithCovarianceStamped: one joint at the last step; its stamp is that instant."""
    prediction = publication.prediction
    covariance = np.eye(6) * UNKNOWN_TURN
    covariance[:3, :3] = prediction.covariance[-1, joint]
    (position,) = points(prediction.mean[-1, joint : joint + 1])
    return {
        "header": _header(publication, stamp + prediction.times[-1] - prediction.stamp),
        "pose": {"pose": pose(position), "covariance": covariance.ravel()},
    }


def _markers(publication: Publication, stamp: float, lifetime: float) -> Fields:
    """Fields of a visualization_msgs/MarkerArray: the arms now, their mean at every step, fading, and the status.

    Joints that are NaN are left out. It stays for its lifetime [s] without a newer one.
    """
    prediction = publication.prediction
    colour = colour_of(prediction.status)
    text, place = words_of(publication)
    lines = {"type": LINE_LIST, "pose": pose({})}
    drawn = (
        lines | {"scale": {"x": THICK}} | limb_lines(arms_of(publication.frame)[None], SEEN, [1.0]),
        lines | {"scale": {"x": THIN}} | limb_lines(prediction.mean, colour, fading(len(prediction.mean))),
        {"type": TEXT, "text": text, "scale": {"z": HIGH}, "color": rgba(colour, 1.0), "pose": pose(place)},
    )
    common = {"header": _header(publication, stamp), "ns": "/".join(publication.key), "lifetime": lifetime}
    return {"markers": [common | {"id": id_} | each for id_, each in zip(MARKERS, drawn, strict=True)]}


def _header(publication: Publication, stamp: float) -> Fields:
    return {"stamp": stamp, "frame_id": publication.frame.frame_id}
