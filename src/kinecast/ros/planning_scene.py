"""Tubes as collision objects of MoveIt: what a moveit_msgs/PlanningScene diff adds, moves and removes.

A tube is a cylinder with a sphere at each end. Where the shape that MoveIt has still holds it, the object is only
moved: new shapes cost MoveIt more than new poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import arms_of
from kinecast.live.drawing import Fields, points, pose, turn_of_z
from kinecast.live.publication import Publication
from kinecast.types import LIMBS

LIMB_NAMES = ("left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm")
ADD, REMOVE, MOVE = 0, 1, 3  # operations of moveit_msgs/CollisionObject
SPHERE, CYLINDER = 2, 3  # types of shape_msgs/SolidPrimitive
MARGIN = 0.02  # a new shape is larger than its tube by this [m], so that it can be kept for a while
SLACK = 0.06  # a shape that is larger than its tube by more than this [m] is replaced
REFRESH = 1.0  # after so long [s] an object is added anew, for those who came later

Ends = Float[np.ndarray, "2 3"]


class _Object(NamedTuple):
    """What MoveIt has been told of one."""

    frame: str
    length: float
    radius: float
    added: float
    expires: float


class CollisionObjects:
    """The objects of every person in view; see `OutputOptions` for parts and thickness [m]."""

    def __init__(self, parts: int, thickness: float) -> None:
        self._parts, self._thickness = parts, thickness
        self._known: dict[str, _Object] = {}

    def update(self, publication: Publication, person: str, stamp: float, now: float, expires: float) -> list[Fields]:
        """Fields of a moveit_msgs/CollisionObject for every limb and part, with ids from the person's name.

        Limbs that the publication does not know keep the object they have until it expires. Times as in the publisher.
        """
        frame = publication.frame.frame_id
        changes: list[Fields] = []
        for name, ends, radius in self._capsules(publication):
            id_ = f"kinecast_{person}_{name}"
            length = float(np.linalg.norm(ends[1] - ends[0]))
            header = {"stamp": stamp, "frame_id": frame}
            fields = {"header": header, "id": id_, "pose": pose({}), "primitive_poses": _poses(ends)}
            known = self._known.get(id_)
            holds = known and 0 <= known.radius - radius <= SLACK and 0 <= known.length - length <= SLACK
            if known and holds and known.frame == frame and now - known.added < REFRESH:
                self._known[id_] = known._replace(expires=expires)
                changes.append(fields | {"operation": MOVE})
            else:
                self._known[id_] = new = _Object(frame, length + MARGIN, radius + MARGIN, now, expires)
                shapes = [{"type": CYLINDER, "dimensions": [new.length, new.radius]}]
                shapes += [{"type": SPHERE, "dimensions": [new.radius]}] * 2
                changes.append(fields | {"operation": ADD, "primitives": shapes})
        return changes

    def remove(self, now: float) -> list[Fields]:
        """Fields that remove what has expired; inf removes everything."""
        expired = [id_ for id_, each in self._known.items() if each.expires <= now]
        return [{"header": {"frame_id": self._known.pop(id_).frame}, "id": id_, "operation": REMOVE} for id_ in expired]

    def _capsules(self, publication: Publication) -> Iterator[tuple[str, Ends, float]]:
        """A capsule for each part and limb, its ends and radius [m].

        It holds the limb's tubes at all steps of the part, and between them: a capsule is convex, so it holds whatever
        lies between ends that it holds, and neighbouring parts share a step. The first one holds the limb as it was
        seen, too.
        """
        tubes = publication.tubes
        ends = np.stack((tubes.start, tubes.end), axis=-2)  # (T, 4, 2, 3)
        edges = np.linspace(0, len(tubes.radius) - 1, self._parts + 1).round().astype(int)
        for part, (low, high) in enumerate(pairwise(edges)):
            centre = ends[(low + high + 1) // 2]
            away = np.linalg.norm(ends[low : high + 1] - centre, axis=-1).max(axis=-1)
            reach = (away + tubes.radius[low : high + 1]).max(axis=0)
            if part == 0:
                seen = np.linalg.norm(arms_of(publication.frame)[np.array(LIMBS)] - centre, axis=-1).max(axis=-1)
                reach = np.where(np.isfinite(seen), np.maximum(reach, seen), reach)
            for limb in np.flatnonzero(np.isfinite(reach)):
                yield f"{LIMB_NAMES[limb]}_{part}", centre[limb], float(reach[limb]) + self._thickness


def _poses(ends: Ends) -> list[Fields]:
    """Of the cylinder and the spheres."""
    middle, start, end = points(np.vstack((ends.mean(axis=0), ends)))
    return [pose(middle, turn_of_z(ends[1] - ends[0])), pose(start), pose(end)]
