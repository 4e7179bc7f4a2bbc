"""Coordinate frames as TF tells them: who is whose parent, and where now."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.geometry.transforms import from_quaternion, inverse
from kinecast.geometry.transforms import transform as rigid
from kinecast.live.message import FARTHEST, LONGEST_NAME, MessageError

__all__ = ["STALE", "FrameTree", "Lookup", "point", "seconds"]

MOST_FRAMES = 1024
DEEPEST = 64
"""Frames between one and the root of its tree."""
STALE = 0.5
"""A transform that is older than what it is applied to by more than this [s] is not used."""


def seconds(clock: Any) -> float:
    """A ROS time or duration [s]."""
    return float(clock.sec) + 1e-9 * float(clock.nanosec)


def point(xyz: Any) -> list[float | None]:
    """x, y, z of anything that has them [m]."""
    return [float(xyz.x), float(xyz.y), float(xyz.z)]


@dataclass(frozen=True)
class Lookup:
    """Where a frame is in another.

    Attributes:
        T: 4 x 4, from the frame into the other.
        oldest, newest: stamps of the moving transforms it is made of [s]; inf, -inf where all are fixed.
    """

    T: Float[np.ndarray, "4 4"]
    oldest: float
    newest: float


@dataclass(frozen=True)
class _Link:
    parent: str
    T: Float[np.ndarray, "4 4"]
    stamp: float
    fixed: bool


class FrameTree:
    """The newest transform of every frame to its parent."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def __contains__(self, frame: str) -> bool:
        return frame in self._links

    def update(self, message: Any, fixed: bool = False) -> None:
        """Takes a tf2_msgs/TFMessage; one of its transforms that is older than what is known is passed over.

        Args:
            message: as decoded.
            fixed: from `/tf_static`: holds for all times.

        Raises:
            MessageError: a transform that is none, or too many frames; those before it are taken.
        """
        for each in message.transforms:
            child, parent = _name(each.child_frame_id), _name(each.header.frame_id)
            stamp = seconds(each.header.stamp)
            known = self._links.get(child)
            if known is None and len(self._links) >= MOST_FRAMES:
                raise MessageError(f"more than {MOST_FRAMES} coordinate frames")
            if known is None or known.fixed or stamp >= known.stamp or known.stamp - stamp > 1.0:
                self._links[child] = _Link(parent, _transform(each.transform, child), stamp, fixed)

    def root(self, frame: str) -> str:
        """The frame at the top of its tree."""
        *_, last = self._way(frame)
        return last

    def find(self, frame: str, within: str) -> Lookup:
        """Where a frame is within another.

        Raises:
            MessageError: the two are not connected.
        """
        up, down = list(self._way(frame)), list(self._way(within))
        common = next((each for each in up if each in down), None)
        if common is None:
            raise MessageError(f"TF does not say where {frame!r} is in {within!r}")
        T, oldest, newest = np.eye(4), np.inf, -np.inf
        for way, backwards in ((up, False), (down, True)):
            part = np.eye(4)
            for each in way[: way.index(common)]:
                link = self._links[each]
                part = link.T @ part
                if not link.fixed:
                    oldest, newest = min(oldest, link.stamp), max(newest, link.stamp)
            T = inverse(part) @ T if backwards else part
        return Lookup(T, oldest, newest)

    def _way(self, frame: str) -> Iterator[str]:
        for _ in range(DEEPEST):
            yield frame
            if frame not in self._links:
                return
            frame = self._links[frame].parent
        raise MessageError(f"more than {DEEPEST} coordinate frames above one another, or a circle")


def _name(text: str) -> str:
    name = text.lstrip("/")
    if not 0 < len(name) <= LONGEST_NAME or not name.isprintable():
        raise MessageError(f"a frame's name has {len(name)} characters; 1 to {LONGEST_NAME} printable ones are taken")
    return name


def _transform(message: Any, child: str) -> Float[np.ndarray, "4 4"]:
    xyz = np.array(point(message.translation), dtype=np.float64)
    turn = message.rotation
    wxyz = np.array([turn.w, turn.x, turn.y, turn.z])
    whole = np.abs(xyz).max() <= FARTHEST and np.abs(wxyz).max() <= 1.01  # not of a NaN
    if not (whole and 0.99 < np.linalg.norm(wxyz) < 1.01):
        raise MessageError(f"the transform of {child!r} is none: its quaternion's length must be 1")
    return rigid(from_quaternion(wxyz / np.linalg.norm(wxyz)), xyz)
