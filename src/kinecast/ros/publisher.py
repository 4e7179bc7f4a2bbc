"""What a prediction is told as, on which topic, and when that is taken back."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from kinecast.errors import OptionError
from kinecast.live.publication import Publication
from kinecast.ros.planning_scene import CollisionObjects, SceneOptions
from kinecast.ros.predictions import Fields, distribution, joint_pose, markers, no_markers, pose_array

OUTPUTS = ("prediction", "markers", "poses", "planning_scene")
_TYPES = {
    "prediction": "kinecast_msgs/PredictedDistribution",
    "markers": "visualization_msgs/MarkerArray",
    "planning_scene": "moveit_msgs/PlanningScene",
}
MOST_PERSONS = 64  # with topics of their own, all through a run
SAME_CLOCK = 60.0  # stamps within so much [s] of the ROS clock are of that clock, and go out as they came
AT_LEAST = 0.1  # how long anything stays [s]


class Posting(NamedTuple):
    """Fields of a message, see `Messages.encode`, for a topic with its namespace."""

    topic: str
    type_: str
    fields: Fields


@dataclass(frozen=True)
class OutputOptions:
    """What is sent, and where."""

    namespace: str = "/kinecast"  # of all topics
    outputs: tuple[str, ...] = OUTPUTS  # which of `OUTPUTS`
    planning_scene: str = ""  # its topic; "" is below the namespace. MoveIt listens on /planning_scene
    scene: SceneOptions = field(default_factory=SceneOptions)

    def __post_init__(self) -> None:
        for name in filter(None, (self.namespace, self.planning_scene)):
            if not re.fullmatch(r"(/[A-Za-z][A-Za-z0-9_]*)+", name):
                raise OptionError(f"{name!r} is no ROS name: expected /letters/and_digits")
        unknown = [each for each in self.outputs if each not in OUTPUTS]
        if unknown or not self.outputs:
            raise OptionError(f"output {', '.join(unknown) or 'none'}: expected some of {', '.join(OUTPUTS)}")


class PredictionPublisher:
    """Turns predictions into messages, and remembers what must be deleted.

    All times are [s] on one clock of this machine that never jumps, but for `ros_now`.
    """

    def __init__(self, options: OutputOptions) -> None:
        self._options = options
        self._objects = CollisionObjects(options.scene)
        self._shown: dict[tuple[str, str], tuple[str, float]] = {}  # coordinate frame and expiry of each person
        self._tokens: dict[tuple[str, str], str] = {}

    @property
    def topics(self) -> dict[str, str]:
        """Those that are there from the beginning, with their types; a person's own come with the person."""
        return {self._topic(each): _TYPES[each] for each in self._options.outputs if each in _TYPES}

    def tell(self, publication: Publication, now: float, ros_now: float) -> Iterator[Posting]:
        """Messages of a prediction; what it rests on has been acquired by `now`, on `Publication.acquired`'s clock."""
        outputs, prediction = self._options.outputs, publication.prediction
        token = self._token(publication.key)
        stamp = prediction.stamp
        if abs(stamp - ros_now) > SAME_CLOCK:
            stamp = max(ros_now - (now - publication.acquired), 0.0)
        horizon = float(prediction.times[-1] - prediction.stamp) if len(prediction.times) else 0.0
        expires = max(publication.acquired + horizon, now + AT_LEAST)
        self._shown[publication.key] = publication.frame.frame_id, expires
        if "prediction" in outputs:
            yield self._posting("prediction", distribution(publication, stamp))
        if "markers" in outputs:
            yield self._posting("markers", markers(publication, stamp, expires - now))
        if "poses" in outputs and token and len(prediction.times):
            yield Posting(self._topic(f"{token}/poses"), "geometry_msgs/PoseArray", pose_array(publication, stamp))
            for joint, name in enumerate(prediction.joints):
                if np.isfinite(prediction.mean[-1, joint]).all():
                    fields = joint_pose(publication, stamp, joint)
                    yield Posting(self._topic(f"{token}/{name}"), "geometry_msgs/PoseWithCovarianceStamped", fields)
        if "planning_scene" in outputs and token:
            changes = self._objects.update(publication, token, stamp, now, expires)
            yield from self._scene(changes + self._objects.remove(now))

    def take_back(self, now: float) -> Iterator[Posting]:
        """Messages that delete what has expired; inf takes back everything."""
        for key, (frame, expires) in list(self._shown.items()):
            if expires <= now:
                del self._shown[key]
                if "markers" in self._options.outputs:
                    yield self._posting("markers", no_markers(key, frame))
        yield from self._scene(self._objects.remove(now))

    @property
    def next_expiry(self) -> float:
        """When something will have to be taken back; inf where there is nothing."""
        return min((expires for _, expires in self._shown.values()), default=math.inf)

    def _scene(self, objects: list[Fields]) -> Iterator[Posting]:
        if objects:
            diff = {"is_diff": True, "robot_state": {"is_diff": True}, "world": {"collision_objects": objects}}
            yield self._posting("planning_scene", diff)

    def _posting(self, output: str, fields: Fields) -> Posting:
        return Posting(self._topic(output), _TYPES[output], fields)

    def _topic(self, name: str) -> str:
        if name == "planning_scene" and self._options.planning_scene:
            return self._options.planning_scene
        return f"{self._options.namespace}/{name}"

    def _token(self, key: tuple[str, str]) -> str:
        """A person's name as part of a topic; "" where there have been too many persons."""
        if key not in self._tokens and len(self._tokens) < MOST_PERSONS:
            plain = re.sub(r"[^A-Za-z0-9]+", "_", key[1]).strip("_") or "0"
            names = (f"person_{plain}", *(f"person_{plain}_{count}" for count in range(2, MOST_PERSONS + 2)))
            self._tokens[key] = next(name for name in names if name not in self._tokens.values())
        return self._tokens.get(key, "")
