"""Coordinate frames as TF tells them: who is whose parent, and where now."""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.geometry.transforms import from_quaternion, inverse, transform
from kinecast.live.message import FARTHEST, MessageError, name_in

MOST_FRAMES = 1024
DEEPEST = 64  # frames between one and the root of its tree
STALE = 0.5  # a transform that is older than what it is applied to by more than this [s] is not used

Matrix = Float[np.ndarray, "4 4"]
Position = list[float | None]
UNSEEN: Position = [None, None, None]


def seconds(clock: Any) -> float:
    """A ROS time or duration [s]."""
    return float(clock.sec) + 1e-9 * float(clock.nanosec)


def point(xyz: Any) -> Position:
    """x, y, z of anything that has them [m]."""
    return [float(xyz.x), float(xyz.y), float(xyz.z)]


class Lookup(NamedTuple):
    """Where a frame is: T carries points into the frame `within`; stamps of the moving transforms used [s]."""

    T: Matrix
    within: str
    oldest: float
    newest: float


class _Transform(NamedTuple):
    parent: str
    T: Matrix
    stamp: float
    fixed: bool


class TransformTree:
    """The newest transform of every frame to its parent."""

    def __init__(self) -> None:
        self._transforms: dict[str, _Transform] = {}

    def __contains__(self, frame: str) -> bool:
        return frame in self._transforms

    def update(self, message: Any, fixed: bool) -> None:
        """Takes a tf2_msgs/TFMessage; one of its transforms that is older than what is known is passed over.

        Those from `/tf_static` are fixed: they hold for all times. A MessageError for a transform that is none, or too
        many frames; those before it are taken.
        """
        for each in message.transforms:
            names = each.child_frame_id, each.header.frame_id
            child, parent = (name_in("frame", name.lstrip("/")) for name in names)
            stamp = seconds(each.header.stamp)
            known = self._transforms.get(child)
            if known is None and len(self._transforms) >= MOST_FRAMES:
                raise MessageError(f"more than {MOST_FRAMES} coordinate frames")
            if known is None or known.fixed or stamp >= known.stamp or known.stamp - stamp > 1.0:
                self._transforms[child] = _Transform(parent, _matrix(each.transform, child), stamp, fixed)

    def lookup(self, frame: str, within: str, stamp: float = -np.inf) -> Lookup:
        """Where a frame is within another, "" for the root of its tree, when it is needed [s].

        A MessageError where the two are not connected, or were told more than `STALE` before the stamp.
        """
        up = self._chain(frame)
        if not within and len(up) == 1:
            raise MessageError(f"TF does not say where {frame!r} is")
        within = within or up[-1]
        down = self._chain(within)
        common = next((each for each in up if each in down), None)
        if common is None:
            raise MessageError(f"TF does not say where {frame!r} is in {within!r}")
        up, down = up[: up.index(common)], down[: down.index(common)]
        moving = [known.stamp for known in map(self._transforms.__getitem__, up + down) if not known.fixed]
        if (age := stamp - min(moving, default=np.inf)) > STALE:
            raise MessageError(f"TF does not say where {frame!r} is in {within!r}: it said so {age:.1f} s before")
        T_down, T_up = (reduce(lambda T, each: self._transforms[each].T @ T, chain, np.eye(4)) for chain in (down, up))
        return Lookup(inverse(T_down) @ T_up, within, min(moving, default=np.inf), max(moving, default=-np.inf))

    def _chain(self, frame: str) -> list[str]:
        """A frame, its parent, …, the root."""
        chain = [frame]
        while chain[-1] in self._transforms:
            if len(chain) >= DEEPEST:
                raise MessageError(f"more than {DEEPEST} coordinate frames above one another, or a circle")
            chain.append(self._transforms[chain[-1]].parent)
        return chain


def _matrix(message: Any, child: str) -> Matrix:
    xyz, turn = np.array(point(message.translation), dtype=np.float64), message.rotation
    wxyz = np.array([turn.w, turn.x, turn.y, turn.z])
    near = np.abs(xyz).max() <= FARTHEST and np.abs(wxyz).max() <= 1.01  # not of a NaN
    if not (near and 0.99 < np.linalg.norm(wxyz) < 1.01):
        raise MessageError(f"the transform of {child!r} is none: its quaternion's length must be 1")
    return transform(from_quaternion(wxyz), xyz)
