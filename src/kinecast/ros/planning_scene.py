"""Tubes as collision objects of MoveIt: what a moveit_msgs/PlanningScene diff adds, moves and removes.

A tube is a cylinder with a sphere at each end. Where the shape that MoveIt has still holds it, the object is only
moved: new shapes cost MoveIt more than new poses.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.live.publication import Publication, arms_of
from kinecast.types import LIMBS

__all__ = ["CollisionObjects", "SceneOptions", "scene_diff"]

LIMB_NAMES = ("left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm")
ADD, REMOVE, MOVE = 0, 1, 3
"""Operations of moveit_msgs/CollisionObject."""
SPHERE, CYLINDER = 2, 3
"""Types of shape_msgs/SolidPrimitive."""
MARGIN = 0.02
"""A new shape is larger than its tube by this [m], so that it can be kept for a while."""
SLACK = 0.06
"""A shape that is larger than its tube by more than this [m] is replaced."""
REFRESH = 1.0
"""After so long [s] an object is added anew, for those who came later."""

Fields = dict[str, Any]


@dataclass(frozen=True)
class SceneOptions:
    """How tubes become objects.

    Attributes:
        parts: of the horizon, each an object a limb; 1..8. A part's object holds the tubes of all its steps.
        thickness: of a limb around its centre line, added to every radius [m]; 0..0.5.
    """

    parts: int = 3
    thickness: float = 0.05

    def __post_init__(self) -> None:
        if not 1 <= self.parts <= 8:
            raise OptionError(f"parts {self.parts} is outside 1..8")
        if not 0 <= self.thickness <= 0.5:
            raise OptionError(f"thickness {self.thickness:g} m is outside 0..0.5 m")


@dataclass(frozen=True)
class _Capsule:
    start: Float[np.ndarray, "3"]
    end: Float[np.ndarray, "3"]
    radius: float

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.end - self.start))


@dataclass(frozen=True)
class _Known:
    """What MoveIt has been told of an object."""

    frame: str
    length: float
    radius: float
    added: float
    expires: float

    def holds(self, capsule: _Capsule) -> bool:
        return 0 <= self.radius - capsule.radius <= SLACK and 0 <= self.length - capsule.length <= SLACK


class CollisionObjects:
    """The objects of every person in view.

    Args:
        options: see there.
    """

    def __init__(self, options: SceneOptions) -> None:
        self._options = options
        self._known: dict[Hashable, dict[str, _Known]] = {}

    def update(self, publication: Publication, person: str, stamp: float, now: float, expires: float) -> list[Fields]:
        """Fields of a moveit_msgs/CollisionObject for every limb and part.

        Args:
            publication: limbs that are not known in it keep the object they have until that expires.
            person: name for the objects' ids.
            stamp: for the headers [s].
            now, expires: when it is, and when what is predicted has passed [s], on one clock.
        """
        frame = publication.frame.frame_id
        known = self._known.setdefault(publication.key, {})
        header = {"stamp": stamp, "frame_id": frame}
        changes = []
        for name, capsule in self._capsules(publication):
            id_ = f"kinecast_{person}_{name}"
            had = known.get(id_)
            fields: Fields = {"header": header, "id": id_, "pose": _IDENTITY}
            if had and had.frame == frame and had.holds(capsule) and now - had.added < REFRESH:
                known[id_] = _Known(frame, had.length, had.radius, had.added, expires)
                fields["operation"] = MOVE
            else:
                length, radius = capsule.length + MARGIN, capsule.radius + MARGIN
                known[id_] = _Known(frame, length, radius, now, expires)
                fields["operation"] = ADD
                fields["primitives"] = [
                    {"type": CYLINDER, "dimensions": [length, radius]},
                    {"type": SPHERE, "dimensions": [radius]},
                    {"type": SPHERE, "dimensions": [radius]},
                ]
            fields["primitive_poses"] = _poses(capsule)
            changes.append(fields)
        return changes

    def remove(self, now: float) -> list[Fields]:
        """Fields that remove what has expired; inf removes everything."""
        removed = []
        for key, known in list(self._known.items()):
            for id_ in [id_ for id_, each in known.items() if each.expires <= now]:
                removed.append({"header": {"frame_id": known.pop(id_).frame}, "id": id_, "operation": REMOVE})
            if not known:
                del self._known[key]
        return removed

    def _capsules(self, publication: Publication) -> Iterator[tuple[str, _Capsule]]:
        """A capsule for each limb and part: it holds the limb's tubes at all steps of the part, and between them.

        A capsule is convex, so it holds whatever lies between ends that it holds; neighbouring parts share a step.
        The first one holds the limb as it was seen, too.
        """
        tubes, parts = publication.tubes, self._options.parts
        start, end, radius = tubes.start, tubes.end, tubes.radius
        if not len(radius):
            return
        edges = np.linspace(0, len(radius) - 1, parts + 1).round().astype(int)
        seen = arms_of(publication.frame)
        for limb, (first, last) in enumerate(LIMBS):
            for part, (low, high) in enumerate(pairwise(edges)):
                steps = np.arange(low, high + 1)
                middle = steps[len(steps) // 2]
                away = np.maximum(
                    np.linalg.norm(start[steps, limb] - start[middle, limb], axis=-1),
                    np.linalg.norm(end[steps, limb] - end[middle, limb], axis=-1),
                )
                reach = float((away + radius[steps, limb]).max())
                if part == 0 and np.isfinite(seen[[first, last]]).all():
                    ends = np.stack((start[middle, limb], end[middle, limb]))
                    reach = max(reach, float(np.linalg.norm(seen[[first, last]] - ends, axis=-1).max()))
                if np.isfinite(reach):
                    capsule = _Capsule(start[middle, limb], end[middle, limb], reach + self._options.thickness)
                    yield f"{LIMB_NAMES[limb]}_{part}", capsule


def scene_diff(objects: list[Fields]) -> Fields:
    """Fields of a moveit_msgs/PlanningScene that changes these objects and nothing else."""
    return {"is_diff": True, "robot_state": {"is_diff": True}, "world": {"collision_objects": objects}}


_IDENTITY = {"orientation": {"w": 1.0}}


def _poses(capsule: _Capsule) -> list[Fields]:
    axis = (capsule.end - capsule.start) / (capsule.length or 1.0)
    along = {"position": _point((capsule.start + capsule.end) / 2), "orientation": _from_z_to(axis)}
    return [along, *({"position": _point(end), "orientation": {"w": 1.0}} for end in (capsule.start, capsule.end))]


def _point(xyz: Float[np.ndarray, "3"]) -> Fields:
    x, y, z = xyz.tolist()
    return {"x": x, "y": y, "z": z}


def _from_z_to(axis: Float[np.ndarray, "3"]) -> Fields:
    """The shortest turn of the z axis into a unit vector, as a unit quaternion: (1 + z·d, z × d), made unit."""
    x, y, z = axis.tolist()
    if z < -1 + 1e-9:
        return {"x": 1.0}
    w = float(np.sqrt((1 + z) / 2)) or 1.0
    return {"x": -y / (2 * w), "y": x / (2 * w), "w": w}
